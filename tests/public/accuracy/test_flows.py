"""Flows of splittings: blocks at any angle, long series, moved forms, and bonds of spins."""

import numpy as np
import pytest
import scipy.linalg
from scipy.linalg import expm

import coadjoint as co
from commuting_actions import acting
from cubic_blocks import cubic_bound
from drawn_matrices import whole_matrix
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

MOST_SUBSTEPS, SERIES = 4096, 5
"""Largest number of substeps of a flow, and the kind of its block in the table of docs/table.md."""


SL2, SO3 = co.algebras.sl(2), co.algebras.so(3)


def test_moved_forms_and_matrices_without_a_diagonal():
    """The first flow of a part moves both coordinates of the form of the second, their difference but for rounding not.

    Rounding of ten steps, of up to 100 flows of n coordinates each.
    """
    moved = co.LieAlgebra.from_brackets(5, {pair: {4: 1.0} for pair in ((0, 1), (0, 2), (1, 2), (1, 3))})
    difference = np.diag([1.0, 1.0, 1.0, 1.0, 0.0])
    difference[1, 2] = difference[2, 1] = -1.0
    hollow = co.Quadratic([[0.0, 1.0, 0.5], [1.0, 0.0, -2.0], [0.5, -2.0, 0.0]], linear=[1.0, 2.0, 3.0])
    for algebra, H in ((moved, co.Quadratic(difference)), (SO3, hollow)):
        system, x0 = co.LiePoissonSystem(algebra, H), np.linspace(-0.5, 0.7, algebra.dim)
        for method, h in ((co.Splitting(order=4), 0.0625), (co.Splitting(order=2, compensated=True), -0.0625)):
            x = x0
            for _ in range(10):
                x = method.step(system, x, 0.0, h)
            found = co.integrate(system, x0, (0.0, 10 * h), abs(h), method).x[-1]
            assert np.abs(found - x).max() <= U * 1000 * (len(x) + 12) * max(1.0, np.linalg.norm(x))
            assert np.abs(x - x0).max() > 1e-3


PLANES = {
    "rotation with damping": [[-0.5, 2.0], [-1.5, -0.5]],
    "saddle": [[0.0, 2.0], [0.5, 0.0]],
    "decay at two rates": [[0.0, 1.0], [1e-3, -2.0]],
    "growth at two rates": [[1.5, 0.25], [0.5, 0.5]],
    "Jordan": [[1.0, 1.0], [0.0, 1.0]],
    "nearly Jordan, real": [[1.5, 0.5], [-0.5 + 1e-14, 0.5]],
    "nearly Jordan, complex": [[1.5, 0.5], [-0.5 - 1e-14, 0.5]],
    "triangular": [[2.0, 1.0], [0.0, -1.0]],
}
MATRICES = {
    **{name: np.array(D) for name, D in PLANES.items()},
    "rotation": np.array([[0.0, -1.5], [1.5, 0.0]]),
    "scale": np.diag([1.0, -0.5]),
    "shear": np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [0.0, 0.0, 0.0]]),
    "chain": np.diag([1.0, 2.0, 3.0], 1),
    "general": np.array([[0.0, 1.0, 0.0, 0.5], [-1.0, 0.2, 0.0, 0.0], [0.3, 0.0, -0.1, 2.0], [0.0, 0.4, -2.0, 0.0]]),
    "so(3)": co.algebras.change_of_basis(SO3, whole_matrix(3, 7)).coadjoint([0.3, -0.2, 0.5]),
    "sl(2), elliptic": co.algebras.change_of_basis(SL2, whole_matrix(3, 11)).coadjoint([0.3, -0.2, 0.5]),
    "sl(2), hyperbolic": co.algebras.change_of_basis(SL2, whole_matrix(3, 11)).coadjoint([0.3, 0.7, 0.5]),
}


CUBIC = ("so(3)", "sl(2), elliptic", "sl(2), hyperbolic")


