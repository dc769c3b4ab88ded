"""Every ready-made system: derivatives, invariants, parameters, closed forms, and its description by the command."""

import json
import pickle

import numpy as np
import pytest
from brackets import U, bracket, rational_points
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

S = co.systems
NAMES = S.names()
FULL = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])
FIELDS = np.array([[0.0, 0.0, 0.5], [1.0, -0.5, 0.25], [0.0, 0.0, 0.0]])
FLUIDS = (
    "sphere_euler", "torus_euler", "sphere_qg", "torus_qg", "surface_qg", "reduced_mhd", "passive_scalar",
    "layered_qg", "thermal_qg",
)  # fmt: skip
SMALL = {name: {"N": 5} for name in FLUIDS}

# Systems with a closed form by name, and the size of the group element, 0 if the closed form is of the state alone.
SOLVED = {
    "rigid body": (S.rigid_body((2.0, 1.0, 1.5)), 3),
    "rigid body, full": (S.rigid_body(FULL), 3),
    "paper": (S.paper_rigid_body((0.3, -0.4, 1.1)), 3),
    "gyrostat about 1": (S.gyrostat((3.0, 2.0, 2.0), (0.7, 0.0, 0.0)), 3),
    "gyrostat about 2": (S.gyrostat((2.0, 3.0, 2.0), (0.0, -0.7, 0.0)), 3),
    "gyrostat about 3": (S.gyrostat((2.0, 2.0, 1.0), (0.0, 0.0, 0.7)), 3),
    "gyrostat, ball": (S.gyrostat((2.0, 2.0, 2.0), (0.3, -0.4, -0.8)), 3),
    "Riccati, real": (S.riccati(0.3, -0.7, -0.4), 2),
    "Riccati, double": (S.riccati(0.25, 1.0, 1.0), 2),
    "Riccati, complex": (S.riccati(0.3, 0.2, 0.4), 2),
    "Maxwell-Bloch": (S.maxwell_bloch(2.5), 0),
    "triad": (S.fluid_triad((1.0, 0.5), (-0.25, 1.5)), 0),
    "triad, other sense": (S.fluid_triad((-0.25, 1.5), (1.0, 0.5)), 0),
    "Lorenz": (S.lorenz_1960(0.75, 1.25), 0),
    "Toda": (S.toda(3), 0),
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
    "particles, falling": (S.decorated_particles((1.0, 2.5), (0.0, 0.3), (0.0, 0.0, 0.1)), 0),
    "particles, free": (S.decorated_particles((1.0, 2.5), (0.2,), (0.0,)), 0),
    "moments": (S.vlasov_moments(4, "0.8*x20"), 0),
    "moments, repelled": (S.vlasov_moments(4, "-0.3*x20"), 0),
    "moments, free": (S.vlasov_moments(2, "0"), 0),
    "satellite": (S.satellite((0.7, 0.7, 0.7), 1.5, 0.8), 0),
    "vortices": (S.point_vortices((1.0, 2.5)), 0),
    "opposite vortices": (S.point_vortices((-1.0, 1.0)), 0),
    "screened vortices": (S.point_vortices((1.0, 2.5), radius=0.7), 0),
    "vortices on a sphere": (S.point_vortices((-1.0, 2.5), "sphere"), 0),
}
OTHERS = {
    "heavy top, full": S.heavy_top(FULL, (0.3, -0.4, 0.8)),
    "gyrostat, full": S.gyrostat(FULL, (0.3, -0.4, 0.8)),
    "body in a fluid": S.kirchhoff_body(FULL, FULL[::-1, ::-1], [[0.2, 0.5, -0.1], [0.0, -0.3, 0.4], [0.3, 0.1, 0.25]]),
    "asteroids to fourth order": S.gravitating_bodies(((0.3, 0.4, 0.5), FULL / 8), (1.5, 0.5), 0.8, 4),
    "a polyhedron with a satellite": S.gravitating_bodies(
        ((0.303, 0.2715, 0.3315), (0.1, 0.2, 0.25)),
        (1.5, 0.5),
        0.8,
        "polyhedron",
        surfaces=(
            (
                np.concatenate([np.diag([1.0, 1.1, 0.9]), -np.diag([1.0, 1.1, 0.9])]),
                [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
            ),
            None,
        ),
    ),
    "molecules in a box": S.rigid_molecules(
        (((0, 0, 0), (0.5, 0, 0.4), (-0.6, 0, 0.3)), ((1, 0, 0), (0, 1, 0.5), (0, 0, 2))),
        ((-0.8, 0.4, 0.4), (0.3, 0.3, -0.6)),
        (((0.6, 0.9), (0, 0), (0.2, 0.5)), ((0.5, 1.25), (0.1, 0.5), (0.3, 0.75))),
        ((16, 1, 2), (3, 4, 5)),
        (1, 1),
        (20, 25, 30),
        9.0,
        3.0,
        80.0,
    ),
    "satellite of revolution": S.satellite((2.0, 2.0, 1.0), 1.5, 0.8),
    "body of five dimensions": S.so_n_body((1.0, 0.5, 2.0, 1.5, 0.75)),
    "paper, other parameters": S.paper_a37(-0.5, (0.7, -0.4, 1.1)),
    "pendulum without gravity": S.double_spherical_pendulum((1.25, 0.5), (0.75, 1.5), 0.0),
    "functions": S.separable_cosh("A3,7", (1.0, 0.7, -0.3), 1.25, {"a": 1.5}),
    "lattice": S.spin_lattice("ring", 4, False, 0.7, (1, 1, 0.5), (0, 0, 0.25), (0, 0, 2), (0, 0, 1)),
    "dipoles": S.spin_lattice("square", (2, 3), exchange=0.4, dipolar=-0.3),
    "moments of degree 8": S.vlasov_moments(8, "1/2*x20 + 3/4*x40 - 1/8*x60"),
    "open chain": S.toda(5),
    "ring": S.toda_ring(5),
    "rotating sphere": S.sphere_euler(5, 0.7),
    "four vortices": S.point_vortices((-1.0, 2.5, 0.3, 1.0), "sphere"),
    "planet": S.sphere_qg(5, 12.0, 0.7, {(2, 1): 0.2 - 0.1j, (1, 0): 0.1}, 1.5),
    "three layers": S.layered_qg(
        5, [[3, -3, 0], [-1.5, 2, -0.5], [0, -0.25, 0.5]], (1.0, 2.0, 4.0), lamb=np.eye(3), rotation=0.7
    ),
    "layers on a torus": S.layered_qg(5, [[2.0, -1.0], [-2.0, 1.5]], (2.0, 1.0), surface="torus"),
    "warm planet": S.thermal_qg(5, 1.5, 0.7, {(2, 1): 0.2 - 0.1j}, {(2, 1): 0.3j, (1, 0): 0.1}, 2.0),
    "warm basin": S.thermal_qg(5, 1.5, topography={(1, 2): 0.2}, bathymetry={(1, 2): 0.2 - 0.1j}, surface="torus"),
    "dye on a planet": S.passive_scalar(5, rotation=0.7),
    "basin": S.torus_qg(5, 1.5, {(1, 2): 0.2 - 0.1j}),
    "surface of a torus": S.surface_qg(5, "torus"),
    "field on a torus": S.reduced_mhd(5, "torus"),
    "dye on a torus": S.passive_scalar(5, "torus"),
}
EVERY = {
    **{name: S.get(name, **SMALL.get(name, {})) for name in NAMES},
    **{name: system for name, (system, _) in SOLVED.items()},
    **OTHERS,
}


def start_of(system, seed=1):
    """Return a state without a special component, of both signs; of a satellite it is away from the center."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.3, 1.2, system.dim) * rng.choice([-1.0, 1.0], system.dim)
    if system.name == "satellite":
        x[6:9] *= 3.0
    if hasattr(system, "positions"):  # of bodies: attitudes that are rotations, and centres apart
        k = len(system.masses)
        turned = Rotation.from_quat(x[: 4 * k].reshape(k, 4)).as_matrix()
        r, v, omega = x[4 * k : 13 * k].reshape(3, k, 3)
        x = system.state(r + 4.0 * np.arange(k)[:, None], v, turned, omega)
    if len(system.shape) > 1:
        x = system.to_vector(system.algebra.projected(system.from_vector(x)))
    return x


def slope_of(function, x, d, h=2.0**-8):
    """Return the derivative along d by differences of order six, whose error is h^6 = 4e-15 times some derivatives."""
    return sum(w * (function(x + k * h * d) - function(x - k * h * d)) for k, w in ((1, 45), (2, -9), (3, 1))) / (
        60 * h
    )


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", EVERY)
def test_derivatives(name):
    """Gradient, Hessian, field and Jacobian, by differences of the energy and of the field."""
    system = EVERY[name]
    x, d = start_of(system), start_of(system, 2)
    H = system.hamiltonian
    slope = H.gradient(x)
    size = 1 + np.abs(slope).max() * np.abs(x).max()
    n = system.dim
    # The rounding of a difference is u over h, 3e-14, times the sum of n terms.
    assert slope @ d == pytest.approx(slope_of(system.energy, x, d), rel=0, abs=1e-11 * n * size)
    assert H.value(x) == pytest.approx(system.energy(x), rel=1e-13)
    J = system.structure_matrix(x)
    np.testing.assert_allclose(J, -J.T, rtol=0, atol=4 * U * np.abs(J).max())
    field = system.vector_field(x)
    # The structure matrix of matrices has the sign.
    sign = 1 if len(system.shape) > 1 else system.sign
    np.testing.assert_allclose(field, sign * J @ slope, rtol=0, atol=64 * n * U * size * (1 + np.abs(J).max()))
    moved = slope_of(system.vector_field, x, d)
    if len(system.shape) == 1:
        np.testing.assert_allclose(system.jacobian(x) @ d, moved, rtol=0, atol=1e-10 * n * size)
    np.testing.assert_allclose(H.hessian(x) @ d, slope_of(H.gradient, x, d), rtol=0, atol=1e-10 * n * size)


@pytest.mark.parametrize("name", [name for name, s in EVERY.items() if isinstance(s, co.LiePoissonSystem)])
def test_invariants_are_accepted_from_a_user(name):
    """Those of a ready-made system are not checked when it is made, and those of a user are, at sample points."""
    system = EVERY[name]
    given = {"casimirs": system.casimirs, "integrals": system.integrals}
    again = co.LiePoissonSystem(system.algebra, system.hamiltonian, system.sign, **given)
    assert [*again.casimirs] == [*system.casimirs] and [*again.integrals] == [*system.integrals]
    false = {"false": co.Polynomial.variable(0, system.dim) + co.Polynomial.variable(1, system.dim) ** 3}
    if len(system.algebra.triples.c) and np.abs(system.structure_matrix(start_of(system))[:2]).any():
        with refused(ValueError, "false", "Casimir"):
            co.LiePoissonSystem(system.algebra, system.hamiltonian, system.sign, casimirs=false)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", [name for name, s in EVERY.items() if s.dim <= 64 and not s.has_matrices])
def test_casimirs_of_every_system_are_accepted_as_functions(name):
    """In three systems of units: a multiple of the state, where the bracket is linear, has the same Casimirs."""
    system = EVERY[name]
    for unit in (1e-7, 1.0, 1e30):
        given = {
            label: lambda x, C=C, unit=unit: C(unit * x) if system.algebra is not None else unit * C(x)
            for label, C in system.casimirs.items()
        }
        if system.algebra is not None:
            again = co.LiePoissonSystem(system.algebra, co.Quadratic(1.0), casimirs=given)
        elif system.structure_function is not None:
            again = co.PoissonSystem(system.structure_function, co.Quadratic(1.0), dim=system.dim, casimirs=given)
        else:
            return
        assert list(again.casimirs) == list(given)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", EVERY)
def test_invariants_are_constant_along_the_field(name):
    """Casimirs for every Hamiltonian; polynomials of systems with structure constants by exact brackets."""
    system, n = EVERY[name], EVERY[name].dim
    x = start_of(system, 3)
    J, field = system.structure_matrix(x), system.vector_field(x)
    d, along = start_of(system, 4), field / (1 + np.abs(field).max())
    for label, C in system.casimirs.items():
        if not hasattr(C, "gradient"):  # traces of matrices
            assert abs(slope_of(C, x, along)) < 1e-10 * n * (1 + abs(C(x))), label
            continue
        slope = np.asarray(C.gradient(x))
        bound = 64 * n * U * np.abs(slope).max()
        assert np.abs(J @ slope).max() <= bound * (1 + np.abs(J).max()), label
        assert slope @ d == pytest.approx(slope_of(C, x, d), rel=0, abs=1e-10 * n * (1 + np.abs(slope).max())), label
    for label, F in getattr(system, "integrals", {}).items():
        value = (lambda v, F=F: F(system.from_vector(v))) if len(system.shape) > 1 else F
        size = 1 + np.abs(F.gradient(x)).max() if hasattr(F, "gradient") else 1 + abs(value(x))
        assert abs(slope_of(value, x, along)) < 1e-10 * n * size, label
        if hasattr(F, "gradient"):
            assert F.gradient(x) @ d == pytest.approx(slope_of(F, x, d), rel=0, abs=1e-10 * n * size), label
    if isinstance(system, co.LiePoissonSystem) and n <= 10:
        (point,) = rational_points(n, 1)
        for C in system.casimirs.values():
            if isinstance(C, co.Polynomial):
                coordinates = [co.Polynomial.variable(k, n) for k in range(n)]
                assert all(bracket(system, C, one, point) == 0 for one in coordinates)


def other_kind(value):
    """The same numbers as arrays of NumPy, whole ones as integers."""
    try:
        array = np.asarray(value)
    except ValueError:  # arrays of several shapes
        return tuple(map(other_kind, value))
    if isinstance(value, bool | str) or callable(value) or not np.issubdtype(array.dtype, np.number):
        return value
    whole = array.astype(np.int64)
    array = whole if np.array_equal(whole, array) else array
    return array if array.ndim else array[()]


def is_plain(value):
    if isinstance(value, dict | tuple):
        return all(map(is_plain, value.values() if isinstance(value, dict) else value))
    return value is None or type(value) in (int, float, bool, str)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", EVERY)
def test_made_again_from_parameters_and_pickled(name):
    """Whatever holds the numbers: parameters are plain ones, and do not change with an array that was given."""
    system = EVERY[name]
    x, arrays = start_of(system), {key: other_kind(value) for key, value in system.parameters.items()}
    copies = [
        S.get(system.name, **given) for given in (system.parameters, json.loads(json.dumps(system.parameters)), arrays)
    ]
    for array in arrays.values():
        if isinstance(array, np.ndarray):
            array[...] = 7
    if system.name in ("rigid_body", "heavy_top", "manakov_top", "spin_lattice", "toda", *FLUIDS[:3]):
        copies.append(pickle.loads(pickle.dumps(system)))
    for again in copies:
        assert again.parameters == system.parameters and again.algebra == system.algebra
        assert again.name == system.name and is_plain(again.parameters)
        assert again.energy(x) == system.energy(x) and list(again.casimirs) == list(system.casimirs)
        np.testing.assert_array_equal(again.vector_field(x), system.vector_field(x))


def test_names_are_sorted_and_listed():
    assert list(NAMES) == sorted(set(NAMES)) and {*NAMES, "get", "names"} <= set(dir(S)) == set(S.__all__)
    for name in NAMES:
        assert getattr(S, name).__name__ == name
    with refused(AttributeError, "heavy_top"):
        S.heavy_topp  # noqa: B018
    with refused(ValueError, "3"):
        S.get(3)
    with refused(ValueError, "rigidbody", "rigid_body"):
        S.get("rigidbody")
    with refused(ValueError, "inertias", "inertia", "rigid_body"):
        S.get("rigid_body", inertias=(1, 2, 3))
    with refused(ValueError, "masses"):
        S.get("paper_rigid_body", masses=(1.0, 2.0))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", SOLVED)
def test_closed_forms_are_motions(name):
    """Slope, group, invariants, and the state that is given."""
    system = SOLVED[name][0]
    x0 = start_of(system, 5)
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
    integrals = getattr(system, "integrals", {})
    for invariant in (system.energy, *system.casimirs.values(), *integrals.values()):
        values = np.array([float(invariant(row)) for row in x])
        np.testing.assert_allclose(values, values[3], rtol=0, atol=1e-12 * (1 + size) ** 4)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SOLVED)
def test_shapes_of_times_and_kinds_of_input(name):
    system, element = SOLVED[name]
    x0 = start_of(system, 7)
    t = np.array([0.4, -1.1, 2.3, 0.0])
    many = system.exact(x0, t)
    assert many.shape == (4, system.dim) and many.dtype == np.float64
    for row, time in zip(many, t, strict=True):
        one = system.exact(x0, time)
        assert one.shape == (system.dim,)
        np.testing.assert_allclose(one, row, rtol=0, atol=64 * U * np.abs(many).max())
    assert system.exact(x0, []).shape == (0, system.dim) and system.exact(x0, [0.4]).shape == (1, system.dim)
    # Views with strides, lists and whole numbers are states and times as well.
    np.testing.assert_array_equal(system.exact(np.stack([x0, -x0], axis=1)[:, 0], np.repeat(t, 2)[::2]), many)
    np.testing.assert_array_equal(system.exact(x0.tolist(), tuple(t), attitude=np.False_), many)
    whole = np.arange(1, system.dim + 1)
    np.testing.assert_array_equal(system.exact(whole, 1), system.exact(whole.astype(float), 1.0))
    many[:] = 0.0
    assert np.abs(system.exact(x0, t)).min(axis=0).max() > 0.0
    for wrong in (x0[:-1], np.stack([x0, x0])):
        with refused(ValueError, "x0", wrong.shape):
            system.exact(wrong, 1.0)
    with refused(ValueError, "t has shape", (2, 2)):
        system.exact(x0, [[1.0, 2.0], [3.0, 4.0]])
    with refused(ValueError, "x0[1]", "inf"):
        system.exact([*x0[:1], np.inf, *x0[2:]], 1.0)
    with refused(ValueError, "t[1]", "nan"):
        system.exact(x0, [1.0, np.nan])
    if not element:
        for some in (True, np.True_, np.eye(3)):
            with refused(TypeError, system.name, "state"):
                system.exact(x0, 1.0, attitude=some)


@pytest.mark.parametrize("name", [name for name, (_, element) in SOLVED.items() if element])
def test_group_elements_of_closed_forms(name):
    """g' = -sign g rho(grad H), from any first element, which multiplies from the left."""
    system, d = SOLVED[name]
    x0, h = start_of(system, 11), 2.0**-17
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
    with refused(ValueError, "attitude", (d + 1, d + 1)):
        system.exact(x0, 1.0, attitude=np.eye(d + 1))
