"""User functions called in Python: copies of the state, the right time, and exceptions that propagate."""

import dataclasses

import numpy as np
import pytest
from interrupting import NOTHING, Failing

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

T0 = 2.0
GENERAL = co.MatrixAlgebra("gl", 3)
W0 = np.array([[0.5, 0.9, -0.2], [0.1, -0.5, 0.8], [0.3, 0.0, 0.1]])
pytestmark = [
    pytest.mark.filterwarnings("ignore:the stream .* is called in Python:RuntimeWarning"),
    pytest.mark.filterwarnings("ignore:the steps of .* are Python calls:RuntimeWarning"),
]


def transposed(W):
    return dict(P=W)["P"].T.copy()  # which Numba does not compile


def transposed_and_written(W):
    found = transposed(W)
    W[...] = 7.0
    return found


def first(W):
    return float(W[0, 0])


def first_and_written(W):
    found = float(W[0, 0])
    W[...] = 7.0
    return found


def moved(stream, event, way=1.0, **options):
    system = co.MatrixSystem(GENERAL, stream, energy=lambda W: 0.5 * np.sum(W * W))
    span = (T0, T0 + 2.0 * way)
    return co.integrate(system, W0, span, 0.0625, co.IsospectralGauss(2), events=event, **options)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_matrix_functions_may_write_into_their_argument(way):
    plain = moved(transposed, co.Event(first), way, save_every=5)
    assert len(plain.events) and np.abs(plain.x[-1] - W0).max() > 0.1
    for stream, g in ((transposed_and_written, first), (transposed, first_and_written)):
        found = moved(stream, co.Event(g), way, save_every=5, observe={"own": g, "again": first})
        assert np.array_equal(found.x, plain.x) and np.array_equal(found.energy, plain.energy)
        assert np.array_equal(found.x0, W0)
        assert all(np.array_equal(values, plain.x[:, 0, 0]) for values in found.observed.values())
        assert np.array_equal(found.events.t, plain.events.t) and np.array_equal(found.events.x, plain.events.x)


@dataclasses.dataclass(frozen=True)
class Forward(co.methods.StepMethod):
    """x + h f(x, t), which may write into x."""

    order, explicit, symmetric, compiles = 1, True, False, False
    writes: bool = False

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        found = x + h * system.vector_field(x, t)
        if self.writes:
            x[...] = 7.0
        return found


@pytest.mark.parametrize("members", [1, 3])
def test_steps_may_write_into_their_argument(members):
    body = co.systems.rigid_body((1, 2, 3))
    x0 = np.linspace(0.3, 0.9, 3 * members).reshape(members, 3)
    plain, found = (co.integrate(body, x0, (0, 2), 0.125, Forward(writes)) for writes in (False, True))
    assert np.array_equal(found.x, plain.x) and np.array_equal(found.energy, plain.energy)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_matrix_events_and_observables_get_the_time(way):
    when = T0 + 0.7 * way

    def late(W, t):
        assert min(T0, T0 + 2 * way) <= t <= max(T0, T0 + 2 * way)
        return float(t - when)

    found = moved(transposed, co.Event(late), way, observe={"late": late}, save_every=3)
    # The time of a crossing is rounded twice, when its part of the step is, and when it is added.
    assert len(found.events) == 1 and abs(found.events.t[0] - when) < 8 * U * abs(T0)
    assert found.events.direction[0] == way and np.array_equal(found.observed["late"], found.t - when)


def test_event_is_first_called_at_the_start():
    """Elsewhere its value may be undefined."""
    system = co.MatrixSystem(GENERAL, transposed)
    event = co.Event(lambda W, t: 1.0 / t + 1.0 / (W[0, 0] + 2.0))
    assert len(co.integrate(system, W0, (T0, T0 + 0.5), 0.125, events=event).events) == 0
    with pytest.raises(ZeroDivisionError):
        co.integrate(system, W0, (0.0, 0.5), 0.125, events=event)


def test_vector_functions_are_called_with_a_copy():
    body, x0 = co.systems.rigid_body((1, 2, 3)), np.array([0.1, 1.0, 0.2])

    def written(x):
        found = x[1] + 0.0
        x[1] = 7.0
        return found

    plain, found = (
        co.integrate(body, x0, (T0, T0 + 4.0), 0.125, observe={"second": g}, events=co.Event(g))
        for g in (lambda x: x[1] + 0.0, written)
    )
    assert np.array_equal(found.x, plain.x) and np.array_equal(found.observed["second"], plain.x[:, 1])
    assert np.array_equal(found.events.t, plain.events.t) and np.array_equal(x0, [0.1, 1.0, 0.2])


CULPRIT = Failing(T0 + 0.4, "culprit")


def bodies_with(culprit):
    names = ["culprit" if m == culprit else f"body {m}" for m in range(3)]
    return [
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.3 + m]), name=name)
        for m, name in enumerate(names)
    ]


@pytest.mark.parametrize("culprit", [0, 1, 2])
@pytest.mark.parametrize("threads", [1, 2])
def test_exceptions_propagate_from_batches(culprit, threads):
    ready = co.prepare(co.batch(bodies_with(culprit)), CULPRIT, 0.125, threads=threads)
    assert np.isfinite(ready.run((0.1, 1.0, 0.2), (T0, T0 + 0.5)).x).all()
    for _ in range(2):
        with refused(LookupError, "t = 2.5"):
            ready.run((0.1, 1.0, 0.2), (T0, T0 + 1.0))
    assert np.isfinite(ready.run((0.1, 1.0, 0.2), (T0, T0 + 0.5)).x).all()
    # An earlier exception is not raised again by a run that fails for another reason.
    with refused(co.IntegrationError, "failed"):
        ready.run((1e200, 1e200, 1e200), (T0, T0 + 0.5))