@pytest.mark.thinned(8)
@pytest.mark.parametrize("theta", [0.0, 1e-12, -1e-12, 0.37, -3.1, 20.0, -20.0, 50.0, -50.0])
@pytest.mark.parametrize("name", MATRICES)
def test_every_kind_of_block_at_any_angle(name, theta):
    """The plain reading is held to exp(theta D) in its own tests; both may miss it by what rounding theta and D moves.

    That is |theta D| u max_s |exp((1 - s) A)| |exp(s A)|, A = theta D, sampled at 9 values of s; 8 (n + 2) roundings.
    """
    D = MATRICES[name]
    n = len(D)
    s = co.LiePoissonSystem(acting(D), co.Quadratic([0.0] * n + [1.0]))
    x = np.append(np.linspace(-0.5, 0.7, n), theta)
    compiled = co.stepper(s, co.Splitting(order=1), 1.0)(x)
    plain = co.Splitting(order=1).step(s, x, 0.0, 1.0)
    ends = [np.linalg.norm(expm(k * theta / 8 * D)) for k in range(9)]
    spread = max(a * b for a, b in zip(ends, ends[::-1], strict=True))
    moved = 1.0 + abs(theta) * np.linalg.norm(D)
    bound = 8 * (n + 2) * U * moved * max(spread, 1.0) + (cubic_bound(D, theta) if name in CUBIC else 0.0)
    assert np.abs(compiled - plain).max() <= bound * np.linalg.norm(x[:n])
    assert compiled[n] == theta


TURNS = scipy.linalg.block_diag([[0, 1], [-1, 0]], [[0, 2], [-2, 0]])
BASIS = np.eye(4, dtype=int) + np.eye(4, k=1, dtype=int) + np.eye(4, k=3, dtype=int)
X0 = np.array([0.5, 1.0, -0.3, 0.2, 0.7])


def moved_by(matrix):
    """H = x1 where e1 acts by a matrix on four commuting elements, in a basis in which no block is simpler."""
    D = np.rint(np.linalg.inv(BASIS) @ matrix @ BASIS).astype(int)
    rows = [(0, 1 + i, 1 + j, float(D[i, j])) for i in range(4) for j in range(4) if D[i, j]]
    algebra = co.LieAlgebra(rows, dim=5, name="acted on")
    return co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=[1.0, 0.0, 0.0, 0.0, 0.0]))


LINEAR = moved_by(TURNS)
QUADRATIC = co.LiePoissonSystem(LINEAR.algebra, co.Quadratic([1.0, 0.0, 0.0, 0.0, 0.0]))
GENERATOR = np.array([LINEAR.structure_matrix(e) @ [1.0, 0, 0, 0, 0] for e in np.eye(5)]).T
SCALE = np.linalg.norm(BASIS, 1) * np.linalg.norm(np.linalg.inv(BASIS), 1)


def norm_of(system):
    """The time in which the series goes one substep far is its inverse."""
    table = co.Splitting(order=1).flow_table(system).to_mapping()
    assert table["state_kind"].tolist() == [SERIES]
    return float(table["state_norm"][0])


@pytest.mark.thinned(4)
@pytest.mark.parametrize("members", [1, 7])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_up_to_the_limit_a_flow_is_exact_and_beyond_it_is_refused(members, direction):
    system = LINEAR
    limit = MOST_SUBSTEPS / norm_of(system)
    x0 = X0 * (1.0 + 0.1 * np.arange(members)[:, None])
    step = co.Splitting(order=1).step

    near = limit * (1.0 - 2.0**-30)
    found = co.integrate(system, x0, (0.0, direction * near), near, co.Splitting(order=1)).x[-1]
    # A multiple of the period is left out: 20 roundings in each substep are what the series loses.
    exact = x0 @ scipy.linalg.expm(np.fmod(direction * near, 2.0 * np.pi) * GENERATOR).T
    tolerance = 20 * MOST_SUBSTEPS * 2.0**-53 * SCALE**2 * np.abs(x0).max()
    assert np.abs(found - exact).max() < tolerance
    assert np.abs(step(system, x0[0], 0.0, direction * near) - exact[0]).max() < tolerance

    far = limit * (1.0 + 2.0**-30)
    with refused(co.IntegrationError, "longer than 4096", "digits"):
        co.integrate(system, x0, (0.0, direction * far), far, co.Splitting(order=1))
    with refused(ValueError, "4096", "smaller step"):
        step(system, x0[0], 0.0, direction * far)


# In substeps of the series; the exponential is a matrix from 65 on, that of group elements from 9 on.
LENGTHS = np.array([0.5, 7.9, 8.1, 63.9, 64.1, 300.0, 4095.0, 4097.0, 1e9, 1e300, 2.0, 1000.0, 20.0])


