"""Splittings: the group element, names and orders, refusals."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.methods.numerics.splitting_schemes import DEFAULT_SCHEMES, SCHEMES
from drawn_matrices import wide

pytestmark = pytest.mark.thinned(3)


SKEWED = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
SYSTEMS = {
    "e(3) diagonal": (co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0.5, 1.5, 0.75], linear=[0, 0, 0, 0.5, 0, 1.0])),
    "so(4) full": (co.algebras.so(4), co.Quadratic(wide(6, 1))),
    "sl(2) full": (co.algebras.sl(2), co.Quadratic(wide(3, 2), linear=[0.25, 0, -0.5])),
    "A3,7 diagonal": (co.algebras.get("A3,7", a=1.75), co.Quadratic([1.0, 2.0, 0.25])),
    "Heisenberg full": (co.algebras.heisenberg(2), co.Quadratic(wide(5, 3))),
    "so(5) diagonal": (co.algebras.so(5), co.Quadratic(np.linspace(0.5, 1.5, 10))),
    "so(3) permuted": (
        co.algebras.change_of_basis(co.algebras.so(3), np.eye(3)[[2, 0, 1]]),
        co.Quadratic([1.0, 0.5, 0.25]),
    ),
    "so(3) other basis": (co.algebras.change_of_basis(co.algebras.so(3), SKEWED), co.Quadratic(wide(3, 4))),
    "quartic on so(3)": (
        co.algebras.so(3),
        co.Polynomial({(4, 0, 0): 0.25, (0, 3, 0): 0.5, (0, 0, 2): 1.0, (1, 0, 1): 0.5}),
    ),
}


def setup(name, sign=1):
    """Without Casimirs: they are watched elsewhere, and that of A3,7 would be compiled for every run."""
    s = co.LiePoissonSystem(*SYSTEMS[name], sign=sign, casimirs={})
    return s, np.linspace(-0.75, 1.25, s.dim)


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
        ({"scheme": "kahan_li8"}, ValueError, "unknown splitting scheme 'kahan_li8'; did you mean 'kahan_li8"),
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
