"""Explicit Lie-Poisson splitting: orders, symmetry, the paper's composition by hand, attitude, absolute references."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.methods.numerics.splitting_schemes import DEFAULT_SCHEMES, SCHEMES

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53


def constants_of(algebra):
    unit = np.eye(algebra.dim)
    return np.array([[algebra.bracket(u, v) for v in unit] for u in unit])


def in_basis(algebra, T):
    inverse = np.rint(np.linalg.inv(T))
    rho = np.einsum("ia,abc->ibc", T, algebra.representation)
    return co.LieAlgebra(np.einsum("ia,jb,abk,kl->ijl", T, T, constants_of(algebra), inverse), representation=rho)


def full(n, seed):
    A = np.random.default_rng(seed).uniform(-1, 1, (n, n))
    return np.diag(np.linspace(0.5, 1.5, n)) + 0.25 * (A + A.T)


def copies(algebra, count):
    i, j, k, c = algebra.triples
    shift = algebra.dim * np.arange(count)[:, None]
    rows = zip(*(np.ravel(a + shift).tolist() for a in (i, j, k)), np.tile(c, count).tolist(), strict=True)
    return co.LieAlgebra(list(rows), dim=algebra.dim * count)


SKEWED = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
SPINS = np.diag(np.full(9, 0.3)) + np.kron(np.ones((3, 3)) - np.eye(3), np.diag([0.5, 0.25, 1.0]))
SYSTEMS = {
    "e(3) diagonal": (co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0.5, 1.5, 0.75], linear=[0, 0, 0, 0.5, 0, 1.0])),
    "so(4) full": (co.algebras.so(4), co.Quadratic(full(6, 1))),
    "sl(2) full": (co.algebras.sl(2), co.Quadratic(full(3, 2), linear=[0.25, 0, -0.5])),
    "A3,7 diagonal": (co.algebras.get("A3,7", a=1.75), co.Quadratic([1.0, 2.0, 0.25])),
    "Heisenberg full": (co.algebras.heisenberg(2), co.Quadratic(full(5, 3))),
    "so(5) diagonal": (co.algebras.so(5), co.Quadratic(np.linspace(0.5, 1.5, 10))),
    "so(3) permuted": (in_basis(co.algebras.so(3), np.eye(3)[[2, 0, 1]]), co.Quadratic([1.0, 0.5, 0.25])),
    "so(3) other basis": (in_basis(co.algebras.so(3), SKEWED), co.Quadratic(full(3, 4))),
    "3 spins": (copies(co.algebras.so(3), 3), co.Quadratic(SPINS)),
    "quartic on so(3)": (
        co.algebras.so(3),
        co.Polynomial({(4, 0, 0): 0.25, (0, 3, 0): 0.5, (0, 0, 2): 1.0, (1, 0, 1): 0.5}),
    ),
}
SYMMETRIC = [
    co.Splitting(order=2),
    co.Splitting(order=4),
    co.Splitting(scheme="yoshida4"),
    co.Splitting(parts="coordinates"),
]


def setup(name, sign=1):
    """Without Casimirs: they are watched elsewhere, and that of A3,7 would be compiled for every run."""
    s = co.LiePoissonSystem(*SYSTEMS[name], sign=sign, casimirs={})
    return s, np.linspace(-0.75, 1.25, s.dim)


def reference(s, x0, t, t0=0.0):
    solution = solve_ivp(lambda t, x: s.vector_field(x, t), (t0, t), x0, method="DOP853", rtol=1e-13, atol=1e-14)
    return solution.y[:, -1]


@pytest.mark.thinned(9)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", SYSTEMS)
def test_orders_against_an_independent_integrator(name, sign):
    """log2 of the ratio of errors at h and h/2 is p + O(h), h = 1/64 the smallest; below 1e-11 they are DOP853's."""
    s, x0 = setup(name, sign)
    exact = reference(s, x0, 1.0)
    for method, tolerance in (
        (co.Splitting(order=1), 0.2),
        (co.Splitting(order=1, adjoint=True), 0.2),
        (co.Splitting(order=2), 0.1),
        (co.Splitting(order=4), 0.2),
        (co.Splitting(scheme="yoshida4"), 0.35),
    ):
        errors = []
        for steps in (16, 32, 64):
            sol = co.integrate(s, x0, (0, 1), 1 / steps, method, save_every=steps, watch=False)
            errors.append(np.abs(sol.x[-1] - exact).max())
        slopes = [math.log2(a / b) for a, b in pairwise(errors) if b > 1e-11]
        assert slopes, errors
        assert abs(slopes[-1] - method.order) <= tolerance, (method, errors)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_adjoint_is_the_inverse_of_the_step_back(name):
    """Rounding of two steps of n flows, times the size of the states."""
    s, x = setup(name)
    back = co.stepper(s, co.Splitting(order=1), -0.1)
    adjoint = co.stepper(s, co.Splitting(order=1, adjoint=True), 0.1)
    assert np.abs(back(adjoint(x)) - x).max() <= 64 * s.dim * U
    assert np.abs(adjoint(x) - co.stepper(s, co.Splitting(order=1), 0.1)(x)).max() > 1e-5


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", SYMMETRIC, ids=str)
def test_a_step_back_undoes_a_step(name, method):
    s, x = setup(name)
    there, back = co.stepper(s, method, 0.1), co.stepper(s, method, -0.1)
    assert np.abs(back(there(x)) - x).max() <= 512 * s.dim * U