@pytest.mark.parametrize("attitude", [False, "coadjoint"])
@pytest.mark.parametrize("compensated", [False, True])
def test_flows_of_every_length_alone_and_in_lanes(attitude, compensated):
    """With H = x1^2 / 2, x1 is constant, and the rate at which the others turn."""
    system = QUADRATIC
    x0 = np.tile(X0, (len(LENGTHS), 1))
    x0[:, 0] = LENGTHS / norm_of(LINEAR)
    method = co.Splitting(order=2, compensated=compensated)
    given = (0.0, 2.0), 1.0, method
    with refused(co.IntegrationError, "longer than 4096", "3 of 13 members", "member 7") as raised:
        co.integrate(system, x0, *given, attitude=attitude)
    found = raised.value.partial
    assert np.flatnonzero(found.failed).tolist() == [7, 8, 9]
    for m, length in enumerate(LENGTHS):
        try:
            alone = co.integrate(system, x0[m], *given, attitude=attitude)
        except co.IntegrationError as error:
            assert length > MOST_SUBSTEPS and error.step == 1
            assert np.isnan(found.x[1:, m]).all()
            continue
        np.testing.assert_array_equal(alone.x, found.x[:, m])
        turn = scipy.linalg.expm(np.fmod(2.0 * x0[m, 0], 2.0 * np.pi) * GENERATOR)
        # Two steps, each with 20 roundings in a substep, or with as much error in the squares.
        tolerance = 2 * 20 * max(length, 1.0) * 2.0**-53 * SCALE**2
        assert np.abs(alone.x[-1, 1:] - (turn @ x0[m])[1:]).max() < tolerance
        if attitude:
            np.testing.assert_array_equal(alone.attitude, found.attitude[:, m])
            # The group element takes the momentum back to the start.
            assert np.abs(alone.attitude[-1] @ turn - np.eye(5)).max() < SCALE * tolerance


@pytest.mark.parametrize("length", [20.0, 100.0, 3000.0])
def test_derivatives_of_long_flows(length):
    """x(t) = exp(t x1 D) x(0): the derivative by x1 is t D x(t); forward, and backward by the transpose."""
    system = QUADRATIC
    x0 = np.array([length / norm_of(LINEAR), *X0[1:]])
    ready = co.prepare(system, co.Splitting(order=2), 1.0)
    turn = scipy.linalg.expm(np.fmod(2.0 * x0[0], 2.0 * np.pi) * GENERATOR)
    exact = turn.copy()
    exact[:, 0] += 2.0 * GENERATOR @ turn @ x0
    tolerance = 2 * 2 * 20 * length * 2.0**-53 * SCALE**3
    for k in range(5):
        unit = np.eye(5)[k]
        assert np.abs(ready.jvp(x0, (0.0, 2.0), {"x0": unit}, 2)[1].x[-1] - exact[:, k]).max() < tolerance
        _, pullback = ready.vjp(x0, (0.0, 2.0), 2)
        assert np.abs(pullback(x=[0.0 * unit, unit])["x0"] - exact[k]).max() < tolerance


def by_bonds(**options):
    return co.Splitting(parts="bonds", **options)


def turned(c, x, t):
    """H = c S.T with S' = sign J grad H: S' = c K cross S for K = S + T, which is constant, and the same for T."""
    S, T = x.reshape(2, 3)
    K = S + T
    k = np.linalg.norm(K)
    if k == 0.0:
        return x.copy()
    n, phi = K / k, c * k * t
    change = [np.sin(phi) * np.cross(n, v) + 2 * np.sin(phi / 2) ** 2 * np.cross(n, np.cross(n, v)) for v in (S, T)]
    return x + np.concatenate(change)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("compensated", [False, True])
def test_one_bond_is_the_closed_form_at_any_step(sign, compensated):
    rng = np.random.default_rng(1)
    x0 = rng.standard_normal((20, 6))
    x0[0, 3:] = -x0[0, :3]  # no sum: at rest
    x0[1, 3:] = -x0[1, :3] * (1 + 2.0**-40)
    x0[2, 3:] = 2.0 * x0[2, :3]
    x0[3] = 0.0
    for c, h in ((-0.7, 0.03), (1.3, 2.5), (-2.0, -11.0), (0.4, 1000.0)):
        M = np.kron([[0.0, c], [c, 0.0]], np.eye(3))
        pair = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic(M), sign=sign)
        found = co.integrate(pair, x0, (0.0, 2 * h), abs(h), by_bonds(compensated=compensated)).x[-1]
        for x, start in zip(found, x0, strict=True):
            size = np.linalg.norm(start)
            # Rounding of |K| moves the phase.
            bound = 2.0**5 * U * size * (1.0 + abs(c * h) * size)
            # J grad H on so(3) with sign +1 is x cross grad H.
            assert np.abs(x - turned(sign * c, start, 2 * h)).max() <= bound, (c, h, start)


