"""Closed forms of ready-made systems: slopes, groups, invariants, shapes, and group elements, from drawn states."""

import numpy as np
import pytest

import coadjoint as co

U = 2.0**-53
S = co.systems
FULL = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])
FIELDS = np.array([[0.0, 0.0, 0.5], [1.0, -0.5, 0.25], [0.0, 0.0, 0.0]])

# Systems by name, and the size of the group element, 0 if the closed form is of the state alone.
SYSTEMS = {
    "rigid body": (S.rigid_body((2.0, 1.0, 1.5)), 3),
    "rigid body, full": (S.rigid_body(FULL), 3),
    "paper": (S.paper_rigid_body((0.3, -0.4, 1.1)), 3),
    "gyrostat about 1": (S.gyrostat((3.0, 2.0, 2.0), (0.7, 0.0, 0.0)), 3),
    "gyrostat about 2": (S.gyrostat((2.0, 3.0, 2.0), (0.0, -0.7, 0.0)), 3),
    "gyrostat, ball": (S.gyrostat((2.0, 2.0, 2.0), (0.3, -0.4, -0.8)), 3),
    "Riccati, real": (S.riccati(0.3, -0.7, -0.4), 2),
    "Riccati, double": (S.riccati(0.25, 1.0, 1.0), 2),
    "Riccati, complex": (S.riccati(0.3, 0.2, 0.4), 2),
    "Maxwell-Bloch": (S.maxwell_bloch(2.5), 0),
    "triad": (S.fluid_triad((1.0, 0.5), (-0.25, 1.5)), 0),
    "triad, other sense": (S.fluid_triad((-0.25, 1.5), (1.0, 0.5)), 0),
    "Lorenz": (S.lorenz_1960(0.75, 1.25), 0),
    "Sklyanin": (S.sklyanin((1.0, 2.5, 4.0), (-1.0, 1.5, 3.0, 4.5)), 0),
    "Sklyanin, symmetric": (S.sklyanin((1.0, 1.0, 4.0), (0.3, 2.0, 2.0, 5.0)), 0),
    "Sklyanin, equal": (S.sklyanin((1.0, 2.5, 4.0), (0.3, 2.0, 2.0, 2.0)), 0),
    "spins apart": (S.spin_lattice("chain", 3, exchange=0.0, field=FIELDS), 0),
    "spins together": (S.spin_lattice("complete", 3, exchange=-0.6, field=(0.1, 0.2, -0.3)), 0),
    "spins of a scaled tensor": (
        S.spin_lattice("complete", 4, exchange=-0.6, tensor=2.5 * np.eye(3), on_site=(0.3, 0.3, 0.3)),
        0,
    ),
    "spins alone": (S.spin_lattice("ring", 3, exchange=0.4), 0),
    "particles": (S.decorated_particles((1.0, 2.5), (0.2, 0.3, 0.4), (0.0, 0.0, 0.25)), 0),
    "particles, repelled": (S.decorated_particles((1.0, 2.5), (0.0, 0.3, -0.4), (0.0, 0.0, 0.1)), 0),
    "moments": (S.vlasov_moments(4, "0.8*x20"), 0),
    "moments, repelled": (S.vlasov_moments(4, "-0.3*x20"), 0),
    "moments, free": (S.vlasov_moments(2, "0"), 0),
    "satellite": (S.satellite((0.7, 0.7, 0.7), 1.5, 0.8), 0),
}


def start_of(name, seed):
    """Return a state without a special component, of both signs."""
    x = np.random.default_rng(seed).uniform(0.3, 1.2, SYSTEMS[name][0].dim)
    x *= np.random.default_rng(seed + 100).choice([-1.0, 1.0], x.size)
    if name == "satellite":
        x[6:9] *= 3.0
    return x


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", SYSTEMS)
def test_slope_group_and_invariants(name, seed):
    system, x0 = SYSTEMS[name][0], start_of(name, seed)
    given = x0.copy()
    h = 2.0**-17  # the error of the central difference is about h^2 and u / h, times derivatives of the motion
    t = np.array([-0.8 - h, -0.8, -0.8 + h, 0.0, 1.3 - h, 1.3, 1.3 + h])
    x = system.exact(x0, t)
    np.testing.assert_array_equal(x0, given)
    size = np.abs(x).max()
    for k in (1, 5):
        slope = (x[k + 1] - x[k - 1]) / (2 * h)
        np.testing.assert_allclose(slope, system.vector_field(x[k]), rtol=0, atol=1e-8 * (1 + size**2))
    np.testing.assert_allclose(x[3], x0, rtol=0, atol=16 * U * size)
    np.testing.assert_allclose(system.exact(x[5], -1.3), x0, rtol=0, atol=1e-12 * (1 + size**2))
    np.testing.assert_allclose(system.exact(x[1], 2.1), x[5], rtol=0, atol=1e-12 * (1 + size**2))
    for invariant in (system.energy, *system.casimirs.values()):
        values = np.array([float(invariant(row)) for row in x])
        np.testing.assert_allclose(values, values[3], rtol=0, atol=1e-12 * (1 + size) ** 4)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SYSTEMS)
