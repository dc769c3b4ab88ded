"""Parameters by which runs are differentiated: which there are, and declared energies and their derivatives."""

import math

import numpy as np
import pytest
import scipy.sparse

import coadjoint as co
from coadjoint.systems import registry
from coadjoint.systems.parameters import parameter_of, parameters_of, with_parameters
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore:.*principal moment")


@pytest.mark.parametrize(
    ("name", "given", "names"),
    [
        ("rigid_body", {}, {"inertia"}),
        ("heavy_top", {}, {"inertia", "lever"}),
        ("spin_lattice", {}, {"exchange", "tensor", "dm", "field", "on_site"}),
        # The algebra depends on a.
        ("paper_a37", {}, {"masses"}),
        ("separable_cosh", {}, set()),
        # Moments and masses enter functions.
        ("satellite", {}, set()),
        ("double_spherical_pendulum", {}, set()),
        # Any masses are possible only if the moments are equal, and so are tied to each other.
        ("clebsch_body", {}, {"inverse_mass"}),
        ("clebsch_body", {"inertia": (1.0, 2.0, 4.0), "inverse_mass": (1.0, 2.0, 4.0)}, {"M", "linear"}),
        # Odd powers of the pair potential must be zero.
        ("decorated_particles", {}, {"weights", "external"}),
        # Numbers of sites and wave numbers are whole.
        ("toda", {}, {"M", "linear"}),
        ("fluid_triad", {}, {"M", "linear"}),
        ("vlasov_moments", {}, {"M", "linear"}),
    ],
)
def test_arguments_that_enter_coefficients_alone_are_parameters(name, given, names):
    system = co.systems.get(name, **given)
    found = parameters_of(system)
    assert set(found) == names
    for parameter in names & set(system.parameters):
        assert np.array_equal(found[parameter].value, np.asarray(system.parameters[parameter], dtype=float))


SO3 = co.algebras.so(3)


def test_arguments_that_do_not_give_the_system_are_no_parameters():
    """A system may have the name of a ready-made one, and arguments as a note."""
    body = co.systems.rigid_body((1.0, 2.0, 3.0))
    for energy, names in ((body.hamiltonian, {"inertia"}), (co.Quadratic((1.0, 2.0, 3.0)), {"M", "linear"})):
        system = co.LiePoissonSystem(SO3, energy, sign=-1, name="rigid_body", parameters=dict(body.parameters))
        assert set(parameters_of(system)) == names
    wrong = co.LiePoissonSystem(SO3, body.hamiltonian, sign=-1, name="rigid_body", parameters={"inertia": (1.0, 2.0)})
    assert set(parameters_of(wrong)) == {"M", "linear"}


@pytest.mark.parametrize("entry", [0.0, 1e-15, 1e-9, 1e-6, 1e-3, 0.2])
def test_small_entries_of_a_tensor_have_exact_derivatives(entry):
    """Changes relative to such an entry would change the coefficients by little more than their rounding."""
    inertia, x = np.array([[1.0, entry, 0.0], [entry, 2.0, 0.0], [0.0, 0.0, 2.5]]), np.array([1.0, -0.5, 0.25])
    omega = np.linalg.solve(inertia, x)
    found = parameter_of(co.systems.rigid_body(inertia.tolist()), "inertia").energy().at(x).reshape(3, 3)
    assert np.abs(found + np.outer(omega, omega) / 2).max() <= 8 * 2.0**-53 * (omega @ omega)