def lattices():
    rng = np.random.default_rng(3)
    edges = [(i, j) for i in range(5) for j in range(i + 1, 5) if rng.random() < 0.7]
    J = rng.standard_normal(len(edges))
    yield co.systems.spin_lattice(edges, 5, exchange=J)
    yield co.systems.spin_lattice(edges, 5, exchange=J, field=rng.standard_normal((5, 3)), on_site=(0.0, 0.0, 0.4))
    yield co.systems.spin_lattice("ring", 19, exchange=rng.standard_normal(19))
    stretched = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 2.0}, (0, 2): {1: -1.0}})
    M = np.kron(np.ones((3, 3)) - np.eye(3), np.diag([1.0, 0.5, 0.5]))
    yield co.LiePoissonSystem(co.algebras.copies(stretched, 3), co.Quadratic(M, linear=np.arange(9.0) / 8), sign=-1)


LATTICES = list(lattices())


@pytest.mark.parametrize("system", [LATTICES[0], LATTICES[2]], ids=["graph", "ring"])
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("compensated", [False, True])
def test_total_spin_and_lengths_are_kept(system, order, compensated):
    x0 = np.random.default_rng(2).standard_normal(system.dim)
    steps = 400
    run = co.integrate(
        system, x0, (0.0, -0.25 * steps), 0.25, by_bonds(order=order, compensated=compensated), watch=False
    )
    spins, start = run.x.reshape(len(run.x), -1, 3), x0.reshape(-1, 3)
    size = np.linalg.norm(start, axis=1).max()
    # A flow of a bond rounds six numbers, which add up like a random walk; 5 steps of order 2 make one of order 4.
    flows = steps * (6 if order == 2 else 30) * len(start)
    assert np.abs(spins.sum(axis=1) - start.sum(axis=0)).max() <= 4 * U * size * np.sqrt(flows)
    lengths = np.linalg.norm(spins, axis=2) / np.linalg.norm(start, axis=1) - 1
    assert np.abs(lengths).max() <= 8 * U * np.sqrt(flows)
    assert np.abs(run.x[-1] - x0).max() > 0.1


@pytest.mark.parametrize("system", [LATTICES[1], LATTICES[3]], ids=["field", "stretched"])
def test_the_plain_reading_and_its_tangent_agree_with_the_loops(system):
    x0, h, n = np.random.default_rng(6).standard_normal(system.dim), 0.25, system.dim
    method = by_bonds()
    run = co.integrate(system, x0, (0.0, h), h, method, attitude="coadjoint")
    x, step = method.step(system, x0, 0.0, h), co.stepper(system, method, h)
    size = max(1.0, np.abs(x).max())
    np.testing.assert_allclose(run.x[-1], x, rtol=0, atol=2.0**8 * U * size)
    P, J = step.tangent(x0), system.algebra.structure_matrix
    defect = P @ J(x0) @ P.T - J(x)
    assert np.abs(defect).max() <= 2.0**10 * U * max(1.0, np.abs(P).max()) ** 2 * size
    d = 2.0**-18
    differences = [(step(x0 + d * e) - step(x0 - d * e)) / (2 * d) for e in np.eye(n)]
    assert np.abs(np.transpose(differences) - P).max() < 1e-8 * np.abs(P).max() ** 2 * size
    np.testing.assert_allclose(np.linalg.solve(run.attitude[-1], x0), run.x[-1], rtol=0, atol=2.0**10 * U * size)


@pytest.mark.parametrize("scale", [2.0**-600, 2.0**400])
def test_any_size_of_spins(scale):
    x0 = np.random.default_rng(9).standard_normal(15)
    one = co.integrate(LATTICES[0], x0, (0.0, 1.0), 0.25, by_bonds())
    other = co.integrate(LATTICES[0], scale * x0, (0.0, 1.0 / scale), 0.25 / scale, by_bonds(), watch=False)
    np.testing.assert_array_equal(other.x, scale * one.x)
