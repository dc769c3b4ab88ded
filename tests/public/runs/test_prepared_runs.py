"""Prepared runs: the results of `integrate`, without set-up, in several threads."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.1, 1.0, 0.2])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("system", "method"),
    [
        (BODY, co.Splitting(order=4, compensated=True)),
        (BODY, co.Splitting(order=2, rotation="rational")),
        (BODY, co.Splitting(order=2, parts="free_body")),
        (co.systems.spin_lattice("chain", 4, field=lambda t: [0.0, t, 0.1]), co.Splitting(order=2)),
        (co.systems.spin_lattice("chain", 4), co.Splitting(order=2, parts="bonds")),
    ],
    ids=str,
)
def test_runs_in_the_other_direction_are_those_prepared_for_it(system, method):
    x0 = np.linspace(0.2, 1.1, system.dim)
    first, fresh = (co.prepare(system, method, 0.1, attitude="coadjoint") for _ in range(2))
    first.run(x0, (1.0, 1.7))
    sols = [ready.run(x0, (1.0, 0.3)) for ready in (first, fresh)]
    for name in ("x", "attitude", "energy"):
        np.testing.assert_array_equal(getattr(sols[0], name), getattr(sols[1], name))
    np.testing.assert_allclose(first.run(sols[0].x[-1], (0.3, 1.0)).x[-1], x0, rtol=0, atol=1e-13)


def test_attributes_of_solutions_are_lazy_and_cached():
    """In any order, after other runs, and after the states are overwritten."""
    ready = co.prepare(BODY, co.Splitting(order=4), 0.1, attitude=True, observe={"x1": lambda x: x[0]})
    parts = "t energy casimirs attitude attitude0 initial observed t_span step save_every watched".split()
    for x in (X, np.array([X, 2 * X])):
        sol, other = ready.run(x, (0, 1), 4), ready.run(x, (0, 1), 4)
        at_once = {name: getattr(other, name) for name in parts}
        sol.x[:] = 0.0
        ready.run(2 * x, (0, 1), 4)
        for name in reversed(parts):
            np.testing.assert_equal(getattr(sol, name), at_once[name])
            assert getattr(sol, name) is getattr(sol, name)
        for again in (copy.deepcopy(other), copy.copy(other), pickle.loads(pickle.dumps(other))):
            for name in ("t", "x", "energy", "attitude"):
                np.testing.assert_array_equal(getattr(again, name), getattr(other, name))
            assert again.drift() == other.drift() and again.stats == other.stats


def test_group_elements_are_copied():
    for _ in range(2):
        unit = co.integrate(BODY, X, (0, 1), 0.1, attitude=True).attitude0
        assert np.array_equal(unit, np.eye(3))
        unit[:] = 7.0
    elements = np.stack([np.linalg.matrix_power(QUARTER, m) for m in range(3)])
    x, given = X * np.linspace(1, 2, 3)[:, None], elements.copy()
    listed = co.prepare(BODY, None, 0.1, attitude=given.tolist())
    for ready in (listed, co.prepare(BODY, None, 0.1, attitude=given)):
        given[:] = np.eye(3)
        assert np.array_equal(ready.run(x, (0, 1)).attitude[0], elements)
    # The second state is outside of the sample, and gets its own choice.
    given = elements[1].copy()
    ready = co.prepare(BODY, accuracy=1e-6, x0=X, t_span=(0, 2), attitude=given)
    given[:] = np.eye(3)
    for start in (X, 9.0 * X):
        assert np.array_equal(ready.run(start, (0, 2)).attitude[0], elements[1])


def test_solutions_are_frozen_and_name_missing_attributes():
    sol = co.integrate(BODY, X, (0, 1), 0.1)
    with refused(AttributeError, "momentum", "x"):
        _ = sol.momentum
    with pytest.raises(dataclasses.FrozenInstanceError):
        sol.x = X


@pytest.mark.parametrize(
    "name", ["prepared", "prepared for an accuracy", "stepper", "system", "matrices", "two fields"]
)
def test_what_runs_share_cannot_be_changed(name):
    """Also copies and pickles; a changed step would be printed, and the run would take the other one."""
    body = co.systems.rigid_body((1, 2, 3))
    shared = {
        "prepared": lambda: co.prepare(body, co.Splitting(), 0.1, inputs=True),
        "prepared for an accuracy": lambda: co.prepare(body, accuracy=1e-6, x0=(0.1, 1, 0.2), t_span=(0, 10)),
        "stepper": lambda: co.stepper(body, co.Splitting(), 0.1),
        "system": lambda: body,
        "matrices": lambda: co.systems.sphere_euler(N=4),
        "two fields": lambda: co.systems.reduced_mhd(N=5),
    }[name]()
    for one in (shared, copy.copy(shared), pickle.loads(pickle.dumps(shared))):
        before = dict(vars(one))
        for attribute in {"system", "method", "step", "h", "observe", "name", "dim", "hamiltonian"} & vars(one).keys():
            with pytest.raises(AttributeError, match=attribute):
                setattr(one, attribute, 0.2)
        assert vars(one) == before