@pytest.fixture
def registering(monkeypatch):
    """Systems that a test registers are unknown after it."""
    co.systems.names()
    for name in ("_REGISTRY", "_ENERGIES"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


def derivatives_of(diagonal, value):
    """Return the derivatives of M = diag(diagonal(p)) at a value, by entries of M and of p."""

    def energy(p):
        return (np.array(diagonal(p)),)

    @co.systems.ready_made(energy=energy)
    def made(p):
        return co.LiePoissonSystem(SO3, co.Quadratic(*energy(np.asarray(p))), name="made", parameters={"p": p})

    found = parameter_of(made(value), "p").energy()
    table = np.zeros((3, np.size(value)))
    table[found.quadratic[:, 0], found.quadratic_entry] = 2.0 * found.quadratic_factor
    return table


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("diagonal", "value", "derivatives"),
    [
        (lambda p: [3.0 - 2.0 * p, 1.0, 2.0], 0.75, [[-2.0], [0.0], [0.0]]),
        (lambda p: [p * p, 1.0 / p, 0.25 / (1.0 + p * p)], 0.75, [[1.5], [-1.0 / 0.5625], [-0.375 / 1.5625**2]]),
        (lambda p: [np.exp(p), p, 1.0], 0.75, [[np.exp(0.75)], [1.0], [0.0]]),
        (lambda p: [1.0 / p + p, 1.0, 1.0], 0.75, [[1.0 - 1.0 / 0.5625], [0.0], [0.0]]),
        (lambda p: 1.0 / p, [1.0, 2.0, 4.0], np.diag([-1.0, -0.25, -0.0625])),
        (lambda p: [p[0], p[2], 1.0], [1.0, 2.0, 4.0], [[1, 0, 0], [0, 0, 1], [0, 0, 0]]),
        # The second entry changes what the first one has changed.
        (lambda p: [p[0] + p[1], p[2], 1.0], [1.0, 2.0, 4.0], [[1, 1, 0], [0, 0, 1], [0, 0, 0]]),
        # Alone, the first entry changes nothing: its factor is zero.
        (lambda p: [p[0] * (p[1] - 2.0), p[2], 1.0], [1.0, 2.0, 4.0], [[0, 1, 0], [0, 0, 1], [0, 0, 0]]),
    ],
)
def test_derivatives_of_coefficients(registering, diagonal, value, derivatives):
    found = derivatives_of(diagonal, value if np.ndim(value) == 0 else np.array(value))
    np.testing.assert_allclose(found, derivatives, rtol=4 * 2.0**-53, atol=0)


def test_values_at_the_end_of_their_range_have_derivatives(registering):
    """Schemes that are stepped in Python take differences, for which values on both sides are needed."""

    def energy(stiffness):
        return (np.array([stiffness, 0.0, 0.0]),)

    @co.systems.ready_made(energy=energy)
    def at_least_one(stiffness=1.0):
        if stiffness < 1.0:
            raise ValueError("too soft")
        return co.LiePoissonSystem(
            SO3, co.Quadratic(*energy(stiffness)), name="at_least_one", parameters={"stiffness": stiffness}
        )

    x = np.array([1.0, 2.0, 3.0])
    for value in (2.0, 1.0):
        assert parameter_of(at_least_one(value), "stiffness").energy().at(x).tolist() == [0.5]
    _, tangents = co.prepare(at_least_one(), co.GaussLegendre(2), 0.125).jvp(x, (0, 1), {"stiffness": 1.0})
    assert np.any(tangents.x)
    with refused(ValueError, "stiffness", "too soft"):
        co.prepare(at_least_one(), co.Kahan(), 0.125).jvp(x, (0, 1), {"stiffness": 1.0})


def test_energies_have_arguments_of_their_builders(registering):
    for energy, symmetric in ((lambda p, q: None, ()), (lambda *, q: None, ()), (lambda p: None, ("q",))):
        with refused(TypeError, "wrong", "q"):

            @co.systems.ready_made(energy=energy, symmetric=symmetric)
            def wrong(p=1.0):
                return p

    with refused(TypeError, "energy", "3"):
        co.systems.ready_made(energy=3)


def twice(p):
    return (np.array([2.0 * p, 1.0, 1.0]),)