def test_order_one_is_not_symmetric():
    s, x = setup("e(3) diagonal")
    there, back = (co.stepper(s, co.Splitting(order=1), h) for h in (0.1, -0.1))
    assert np.abs(back(there(x)) - x).max() > 1e-4


def test_order_two_is_half_a_step_and_half_its_adjoint():
    s, x = setup("so(4) full")
    first, second = (co.stepper(s, co.Splitting(order=1, adjoint=adjoint), 0.05) for adjoint in (False, True))
    assert np.abs(second(first(x)) - co.stepper(s, co.Splitting(order=2), 0.1)(x)).max() <= 64 * 6 * U


def test_the_composition_that_the_paper_prints():
    """X1(h/2) X2(h/2) X3(h) X2(h/2) X1(h/2), each flow a rotation about its axis written out (Lemma 4.1)."""
    m, h = (1.0, 0.5, 1 / 3), 0.1

    def flow(i, tau, x):
        j, k = (i + 1) % 3, (i + 2) % 3
        angle = tau * m[i] * x[i]
        y = x.copy()
        # x' = J(x) M x = (M x) cross x, for the one coordinate: e_i m_i x_i cross x.
        y[j] = math.cos(angle) * x[j] - math.sin(angle) * x[k]
        y[k] = math.sin(angle) * x[j] + math.cos(angle) * x[k]
        return y

    body = co.systems.paper_rigid_body(m)
    step = co.stepper(body, co.Splitting(order=2, parts="coordinates"), h)
    x = np.array([1.0, 10.0, 1.0])
    for _ in range(5):
        by_hand = x
        for i, tau in ((0, h / 2), (1, h / 2), (2, h), (1, h / 2), (0, h / 2)):
            by_hand = flow(i, tau, by_hand)
        x = step(x)
        assert np.abs(x - by_hand).max() <= 5 * 4 * U * 10.1
        x = by_hand


