"""Derivatives of energies by parameters of all ready-made systems, against their formulas in 50 digits."""

import inspect
import warnings

import mpmath
import numpy as np
import pytest

import coadjoint as co
from long import long_where
from rounding import UNIT_ROUNDOFF

DIGITS, SMALL = 50, mpmath.mpf(10) ** -15
TENSOR = ((2.0, 0.3, 0.1), (0.3, 3.0, -0.2), (0.1, -0.2, 4.0))
COUPLING = ((0.5, 0.25, 0.125), (0.0, 0.5, 0.25), (0.75, -0.25, 1.0))


def matrix(values):
    """Return moments as a diagonal matrix, or a tensor."""
    values = np.asarray(values)
    return np.diag(values) if values.ndim == 1 else values


def solved(A, b):
    return np.array(list(mpmath.lu_solve(mpmath.matrix(A.tolist()), mpmath.matrix(b.tolist()))))


def body(x, inertia):
    return x @ solved(matrix(inertia), x) / 2


def top(x, equatorial, lever, ratio):
    return body(x[:3], np.array([equatorial, equatorial, equatorial / ratio])) + lever @ x[3:5]


def in_fluid(x, inertia, mass, coupling):
    return body(x, np.block([[matrix(inertia), coupling], [coupling.T, matrix(mass)]]))


def in_planes(x, inertia):
    """The momentum X satisfies X = L Omega + Omega L."""
    L, n = matrix(inertia), len(inertia)
    planes = [(1, 2), (2, 0), (0, 1)] if n == 3 else [(i, j) for i in range(n) for j in range(i + 1, n)]
    columns = []
    for i, j in planes:
        omega = np.zeros((n, n), dtype=int)
        omega[i, j], omega[j, i] = 1, -1
        X = L @ omega + omega @ L
        columns.append([X[p, q] for p, q in planes])
    return body(x, np.array(columns).T)


def manakov(x, a, b):
    i, j = np.triu_indices(len(a), 1)
    return ((b[i] - b[j]) / (a[i] - a[j]) * x**2).sum() / 2


def spins(x, lattice, shape, periodic, exchange, tensor, dm, field, on_site):
    """On a chain, or of edges that are given."""
    S, T, K = x.reshape(-1, 3), matrix(tensor), matrix(on_site)
    edges = [(i, i + 1) for i in range(shape - 1)] if lattice == "chain" else lattice
    J, D, B = np.resize(exchange, len(edges)), np.resize(dm, (len(edges), 3)), np.resize(field, (shape, 3))
    bonds = [-J[k] * (S[i] @ T @ S[j]) + D[k] @ np.cross(S[i], S[j]) for k, (i, j) in enumerate(edges)]
    return sum(bonds) - sum(S[i] @ K @ S[i] + B[i] @ S[i] for i in range(shape))


def lumps(x, weights, external, pair):
    n = len(weights)
    q, p, x20, x02 = x[:n], x[n : 2 * n], x[2 * n + 1 :: 3], x[2 * n + 3 :: 3]

    def potential(c, y, order):
        c = np.array([mpmath.mpf(k) for k in c])
        for _ in range(order):
            c = c[1:] * np.arange(1, len(c))
        return sum(factor * y**k for k, factor in enumerate(c))

    total = 0
    for a, w in enumerate(weights):
        total += p[a] ** 2 / (2 * w) + x02[a] / 2 + w * potential(external, q[a], 0)
        total += (potential(external, q[a], 2) + w * potential(pair, 0, 2)) * x20[a] / 2
        for b in range(a):
            r = q[a] - q[b]
            total += w * weights[b] * potential(pair, r, 0)
            total += potential(pair, r, 2) * (weights[b] * x20[a] + w * x20[b]) / 2
    return total


def of_matrix(x, inertia):
    X, sums = x.reshape(len(inertia), -1), np.add.outer(inertia, inertia)
    return (X**2 / sums).sum() / 2