# Each beside the declaration of a system whose energy is p x1^2 + x2^2 / 2 + x3^2 / 2, for p = 0.7.
CONTRADICTIONS = {
    "another H": (lambda p: (np.array([p, 1.0, 1.0]),), {}, ("0.35 of x1*x1", "0.7")),
    "rounding": (lambda p: (np.array([2.0 * p * (1.0 + 2.0**-52), 1.0, 1.0]),), {}, ("0.7000000000000001 of x1*x1",)),
    "abs": (lambda p: (np.array([2.0 * abs(p), 1.0, 1.0]),), {}, ("analytic", "complex")),
    "float": (lambda p: (np.array([2.0 * float(np.real(p)), 1.0, 1.0]),), {}, ("analytic", "complex")),
    "plain mathematics": (lambda p: (np.array([2.0 * math.exp(math.log(p)), 1.0, 1.0]),), {}, ("analytic", "complex")),
    "no number": (lambda p: (np.array([2.0 * p[0], 1.0, 1.0]),), {}, ("fails", "indices")),
    "a name of another note": (twice, {"parameters": {"q": 0.7}}, ("p", "parameters", "q")),
    "a name of another system": (twice, {"name": "unmade"}, ("made", "unmade")),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("which", CONTRADICTIONS)
def test_a_declared_energy_that_is_not_that_of_the_system_is_refused(registering, which):
    declared, options, named = CONTRADICTIONS[which]

    def made(p=0.7, q=0.7):
        return co.LiePoissonSystem(SO3, co.Quadratic(*twice(p)), **{"name": "made", "parameters": {"p": p}, **options})

    made = co.systems.ready_made(energy=declared)(made)
    with refused(TypeError, "made", *named):
        co.prepare(made(), co.Splitting(), 0.125).jvp(np.array([0.3, 0.8, 0.4]), (0, 1), {"p": 1.0})


def test_a_system_of_the_name_of_another_one_has_its_own_parameters():
    """The arguments are a note; so they are where functions and tied parameters are not evaluated."""
    other = co.LiePoissonSystem(SO3, co.Quadratic(1.0), name="rigid_body", parameters={"inertia": (1.0, 2.0, 3.0)})
    assert list(parameters_of(other)) == ["M", "linear"]
    driven = co.systems.spin_lattice("chain", 2, field=lambda t: np.array([0.0, 0.0, np.sin(t)]))
    assert "field" not in parameters_of(driven)


def test_names_of_ready_made_systems_are_taken(registering):
    def toda(sites=3):
        return co.LiePoissonSystem(SO3, co.Quadratic(1.0), name="toda", parameters={"sites": sites})

    with refused(ValueError, "toda", "ready-made", "lattices"):
        co.systems.ready_made(toda)


def test_a_ready_made_system_has_no_forces(registering):
    """Its name and parameters would not make it again, and a record would add the forces once more."""

    @co.systems.ready_made
    def braked(rate=0.1):
        system = co.LiePoissonSystem(SO3, co.Quadratic(1.0), name="braked", parameters={"rate": rate})
        return system.with_forces(co.forces.LinearDamping(rate))

    with refused(TypeError, "braked", "forces", "with_forces"):
        braked(0.2)


@pytest.mark.filterwarnings("error")
def test_differences_do_not_warn_of_values_that_were_not_given():
    """A flat body is at the end of the inertias that bodies have."""
    body = co.systems.rigid_body((1.0, 2.0, 3.0))
    _, tangents = co.prepare(body, co.Kahan(), 0.125).jvp(np.array([1.0, 2.0, 3.0]), (0, 1), {"inertia": np.eye(3)})
    assert np.any(tangents.x)


def band(n):
    """A sparse matrix above the largest dense one, and its stored entries."""
    return scipy.sparse.diags_array([np.full(n - 1, 0.1), np.ones(n), np.full(n - 1, 0.1)], offsets=(-1, 0, 1)).tocsr()


def test_matrices_are_parameters_with_all_entries_up_to_a_dimension_and_then_with_those_stored():
    for n in (128, 129):
        M, x, linear = band(n), np.cos(np.arange(n)), np.sin(np.arange(n))
        H = co.Quadratic(M, linear, constant=2.0)
        system = co.LiePoissonSystem(co.LieAlgebra.from_brackets(n, {}), H, casimirs={})
        found, squares, stored = parameters_of(system)["M"], np.outer(x, x) / 2, M.nonzero()
        value = found.value
        assert np.array_equal(value, M.toarray() if n == 128 else M.toarray()[stored])
        assert np.array_equal(found.energy().at(x), squares.ravel() if n == 128 else squares[stored])
        changed = with_parameters(system, {"M": 2.0 * value})
        assert abs(changed.hamiltonian.hessian(np.zeros(n)) - 2.0 * M.toarray()).max() == 0.0
        assert changed.energy(x) == co.Quadratic(2.0 * M, linear, constant=2.0)(x)
        only = with_parameters(system, {"linear": 0.5 * linear})
        assert only.energy(x) == co.Quadratic(M, 0.5 * linear, constant=2.0)(x)
    # An entry alone counts with its symmetric part, as in smaller matrices.
    moved = value.copy()
    moved[1] += 0.5
    hessian = with_parameters(system, {"M": moved}).hamiltonian.hessian(np.zeros(n))
    assert M.toarray()[0, 1] == 0.1 and hessian[0, 1] == hessian[1, 0] == 0.5 * (0.6 + 0.1)


def test_energies_of_functions_and_of_pieces_have_no_parameters():
    cube = (lambda y: y**3, lambda y: 3 * y**2, lambda y: 6 * y)
    pieces = [((0,), co.Quadratic(1.0)), ((1,), co.Quadratic(2.0))]
    for energy in (co.Separable({0: cube}), co.SplitHamiltonian(pieces)):
        assert parameters_of(co.LiePoissonSystem(SO3, energy)) == {}
    with refused(ValueError, "inertai", "inertia", "rigid_body"):
        parameter_of(co.systems.rigid_body(), "inertai")


@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2)], ids=str)
def test_members_of_a_batch_may_have_derivatives_of_other_monomials(registering, method):
    """The derivative of 1 + p^2 has no monomial at p = 0; each member has that of its run alone."""

    def energy(p):
        return (np.array([1.0 + p * p, 0.5 + p, 0.25]),)

    @co.systems.ready_made(energy=energy)
    def made(p):
        return co.LiePoissonSystem(SO3, co.Quadratic(*energy(p)), name="made", parameters={"p": p})

    systems, x0 = [made(p) for p in (0.25, 0.0, 0.375)], np.array([0.3, 0.8, 0.4])
    sol, pullback = co.prepare(co.batch(systems), method, 0.125).vjp(x0, (0, 1))
    found = pullback(sol.x**2)["p"]
    for m, system in enumerate(systems):
        alone, own = co.prepare(system, method, 0.125).vjp(x0, (0, 1))
        assert found[m] == own(alone.x**2)["p"] != 0.0


