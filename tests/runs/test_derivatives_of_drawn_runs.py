"""Derivatives of runs with drawn systems, forces, schemes and options, against differences of whole runs of order 8."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from derivative_cases import wave, wave_curvature, wave_slope
from scipy.linalg import expm

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import with_parameters
from coadjoint.systems.protocol import forces_of, is_batch
from group_elements import random_element

F, H = co.forces, 0.125
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# So small that no crossing appears, or moves over the end of a step, where its derivative jumps.
DISTANCE = 2.0**-13
ADJOINT_ERROR = 2.0**11 * UNIT_ROUNDOFF
DIFFERENCE_ERROR = 2.0**12 * UNIT_ROUNDOFF / DISTANCE
# Gradients by undone steps have the rounding of these.
UNDONE_ERROR = 2.0**14 * UNIT_ROUNDOFF


# Functions of a number, for the members of batches.
SYSTEMS = {
    "body": lambda k: co.systems.rigid_body(inertia=(1.0, 2.0, 2.5 + 0.1 * k)),
    "top": lambda k: co.systems.heavy_top(inertia=(1.0, 2.0, 2.5 + 0.1 * k), lever=(0.1, 0.2, 1.0)),
    "full": lambda k: co.LiePoissonSystem(
        co.algebras.so(3),
        co.Quadratic([[1.0, 0.1, 0.2], [0.1, 0.7, 0.0], [0.2, 0.0, 0.4 + 0.1 * k]], linear=[0.1, 0.0, 0.2]),
        sign=-1,
    ),
    "sl(2)": lambda k: co.LiePoissonSystem(
        co.algebras.sl(2), co.Quadratic([0.3, 0.6, 1.0], linear=[0.1, 0.2, 0.3 + 0.1 * k])
    ),
    "A5,40": lambda k: co.LiePoissonSystem(co.algebras.get("A5,40"), co.Quadratic(np.linspace(0.4 + 0.1 * k, 1.2, 5))),
    "cubic": lambda k: co.LiePoissonSystem(
        co.algebras.se(2),
        co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): 0.3, (0, 0, 2): 0.2, (0, 1, 2): 0.4 + 0.1 * k, (1, 0, 0): 0.1}),
    ),
    "timed": lambda k: co.LiePoissonSystem(
        co.algebras.so(3),
        co.Quadratic([1.0, 0.5, 0.4 + 0.1 * k]) + co.Separable({0: (wave, wave_slope, wave_curvature)}),
        sign=-1,
        name="timed",
    ),
}
FLOWS = [
    co.Splitting(order=1),
    co.Splitting(order=4),
    co.Splitting(compensated=True),
    co.Splitting(parts="coordinates"),
    co.Splitting(scheme="blanes_casas_murua6"),
    co.Composition(co.Splitting(order=2), (0.7, -0.4, 0.7)),
]
STAGES = [co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")]
IN_PYTHON = [co.Taylor(order=5), co.CommutatorFree(), co.Kahan()]
SCHEMES = [*FLOWS, *STAGES, *IN_PYTHON]
SERIES = [co.Taylor(order=5), co.Kahan()]
# Those with group elements.
TURNING = [*FLOWS, *STAGES, *IN_PYTHON[:2]]
# Their number has no divisor in common with those of the other lists: every pair is visited.
MEMBERS = ("one", "three", "batch", "one", "three")
EXTRAS = ("none", "forces", "inputs", "forces and inputs", "events", "forces and events")


def observed(n):
    """Return quantities of every kind."""
    return {
        "product": lambda x: x[0] * x[1] + np.sin(x[2]),
        "clock": lambda x, t: x[1] * t,
        "square": lambda x: x[2] ** 2,
        "polynomial": co.Polynomial({(1, 0, 1, *[0] * (n - 3)): 1.0, (0, 2, *[0] * (n - 2)): 0.5}),
        "quadratic": co.Quadratic(np.linspace(1.0, 0.2, n), linear=np.linspace(0.1, 0.3, n)),
    }


def forces_for(n, rng, noise):
    """Return one or two forces of different classes, and a constant torque."""
    u, B = rng.uniform(-0.3, 0.3, n), rng.uniform(-0.2, 0.2, (n, n))
    # Each entry takes its own flows.
    matrix = rng.integers(2) if n == 3 else 0
    classes = [
        [F.LinearDamping(0.3, u), F.LinearDamping(0.2 * np.eye(n) + B, u[::-1])],
        [F.Torque(lambda t: np.cos(t) * u), F.Torque(lambda x, t: 0.3 * x * x[0] - t * 0.02 * u)],
        [F.DoubleBracketDamping(0.2, np.linspace(0.5, 1.0, n)), F.DoubleBracketDamping(0.1, B @ B.T + np.eye(n))],
        [F.HeatBath(0.3, 0.8, 0.2, seed=5), F.HeatBath(0.2, np.linspace(0.5, 1.0, n), 0.3, seed=7)],
    ]
    which = [matrix, rng.integers(2), matrix, rng.integers(2)]
    chosen = rng.permutation(len(classes) if noise else len(classes) - 1)[: rng.integers(1, 3)]
    return [*(classes[k][which[k]] for k in chosen), F.Torque(rng.uniform(-0.3, 0.3, n))]


class Drawn(NamedTuple):
    """A prepared run with the options of `prepare`, its arguments, and the matrices of its representation."""

    method: Any
    ready: Any
    options: dict[str, Any]
    x0: np.ndarray
    span: tuple[float, float]
    points: dict[str, Any]
    attitude: np.ndarray | None
    inputs: dict[str, np.ndarray]
    matrices: np.ndarray | None

    @property
    def arguments(self):
        return {**self.points, **self.inputs, **({} if self.attitude is None else {"attitude": self.attitude})}


def drawn(seed):
    """Return a run with drawn options, of a system and a scheme that the seeds visit in turn."""
    rng, method = np.random.default_rng(seed), SCHEMES[seed % len(SCHEMES)]
    build, extra = list(SYSTEMS.values())[seed % len(SYSTEMS)], EXTRAS[seed % len(EXTRAS)]
    n, members = build(0).dim, MEMBERS[seed % len(MEMBERS)]
    members = "three" if "inputs" in extra and members == "batch" else members
    leading = {"one": (), "three": (3,), "batch": (2,)}[members]
    forces = forces_for(n, rng, noise="events" not in extra) if "forces" in extra else []
    # Noise is that of whole steps forward; functions of the user are in no series.
    noise = any(isinstance(force, F.HeatBath) for force in forces)
    method = co.CommutatorFree() if build is SYSTEMS["timed"] and method in SERIES else method
    systems = [build(k).with_forces(*forces) if forces else build(k) for k in range(2)]
    system = co.batch(systems) if members == "batch" else systems[0]
    options, inputs = {} if forces else {"observe": observed(n)}, {}
    if "inputs" in extra:
        options["inputs"] = {"field": (2, 0)} | ({"jet": forces_of(system)[-1][0]} if forces else {})
        sizes = {name: 2 if name == "field" else n for name in options["inputs"]}
        inputs = {k: rng.uniform(-0.3, 0.3, (*(leading if rng.random() < 0.5 else ()), v)) for k, v in sizes.items()}
    t0, forward, steps = (
        rng.choice([0.0, 0.5, -3.25]),
        1 if noise else rng.choice([1, -1]),
        2 if forces else 3 if method in IN_PYTHON else 9,
    )
    points = {"save_every": int(rng.integers(1, min(steps, 4) + 1))}
    if not noise and rng.random() < 0.5:
        times = np.sort([0.0, 1.0, *rng.uniform(0.0, steps, 2), steps])[rng.integers(3) : rng.integers(3, 6)]
        points = {"t_eval": t0 + forward * H * times}
    if "events" in extra:
        line = rng.uniform(-0.1, 0.1)
        ending = co.Event(lambda x, t: x[1] + line * (t - t0) - 0.3, terminal=bool(rng.integers(2)))
        points["events"] = [co.Event(int(rng.integers(3))), ending]
    x0 = 0.3 + 0.4 * np.cos(1.0 + np.arange(n)) + 0.1 * rng.standard_normal((*leading, n))
    attitude = matrices = None
    if method in TURNING and rng.random() < 0.7:
        options["attitude"] = "coadjoint"
        matrices = np.array([systems[0].algebra.coadjoint(unit) for unit in np.eye(n)])
        if not forces and systems[0].representation is not None and rng.random() < 0.5:
            options["attitude"], matrices = True, systems[0].representation
        if rng.random() < 0.5:
            attitude = random_element(matrices, seed, *(leading if rng.random() < 0.5 else ()), size=0.3)
    ready = co.prepare(system, method, H, **options)
    span = (t0, t0 + forward * steps * H)
    return Drawn(method, ready, options, x0, span, points, attitude, inputs, matrices), rng


def outputs(result):
    """Return the arrays of a solution, or of tangents, by name."""
    found = {name: getattr(result, name) for name in ("x", "energy", "attitude")}
    events = result.events if isinstance(result.events, dict) else {}
    if result.events is not None and not isinstance(result.events, dict):
        events = {name: getattr(result.events, name) for name in ("t", "x")}
    found |= {f"{name} of events": one for name, one in events.items()}
    found |= {f"observed {name}": one for name, one in getattr(result, "observed", {}).items()}
    return {name: one for name, one in found.items() if one is not None}


def directions_of(case, start, rng):
    """Return two directions of everything, and the coordinates in the algebra of those of the attitude, as matrices."""
    found = {"x0": rng.standard_normal((*case.x0.shape, 2))}
    for name, value in case.ready.parameters.items():
        one = rng.standard_normal((*value.shape, 2))
        # Matrices of dampings along orbits stay symmetric.
        square = name.endswith("metric") and value.ndim > 1 and value.shape[-2] == value.shape[-1]
        found[name] = one + np.swapaxes(one, -3, -2) if square else one
    if case.inputs:
        found["inputs"] = {name: rng.standard_normal((*value.shape, 2)) for name, value in case.inputs.items()}
    turns = None
    if start is not None:
        turns = np.tensordot(rng.standard_normal((*start.shape[:-2], 2, len(case.matrices))), case.matrices, 1)
        found["attitude0"] = np.moveaxis(turns @ start[..., None, :, :], -3, -1)
    return found, turns


def moved_system(system, values):
    if not is_batch(system):
        return with_parameters(system, values) if values else system
    members = [{name: value[m] for name, value in values.items()} for m in range(len(system))]
    return co.batch([with_parameters(one, own) if own else one for one, own in zip(system, members, strict=True)])


def along(directions, k):
    return {name: along(d, k) if isinstance(d, dict) else d[..., k] for name, d in directions.items()}


def flat(values):
    """Return values by name, of which inputs are in a mapping of their own."""
    return {name: one for name, one in values.items() if name != "inputs"} | dict(values.get("inputs", {}))


def difference(case, direction, turns, start, weights):
    """Return the difference of order 8 of a sum of the outputs of whole runs."""
    ready, inputs = case.ready, direction.get("inputs", {})

    def total(by):
        values = {name: value + by * direction[name] for name, value in ready.parameters.items() if name in direction}
        moved = co.prepare(moved_system(ready.system, values), case.method, H, **case.options)
        arguments = case.arguments | {name: u + by * inputs[name] for name, u in case.inputs.items()}
        if start is not None:
            arguments["attitude"] = expm(by * turns) @ start
        found = outputs(moved.run(case.x0 + by * direction["x0"], case.span, **arguments))
        return sum(np.sum(np.where(w == 0.0, 0.0, found[name]) * w) for name, w in weights.items())

    return sum(w * (total(j * DISTANCE) - total(-j * DISTANCE)) for j, w in enumerate(WEIGHTS, 1)) / DISTANCE


def arguments_of(weights, events):
    """Return the arguments of a pullback for the cotangents of all outputs."""
    found = {name: weights[name] for name in ("x", "energy", "attitude") if name in weights}
    found["observed"] = {k.removeprefix("observed "): w for k, w in weights.items() if k.startswith("observed ")}
    return found | ({"events": {name: weights[f"{name} of events"] for name in ("t", "x")}} if events else {})


@pytest.mark.thinned(1)
@pytest.mark.parametrize("seed", range(42))
def test_derivatives_of_drawn_runs(seed):
    """Gradients by everything agree with tangents, with differences of runs, and with those by undone steps."""
    case, rng = drawn(seed)
    ready, x0, span, arguments, events = case.ready, case.x0, case.span, case.arguments, "events" in case.points
    sol, pullback = ready.vjp(x0, span, **arguments)
    start = None
    if case.matrices is not None:
        start = np.eye(case.matrices.shape[-1]) if case.attitude is None else case.attitude
        start = np.broadcast_to(start, sol.attitude.shape[1:])
    directions, turns = directions_of(case, start, rng)
    _, tangents = ready.jvp(x0, span, directions, **arguments)
    series, plain, followed = outputs(sol), outputs(ready.run(x0, span, **arguments)), outputs(tangents)
    assert all(np.array_equal(one, plain[name], equal_nan=True) for name, one in series.items())
    weights = {k: np.where(np.isfinite(one), rng.standard_normal(one.shape), 0.0) for k, one in series.items()}
    gradient = pullback(**arguments_of(weights, events))
    # Tangents are those of outputs that are not observed.
    of_tangents = {name: w for name, w in weights.items() if name in followed}
    unobserved = flat(pullback(**arguments_of(of_tangents, events)) if len(of_tangents) < len(weights) else gradient)
    for k in range(2):
        products = {name: unobserved[name] * d for name, d in flat(along(directions, k)).items()}
        size = sum(np.sum(np.abs(product)) for product in products.values())
        forward = sum(np.sum(np.where(w == 0.0, 0.0, followed[n][..., k]) * w) for n, w in of_tangents.items())
        assert abs(sum(map(np.sum, products.values())) - forward) <= ADJOINT_ERROR * size
    same_map = {name: d for name, d in along(directions, 0).items() if gradient.rule.get(name) != "added part"}
    products = {name: flat(gradient)[name] * d for name, d in flat(same_map).items()}
    size = sum(np.sum(np.abs(product)) for product in products.values())
    expected = difference(case, same_map, None if turns is None else turns[..., 0, :, :], start, weights)
    assert abs(sum(map(np.sum, products.values())) - expected) <= DIFFERENCE_ERROR * size
    if case.method in FLOWS and not forces_of(ready.system):
        _, undone = ready.vjp(x0, span, reverse="reversible", **arguments)
        found = flat(undone(**arguments_of(weights, events)))
        for name, one in flat(gradient).items():
            assert np.abs(found[name] - one).max() <= UNDONE_ERROR * max(1.0, np.abs(one).max())
