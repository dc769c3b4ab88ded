"""Pictures of deviations from the start, for runs whose `t_eval` does not save the start."""

import numpy as np
import pytest

import coadjoint as co

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([(1.0, 0.2, 0.5), (0.1, 1.0, 0.1)])
END, STEP, TIMES = 13.0, 0.26, (5.05, 13.0)


def _lines(x0, kind, times, system=BODY):
    sol = co.integrate(system, x0, (0, END), STEP, co.Splitting(order=2), t_eval=times)
    return sol, [line.get_ydata() for line in sol.plot(kind).axes[0].lines]


@pytest.mark.parametrize("kind", ["drift", "error"])
@pytest.mark.parametrize("x0", [X0[0], X0], ids=["one", "members"])
def test_deviations_do_not_depend_on_whether_the_start_is_saved(kind, x0):
    _, found = _lines(x0, kind, TIMES)
    _, expected = _lines(x0, kind, (0.0, *TIMES))
    assert len(found) == len(expected) > 0
    for values, reference in zip(found, expected, strict=True):
        assert np.array_equal(values, reference[1:])


def test_error_is_the_distance_from_the_motion_of_the_initial_state():
    sol, (values,) = _lines(X0[0], "error", TIMES)
    exact = [BODY.exact(X0[0], t) for t in TIMES]
    assert np.allclose(values, np.linalg.norm(sol.x - exact, axis=1) / np.linalg.norm(X0[0]), rtol=1e-12, atol=0)


def test_change_less_work_is_the_balance_from_the_start():
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    sol, lines = _lines(X0[0], "drift", TIMES, damped)
    error = sol.energy - damped.energy(X0[0]) - sol.work["LinearDamping"]["energy"]
    assert np.allclose(lines[1], np.abs(error) / damped.energy(X0[0]), rtol=1e-9, atol=0)
    assert lines[1].max() <= sol.balance()["energy"]


@pytest.mark.parametrize("ends", [(0.0, END), (END, 0.0)], ids=["forward", "backward"])
@pytest.mark.parametrize("x0", [X0[0], X0], ids=["one", "members"])
def test_modified_energies_deviate_from_those_of_the_initial_state(x0, ends):
    lines = []
    for times in (TIMES[:1], (ends[0], *TIMES[:1])):
        sol = co.integrate(BODY, x0, ends, STEP, co.Splitting(order=2), t_eval=times)
        lines.append([line.get_ydata()[-1] for line in co.plotting.draw_modified_energy(sol, (4, 6)).axes[0].lines])
    assert np.allclose(*lines, rtol=1e-6, atol=0)
    assert len(lines[0]) == 3 and min(lines[0]) > 0
