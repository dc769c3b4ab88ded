"""Inertias that no body has are told, once and where they are written; a flat body is one."""

import warnings

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.bodies.inertia import warn_negative_mass

NO_BODY = [(1, 1, 5), (5, 1, 1), (1, 5, 1), (1, 2, 4), (1.0, 2.0, 3.0 + 1e-12)]
BODIES = [(1, 2, 3), (3, 1, 2), (0.1, 0.7, 0.8), (0.1, 0.2, 0.3), (1, 1, 1), (1e-3, 1, 1), (2e200, 3e200, 4e200)]
MAKERS = {
    "rigid_body": co.systems.rigid_body,
    "heavy_top": co.systems.heavy_top,
    "gyrostat": co.systems.gyrostat,
    "satellite": lambda inertia: co.systems.satellite(np.array(inertia) / max(inertia)),
}
WARNING = "inertia: a principal moment exceeds the sum of the other two, which no body has"


def turned(moments, seed=4):
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    tensor = Q @ np.diag(moments) @ Q.T
    return (tensor + tensor.T) / 2


@pytest.mark.parametrize("inertia", NO_BODY)
@pytest.mark.parametrize("maker", MAKERS)
def test_an_inertia_that_no_body_has_is_told(maker, inertia):
    with pytest.warns(UserWarning, match=WARNING) as noticed:
        MAKERS[maker](inertia)
    assert len(noticed) == 1 and noticed[0].filename == __file__


@pytest.mark.parametrize("inertia", BODIES)
@pytest.mark.parametrize("maker", MAKERS)
def test_a_body_is_made_without_a_word(maker, inertia):
    MAKERS[maker](inertia)


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_a_tensor_is_looked_at_in_its_principal_axes(scale):
    for moments in BODIES[:-1]:
        co.systems.rigid_body(scale * turned(moments))
    with pytest.warns(UserWarning, match=WARNING):
        co.systems.rigid_body(scale * turned((1, 2, 4)))


def test_a_mass_of_points_in_a_plane_is_a_body_whatever_its_axes():
    random = np.random.default_rng(8)
    for _ in range(50):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        points = np.column_stack([random.normal(size=(20, 2)), np.zeros(20)]) @ turn.T
        tensor = (points**2).sum() * np.eye(3) - points.T @ points
        co.systems.rigid_body((tensor + tensor.T) / 2)


def test_what_is_said_is_a_way_out():
    with pytest.warns(UserWarning, match=r"co.LiePoissonSystem\(co.algebras.so\(3\), co.Quadratic\(...\), sign=-1\)"):
        body = co.systems.rigid_body((1, 1, 5))
    with pytest.warns(UserWarning, match=r"co.algebras.e\(3\)"):
        co.systems.heavy_top((1, 1, 5))
    meant = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 1, 1 / 5]), sign=-1)
    assert np.array_equal(meant.vector_field([0.3, 0.4, 0.5]), body.vector_field([0.3, 0.4, 0.5]))


def test_a_line_that_makes_many_is_told_once():
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("default")
        for third in range(1, 100):
            co.systems.rigid_body((1, 2, third))
    assert len(noticed) == 1


def test_lagrange_s_top_is_a_body_up_to_a_disk():
    co.systems.lagrange_top(equatorial=1.0, axial=2.0)
    with pytest.warns(UserWarning, match="axial: .* no body has"):
        co.systems.lagrange_top(equatorial=1.0, axial=2.25)


@pytest.mark.parametrize("maker", [co.systems.so_n_body, co.systems.matrix_body])
def test_second_moments_are_of_a_mass(maker):
    maker((0.0, 1.0, 2.0, 3.0))
    with pytest.warns(UserWarning, match=r"negative, which no body has; .* co.LiePoissonSystem\(co.algebras.so\(4\)"):
        maker((-0.5, 1.0, 2.0, 3.0))


@pytest.mark.parametrize("scale", [1e-120, 1.0, 1e120])
@pytest.mark.parametrize("n", [3, 4, 5])
def test_a_flat_mass_has_a_second_moment_of_zero_up_to_rounding(n, scale):
    """Its matrix in other axes has an eigenvalue that is zero up to rounding, of either sign."""
    random, signs = np.random.default_rng(n), set()
    for draw in range(20):
        Q = np.linalg.qr(random.normal(size=(n, n)))[0] * [*[1.0] * (n - 1), 0.0]
        flat = scale * (Q * random.uniform(0.5, 2.0, n)) @ Q.T
        flat = (flat + flat.T) / 2
        signs.add(np.sign(np.linalg.eigvalsh(flat)[0]))
        warn_negative_mass(flat)
        if n == 3 and draw < 4:
            co.systems.so_n_body(flat)
    assert {1.0, -1.0} <= signs
    below = np.eye(n) - 1.001 * np.outer(Q[:, 0], Q[:, 0])
    with pytest.warns(UserWarning, match=rf"is negative, which no body has; .*co.algebras.so\({n}\)") as noticed:
        warn_negative_mass(scale * (below + below.T) / 2)
    assert len(noticed) == 1


def test_what_a_fluid_adds_is_no_body():
    co.systems.kirchhoff_body(inertia=(1, 2, 4))
    co.systems.clebsch_body(inertia=(1.0, 2.0, 4.0), inverse_mass=(1.0, 2.0, 4.0))
