"""Domains of the parameters of Hamiltonians, of systems made of them, and of forces, as documented."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from domains.kinds import (
    Case,
    Domain,
    choice,
    flag,
    function,
    instance,
    not_negative,
    one_of,
    optional,
    real,
    title,
    vector,
    whole,
)
from domains.of_systems import FULL, INDEFINITE, SKEWED

SO3, BODY = co.algebras.so(3), co.systems.rigid_body((1.0, 2.0, 2.5))
FLUID = co.systems.sphere_euler(N=6)
SCALAR = co.systems.passive_scalar(N=6)
MATRICES = co.MatrixAlgebra("so", 3)
WEIGHTS, LARGE = (co.systems.Weights(np.ones((n, n))) for n in (3, 4))
SQUARE = co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1.0})
CUBIC = co.Polynomial({(3, 0, 0): 1.0})


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


def constant(x):
    return np.zeros((3, 3, 3))


def symmetric(x):
    return np.eye(3)


def third(x):
    return x[2]


def twice(W):
    return 2.0 * W


def half(W):
    return -np.trace(W @ W)


def flow(x, t, tau):
    return x + tau


def torque(t):
    return np.array([0.0, 0.0, t])


def rate_of(l):
    return l * 0.5


def exact(x0, t, attitude=False):
    return x0


NOT_ONE_MATRIX = (np.ones((2, 2, 2)), np.eye(2), np.eye(4))
SIGN = one_of(1, -1)
RATES = vector((0.5, -1.0, 0.0), real(), 0.5, 0, np.eye(3), SKEWED, number=True).plus(outside=NOT_ONE_MATRIX)
METRIC = vector((0.5, 1.0, 0.0), not_negative(), 0, 2.0, FULL, np.zeros((3, 3)), number=True).plus(
    outside=(*NOT_ONE_MATRIX, SKEWED, INDEFINITE, -1.0, -5e-324, math.inf)
)
LAYER = choice("vorticity", "carried")
SEED = whole(0, 2**62, usual=1)
OF_H = r"\bHamiltonian\b|^M has|^the polynomial"
INVARIANTS = Domain(
    (None, {}, {"C": co.Polynomial({(2, 0, 0): 1.0, (0, 2, 0): 1.0, (0, 0, 2): 1.0})}, {"C": co.Quadratic(2.0)}),
    (
        {"C": SQUARE},
        {"C": co.Polynomial({(2,): 1.0})},
        {"C": 1.0},
        {"C": None},
        [],
        "C",
        1.0,
        True,
        1j,
    ),
    "[cC]asimir|[iI]ntegral",
)
DIM = whole(1).first(3, np.int64(3)).plus(outside=(2, 4)).but_called(r"\bdim\b|\bdimension [24]\b|\([24], [24]\)")
PARAMETERS = Domain((None, {}, {"a": 1.0}), ([], "a", 1.0, True, 1j))
EXACT = optional(function(exact)).but_called("exact")
NAME = optional(title("mine"))
POWERS = whole(0, usual=2)

HAMILTONIANS = {
    "Quadratic": Case(co.Quadratic, {
        "M": vector((1.0, -0.5, 0.0), real(), 0.5, 0, FULL, INDEFINITE, number=True).plus(outside=(SKEWED,
            np.eye(3)[:2], np.ones((2, 2, 2)))),
        "linear": optional(vector((1.0, -0.5, 0.0), real())).plus(outside=(np.eye(3),)),
        "constant": real(),
    }, then=lambda H: H.bind(3)),
    "Quadratic.from_polynomial": Case(co.Quadratic.from_polynomial, {
        "polynomial": instance(SQUARE).plus(outside=(CUBIC,)),
    }),
    "Polynomial": Case(co.Polynomial, {
        "monomials": Domain(({(2, 0, 0): 0.5, (0, 1, 1): -1}, {}, "0.5*x1^2 - x2*x3", {(0, 0, 0): 0.001}), ({(1, 2):
            1.0}, {(1, 0, 0): 1.0, (1, 0): 1.0}, {(-1, 0, 0): 1.0}, {(0.5, 0, 0): 1.0}, {(True, 0, 0): 1.0}, {(1, 0,
            0): math.nan}, {(1, 0, 0): math.inf}, {(1, 0, 0): 1j}, {(1, 0, 0): True}, {(1, 0, 0): "1"}, {"x1": 1.0},
            {1: 1.0}, "", "x4", "x1^-1", "x1 +", None, 1.0, True, [], 1j),
            "exponents|coefficient|coordinate|monomials|cannot be parsed|power"),
        "dim": optional(DIM),
        "basis": Domain((None,), (("a", "b", "c"), ["x"], "", 1.0, True, ("a", "a", "b"))),
        "parameters": Domain((None,), ({"a": 1.0}, 1.0, True, "")),
    }),
    "Polynomial.variable": Case(co.Polynomial.variable, {
        "i": whole(0, 2).but_called("index of a coordinate"),
        "dim": whole(1, usual=3),
    }),
    "Invariant": Case(co.Invariant, {
        "value": function(value, third),
        "gradient": optional(function(gradient)),
        "period": not_negative(),
    }),
    "Separable": Case(co.Separable, {
        "functions": Domain(({0: (math.sin, math.cos)}, {2: (np.sin, np.cos)}, {0: (math.sin, math.cos), 1: (math.cos,
            lambda y: -math.sin(y))}), ({-1: (math.sin, math.cos)}, {3: (math.sin, math.cos)}, {0.5: (math.sin,
            math.cos)}, {True: (math.sin, math.cos)}, {0: math.sin}, {0: (math.sin,)}, {0: (math.sin, math.sin)}, {0:
            (math.sin, 1.0)}, {"0": (math.sin, math.cos)}, None, [], "", 1.0, True, 1j, {}),
            "Separable|[cC]oordinate|H_0"),
    }, then=lambda H: H.bind(3)),
    "SplitHamiltonian": Case(co.SplitHamiltonian, {
        "pieces": Domain(([((0,), co.Quadratic(1.0))], (((0, 2), co.Quadratic(1.0)), ((2,), co.Quadratic(0.5)))),
            ([((-1,), co.Quadratic(1.0))], [((3,), co.Quadratic(1.0))], [((0, 0), co.Quadratic(1.0))], [((0.5,),
            co.Quadratic(1.0))], [((0, 1), co.Quadratic((1.0, 2.0, 3.0)))], [((0,), 1.0)], [((0,),)], [((True,),
            co.Quadratic(1.0))], [(("0",), co.Quadratic(1.0))], [], None, "", 1.0, True, 1j, {}, [()]),
            "\\bpieces?\\b|SplitHamiltonian"),
    }, then=lambda H: H.bind(3)),
    "Hamiltonian": Case(co.Hamiltonian, {
        "value": function(value).plus(outside=(of_time, of_nothing, third)),
        "gradient": function(gradient).plus(outside=(of_time, of_nothing, value)),
        "hessian": optional(function(hessian)).plus(outside=(of_time, gradient, structure)),
    }, then=lambda H: H.bind(3)),
    "formula": Case(co.formula, {
        "text": Domain(("x1^2/2 - (x2 + 1)*x3", "cos(x1)", "a*x1", "1"), ("", "x4", "x1 +", "x1/0", "f(x1)",
            "sqrt(-1)", None, 1.0, True, [], 1j), "formula|coordinate|cannot be parsed|divides|function|finite"),
        "dim": DIM.plus(without=(2, 4), outside=(2,)).but_called("\\bdim\\b|coordinate x3"),
        "basis": Domain((None, ("x1", "x2", "x3")), (["x"], "", 1.0, True, ("a", "a", "b"))),
        "parameters": Domain(({"a": 2.0}, None, {}, {"a": 1, "omega": 0.5}), ([], "a", 1.0, True, {"x1": 1.0}, {1:
            1.0}, {"a": math.nan}, {"a": "1"}, {"a b": 1.0}), "parameter"),
    }),
}  # fmt: skip

OWN_SYSTEMS = {
    "LiePoissonSystem": Case(co.LiePoissonSystem, {
        "algebra": instance(SO3, co.algebras.sl(2)),
        "hamiltonian": instance(co.Quadratic(1.0), SQUARE, co.Quadratic((1.0, 2.0, 3.0))).plus(value,
            "x1^2/2 + cos(x2)", outside=(co.Quadratic((1.0, 2.0)), co.Polynomial({(1,): 1.0}),
            "x4")).but_called(OF_H),
        "sign": SIGN,
        "casimirs": INVARIANTS,
        "representation": Domain((None, SO3.representation), (2 * SO3.representation, np.ones((3, 3)),
            SO3.representation[:2], np.full((3, 3, 3), math.nan), SO3.representation * 1j, "", 1.0, True, [])),
        "name": NAME,
        "parameters": PARAMETERS,
        "exact": EXACT,
        "integrals": INVARIANTS,
        "layout": Domain((None, {"lattice": "chain", "shape": 1}), ([], "chain", 1.0, True, 1j)),
    }, usual={"hamiltonian": co.Quadratic((1.0, 2.0, 3.0))}),
    "PoissonSystem": Case(co.PoissonSystem, {
        "structure_matrix": function(structure).plus(outside=(symmetric, value, gradient, of_nothing)),
        "hamiltonian": instance(co.Quadratic(1.0), SQUARE).plus(outside=(co.Quadratic((1.0, 2.0)),)).but_called(OF_H),
        "sign": SIGN,
        "dim": DIM,
        "derivative": optional(function(constant)).plus(outside=(structure, of_nothing)),
        "casimirs": Domain((None, {}, {"C": co.Polynomial({(0, 0, 1): 1.0})}), ({"C": SQUARE}, {"C":
            co.Polynomial({(2,): 1.0})}, {"C": 1.0}, [], "C", 1.0, True), "[cC]asimir"),
        "name": NAME,
        "parameters": PARAMETERS,
        "exact": EXACT,
    }),
    "MatrixSystem": Case(co.MatrixSystem, {
        "algebra": instance(MATRICES, co.MatrixAlgebra("su", 3)),
        "stream": function(twice, WEIGHTS).plus(outside=(of_nothing, np.trace, np.abs)),
        "linear": Domain((None, np.zeros((3, 3)), [[0, 1, 0], [-1, 0, 2], [0, -2, 0]]), (np.eye(3), np.zeros((2, 2)),
            np.zeros(3), np.full((3, 3), math.nan), np.eye(3) * 1j, "", 1.0, True, [])),
        "energy": optional(function(half)).plus(outside=(of_nothing, np.linalg.norm)),
        "energy_sign": SIGN,
        "name": title("mine"),
        "parameters": PARAMETERS,
        "exact": EXACT,
        "powers": POWERS,
    }, usual={"energy": None, "exact": None}),
    "TwoLayerSystem": Case(co.TwoLayerSystem, {
        "algebra": instance(MATRICES, co.MatrixAlgebra("su", 3)).plus(outside=(co.MatrixAlgebra("gl", 3),)),
        "stream": instance(WEIGHTS).plus(outside=(LARGE,)),
        "second_stream": optional(instance(WEIGHTS)).plus(outside=(LARGE,)).but_called("\\b(second_)?stream\\b"),
        "energy_sign": SIGN,
        "name": title("mine"),
        "parameters": PARAMETERS,
        "powers": POWERS,
    }),
    "ForcedSystem": Case(co.ForcedSystem, {
        "system": instance(BODY, FLUID),
        "forces": Domain(((co.forces.LinearDamping(0.5),), [co.forces.LinearDamping(0.5)] * 2), ((), [], None, 1.0,
            "", True, 1j, (1.0,), (co.forces.LinearDamping((0.5, 1.0)),), co.forces.BetaPlane(1.0)),
            "\\bforces?\\b|^rate of LinearDamping"),
    }),
    "batch": Case(co.batch, {
        "systems": Domain(((BODY, BODY), [BODY], iter([BODY, co.systems.rigid_body()])), ((), [], None, 1.0, "", True,
            1j, (BODY, 1.0), (BODY, co.systems.heavy_top()), (BODY, co.systems.paper_a37())),
            "\\bsystems\\b|\\bthe batch\\b"),
    }),
}  # fmt: skip

FORCES = {
    "BetaPlane": Case(co.forces.BetaPlane, {"beta": real()}),
    "DoubleBracketDamping": Case(co.forces.DoubleBracketDamping, {
        "alpha": not_negative(),
        "metric": METRIC,
    }, then=BODY.with_forces),
    "Friction": Case(co.forces.Friction, {
        "rate": real().plus(rate_of, outside=(of_nothing, lambda l: math.nan, lambda l: "1")),
        "layer": LAYER,
    }, then=SCALAR.with_forces),
    "HeatBath": Case(co.forces.HeatBath, {
        "alpha": not_negative(),
        "metric": METRIC,
        "temperature": not_negative(),
        "seed": SEED,
        "stream": SEED,
    }, then=BODY.with_forces),
    "LinearDamping": Case(co.forces.LinearDamping, {
        "rate": RATES,
        "toward": vector((0.5, -1.0, 0.0), real(), 0.5, number=True),
    }, then=BODY.with_forces),
    "OwnForce": Case(co.forces.OwnForce, {
        "function": function(flow).plus(outside=(of_nothing, of_time)),
        "name": title("wind"),
        "keeps_casimirs": flag(),
        "backward": flag(),
    }, then=BODY.with_forces),
    "RandomForcing": Case(co.forces.RandomForcing, {
        "energy_rate": not_negative(),
        "band": vector((2.0, 3.0), real(), (2, 2), [1, 4.5]).plus(outside=((3, 2), (0, 2), (-1, 2))),
        "seed": SEED,
        "stream": SEED,
        "layer": LAYER,
    }),
    "Torque": Case(co.forces.Torque, {
        "torque": vector((0.5, -1.0, 0.0), real(), torque).plus(outside=(of_nothing, flow, np.eye(3), lambda t: t)),
    }, then=BODY.with_forces),
    "Viscosity": Case(co.forces.Viscosity, {
        "nu": not_negative(),
        "power": whole(1, 32),
        "rotation": flag(),
        "layer": LAYER,
    }),
}  # fmt: skip
