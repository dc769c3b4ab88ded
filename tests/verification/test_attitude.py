"""Group elements: constant spatial momentum, and preservation of the group in every declared representation."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.systems.bodies.rigid_body import so3_body

from .measures import group_bound, order_of
from .schemes_under_test import schemes, serves
from .systems_under_test import AXES, cases, full_matrix

pytestmark = pytest.mark.thinned(6)

BODY = cases()["so(3), diagonal"].system
ATTITUDES = {n: m.properties(BODY).attitude for n, m in schemes().items() if serves(m, BODY)}
SPLITTINGS = [n for n, kind in ATTITUDES.items() if kind == "every representation" and "free body" not in n]
GAUSS = [n for n, kind in ATTITUDES.items() if kind == "coadjoint"]
REPRESENTED = [c for c, case in cases().items() if case.system.representation is not None]
ORTHOGONAL = ["so(3), diagonal", "so(3), full, axes turned", "so(4), diagonal", "so(4), separable"]


def run_of(scheme, case, attitude, count=400, step=0.05):
    system, x0, _ = cases()[case]
    return co.integrate(
        system, x0, (0.0, count * step), step, schemes()[scheme], attitude=attitude, save_every=count // 4
    )


def in_space_axes(case, x):
    """Return the momentum in the axes of the hat matrices: in "axes turned" coordinate i is component AXES[i]."""
    vector = np.array(x)
    if case == "so(3), full, axes turned":
        vector[..., list(AXES)] = x
    return vector


@pytest.mark.parametrize("scheme", SPLITTINGS + GAUSS)
@pytest.mark.parametrize("case", ["so(3), diagonal", "so(3), full, axes turned"])
def test_rotations_preserve_the_spatial_momentum(case, scheme):
    run = run_of(scheme, case, True)
    bound = group_bound(run, 3.0)
    assert np.max(np.abs(np.einsum("tij,tij->t", run.attitude, run.attitude) - 3.0)) <= 3 * bound
    for A, x in zip(run.attitude, run.x, strict=True):
        assert np.max(np.abs(A.T @ A - np.eye(3))) <= bound
        assert np.linalg.det(A) > 0
        moved = A @ in_space_axes(case, x) - in_space_axes(case, run.x[0])
        assert np.max(np.abs(moved)) <= bound * np.linalg.norm(x)


@pytest.mark.parametrize("scheme", SPLITTINGS)
@pytest.mark.parametrize("case", ORTHOGONAL)
def test_orthogonal_representations_stay_orthogonal(case, scheme):
    run = run_of(scheme, case, True)
    d = run.attitude.shape[-1]
    for g in run.attitude:
        assert np.max(np.abs(g.T @ g - np.eye(d))) <= group_bound(run, d)


@pytest.mark.thinned(18)
@pytest.mark.parametrize("scheme", SPLITTINGS)
@pytest.mark.parametrize("case", REPRESENTED)
def test_representation_agrees_with_the_coadjoint_matrix(case, scheme):
    """g^(-1) rho(e_i) g = sum_j K_ij rho(e_j), where K x is constant."""
    system = cases()[case].system
    step = 0.01 if case in ("sl(2), driven", "A3,7, diagonal", "A3,7, full") else 0.05
    in_rho, in_K = (run_of(scheme, case, how, count=100, step=step) for how in (True, "coadjoint"))
    rho = system.representation
    for g, K in zip(in_rho.attitude, in_K.attitude, strict=True):
        turned = np.linalg.solve(g, rho @ g)
        size = np.linalg.cond(g) ** 2 * np.linalg.norm(K) * np.linalg.norm(rho)
        assert np.max(np.abs(turned - np.einsum("ij,jab->iab", K, rho))) <= group_bound(in_K, size)


@pytest.mark.parametrize("scheme", SPLITTINGS)
def test_spatial_momentum_of_so4_is_constant(scheme):
    """X = sum x_ij (E_ij - E_ji); g X g^T is constant."""
    run = run_of(scheme, "so(4), diagonal", True)
    rho = cases()["so(4), diagonal"].system.representation
    X = np.einsum("ti,iab->tab", run.x, rho)
    spatial = run.attitude @ X @ np.swapaxes(run.attitude, 1, 2)
    assert np.max(np.abs(spatial - spatial[0])) <= group_bound(run, 4 * np.linalg.norm(X[0]))


@pytest.mark.parametrize("scheme", GAUSS)
@pytest.mark.parametrize("case", ["e(3), heavy top", "A3,7, full", "so(4), diagonal"])
def test_gauss_methods_refuse_other_representations(case, scheme):
    system, x0, _ = cases()[case]
    with pytest.raises(ValueError, match="coadjoint"):
        co.integrate(system, x0, (0.0, 1.0), 0.1, schemes()[scheme], attitude=True)


@pytest.mark.parametrize("scheme", SPLITTINGS + GAUSS)
def test_initial_attitude_multiplies_from_the_left(scheme):
    system, x0, _ = cases()["so(3), full, axes turned"]
    c, s = np.cos(0.7), np.sin(0.7)
    A0 = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    from_one = co.integrate(system, x0, (0.0, 5.0), 0.1, schemes()[scheme], attitude=True)
    from_A0 = co.integrate(system, x0, (0.0, 5.0), 0.1, schemes()[scheme], attitude=A0)
    assert np.array_equal(from_A0.x, from_one.x)
    assert np.max(np.abs(from_A0.attitude - A0 @ from_one.attitude)) <= group_bound(from_one, 3.0)


@pytest.mark.thinned(18)
@pytest.mark.parametrize("scheme", SPLITTINGS + GAUSS)
@pytest.mark.parametrize("case", ["so(3), full, axes turned", "so(4), diagonal", "e(3), heavy top", "A3,7, full"])
def test_first_element_is_the_given_one_bitwise(case, scheme):
    """In representations and as the coadjoint matrix, forward and backward, alone and in ensembles."""
    system, x0, _ = cases()[case]
    attitudes = [("coadjoint", np.eye(system.dim))]
    if scheme in SPLITTINGS or case.startswith("so(3)"):
        # The first generator moves few axes: the other entries are zeros, of which half are made negative.
        given = expm(0.7 * system.representation[0])
        given[:2][given[:2] == 0.0] = -0.0
        attitudes.append((given, given))
    for attitude, given in attitudes:
        for span in ((0.0, 0.1), (3.0, 2.9)):
            for x in (x0, np.array([x0, 0.5 * x0])):
                first = co.integrate(system, x, span, 0.05, schemes()[scheme], attitude=attitude).attitude[0]
                assert first.tobytes() == np.broadcast_to(given, first.shape).tobytes()


@pytest.mark.parametrize(
    "scheme",
    [
        "Splitting 2",
        "Splitting 4",
        "GaussLegendre 1",
        "GaussLegendre 2",
        "Modified 1 gradient",
        "Modified 2 gradient",
        "runge2",
        "rk4",
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_attitude_has_the_order_of_the_scheme(scheme, sign):
    """Against the closed form, full inertia tensor, both signs."""
    M = full_matrix(1, 3)
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M), sign=sign)
    # The closed form of a body for this quadratic form, which no body has.
    body = so3_body(M, sign=-1, name="form", parameters={})
    x0, method = np.array([1.0, -1.5, 1.2]), schemes()[scheme]
    # x' = J M x run forward is the body motion run backward.
    exact = body.exact(x0, -2.0 * sign, attitude=True)[1]
    errors = []
    counts = (32, 45, 64, 91, 128)
    for count in counts:
        run = co.integrate(system, x0, (0.0, 2.0), 2.0 / count, method, attitude=True, save_every=count)
        errors.append(float(np.linalg.norm(run.attitude[-1] - exact)))
    found = order_of([2.0 / c for c in counts], errors, 2 if method.symmetric else 1)
    assert found.agrees_with(method.order), found
