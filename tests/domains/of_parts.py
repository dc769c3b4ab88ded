"""Domains of the parameters of Hamiltonians, own systems, forces, schemes, events and initial states, as documented."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from domains.kinds import (
    Case,
    Domain,
    case_of,
    choice,
    flag,
    instance,
    not_negative,
    one_of,
    optional,
    positive,
    real,
    structured,
    title,
    vector,
    whole,
)
from domains.of_systems import FULL, INDEFINITE, SKEWED

SO3, BODY = co.algebras.so(3), co.systems.rigid_body((1.0, 2.0, 2.5))
FLUID, SCALAR = co.systems.sphere_euler(N=6), co.systems.passive_scalar(N=6)
MATRICES, SU3 = co.MatrixAlgebra("so", 3), co.MatrixAlgebra("su", 3)
WEIGHTS, LARGE = (co.systems.Weights(np.ones((n, n))) for n in (3, 4))
SQUARE = co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1.0})
CUBIC = co.Polynomial({(3, 0, 0): 1.0})
SPHERICAL = co.Polynomial({(2, 0, 0): 1.0, (0, 2, 0): 1.0, (0, 0, 2): 1.0})


def value(x):
    return 0.5 * x[0] * x[0]


def gradient(x):
    return np.array([x[0], 0.0, 0.0])


def hessian(x):
    return np.diag(np.array([1.0, 0.0, 0.0]))


def of_time(x, t):
    return x[0] * t


def of_nothing():
    return 0.0


def structure(x):
    return np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def third(x):
    return x[2]


def flow(x, t, tau):
    return x + tau


SIN, COS = (math.sin, math.cos), (math.cos, lambda y: -math.sin(y))
ONE = co.Quadratic(1.0)
NOT_ONE_MATRIX = (np.ones((2, 2, 2)), np.eye(2), np.eye(4))
METRIC = vector((0.5, 1.0, 0.0), not_negative(), 0, 2.0, FULL, np.zeros((3, 3)), number=True).plus(
    outside=(*NOT_ONE_MATRIX, SKEWED, INDEFINITE, -1.0, -5e-324, math.inf)
)
DIM = whole(1).first(3, np.int64(3)).plus(outside=(2, 4)).but_called(r"\bdim\b|\bdimension [24]\b|\([24], [24]\)")
NUMBERS = Domain((None,), ({"a": 1.0}, 1.0, True, ""))
# By the name of the parameter, where classes share it.
SHARED = {
    "sign": one_of(1, -1),
    "energy_sign": one_of(1, -1),
    "name": optional(title("mine")),
    "parameters": structured((None, {}, {"a": 1.0}), ("a",), keep=(None, "", {})),
    "exact": optional(instance(lambda x0, t, attitude=False: x0)).but_called("exact"),
    "powers": whole(0, usual=2),
    "alpha": not_negative(),
    "metric": METRIC,
    "layer": choice("vorticity", "carried"),
    "seed": whole(0, 2**62, usual=1),
    "stream": whole(0, 2**62, usual=1),
    "keeps_casimirs": flag(),
    "backward": flag(),
}
KEPT = (None, {}, {"C": SPHERICAL}, {"C": co.Quadratic(2.0)})
NOT_KEPT = ({"C": SQUARE}, {"C": co.Polynomial({(2,): 1.0})}, {"C": 1.0}, {"C": None}, [], "C", 1.0, True, 1j)
INVARIANTS = Domain(KEPT, NOT_KEPT, "[cC]asimir|[iI]ntegral")
ENERGY = (
    instance(ONE, SQUARE)
    .but_called(r"\bHamiltonian\b|^M has|^the polynomial")
    .plus(outside=(co.Quadratic((1.0, 2.0)),))
)

HAMILTONIANS = {
    "Quadratic": Case(co.Quadratic, {
        "M": vector((1.0, -0.5, 0.0), real(), 0.5, 0, FULL, INDEFINITE, number=True).plus(
            outside=(SKEWED, np.eye(3)[:2], np.ones((2, 2, 2)))),
        "linear": optional(vector((1.0, -0.5, 0.0), real())).plus(outside=(np.eye(3),)),
        "constant": real(),
    }, then=lambda H: H.bind(3)),
    "Quadratic.from_polynomial": Case(co.Quadratic.from_polynomial, {
        "polynomial": instance(SQUARE).plus(outside=(CUBIC,)),
    }),
    "Polynomial": Case(co.Polynomial, {
        "monomials": structured(
            ({(2, 0, 0): 0.5, (0, 1, 1): -1}, {}, "0.5*x1^2 - x2*x3", {(0, 0, 0): 0.001}),
            ({(1, 2): 1.0}, {(1, 0, 0): 1.0, (1, 0): 1.0}, {(-1, 0, 0): 1.0}, {(0.5, 0, 0): 1.0}, {(True, 0, 0): 1.0},
             {(1, 0, 0): math.nan}, {(1, 0, 0): math.inf}, {(1, 0, 0): 1j}, {(1, 0, 0): True}, {(1, 0, 0): "1"},
             {"x1": 1.0}, {1: 1.0}, "x4", "x1^-1", "x1 +"),
            "exponents|coefficient|coordinate|monomials|cannot be parsed|power", keep=({},)),
        "dim": optional(DIM),
        "basis": Domain((None,), (("a", "b", "c"), ["x"], "", 1.0, True, ("a", "a", "b"))),
        "parameters": NUMBERS,
    }),
    "Polynomial.variable": Case(co.Polynomial.variable, {
        "i": whole(0, 2).but_called("index of a coordinate"), "dim": whole(1, usual=3),
    }),
    "Invariant": Case(co.Invariant, {
        "value": instance(value, third), "gradient": optional(instance(gradient)), "period": not_negative(),
    }),
    "Separable": Case(co.Separable, {
        "functions": structured(
            ({0: SIN}, {2: (np.sin, np.cos)}, {0: SIN, 1: COS}),
            ({-1: SIN}, {3: SIN}, {0.5: SIN}, {True: SIN}, {0: math.sin}, {0: (math.sin,)}, {0: (math.sin, math.sin)},
             {0: (math.sin, 1.0)}, {"0": SIN}),
            "Separable|[cC]oordinate|H_0"),
    }, then=lambda H: H.bind(3)),
    "SplitHamiltonian": Case(co.SplitHamiltonian, {
        "pieces": structured(
            ([((0,), ONE)], (((0, 2), ONE), ((2,), co.Quadratic(0.5)))),
            ([((-1,), ONE)], [((3,), ONE)], [((0, 0), ONE)], [((0.5,), ONE)], [((True,), ONE)], [(("0",), ONE)],
             [((0, 1), co.Quadratic((1.0, 2.0, 3.0)))], [((0,), 1.0)], [((0,),)], [()]),
            r"\bpieces?\b|SplitHamiltonian"),
    }, then=lambda H: H.bind(3)),
    "Hamiltonian": Case(co.Hamiltonian, {
        "value": instance(value).plus(outside=(of_time, of_nothing, third)),
        "gradient": instance(gradient).plus(outside=(of_time, of_nothing, value)),
        "hessian": optional(instance(hessian)).plus(outside=(of_time, gradient, structure)),
    }, then=lambda H: H.bind(3)),
    "formula": Case(co.formula, {
        "text": structured(
            ("x1^2/2 - (x2 + 1)*x3", "cos(x1)", "a*x1", "1"), ("x4", "x1 +", "x1/0", "f(x1)", "sqrt(-1)"),
            "formula|coordinate|cannot be parsed|divides|function|finite", keep=({},)),
        "dim": DIM.plus(without=(4,)).but_called(r"\bdim\b|coordinate x3"),
        "basis": Domain((None, ("x1", "x2", "x3")), (["x"], "", 1.0, True, ("a", "a", "b"))),
        "parameters": Domain(({"a": 2.0}, None, {}, {"a": 1, "omega": 0.5}),
            ([], "a", 1.0, True, {"x1": 1.0}, {1: 1.0}, {"a": math.nan}, {"a": "1"}, {"a b": 1.0}), "parameter"),
    }),
}  # fmt: skip

OWN_SYSTEMS = {
    "LiePoissonSystem": case_of(co.LiePoissonSystem, SHARED,
        algebra=instance(SO3, co.algebras.sl(2)),
        hamiltonian=ENERGY.plus(value, "x1^2/2 + cos(x2)", outside=(co.Polynomial({(1,): 1.0}), "x4")),
        casimirs=INVARIANTS,
        integrals=INVARIANTS,
        representation=structured((None, SO3.representation), (2 * SO3.representation, np.ones((3, 3)),
            SO3.representation[:2], np.full((3, 3, 3), math.nan), SO3.representation * 1j), keep=(None, {})),
        layout=structured((None, {"lattice": "chain", "shape": 1}), ("chain",), keep=(None, "", {})),
        usual={"hamiltonian": co.Quadratic((1.0, 2.0, 3.0))},
    ),
    "PoissonSystem": case_of(co.PoissonSystem, SHARED,
        structure_matrix=instance(structure).plus(outside=(lambda x: np.eye(3), value, gradient, of_nothing)),
        hamiltonian=ENERGY,
        dim=DIM,
        derivative=optional(instance(lambda x: np.zeros((3, 3, 3)))).plus(outside=(structure, of_nothing)),
        casimirs=INVARIANTS.first(None, {}, {"C": co.Polynomial({(0, 0, 1): 1.0})}),
    ),
    "MatrixSystem": case_of(co.MatrixSystem, SHARED,
        algebra=instance(MATRICES, SU3),
        stream=instance(lambda W: 2.0 * W, WEIGHTS).plus(outside=(of_nothing, np.trace, np.abs)),
        linear=structured((None, np.zeros((3, 3)), [[0, 1, 0], [-1, 0, 2], [0, -2, 0]]),
            (np.eye(3), np.zeros((2, 2)), np.zeros(3), np.full((3, 3), math.nan), np.eye(3) * 1j), keep=(None, {})),
        energy=optional(instance(lambda W: -np.trace(W @ W))).plus(outside=(of_nothing, np.linalg.norm)),
        name=title("mine"),
        usual={"energy": None, "exact": None},
    ),
    "TwoLayerSystem": case_of(co.TwoLayerSystem, SHARED,
        algebra=instance(MATRICES, SU3).plus(outside=(co.MatrixAlgebra("gl", 3),)),
        stream=instance(WEIGHTS).plus(outside=(LARGE,)),
        second_stream=optional(instance(WEIGHTS)).plus(outside=(LARGE,)).but_called(r"\b(second_)?stream\b"),
        name=title("mine"),
    ),
    "batch": Case(co.batch, {
        "systems": structured(((BODY, BODY), [BODY], iter([BODY, co.systems.rigid_body()])),
            ((), (BODY, 1.0), (BODY, co.systems.heavy_top()), (BODY, co.systems.paper_a37())),
            r"\bsystems\b|\bthe batch\b"),
    }),
}  # fmt: skip

STRENGTHS = (math.nan, math.inf, None, "1", "", 1j, {}, [], np.ones((3, 3, 3)))
OF_SPINS = vector((0.5,), not_negative(), 0.5, 0, number=True)  # of a body, which has one
LAYER = Domain(("vorticity", "carried", 0, 63), ("vorticityx", "", None, True, 64, -1, 1.5, 1j, math.nan, []))
OF_FORCES = {
    "BetaPlane": {"beta": real()},
    "Friction": {"rate": real().plus(lambda l: l * 0.5, outside=(of_nothing, lambda l: math.nan, lambda l: "1"))},
    "Gilbert": {"alpha": OF_SPINS, "temperature": OF_SPINS, "boltzmann": optional(positive())},
    "HamiltonianNoise": {
        "hamiltonians": structured(
            (np.eye(3), ["x1", "x2^2/2"], "x3", SQUARE, (0.5, 0, -1.0)),
            (np.eye(4), ["x4"], np.ones((1, 3, 3)), [[1.0, math.nan, 0.0]], of_nothing),
            "hamiltonians|Hamiltonian",
        ),
        "strength": Domain((0.5, 0, -1.0, (0.5, 0.0, 1.0), FULL), (*STRENGTHS, (1.0, 2.0))),
        "levels": whole(0, 20, tried=2),
    },
    "HeatBath": {"temperature": OF_SPINS, "boltzmann": optional(positive())},
    "Langevin": {
        "rate": vector((0.5, 0.1, 0.0), not_negative(), 0.5, 0, number=True).plus(outside=NOT_ONE_MATRIX),
        "temperature": not_negative(),
    },
    "LinearDamping": {
        "rate": vector((0.5, -1.0, 0.0), real(), 0.5, 0, np.eye(3), SKEWED, number=True).plus(outside=NOT_ONE_MATRIX),
        "toward": vector((0.5, -1.0, 0.0), real(), 0.5, number=True),
    },
    "OwnForce": {"function": instance(flow).plus(outside=(of_nothing, of_time)), "name": title("wind")},
    "RandomField": {
        "strength": Domain((0.5, 0, (0.5, 0.0, 1.0)), (*STRENGTHS, (1.0, 2.0), FULL)),
        "levels": whole(0, 20, tried=2),
    },
    "RandomForcing": {
        "energy_rate": not_negative(),
        "band": vector((2.0, 3.0), real(), (2, 2), [1, 4.5]).plus(outside=((3, 2), (0, 2), (-1, 2))),
        "layer": LAYER,
    },
    "SelectiveDecay": {"rate": not_negative()},
    "TransportNoise": {
        "degrees": Domain(((1, 2), [1, 3]), ((1, 1), (0, 1), (1.5, 2), (), "1", 1j, math.nan)),
        "strength": not_negative(),
        "spectrum": Domain((None, (1.0, 2.0), [0, 1]), ((1.0,), (-1.0, 2.0), (0, 0), 1.0, "1", (math.nan, 1.0))),
    },
    "Torque": {
        "torque": vector((0.5, -1.0, 0.0), real(), lambda t: np.array([0.0, 0.0, t])).plus(
            outside=(of_nothing, flow, np.eye(3), lambda t: t)
        ),
        "arguments": Domain((None, {}), ({"gain": 0.5}, 3, "gain", math.nan, [1.0])),
    },
    "Viscosity": {"nu": not_negative(), "power": whole(1, 32), "rotation": flag(), "layer": LAYER},
}
PLATES = {
    "areas": structured(((0.5,), [0]), ((), (-0.5,), (1.0, 2.0), 0.5, (math.inf,), ("1",), (1j,))),
    "normals": structured(
        (((0, 0.6, 0.8),), np.eye(3)[:1]), (((0, 0, 2),), (0, 0, 1), ((0, 0, math.nan),), (("1", 0, 0),))
    ),
    "centres": structured((((0, 0.5, -0.5),), np.zeros((1, 3))), ((0, 0, 1), ((0, 0, math.inf),), ((1j, 0, 0),))),
}
IN_SPACE = vector((0.5, -1.0, 0.25), real(), lambda t: np.array([1.0, 0.0, t])).plus(
    outside=(of_nothing, flow, np.eye(3), lambda t: t)
)
GAINS = vector((0.5, 0.25, 1.0), real(), 0.5, 0, FULL, number=True).plus(
    outside=(np.eye(2), (1.0, 2.0), np.ones((2, 2, 2)))
)
LIMITS = optional(vector((0.5, 0.25, 1.0), positive(), 0.5, number=True)).plus(outside=(np.eye(3), (1.0, 2.0)))
SHARES = Domain((0.25, 0, 0.5, (0.3,)), (-0.1, 1.1, (0.1, 0.2), math.nan, "1", 1j), "specular|diffuse")
ERRORS = Domain(
    (None, {}, {"attitude": 0.5}, {"angular_velocity": (0.5, 0, 2.0), "attitude": 1}),
    (
        {"attitude": 1.1},
        {"attitude": -0.1},
        {"omega": 0.1},
        {"attitude": (0.1, 0.2)},
        {"attitude": math.nan},
        3,
        "noise",
    ),
    "noise|bias",
)
HOLDING = {
    "law": instance(co.forces.Pointing(0.5, 1.0), co.forces.Torque((0.0, 0.0, 1.0)))
    .plus(outside=(co.forces.LinearDamping(0.5), co.forces.Torque((1.0, 2.0))))
    .but_called("law"),
    "period": positive(),
    "first": whole(0, usual=0, tried=0),
    "max_torque": LIMITS,
    "memory": Domain((None, {}), ({"integral": 3}, {"integral": 0}, {"i1": 1}, {"held": 1}, 3, "integral", math.nan)),
    "delay": whole(0, 1000, usual=0, tried=2),
    "noise": ERRORS,
    "bias": ERRORS,
    "seed": optional(whole(0, 2**62, usual=1)),
    "resolution": Domain((None, 0.25, 0.125), (0, -0.25, 0.3, math.nan, math.inf, "1", 1j, np.eye(3), (1.0, 2.0))),
}
PLACE = Domain((None,), ((1.0, 2.0), math.nan, "1", flow))
FRICTION = vector((0.5, 0.25, 1.0), not_negative(), 0.5, number=True).plus(outside=(np.eye(3), (1.0, 2.0), None))
ON_BODIES = {
    "GravityGradient": {
        "mu": real(),
        "position": IN_SPACE.plus(outside=((0, 0, 0),)),
        "quadrupole": GAINS,
    },
    "MagneticDipole": {
        "moment": vector((0.5, -1.0, 0.25), real()),
        "B": IN_SPACE,
        "position": PLACE,
    },
    "BDot": {"gain": real(), "B": IN_SPACE, "position": PLACE, "max_moment": LIMITS},
    "Magnetorquers": HOLDING
    | {"B": IN_SPACE, "position": PLACE, "max_moment": LIMITS, "commands": choice("torque", "moment")},
    "WheelFriction": {
        "viscous": FRICTION,
        "coulomb": FRICTION,
        "transition_speed": vector((0.5, 0.25, 1.0), positive(), 0.5, number=True).plus(
            outside=(np.eye(3), (1.0, 2.0), None)
        ),
    },
    "SolarPressure": {"pressure": real(), "sun": IN_SPACE, **PLATES, "specular": SHARES, "diffuse": SHARES},
    "Drag": {"density": real(), "velocity": IN_SPACE, **PLATES, "coefficient": real()},
    "RandomTorque": {
        "strength": Domain((0.5, 0, (0.5, 0.0, 1.0), FULL), (*STRENGTHS, (1.0, 2.0))),
        "axes": choice("body", "space"),
    },
    "Pointing": {
        "stiffness": GAINS,
        "damping": GAINS,
        "attitude": Domain(
            (None, (0, 0, 0, 1), np.eye(3)), (np.ones((3, 3)), (0, 0, 0, 2), 1.0, "1", of_nothing, flow)
        ),
        "rate": optional(IN_SPACE),
        "error": choice("sine", "quaternion"),
        "max_torque": LIMITS,
    },
    "Sampled": HOLDING,
    "ReactionWheels": HOLDING | {"max_momentum": LIMITS},
    "ControlMomentGyros": HOLDING | {"max_rate": optional(positive()), "regularization": positive()},
    "Thrusters": HOLDING
    | {
        "max_torque": vector((0.5, 0.25, 1.0), positive(), 0.5, number=True).plus(outside=(np.eye(3), (1.0, 2.0))),
        "min_impulse": vector((0.5, 0.25, 1.0), not_negative(), 0.5, number=True).plus(outside=(np.eye(3), (1.0, 2.0))),
    },
}
OF_FORCES |= ON_BODIES
SATELLITE = co.systems.body((1.0, 2.0, 2.5), wheels=0.01 * np.eye(3), gyros=[[(1, 0, 0), (0, 1, 0)]])
ON_FLUIDS = {"BetaPlane", "RandomForcing", "TransportNoise", "Viscosity"}
TARGETS = {"Friction": SCALAR} | dict.fromkeys(ON_BODIES, SATELLITE)
FORCES = {
    name: case_of(getattr(co.forces, name), SHARED, **OF_FORCES.get(name, {}),
        then=None if name in ON_FLUIDS else TARGETS.get(name, BODY).with_forces)
    for name in co.forces.names()
}  # fmt: skip

BASE = instance(co.Splitting(), co.GaussLegendre(1)).plus(outside=(co.Splitting,))
SYMMETRIC = BASE.plus(outside=(co.Splitting(order=1), co.ExplicitRungeKutta()))
ORDERS = one_of(2, 4, 6, 8, 10).but_called(r"\borders?\b")
OF_SCHEMES = {
    "CommutatorFree": {"order": one_of(2, 3, 4)},
    "Composition": {
        "base": SYMMETRIC,
        "coefficients": vector((0.25, 0.5, 0.25), real(), (1.0,), any_length=True).plus(
            outside=((0.5, 0.25), (1.0, 1.0))),
    },
    "ExplicitRungeKutta": {"name": choice("runge2", "rk4").but_called(r"\bname\b|Runge-Kutta method")},
    "IsospectralGauss": {"stages": whole(1, 8)},
    "LineSplitting": {"order": ORDERS},
    "ModifiedGaussLegendre": {"freeze": choice("structure", "gradient")},
    "Projected": {"base": BASE.plus(co.ExplicitRungeKutta())},
    "ReversibleSteps": {
        "base": SYMMETRIC,
        "stride": positive(),
        "speed": structured((None, ONE, SQUARE, [[1.0, [2, 0, 0]]]), ("fast", math.nan, value, [[1.0, [-1, 0, 0]]],
            [[math.nan, [2, 0, 0]]], [[1.0]], [1.0]), keep=(None, [])),
    },
    "Splitting": {
        "order": ORDERS.plus(1, without=(1,)),
        "scheme": optional(choice("strang", "yoshida4", "suzuki4")),
        "adjoint": flag().first(False),
        "usual": {"scheme": None},
    },
    "Taylor": {
        "order": optional(whole(1, 64)),
        "projected": flag(),
        "tolerance": optional(positive(1e-6, least=1e-18, most=0.1)),
    },
}  # fmt: skip
STAGES = {
    "stages": whole(1, usual=2),
    "iterations": optional(whole(1)),
    "parts": structured(
        ("auto", "coordinates", "free_body", "bonds", ((0,), (1,), (2,)), [[0, 1], [2]]),
        ("autox", "Auto", [[-1], [0]], [[0, 0]], [[0.5]], [["a"]], [[True]], [0, 1]),
        keep=([],),
    ),
    "compensated": optional(flag()),
    "rotation": choice("exact", "rational"),
}
CLASSES = {name: co.methods.registry.scheme(name) for name in co.methods.names()}
SCHEMES = {
    **{name: case_of(scheme, STAGES, **OF_SCHEMES.get(name, {})) for name, scheme in CLASSES.items()},
    "Splitting.tuned": Case(co.Splitting.tuned, {
        "system": instance(BODY).plus(outside=(co.batch([BODY]), co.systems.toda_ring(3).with_forces)),
        "x0": vector((0.5, 1.0, -0.25), real()).first((0.5, 1.0, -0.25), np.ones((2, 3))),
        "order": ORDERS.first(2, 1).plus(without=(1,)),
    }),
    "Forced": Case(co.methods.Forced, {"base": BASE}),
    "even_order": Case(co.methods.even_order, {
        "base": BASE.first(co.Splitting(order=1), co.Splitting()),
        "order": one_of(2, 4, 6, 8, 10, 12),
        "jump": choice("triple", "suzuki"),
    }),
    "Properties": case_of(co.methods.Properties, dict.fromkeys(("poisson", "energy", "reversible"), flag()),
        casimirs=choice("all", "polynomial", "quadratic", "none").but_called("Casimirs"),
        attitude=choice("every representation", "coadjoint", "group", "integrated", "none"),
        broken_by=Domain(((), ("energy: LinearDamping",)), (None, "energy", 1.0, True, (1.0,), 1j)),
    ),
}  # fmt: skip
EVENTS = {
    "Event": Case(co.Event, {
        "g": Domain((0, 2, "m1", SQUARE, ONE, value, np.int64(1)),
            (-1, 0.5, True, None, 1j, math.nan, [], {}, (0, 1), of_nothing), r"\bg\b|coordinate of an event"),
        "direction": one_of(0, 1, -1),
        "count": optional(whole(1)),
        "terminal": flag(),
        "name": optional(title("turn")),
    }),
}  # fmt: skip

SPHERE, TORUS = co.systems.sphere_euler(N=8), co.systems.torus_euler(N=9)
HALF = math.pi / 2


def each(domain, *per_place):
    """A number for all places, or one for each of two."""
    wrong = ([1.0], [1.0, 1.0, 1.0], [[1.0, 1.0]], [1.0, math.nan], [1.0, 1j], [1.0, True])
    return domain.plus(*per_place, without=([1.0, 2.0],), outside=wrong)


PLACES = vector([[0.5, 1.0], [-0.25, 4.0]], real(), any_length=True).plus(outside=([0.5, 1.0], [[0.5, 1.0, 0.0]]))
LATITUDES = PLACES.plus(
    [[HALF, 0.0], [-HALF, 0.0]], outside=([[np.nextafter(HALF, 2.0), 0.0], [0.0, 0.0]], [[-2, 0]] * 2)
)
POSITIVES = each(positive(), [1.0, 0.5], (1, 2)).plus(outside=([1.0, 0.0], [-1.0, 1.0]))
OF_STATES = {
    "seed": whole(0, usual=1, tried=2**63),
    "degrees": Domain(
        ((2, 4), (1, 1), [3, 4], None),
        ((0, 2), (-1, 2), (3, 2), (2, 99), (2.5, 3), (2,), (2, 3, 4), (True, 2), ("1", 2), 3, "", "2", 1j, math.nan,
         (2, 2**63)),
    ),
    "spectrum": Domain(
        (None, lambda degrees: degrees**-3.0, [0.0, 0.0, 1.0, 0.5, 0.25], np.array([0.0, 1.0, 0.0, 0.0, 2.0])),
        ([0.0, 0.0, -1.0, 1.0, 1.0], [0.0] * 5, [0.0, 0.0, math.nan, 1.0, 1.0], [0.0, 1j, 1.0, 1.0, 1.0],
         np.ones((2, 5)), "", "flat", 1j, True, {}, math.cos, lambda l: -l, lambda l: l[1:], lambda l: l * math.nan),
    ),
    "energy": optional(positive()),
    "enstrophy": optional(positive()),
    "strengths": each(real(), [1.0, -2.0], (0, 1)),
    "widths": POSITIVES,
    "radii": POSITIVES.plus(3.1, outside=(math.pi, 4.0)).but_called(r"\bradii\b|^a radius\b"),
    "vorticities": each(real(), [1.0, -2.0], (0, 1)),
    "edge": optional(not_negative()),
    "speed": positive(1.0),
    "perturbation": real(0.01),
    "band": vector((0.5, 1.0), real(), (-1.5, 1.5)).plus(outside=((1.0, 0.5), (0.5, 0.5), (-1.6, 0.0), (0.0, 1.6))),
    "width": positive(0.3, most=0.5),
    "waves": whole(1, 4, usual=2),
    "degree": whole(2, 7, usual=5),
    "order": whole(0, 5, usual=4),
    **dict.fromkeys(("zonal", "wave", "longitude"), real(1.0)),
}  # fmt: skip
USUAL = {"random": {"degrees": (2, 4), "energy": None, "enstrophy": None}, "rossby_haurwitz": {"order": 2}}
STATES = {
    f"{surface}, {name}": case_of(getattr(system, name), OF_STATES | {"places": places}, usual=USUAL.get(name))
    for surface, system, places in (("sphere", SPHERE, LATITUDES), ("torus", TORUS, PLACES))
    for name in ("random", "blobs", "patches", "zonal_jet", "rossby_haurwitz")
    if hasattr(system, name)
}