def test_shapes_of_times_and_kinds_of_input(name):
    system, element = SYSTEMS[name]
    x0 = start_of(name, 7)
    t = np.array([0.4, -1.1, 2.3, 0.0])
    many = system.exact(x0, t)
    assert many.shape == (4, system.dim) and many.dtype == np.float64
    for row, time in zip(many, t, strict=True):
        one = system.exact(x0, time)
        assert one.shape == (system.dim,)
        np.testing.assert_allclose(one, row, rtol=0, atol=64 * U * np.abs(many).max())
    assert system.exact(x0, []).shape == (0, system.dim) and system.exact(x0, [0.4]).shape == (1, system.dim)
    # Views with strides, lists and whole numbers are states and times as well.
    wide = np.stack([x0, -x0], axis=1)
    np.testing.assert_array_equal(system.exact(wide[:, 0], np.repeat(t, 2)[::2]), many)
    np.testing.assert_array_equal(system.exact(x0.tolist(), tuple(t)), many)
    whole = np.arange(1, system.dim + 1)
    np.testing.assert_array_equal(system.exact(whole, 1), system.exact(whole.astype(float), 1.0))
    for no in (False, np.False_):
        np.testing.assert_array_equal(system.exact(x0, t, attitude=no), many)
    many[:] = 0.0
    assert np.abs(system.exact(x0, t)).min(axis=0).max() > 0.0
    for wrong in (x0[:-1], np.stack([x0, x0])):
        with pytest.raises(ValueError, match=rf"x0 has shape \({str(wrong.shape)[1:-1]}\)"):
            system.exact(wrong, 1.0)
    with pytest.raises(ValueError, match=r"t has shape \(2, 2\)"):
        system.exact(x0, [[1.0, 2.0], [3.0, 4.0]])
    with pytest.raises(ValueError, match=r"x0\[1\] is inf"):
        system.exact([*x0[:1], np.inf, *x0[2:]], 1.0)
    with pytest.raises(ValueError, match=r"t\[1\] is nan"):
        system.exact(x0, [1.0, np.nan])
    if not element:
        for some in (True, np.True_, np.eye(3)):
            with pytest.raises(TypeError, match=f"{system.name} has a closed form of the state alone"):
                system.exact(x0, 1.0, attitude=some)


@pytest.mark.parametrize("name", [name for name, (_, element) in SYSTEMS.items() if element])
def test_group_elements(name):
    """g' = -sign g rho(grad H), from any first element, which multiplies from the left."""
    system, d = SYSTEMS[name]
    x0, h = start_of(name, 11), 2.0**-17
    first = np.random.default_rng(4).uniform(-1.0, 1.0, (d, d))
    t = np.array([-0.6 - h, -0.6, -0.6 + h, 0.0, 1.7])
    x, g = system.exact(x0, t, attitude=first)
    size = np.abs(g).max() * (1 + np.abs(x).max())
    np.testing.assert_array_equal(x, system.exact(x0, t))
    rho = np.einsum("k,kij->ij", system.hamiltonian.gradient(x[1]), system.representation)
    np.testing.assert_allclose((g[2] - g[0]) / (2 * h), -system.sign * g[1] @ rho, rtol=0, atol=1e-8 * (1 + size**2))
    np.testing.assert_allclose(g[3], first, rtol=0, atol=16 * U)
    for yes in (True, np.True_, np.eye(d)):
        state, from_one = system.exact(x0, t, attitude=yes)
        np.testing.assert_array_equal(state, x)
        np.testing.assert_allclose(first @ from_one, g, rtol=0, atol=64 * U * size)
    state, alone = system.exact(x0, 1.7, attitude=first)
    assert state.shape == (system.dim,) and alone.shape == (d, d)
    np.testing.assert_allclose(alone, g[4], rtol=0, atol=64 * U * size)
    # From the middle of the motion on: the element found there is the next first one.
    np.testing.assert_allclose(system.exact(x[1], 2.3, attitude=g[1])[1], g[4], rtol=0, atol=1e-12 * (1 + size**2))
    with pytest.raises(ValueError, match="attitude has shape"):
        system.exact(x0, 1.0, attitude=np.eye(d + 1))
