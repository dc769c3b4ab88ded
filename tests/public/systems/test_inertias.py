"""Inertias that no body has, tensors that are symmetric or definite up to rounding, and units beyond float64."""

import itertools

import numpy as np
import pytest
from brackets import U

import coadjoint as co
from refusals import refused

S = co.systems
NO_BODY = [(1, 1, 5), (5, 1, 1), (1, 5, 1), (1, 2, 4), (1.0, 2.0, 3.0 + 1e-12)]
BODIES = [(1, 2, 3), (3, 1, 2), (0.1, 0.7, 0.8), (0.1, 0.2, 0.3), (1, 1, 1), (1e-3, 1, 1), (2e200, 3e200, 4e200)]
MAKERS = {
    "rigid_body": S.rigid_body,
    "heavy_top": S.heavy_top,
    "gyrostat": S.gyrostat,
    "satellite": lambda inertia: S.satellite(np.array(inertia) / max(inertia)),
}


def turned(moments, seed=4):
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(moments),) * 2))[0]
    tensor = Q @ np.diag(moments) @ Q.T
    return (tensor + tensor.T) / 2


def warned(make, *named):
    """Return what is made with one warning, at the line that makes it, that has these words."""
    with pytest.warns(UserWarning) as noticed:
        made = make()
    assert len(noticed) == 1 and noticed[0].filename == __file__
    assert all(word in str(noticed[0].message) for word in named), str(noticed[0].message)
    return made


@pytest.mark.parametrize("maker", MAKERS)
def test_an_inertia_that_no_body_has_is_warned_of(maker):
    for inertia in NO_BODY:
        warned(lambda inertia=inertia: MAKERS[maker](inertia), "inertia")
    for inertia in BODIES:
        MAKERS[maker](inertia)


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_a_tensor_is_checked_in_its_principal_axes(scale):
    for moments in BODIES[:-1]:
        S.rigid_body(scale * turned(moments))
    warned(lambda: S.rigid_body(scale * turned((1, 2, 4))), "inertia")


def test_the_warning_names_what_has_no_such_limit():
    body = warned(lambda: S.rigid_body((1, 1, 5)), "co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(...), sign=-1)")
    warned(lambda: S.heavy_top((1, 1, 5)), "co.algebras.e(3)")
    meant = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 1, 1 / 5]), sign=-1)
    assert np.array_equal(meant.vector_field([0.3, 0.4, 0.5]), body.vector_field([0.3, 0.4, 0.5]))
    # Of the inertia of a body in a fluid there is none: the fluid adds to it.
    S.kirchhoff_body(inertia=(1, 2, 4))
    S.clebsch_body(inertia=(1.0, 2.0, 4.0), inverse_mass=(1.0, 2.0, 4.0))
    S.lagrange_top(equatorial=1.0, axial=2.0)
    warned(lambda: S.lagrange_top(equatorial=1.0, axial=2.25), "axial")


@pytest.mark.parametrize("make", [S.so_n_body, S.matrix_body])
def test_second_moments_are_of_a_mass(make):
    """In any order: the two smallest add up to more than zero, and none is negative."""
    make((0.0, 1.0, 2.0, 3.0))
    for order in itertools.permutations(range(4)):
        with refused(ValueError, "inertia", "positive"):
            make(np.array([-1.5, 1.0, 3.0, 4.0])[list(order)])
        light = np.array([-0.5, 1.0, 3.0, 4.0])[list(order)]
        warned(lambda light=light: make(light), "negative", "co.LiePoissonSystem(co.algebras.so(4)")


@pytest.mark.parametrize(
    ("n", "scale", "draws"), [(3, 1e-120, 12), (3, 1.0, 12), (3, 1e120, 12), (4, 1.0, 4), (5, 1.0, 2)]
)
def test_a_flat_mass_has_a_second_moment_of_zero_up_to_rounding(n, scale, draws):
    """Its matrix in other axes has an eigenvalue that is zero up to rounding, of either sign."""
    random, signs = np.random.default_rng(n), set()
    for _ in range(draws):
        Q = np.linalg.qr(random.normal(size=(n, n)))[0] * [*[1.0] * (n - 1), 0.0]
        flat = scale * (Q * random.uniform(0.5, 2.0, n)) @ Q.T
        flat = (flat + flat.T) / 2
        signs.add(np.sign(np.linalg.eigvalsh(flat)[0]))
        S.so_n_body(flat)
    assert n > 3 or {1.0, -1.0} <= signs
    below = np.eye(n) - 1.001 * np.outer(Q[:, 0], Q[:, 0]) / (Q[:, 0] @ Q[:, 0])
    warned(lambda: S.so_n_body(scale * (below + below.T) / 2), "negative", f"co.algebras.so({n})")


@pytest.mark.parametrize("n", [3, 4])
def test_a_tensor_symmetric_up_to_rounding_counts_by_its_upper_half(n):
    """The stored tensor is symmetric, and makes the same system again."""
    root = np.random.default_rng(n).uniform(-1.0, 1.0, (n, n))
    upper = np.triu(root @ root.T + n * np.eye(n))
    symmetric = upper + np.triu(upper, 1).T
    nearly = symmetric * (1.0 + 4 * U * np.tril(np.ones((n, n)), -1))
    assert not np.array_equal(nearly, nearly.T)
    x = np.cos(np.arange(n * (n - 1) / 2))
    for make in [S.so_n_body, S.rigid_body] if n == 3 else [S.so_n_body]:
        body, wanted = make(nearly), make(symmetric)
        assert make is S.rigid_body or body.parameters == wanted.parameters
        np.testing.assert_array_equal(body.hamiltonian.hessian(x), wanted.hamiltonian.hessian(x))
        again = S.get(body.name, **body.parameters)
        np.testing.assert_array_equal(again.hamiltonian.hessian(x), wanted.hamiltonian.hessian(x))
    symmetric[n - 1, 1] += 1e-13 * symmetric.max()
    with refused(ValueError, "inertia", "symmetric", f"[1, {n - 1}]", f"[{n - 1}, 1]"):
        S.so_n_body(symmetric)


@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("place", range(3))
def test_moments_whose_inverse_overflows(place):
    """Half and a quarter of a moment may overflow where the moment itself does not."""
    moments = [1.0, 1.0, 1.0]
    moments[place] = 2.0**-1023
    for make in (S.rigid_body, S.heavy_top, S.gyrostat, S.kirchhoff_body):
        with refused(ValueError, f"inertia[{place}]", "e-308"):
            make(moments)
    for make, least in ((S.kovalevskaya_top, 2.0**-1021), (S.goryachev_chaplygin_top, 2.0**-1020)):
        with refused(ValueError, "equatorial"):
            make(least / 2)


@pytest.mark.parametrize("place", range(3))
def test_unequal_moments_about_a_rod_are_refused(place):
    """With the place of the moment that is zero, the body, and the two others in their order."""
    moments = np.insert([1.5, 1.75], place, 0.0)
    with refused(ValueError, f"inertia[{place}]", "1.5 and 1.75"):
        S.body(moments)
    with refused(ValueError, f"inertias[1][{place}]", "1.5 and 1.75"):
        S.bodies([(1, 2, 2.5), moments])
    with refused(ValueError, f"inertias[0][{place}]", "1.5 and 1.75"):
        S.gravitating_bodies([moments, (1, 2, 2.5)], (1.0, 2.0))