def on_orbit(x, inertia, mean_motion, eccentricity):
    L, radial, normal, I = x[:3], x[3:6], x[9:12], matrix(inertia)
    gradient = radial @ I @ radial - np.trace(I) / 3 * (radial @ radial)
    return body(L, inertia) - mean_motion * (L @ normal) + 3 * mean_motion**2 * gradient / 2


def on_rotating_sphere(W, N, rotation):
    """The energy is a quadratic function of the rotation: without its constant."""
    still, ahead, behind = (co.systems.sphere_euler(N, rate).energy(W) for rate in (0.0, 1.0, -1.0))
    return rotation * (ahead - behind) / 2 + rotation**2 * ((ahead + behind) / 2 - still)


def on_rotating_layers(X, N, gamma, thicknesses, lamb, rotation):
    """As on a rotating sphere."""
    energies = [
        co.systems.layered_qg(N, *(np.array(one, dtype=float) for one in (gamma, thicknesses, lamb)), rate).energy(X)
        for rate in (0.0, 1.0, -1.0)
    ]
    still, ahead, behind = energies
    return rotation * (ahead - behind) / 2 + rotation**2 * ((ahead + behind) / 2 - still)


def free_bodies(x, inertias, masses, potential, gradient, hessian):
    k = len(masses)
    spins = sum(body(x[12 * i : 12 * i + 3], inertias[i]) for i in range(k))
    return spins + sum((x[12 * k + 3 * i : 12 * k + 3 * i + 3] ** 2).sum() / masses[i] / 2 for i in range(k))


def gravitating_bodies(x, inertias, masses, G, order, higher_moments, surfaces):
    """MacCullagh, for attitudes of any matrix: of the second moments only the anisotropic part acts."""
    k, total = len(masses), free_bodies(x, inertias, masses, None, None, None)
    centres = x[15 * k : 18 * k].reshape(k, 3)
    turned = [x[12 * i + 3 : 12 * i + 12].reshape(3, 3) for i in range(k)]
    for i in range(k):
        for j in range(i):
            apart = centres[i] - centres[j]
            s = mpmath.sqrt(apart @ apart)
            total -= G * masses[i] * masses[j] / s
            for here, other in ((i, j), (j, i)):
                u, I = turned[here].T @ apart / s, matrix(inertias[here])
                total -= G * masses[other] * (np.trace(I) * (u @ u) - 3 * (u @ I @ u)) / (2 * s**3)
    return total


