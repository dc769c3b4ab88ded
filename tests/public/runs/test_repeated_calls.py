"""Calls of one prepared run, whatever came before, equal those of a fresh one, `end` too: bits, errors, messages."""

import dataclasses
import itertools

import numpy as np
import pytest

import coadjoint as co

BODY, STEP = co.systems.rigid_body(inertia=(1, 2, 2.5)), 0.0625
PUSHED = BODY.with_forces(co.forces.Torque(lambda t: np.array([t, 1.0 - t, t * t])))
WAVE = lambda y, t: np.cos(y) * (1.0 + 0.25 * t), lambda y, t: -np.sin(y) * (1.0 + 0.25 * t)
WAVES = co.LiePoissonSystem(co.algebras.so(3), co.Separable(dict.fromkeys(range(3), WAVE)))
X = np.array([0.3, -0.8, 0.5])
MANY = X * np.linspace(0.5, 1.0, 4)[:, None]
BLOWN = np.array([1e150, 1e150, -1e150])
SPANS = [
    (0.0, 0.25),
    (-0.0, 0.25),
    (0, 0.25),
    (0, 1),
    [0.0, 0.25],
    np.array([0.0, 0.25]),
    (np.float64(0.0), np.float32(0.25)),
    (np.array(0.0), 0.25),
    (0.25, 0.0),
    (0.25, -0.0),
    (0.5, 0.75),
    (0.0, 0.0),
    (0.0, 0.3),
    (0.0, np.nan),
    (0.0, True),
    (0.0,),
    None,
]
STATES = [
    X,
    tuple(X),
    X.astype(np.float32),
    np.array([1, 0, 1]),
    np.repeat(X, 2)[::2],
    X[::-1],
    -0.0 * X,
    MANY,
    np.asfortranarray(MANY),
    MANY[::2],
    MANY[:1],
    MANY.tolist(),
    BLOWN,
    np.array([X, BLOWN]),
    np.array([X[0], np.nan, 0.0]),
    np.array([np.inf, 0.0, 0.0]),
    X[:2],
    X[None, None],
    MANY[:0],
    "state",
    np.array([True, False, True]),
    X.astype(object),
    X.astype(">f8"),
]
LEVELS = [co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -X[0] - by}) for by in (-0.006, -0.002, 0.002, 0.006)]
EVENTS = [*map(co.Event, LEVELS), [co.Event(level, terminal=True) for level in LEVELS[::3]], "x1"]
SAVED = [1, 2, 2.0, np.int64(2), True, 0, 10**6, 2**60, 1.5, None]


class Case:
    """A prepared run, and calls with their arguments."""

    def __init__(self, method, system=BODY, **options):
        self.system, self.method, self.options = system, method, {"threads": 1, **options}
        self.inputs = (
            [{"linear": value} for value in (X, [0, 0, 0], MANY, X[:2], -0.0 * X)] if "inputs" in options else []
        )

    def prepared(self):
        return co.prepare(self.system, self.method, STEP, **self.options)

    def calls(self, count):
        rng = np.random.default_rng(count)
        yield from ((X, span, 1, {}) for span in SPANS)
        yield from ((state, SPANS[0], 1, {}) for state in STATES)
        yield from ((X, SPANS[0], every, {}) for every in SAVED)
        yield from ((state, SPANS[0], 1, given) for state in (X, MANY) for given in self.inputs)
        yield X, SPANS[0], 1, {"linear": X}
        yield X, SPANS[0], 1, {"t_eval": [0.1, 0.2]}
        yield from ((state, SPANS[3], 1, {"events": event}) for event in EVENTS for state in (X, MANY))
        yield X, SPANS[0], 1, {"attitude": np.eye(3)}  # refused, unless one was prepared
        for _ in range(count):
            given = self.inputs[rng.integers(len(self.inputs))] if self.inputs else {}
            values = [
                options[rng.integers(len(options))] if rng.random() < 0.4 else options[0]
                for options in (STATES, SPANS, SAVED)
            ]
            yield *values, given