def test_spirals_that_the_paper_prints():
    """Section 4 for A3,7: H3 moves (x1, x2) by exp(theta (a, -1; 1, a)), H1 and H2 move x3 alone; theta = tau m3 x3."""
    a, m, h = 2.0, (1.0, 2.0, 0.01), 0.01
    s = co.systems.paper_a37(a, m)
    x = np.array([1.0, 1.0, 1.0])

    def shear(x, tau):
        # x3' = J_31 m1 x1 + J_32 m2 x2, J_13 = a x1 - x2, J_23 = x1 + a x2
        rate = -(a * x[0] - x[1]) * m[0] * x[0] - (x[0] + a * x[1]) * m[1] * x[1]
        return np.array([x[0], x[1], x[2] + tau * rate])

    def spiral(x, tau):
        theta = tau * m[2] * x[2]
        c, s, r = math.cos(theta), math.sin(theta), math.exp(a * theta)
        # x1' = J_13 m3 x3 = (a x1 - x2) m3 x3, x2' = (x1 + a x2) m3 x3
        return np.array([r * (c * x[0] - s * x[1]), r * (s * x[0] + c * x[1]), x[2]])

    step = co.stepper(s, co.Splitting(order=2), h)
    by_hand = shear(spiral(shear(x, h / 2), h), h / 2)
    assert np.abs(step(x) - by_hand).max() <= 16 * U * 7


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_coadjoint_matrix_carries_the_momentum(name, sign):
    """K x = x0: each of the roundings of 200 steps is unbiased in K and x; bounded by their number times the sizes."""
    s, x0 = setup(name, sign)
    sol = co.integrate(s, x0, (0, 2), 0.01, co.Splitting(order=2), attitude="coadjoint", save_every=50)
    flows = sol.stats.evaluations
    for x, K in zip(sol.x, sol.attitude, strict=True):
        assert np.abs(K @ x - x0).max() <= 4 * flows * s.dim * U * np.linalg.norm(K) * np.linalg.norm(x)
    assert np.abs(sol.x[-1] - x0).max() > 0.01


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["e(3) diagonal", "so(4) full", "sl(2) full", "A3,7 diagonal", "so(3) other basis"])
def test_the_group_element_follows_its_equation(name, sign):
    """g' = -sign g rho(grad H), integrated beside x by DOP853: order 4 at h = 1/64 leaves 1e-7."""
    s, x0 = setup(name, sign)
    rho = s.representation
    d, n = rho.shape[1], s.dim

    def field(t, z):
        x, g = z[:n], z[n:].reshape(d, d)
        rate = -sign * g @ np.einsum("i,ibc->bc", s.hamiltonian.gradient(x, t), rho)
        return np.concatenate([s.vector_field(x, t), rate.ravel()])

    start = np.concatenate([x0, np.eye(d).ravel()])
    end = solve_ivp(field, (0, 1), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    sol = co.integrate(s, x0, (0, 1), 1 / 64, co.Splitting(order=4), attitude=True)
    error = np.abs(sol.attitude[-1] - end[n:].reshape(d, d)).max()
    assert error <= 1e-5
    finer = co.integrate(s, x0, (0, 1), 1 / 128, co.Splitting(order=4), attitude=True)
    smaller = np.abs(finer.attitude[-1] - end[n:].reshape(d, d)).max()
    assert smaller <= max(error / 8, 1e-11)  # 16 in the limit


@pytest.mark.parametrize(
    "body", [co.systems.rigid_body((1.0, 2.0, 2.5)), co.systems.paper_rigid_body((1.0, 0.5, 1 / 3))], ids=str
)
def test_the_exact_free_body(body):
    """State and attitude against elliptic functions: a wrong sign or speed keeps every invariant, not these."""
    x0, t = np.array([0.3, 1.0, -0.6]), 5.0
    x, A = body.exact(x0, t, attitude=True)
    errors = []
    for steps in (100, 200):
        sol = co.integrate(body, x0, (0, t), t / steps, co.Splitting(order=4), attitude=True, save_every=steps)
        errors.append((np.abs(sol.x[-1] - x).max(), np.abs(sol.attitude[-1] - A).max()))
    for coarse, fine in zip(*errors, strict=True):
        assert coarse < 1e-5
        assert fine < coarse / 12 or fine < 1e-11  # 16 in the limit
    backward = co.integrate(body, x0, (0, -t), t / 200, co.Splitting(order=4), attitude=True, save_every=200)
    exact = body.exact(x0, -t, attitude=True)
    assert np.abs(backward.x[-1] - exact[0]).max() < 1e-6 and np.abs(backward.attitude[-1] - exact[1]).max() < 1e-6


def test_rotations_stay_rotations():
    """100 000 compensated steps of 5 rotations: unbiased errors wander like sqrt(flows) u; 8 sigma (Brouwer's law)."""
    body, x0 = co.systems.rigid_body((1.0, 2.0, 2.5)), np.array([0.3, 1.0, -0.6])
    sol = co.integrate(
        body, x0, (0, 1e4), 0.1, co.Splitting(order=2, compensated=True), attitude=True, save_every=100000
    )
    A, wander = sol.attitude[-1], 8 * math.sqrt(sol.stats.evaluations) * U
    assert np.abs(A.T @ A - np.eye(3)).max() <= wander
    assert np.abs(A @ sol.x[-1] - x0).max() <= wander * np.linalg.norm(x0)
    assert sol.drift()["|x|^2"] <= 2 * wander * (x0 @ x0)


def test_energy_is_bounded_and_not_kept():
    body = co.systems.rigid_body((1.0, 2.0, 2.5))
    drifts = [
        co.integrate(body, (0.3, 1.0, -0.6), (0, 500), h, co.Splitting(order=2)).drift()["energy"] for h in (0.1, 0.05)
    ]
    assert drifts[1].growth < 1.5 and 3.5 < drifts[0] / drifts[1] < 4.5  # 4 = 2^order


@pytest.mark.parametrize("order", [1, 2, 4])
def test_time_dependent_pieces(order):
    """Slope against DOP853 with the clock started anywhere: 4 = order at h = 1/64, each substep at its own time."""
    fast = (lambda y, t: 0.5 * y * y * (1 + 0.5 * math.sin(3 * t)), lambda y, t: y * (1 + 0.5 * math.sin(3 * t)))
    drive = (lambda y, t: y * math.cos(2 * t), lambda y, t: math.cos(2 * t))
    pieces = [
        ((0,), co.Separable({0: fast})),
        ((1,), co.Quadratic(0.7)),
        ((2,), co.Quadratic(0.4)),
        ((3, 4, 5), co.Quadratic([1.0, 2.0, 0.3])),
        ((5,), co.Separable({0: drive})),
    ]
    s = co.LiePoissonSystem(co.algebras.e(3), co.SplitHamiltonian(pieces), sign=-1)
    x0 = np.linspace(-0.5, 0.75, 6)
    exact = reference(s, x0, 1.75, t0=0.75)
    for parts in ("auto", "coordinates") if order == 2 else ("auto",):
        errors = []
        for steps in (32, 64):
            method = co.Splitting(order=order, parts=parts)
            sol = co.integrate(s, x0, (0.75, 1.75), 1 / steps, method, save_every=steps, watch=False)
            errors.append(np.abs(sol.x[-1] - exact).max())
        assert abs(math.log2(errors[0] / errors[1]) - order) < 0.2, errors


def test_names_and_orders():
    for name, scheme in SCHEMES.items():
        method = co.Splitting(scheme=name)
        assert (method.order, method.symmetric, method.explicit) == (scheme.order, not scheme.processed, True)
    for order, name in DEFAULT_SCHEMES.items():
        sweeps = co.Splitting(order=order).sweeps()
        assert sweeps == co.Splitting(scheme=name).sweeps()
    assert not co.Splitting(order=1).symmetric
    assert co.Splitting(order=4) == co.Splitting(order=4) and hash(co.Splitting(parts=[[0], [1, 2]]))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"order": 3}, ValueError, "orders 1, 2, 4, 6, 8 and 10, not 3"),
        ({"scheme": "suzuky4"}, ValueError, "unknown splitting scheme 'suzuky4'; did you mean 'suzuki4'"),
        ({"scheme": "strang", "order": 4}, ValueError, "scheme 'strang' has order 2, not 4"),
        ({"adjoint": True}, ValueError, "adjoint=True is for order 1"),
        ({"rotation": "exactly"}, ValueError, "unknown rotation 'exactly'; did you mean 'exact'"),
        ({"parts": "coordinate"}, ValueError, "unknown choice of parts 'coordinate'; did you mean 'coordinates'"),
        ({"parts": [0, 1, 2]}, TypeError, r"sets of coordinates such as \[\[0, 1\], \[2\]\]"),
        (
            {"parts": [[0.5], [1]]},
            ValueError,
            "a coordinate in parts must be a whole number from 0 to 4294967295, not 0.5",
        ),
    ],
)
def test_refusals(options, error, message):
    with pytest.raises(error, match=message) as refusal:
        co.Splitting(**options)
    assert "\n" not in str(refusal.value)


def test_a_system_without_an_algebra_is_refused_by_name():
    s = co.PoissonSystem(
        lambda x: np.array([[0.0, 1.0 + x[0] ** 2], [-1.0 - x[0] ** 2, 0.0]]),
        co.Quadratic([1.0, 2.0]),
        name="warped plane",
    )
    with pytest.raises(ValueError, match="Splitting needs a Lie algebra, which warped plane does not have"):
        co.integrate(s, (1.0, 0.0), (0, 1), 0.1, co.Splitting())