# The energy of the state by the parameters, and other arguments of the system.
FORMULAS = {
    "rigid_body": body,
    "body": lambda x, inertia, attitude, wheels, gyros, held: body(x[:3], inertia),
    "satellite_on_orbit": on_orbit,
    "bodies": free_bodies,
    "gravitating_bodies": gravitating_bodies,
    "gyrostat": lambda x, inertia, rotors: body(x - rotors, inertia),
    "heavy_top": lambda x, inertia, lever: body(x[:3], inertia) + lever @ x[3:],
    "kovalevskaya_top": lambda x, equatorial, lever: top(x, equatorial, lever, 2),
    "goryachev_chaplygin_top": lambda x, equatorial, lever: top(x, equatorial, lever, 4),
    "lagrange_top": lambda x, equatorial, axial, lever: (
        body(x[:3], np.array([equatorial, equatorial, axial])) + lever * x[5]
    ),
    "clebsch_body": lambda x, inverse_mass, inertia: body(x[:3], inertia) + inverse_mass @ x[3:] ** 2 / 2,
    "kirchhoff_body": in_fluid,
    "so_n_body": in_planes,
    "manakov_top": manakov,
    "maxwell_bloch": lambda x, coupling: x[0] ** 2 / 2 + coupling * x[2],
    "riccati": lambda x, constant, linear, quadratic: -constant * x[0] - linear * x[1] + quadratic * x[2],
    "paper_a37": lambda x, masses, a: masses @ x**2 / 2,
    "paper_rigid_body": lambda x, masses: masses @ x**2 / 2,
    "sklyanin": lambda x, masses, anisotropy: masses @ x**2 / 2,
    "spin_lattice": spins,
    "decorated_particles": lumps,
    "matrix_body": of_matrix,
    "sphere_euler": on_rotating_sphere,
    "layered_qg": lambda X, N, gamma, thicknesses, lamb, rotation, surface: on_rotating_layers(
        X, N, gamma, thicknesses, lamb, rotation
    ),
    "passive_scalar": lambda X, N, surface, rotation: on_rotating_sphere(X[1], N, rotation),
}
# Numbers that are zero by default, where they cannot change on both sides.
INSIDE = {"sphere_qg": {"lamb": 2.0, "gamma": 0.5}, "torus_qg": {"gamma": 0.5}}
VARIANTS = [
    *((name, INSIDE.get(name, {})) for name in co.systems.names()),
    ("sphere_euler", {"N": 5, "rotation": 0.5}),
    ("passive_scalar", {"N": 5, "rotation": 0.5}),
    ("layered_qg", {"N": 5, "rotation": 0.5}),
    ("rigid_body", {"inertia": TENSOR}),
    ("gyrostat", {"inertia": TENSOR}),
    ("body", {"inertia": TENSOR}),
    ("body", {"inertia": (1.0, 2.0, 2.5), "attitude": False}),
    ("bodies", {"inertias": (TENSOR, TENSOR, (1.0, 1.0, 1.0)), "masses": (1.0, 2.0, 0.5)}),
    ("heavy_top", {"inertia": TENSOR, "lever": (0.0, 0.0, 1.0)}),
    ("kirchhoff_body", {"inertia": TENSOR, "mass": TENSOR, "coupling": COUPLING}),
    ("kirchhoff_body", {"coupling": np.diag((0.25, 0.5, -0.125)).tolist()}),
    ("clebsch_body", {"inertia": (2.0, 2.0, 2.0), "inverse_mass": (-1.0, 0.5, 0.0)}),
    ("so_n_body", {"inertia": TENSOR}),
    ("so_n_body", {"inertia": (0.0, 1.0, 2.0, 3.0, 4.0)}),
    # Entries of M are (b_i - b_j)/(a_i - a_j): a pole is near.
    ("manakov_top", {"a": (1.0, 2.0, 4.5, 4.5 + 2.0**-20), "b": (2.0, 3.0, 1.0, 5.0)}),
    ("paper_rigid_body", {"masses": (0.0, 1.0, 2.0)}),
    ("riccati", {"constant": 0.25, "linear": 0.5, "quadratic": -0.125}),
    ("decorated_particles", {"weights": (1.0, 2.0, 0.5), "external": (0.1, 0.2, 0.5, 0.1), "pair": (0, 0, 0.5)}),
    ("spin_lattice", {"shape": 4, "exchange": (0.0, 1.0, 2.0), "on_site": TENSOR, "tensor": COUPLING}),
    ("spin_lattice", {"shape": 12, "exchange": np.linspace(-1.0, 1.0, 11), "dm": (0.1, 0.2, 0.3)}),
    ("spin_lattice", {"shape": 4, "field": np.cos(np.arange(12.0)).reshape(4, 3), "dm": np.diag((0.1, 0.2, 0.3))}),
    ("spin_lattice", {"lattice": ((0, 1), (2, 1), (3, 0)), "shape": 4, "tensor": COUPLING, "dm": (0.1, 0.2, 0.3)}),
]


def parameters_of(name, given):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = co.systems.get(name, **given)
        return [one for one in co.prepare(system, None, 0.125).parameters if one in (system.parameters or {})]