CASES = {
    "splitting": Case(co.Splitting(order=2)),
    "Gauss": Case(co.GaussLegendre(2)),
    "Taylor": Case(co.Taylor(6), watch=False),
    "adaptive": Case(co.Taylor(tolerance=1e-9)),
    "two threads": Case(co.Splitting(order=4), threads=2),
    "observed": Case(co.Splitting(order=2), observe={"first": co.Polynomial("x1", dim=3)}),
    "attitude": Case(co.Splitting(order=2), attitude=True),
    "inputs": Case(co.Splitting(order=2), inputs=True),
    "inputs, tables of each member": Case(co.ReversibleSteps(co.Splitting(order=2)), inputs=True),
    "energy of the time": Case(co.Splitting(order=2), WAVES),
    "torque at times": Case(co.Splitting(order=2), PUSHED),
    "torque at substeps": Case(co.Splitting(order=4), PUSHED),
}


def outcome(prepared, x0, span, every, given):
    """Return everything that a call shows: bits of the arrays, or the error; `end` has its last state, or its error."""
    alone = every is SAVED[0] and given.keys() <= {"linear"}
    try:
        sol = prepared.run(x0, span, every, **given)
    except Exception as error:
        if alone:
            with pytest.raises(type(error)) as ended:
                prepared.end(x0, span, **given)
            assert str(ended.value) == str(error)
        partial = getattr(error, "partial", None)
        return type(error), str(error), None if partial is None else shown(partial)
    if alone:
        assert prepared.end(x0, span, **given).tobytes() == sol.x[-1].tobytes()
    return shown(sol)


def shown(sol):
    arrays = [sol.t, sol.x, sol.x0, sol.energy, sol.change()["energy"].tenths, *sol.casimirs.values()]
    arrays += [*sol.observed.values(), *([] if sol.attitude is None else [sol.attitude])]
    arrays += [] if sol.events is None else [sol.events.t, sol.events.x, sol.events.which, sol.events.member]
    bits = [(np.shape(array), np.asarray(array).tobytes()) for array in arrays]
    stats = dataclasses.replace(sol.stats, seconds=0.0, elapsed=0.0)
    return (
        bits,
        stats,
        repr(sol.t_span),
        sol.save_every,
        sol.incomplete,
        repr(sol),
        None if sol.failed is None else sol.failed.tolist(),
    )


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("name", CASES)
def test_calls_are_those_of_a_fresh_prepared_run(name):
    """Each call after every kind of other call, and repeated at once."""
    case = CASES[name]
    shared, calls = case.prepared(), list(case.calls(10))
    expected = [outcome(case.prepared(), *call) for call in calls]
    assert {len(found) for found in expected} == {3, 7}  # errors, and solutions
    order = np.random.default_rng(1993).permutation(np.arange(len(calls)))
    for k in itertools.chain(range(len(calls)), order.tolist()):
        assert outcome(shared, *calls[k]) == expected[k], calls[k]


BASES = [co.GaussLegendre(1), co.Splitting(order=2)]
SCHEMES = [
    *(scheme for name in co.methods.names() for scheme in co.methods.registry.scheme(name).examples()),
    *(co.methods.even_order(base, 4) for base in BASES),
]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("rate", [0.0, [0.2, 0.1, 0.3], 0.2 * np.eye(3) + 0.01], ids=["none", "diagonal", "matrix"])
def test_a_check_of_the_step_changes_no_bits_of_the_next_run(rate):
    """Checks round up, and what a thread keeps of a step, as factors of damping, is rounded with it."""
    damping = [co.forces.LinearDamping(rate)] if np.any(rate) else []
    system = co.systems.gyrostat().with_forces(co.forces.Torque((0.01, 0.02, 0.03)), *damping)
    tried, drawn = 0, np.random.default_rng(3).standard_normal((4, 3))
    for scheme in SCHEMES:
        try:
            shared = co.prepare(system, scheme, 0.25)
        except (TypeError, ValueError):
            continue  # it takes no forces, or no systems of vectors
        for x0 in (drawn[0], drawn):
            first, second = (shared.run(x0, (0, 3)) for _ in range(2))
            np.testing.assert_array_equal(first.x, second.x, err_msg=str(scheme))
        tried += 1
    assert tried > 20