def test_a_stream_with_a_kink_beside_a_parameter_is_differentiated_nearby(registering):
    """The kink is within the nodes of the first differences: of the runs themselves, and of a decay along the orbit."""
    first, second = np.array([[1.0, 0.5, 0.7], [0.5, 0.3, 0.2], [0.7, 0.2, 1.5]]), np.eye(3)[::-1] + 0.5

    @co.systems.ready_made
    def kinked(p):
        weights = co.systems.Weights(first + np.maximum(p, 0.306) * second)
        return co.MatrixSystem(co.MatrixAlgebra("u", 3), weights, name="kinked", parameters={"p": p})

    system = kinked(0.312).with_forces(co.forces.SelectiveDecay(0.4))
    rng = np.random.default_rng(4)
    x0 = system.unforced.algebra.projected(rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3)))

    def end(p):
        moved = kinked(p).with_forces(co.forces.SelectiveDecay(0.4))
        return co.integrate(moved, x0, (0.5, 1.0), 0.125, co.IsospectralGauss()).x[-1]

    _, tangents = co.prepare(system, co.IsospectralGauss(), 0.125).jvp(x0, (0.5, 1.0), {"p": 1.0})
    h = 2.0**-12
    expected = (8 * (end(0.312 + h) - end(0.312 - h)) - (end(0.312 + 2 * h) - end(0.312 - 2 * h))) / (12 * h)
    np.testing.assert_allclose(tangents.x[-1], expected, rtol=0, atol=1e-9 * np.abs(expected).max())