# By which each energy is differentiated, if not by all arguments of its formula; a run is not asked, since it compiles
# functions.
PARAMETERS = {name: " ".join(list(inspect.signature(formula).parameters)[1:]) for name, formula in FORMULAS.items()} | {
    "bodies": "inertias masses", "body": "inertia", "clebsch_body": "inverse_mass",
    "decorated_particles": "weights external", "goryachev_chaplygin_top": "equatorial lever",
    "gravitating_bodies": "inertias masses G", "gyrostat": "inertia rotors", "heavy_top": "inertia lever",
    "layered_qg": "rotation",
    "kirchhoff_body": "inertia mass coupling", "kovalevskaya_top": "equatorial lever",
    "lagrange_top": "equatorial axial lever", "manakov_top": "a b", "matrix_body": "inertia",
    "maxwell_bloch": "coupling", "paper_a37": "masses", "paper_rigid_body": "masses", "passive_scalar": "rotation",
    "riccati": "constant linear quadratic", "rigid_body": "inertia", "satellite_on_orbit": "inertia mean_motion",
    "sklyanin": "masses", "so_n_body": "inertia", "sphere_euler": "rotation",
    "sphere_qg": "lamb rotation gamma", "spin_lattice": "exchange tensor dm field on_site", "torus_qg": "gamma",
}  # fmt: skip
CASES = [(name, given, one) for name, given in VARIANTS if name in FORMULAS for one in PARAMETERS[name].split()]
SYMMETRIC = {"inertia", "mass", "on_site"}


# Energies without parameters whose functions take seconds to compile.
COMPILED = [("double_spherical_pendulum", {}), ("rigid_molecules", {})]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("name", "given"), long_where(COMPILED, VARIANTS), ids=str)
def test_systems_of_all_arguments_have_the_parameters_of_their_formulas(name, given):
    """An energy that is declared otherwise than that of the system would leave M and linear as parameters."""
    assert set(parameters_of(name, given)) == {*PARAMETERS.get(name, "").split()}


@pytest.mark.parametrize("name", INSIDE)
def test_numbers_at_a_limit_of_their_domain_and_topography_are_no_parameters(name):
    found = set(parameters_of(name, {"topography": {(1, 1): 0.1}}))
    assert found == {*PARAMETERS[name].split()} - INSIDE[name].keys()


def numbers(value):
    """Return numbers in arrays of the reference; anything else as it is."""
    array = np.asarray(value)
    if array.dtype.kind != "f":
        return value
    return np.array([mpmath.mpf(one) for one in array.ravel().tolist()], dtype=object).reshape(array.shape)[()]


@pytest.mark.filterwarnings("ignore:.*principal moment")
@pytest.mark.parametrize(("name", "given", "parameter"), CASES, ids=str)
def test_derivatives_of_energies_have_the_digits_of_the_formulas(name, given, parameter):
    system = co.systems.get(name, **given)
    of_matrices = isinstance(system, co.MatrixSystem)
    x0 = np.random.default_rng(1).standard_normal(system.shape if of_matrices else system.dim)
    x0 = system.algebra.projected(x0) if of_matrices else x0
    if "z" in system.casimirs:
        x0[np.argmax(np.abs(system.casimirs["z"].gradient(x0)))] = 1.0
    ready = co.prepare(system, None, 0.125)
    _, pullback = ready.vjp(x0, (0.0, 0.125))
    found, value = pullback(energy=[1.0, 0.0])[parameter], ready.parameters[parameter]
    x, arguments = numbers(x0), {key: numbers(one) for key, one in system.parameters.items()}
    wanted = np.zeros(value.shape)
    with mpmath.workdps(DIGITS):
        for index in np.ndindex(value.shape):
            change = np.zeros(value.shape, dtype=object)
            change[index] += SMALL
            if parameter in SYMMETRIC and value.ndim == 2:
                change = (change + change.T) / 2
            above, below = (
                FORMULAS[name](x, **arguments | {parameter: arguments[parameter] + sign * change[()]})
                for sign in (1, -1)
            )
            wanted[index] = float((above - below) / (2 * SMALL))
    # Energies of matrices are differentiated by differences.
    bound = 1e-11 if of_matrices else 32 * UNIT_ROUNDOFF
    assert np.abs(found - wanted).max() <= bound * np.abs(wanted).max()
