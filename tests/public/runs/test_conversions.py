"""Solutions as tables of pandas, and attitudes as rotations of SciPy: rows and members are those of the run."""

import numpy as np
import pytest

import coadjoint as co

BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, 1.0, 0.2)
TOP = co.systems.heavy_top()
TOPS = np.array([[1.0, 0.0, 2.0, 0.1, 0.0, 1.0], [0.5, 0.2, 1.0, 0.0, 0.6, 0.8], [0.0, 0.4, 1.5, 0.6, 0.0, 0.8]])


def plain(x):
    return 2.0 * x[2]


def momentum(x):
    return x[0] + x[1]


@pytest.mark.parametrize("times", [{"save_every": 4}, {"t_eval": [0.25, 0.5, 1.75]}])
def test_a_table_has_a_row_for_each_time(times):
    pytest.importorskip("pandas")
    sol = co.integrate(BODY, X0, (0, 2), 0.1, observe={"plain": plain}, **times)
    table = sol.to_pandas()
    assert table.columns.tolist() == ["x1", "x2", "x3", "energy", "|x|^2", "plain"]
    assert table.index.name == "time" and table.index.tolist() == sol.t.tolist()
    np.testing.assert_array_equal(table[["x1", "x2", "x3"]], sol.x)
    np.testing.assert_array_equal(table["energy"], sol.energy)
    np.testing.assert_array_equal(table["|x|^2"], sol.casimirs["|x|^2"])
    np.testing.assert_array_equal(table["plain"], 2.0 * sol.x[:, 2])


def test_a_table_of_members_has_a_row_for_each_member_and_time():
    pytest.importorskip("pandas")
    sol = co.integrate(TOP, TOPS, (0, 1), 0.1, observe={"momentum": momentum})
    table = sol.to_pandas()
    assert table.index.names == ["member", "time"] and len(table) == 3 * len(sol.t)
    names = ["m1", "m2", "m3", "gamma1", "gamma2", "gamma3"]
    for m in range(3):
        part = table.loc[m]
        assert part.index.tolist() == sol.t.tolist()
        np.testing.assert_array_equal(part[names], sol.x[:, m])
        np.testing.assert_array_equal(part["energy"], sol.energy[:, m])
        np.testing.assert_array_equal(part["m.p"], sol.casimirs["m.p"][:, m])
        np.testing.assert_array_equal(part["momentum"], sol.x[:, m, 0] + sol.x[:, m, 1])


@pytest.mark.parametrize("several", [False, True])
def test_a_table_of_matrices_has_a_column_for_each_entry(several):
    pytest.importorskip("pandas")
    fluid = co.systems.sphere_euler(N=3)
    W = np.stack([fluid.random(1), fluid.random(2)]) if several else fluid.random(1)
    sol = co.integrate(fluid, W, (0, 0.5), 0.1)
    table = sol.to_pandas()
    for i, j in np.ndindex(3, 3):
        column = table[f"W{i + 1},{j + 1}"].to_numpy()
        np.testing.assert_array_equal(column, np.moveaxis(sol.x, 0, -3)[..., i, j].ravel())


def test_equal_names_in_a_table_are_told_apart():
    """Of an observed quantity and a coordinate, the energy or a Casimir; of a Casimir and a coordinate."""
    pytest.importorskip("pandas")
    observe = {"x1": plain, "energy": momentum, "|x|^2": plain, "other": momentum}
    sol = co.integrate(BODY, X0, (0, 1), 0.1, observe=observe)
    table = sol.to_pandas()
    np.testing.assert_array_equal(table[["x1", "x2", "x3"]], sol.x)
    np.testing.assert_array_equal(table["energy"], sol.energy)
    np.testing.assert_array_equal(table["|x|^2"], sol.casimirs["|x|^2"])
    for name, column in {"other": "other", **{name: f"observed {name}" for name in list(observe)[:3]}}.items():
        np.testing.assert_array_equal(table[column], sol.observed[name])
    square = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    named = co.LiePoissonSystem(co.algebras.so(3), BODY.hamiltonian, sign=-1, casimirs={"x2": square})
    sol = co.integrate(named, X0, (0, 1), 0.1)
    np.testing.assert_array_equal(sol.to_pandas()["x2"], sol.x[:, 1])
    np.testing.assert_array_equal(sol.to_pandas()["invariant x2"], sol.casimirs["x2"])


@pytest.mark.parametrize("system, x0", [(BODY, X0), (BODY, [X0, (1.0, 0.0, 2.0)]), (TOP, TOPS[0]), (TOP, TOPS)])
def test_rotations_turn_vectors_of_the_body_into_space(system, x0):
    """There the momentum of a free body rests, and the direction of gravity of a top; each time has all members."""
    start = co.integrate(system, x0, (0, 1), 0.1, attitude=True).rotation[:1].as_matrix()[0]
    np.testing.assert_array_equal(start, np.eye(3))
    sol = co.integrate(system, x0, (0, 5), 0.05, attitude=True)
    resting = sol.x[..., -3:].reshape(-1, 3)
    assert len(sol.rotation) == len(resting) == sol.x.size // sol.x.shape[-1]
    turned = sol.rotation.apply(resting).reshape(*sol.x.shape[:-1], 3)
    assert np.abs(turned - turned[0]).max() < 1e-13 and np.abs(sol.x - sol.x[0]).max() > 0.5
