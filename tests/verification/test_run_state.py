"""The state of a run between two steps: interrupted, stored, read and resumed with the same bits."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.interface import limit
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.state import RunState
from coadjoint.runs.times import Times
from started_runs import started

from .schemes_under_test import schemes, serves
from .systems_under_test import matrices

pytestmark = pytest.mark.thinned(3)

STEPS, EVERY, CUTS = 13, 4, (0, 1, 4, 6, 11)
TOP = co.LiePoissonSystem(
    co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0]), sign=-1
)
BODY = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
# On so(3) where the heavy top, with its linear terms, is refused.
SYSTEMS = {"top": (TOP, [1.0, -0.5, 1.5, 0.625, 0.25, 0.75]), "body": (BODY, [0.3, -1.0, 0.7])}
SYSTEMS |= {name: case[:2] for name, case in matrices().items()}


def start_run(system, method, x0, attitude, workers=1, state=None, steps=STEPS):
    """Return a run of this number of steps, from the start or from a state."""
    ready = PreparedRun(system, method, 0.05, attitude=attitude)
    start = ready.start(x0)
    return started(system, method, ready.loops(0.05), Times(0.25, 0.05, steps, EVERY), start, True, workers, state)


def cases():
    for name, method in schemes().items():
        system = next(name for name, (system, _) in SYSTEMS.items() if serves(method, system))
        carried = method.properties(SYSTEMS[system][0]).attitude
        for attitude in (False, "coadjoint") if carried != "none" else (False,):
            for members in (1, 7):
                yield pytest.param(
                    method, system, attitude, members, id=f"{name}, {attitude or 'momentum'}, {members} members"
                )


def stored_copy(state):
    """Copy a state through bytes, as a file would store it."""
    mapping = state.to_mapping()
    plain = {name: value for name, value in mapping.items() if isinstance(value, int)}
    stored = {
        name: (value.tobytes(), value.dtype.str, value.shape)
        for name, value in mapping.items()
        if isinstance(value, np.ndarray)
    }
    assert {*plain, *stored} == set(mapping)
    read = {name: np.frombuffer(raw, dtype).reshape(shape) for name, (raw, dtype, shape) in stored.items()}
    return RunState.from_mapping({**plain, **read})


def parts_of(solution):
    found = {"t": solution.t, "x": solution.x, "energy": solution.energy, **solution.casimirs}
    return found if solution.attitude is None else {**found, "attitude": solution.attitude}


@pytest.mark.thinned(8)
@pytest.mark.parametrize(("method", "name", "attitude", "members"), list(cases()))
def test_resumed_run_has_the_bits_of_the_whole_run(method, name, attitude, members):
    system, x = SYSTEMS[name]
    x0 = np.array(x) if members == 1 else np.multiply.outer(1.0 - 0.03 * np.arange(members), x)
    whole = start_run(system, method, x0, attitude)
    whole.advance()
    expected = whole.solution(None)
    pieces, state = [], None
    for number in (*CUTS, STEPS):
        # A new run, with nothing but the state of the one before.
        piece = start_run(system, method, x0, attitude, state=state)
        before = None if state is None else state.copy()
        piece.advance(until=number)
        assert state == before
        held = len(piece.times.saved[piece.times.saved <= number])
        pieces.append({part: values[:held] for part, values in parts_of(piece.solution(None)).items()})
        state = stored_copy(piece.state)
        assert state == piece.state and state is not piece.state
    assert state == whole.state and state.number == STEPS
    for part, values in parts_of(expected).items():
        assert np.array_equal(np.concatenate([piece[part] for piece in pieces]), values), part


def test_members_of_several_groups_keep_their_order():
    """The loops hold members of different structures in another order."""
    bodies = [co.systems.rigid_body(inertia) for inertia in ((1, 2, 3), (3, 1, 2), (1, 2, 2.5), (3, 1, 2.5), (3, 4, 5))]
    states = np.multiply.outer(np.linspace(1.0, 1.4, 5), [0.3, -1.0, 0.7])
    batch, method = co.batch(bodies), co.Splitting(order=2)
    whole = start_run(batch, method, states, "coadjoint", workers=2)
    assert whole.loops.order is not None and whole.loops.order.tolist() != list(range(5))
    whole.advance()
    first = start_run(batch, method, states, "coadjoint")
    first.advance(until=6)
    for m, body in enumerate(bodies):
        alone = start_run(body, method, states[m], "coadjoint")
        alone.advance(until=6)
        for name in ("momenta", "groups", "worst", "evaluations"):
            assert np.array_equal(first.state[name][m], alone.state[name][0]), name
    second = start_run(batch, method, states, "coadjoint", state=stored_copy(first.state))
    second.advance()
    assert second.state == whole.state
    assert np.array_equal(second.solution(None).attitude, whole.solution(None).attitude[2:])


def test_resumed_run_stays_failed():
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, -1.0, 2.0]))
    x0 = np.array([[1.0, 1.0, 0.0], [1.0, 0.5, 0.25]])
    first = start_run(system, co.RadauEnergy(2), x0, False)
    first.advance(until=3)
    second = start_run(system, co.RadauEnergy(2), x0, False, state=stored_copy(first.state))
    second.advance()
    with pytest.raises(co.IntegrationError, match=r"step 1, at t = 0.25, .* 1 of 2 members") as failure:
        second.solution(None)
    assert failure.value.partial.failed.tolist() == [True, False]


def some_state():
    run = start_run(TOP, co.GaussLegendre(2), np.array(SYSTEMS["top"][1]), False)
    run.advance(until=5)
    return run.state


def test_states_are_compared_bitwise():
    state = some_state()
    other = state.copy()
    assert state == other and not state != other and state != "state"
    other["momenta"][0, 0] = np.nextafter(other["momenta"][0, 0], 1.0)
    assert state != other
    assert state["residual"][0] != state["residual"][0] and state == state.copy()  # no number equals itself here
    later = state.copy()
    later.number += 1
    assert state != later
    zero = state.copy()
    zero["errors"][:], other = 0.0, zero.copy()
    other["errors"][:] = -0.0
    assert zero != other
    assert repr(state) == "<state of 1 member after step 5>"
    with pytest.raises(TypeError, match="unhashable"):
        hash(state)


def changed(**parts):
    mapping = some_state().to_mapping()
    mapping.update(parts)
    return {name: value for name, value in mapping.items() if value is not None}


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"version": limit("STATE_VERSION") + 1}, r"version \d+.* version \d+"),
        ({"version": None}, "no version"),
        ({"number": 2.5}, "number of the state is 2.5"),
        ({"number": -1}, "number of the state is -1"),
        ({"worst": None}, "missing: worst; unknown: none"),
        ({"mood": 1.0}, "missing: none; unknown: 'mood'"),
        (
            {"momenta": np.zeros((2, 6))},
            r"errors of the state is float64 of shape \(1, 6\); .* float64 of shape \(2, 6\)",
        ),
        ({"status": np.zeros(1)}, r"status of the state is float64 of shape \(1,\); .* must be int64"),
        (
            {"worst": np.zeros((1, 9, 3))},
            r"worst of the state is float64 of shape \(1, 9, 3\); .* of shape \(1, 10, 3\)",
        ),
        ({"last": np.zeros(4)}, r"last of the state is float64 of shape \(4,\)"),
    ],
)
def test_invalid_states_are_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        RunState.from_mapping(changed(**parts))


def test_state_of_another_run_is_refused():
    state = some_state()
    with pytest.raises(ValueError, match=r"momenta of shape \(1, 6\).*\(1, 3\)"):
        start_run(BODY, co.GaussLegendre(2), SYSTEMS["body"][1], False, state=state)
    with pytest.raises(ValueError, match=r"memory of shape \(1, 14\).*\(1, 0\)"):
        start_run(TOP, co.ExplicitRungeKutta("rk4"), SYSTEMS["top"][1], False, state=state)
    with pytest.raises(ValueError, match=r"after step 5.* 3 steps"):
        start_run(TOP, co.GaussLegendre(2), SYSTEMS["top"][1], False, state=state, steps=3)
