"""Thresholds of `systems/`."""

import warnings

import numpy as np
from scipy.sparse import csr_array

import coadjoint as co
from coadjoint.systems.bodies.inertia import read_in_range
from coadjoint.systems.closed_forms.spins import _kernel
from coadjoint.systems.forces.rates import metric_root
from coadjoint.systems.matrices.streams import DiagonalSolve
from coadjoint.systems.matrices.torus_grid import coordinates, grid_orientation
from coadjoint.systems.user_functions import SEED, check_derivative, sample_points
from thresholds.probing import U, accepted, limit, perturbed, probe, sides

BODY_WARNINGS, PARTICLES = "systems/bodies/inertia.py", "systems/fluids/decorated_particles.py"
SPHERE, TORUS = "systems/matrices/spherical_modes.py", "systems/matrices/torus_modes.py"
ENERGY, LATTICE = "systems/matrices/matrix_energy.py", "systems/lattices/spin_lattice.py"


def silent(call):
    """Whether a call warns of nothing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return not caught


@probe(
    ("systems/matrix_entries.py", "np.abs(first - second) > 64 * UNIT_ROUNDOFF * np.abs(values).max(initial=0.0)"),
    at=64 * U,
)
def a_quadratic_form_is_symmetric(off):
    M = perturbed([[1.0, 0.5], [0.5, 0.25]], (0, 1), off)
    dense, sparse = (accepted(lambda M=M: co.Quadratic(M), "symmetric") for M in (M, csr_array(M)))
    assert dense == sparse
    return dense


@probe(("systems/bodies/inertia.py", "asymmetry.max() > 64 * UNIT_ROUNDOFF * np.abs(matrix).max()"), at=64 * U)
def an_inertia_tensor_is_symmetric(off):
    tensor = perturbed([[2.0, 0.25, 0.0], [0.25, 2.0, 0.0], [0.0, 0.0, 2.0]], (0, 1), 2.0 * off)
    return accepted(lambda: co.systems.rigid_body(tensor), "symmetric")


@probe((BODY_WARNINGS, "ROUNDING_TOLERANCE"), at=64 * U)
def a_moment_is_the_sum_of_the_others(excess):
    """I3 - I1 - I2 is `excess` of their sum."""
    return silent(lambda: co.systems.rigid_body((1.0, 1.0, 2.0 + 4.0 * excess)))


@probe((BODY_WARNINGS, "ROUNDING_TOLERANCE"), at=64 * U)
def a_mass_is_negative_by_rounding(share):
    return silent(lambda: co.systems.so_n_body((-share, 1.0, 1.0)))


@probe(
    (
        "systems/bodies/so_n_body.py",
        "least_sum <= (0.0 if values.ndim == 1 else 4 * n * UNIT_ROUNDOFF * np.abs(values).max())",
    ),
    at=12 * U,
)
def two_principal_values_of_a_tensor_vanish(light):
    """So that inertia is refused: the sum of the two smallest is `light` of the largest."""
    tensor = np.diag([0.0, 2.0**-20 * (light * 2.0**20), 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return not accepted(lambda: co.systems.so_n_body(tensor), "their sum")


@probe(("systems/bodies/clebsch_body.py", "abs(defect) > 8 * UNIT_ROUNDOFF * size"), at=8 * U)
def coefficients_are_of_a_clebsch_case(off):
    """Of I = c = (1, 2, 3) the absolute products add up to 1 * 5 + 2 * 4 + 3 * 3 = 22; c3 counts I1 - I2 = -1 times."""
    return accepted(lambda: co.systems.clebsch_body((1.0, 2.0, 3.0), (1.0, 2.0, 3.0 + 22.0 * off)), "Clebsch")


@probe(
    (
        "systems/hamiltonians/decorated_potential.py",
        "abs(right - left) <= 64 * UNIT_ROUNDOFF * (abs(right) + abs(left))",
    ),
    at=64 * U,
)
def a_pair_potential_is_even(off):
    """1 for positive r, and for negative r a little more; no derivative sees that."""
    zero = lambda r: 0.0 * r  # noqa: E731
    pair = (lambda r: 1.0 + (2.0 * off if r < 0 else 0.0), zero, zero, zero)
    return accepted(lambda: co.systems.decorated_particles(pair=pair), "even")


class Stated:
    """A Hamiltonian a |x|^2 / 2 whose terms are those of another number."""

    dim, timed = 3, False

    def __init__(self, off):
        self.other = co.Quadratic(np.full(3, 1.0 + off)).bind(3)

    def bind(self, n):
        return self

    def value(self, x, t=0.0):
        return 0.5 * np.sum(np.asarray(x) ** 2)

    def gradient(self, x, t=0.0):
        return np.asarray(x) * 1.0

    def hessian(self, x, t=0.0):
        return np.eye(3)

    def terms(self):
        return self.other.terms()


@probe(
    (
        "systems/hamiltonians/user_hamiltonian.py",
        "np.abs(total - declared) <= 2.0 ** 10 * UNIT_ROUNDOFF * (size + np.abs(declared))",
    ),
    at=2.0**10 * U,
)
def terms_and_gradient_agree(off):
    """Both sides count."""
    return accepted(lambda: co.LiePoissonSystem(co.algebras.so(3), Stated(2.0 * off)), "contradict")


@probe(("systems/poisson.py", "excess.max(initial=0.0) > 64 * UNIT_ROUNDOFF * size"), at=64 * U)
def a_structure_matrix_is_skew(off):
    J = np.array([[0.0, 1.0], [-1.0 + off, 0.0]])
    return accepted(lambda: co.PoissonSystem(lambda x: J, co.Quadratic((1.0, 2.0))), "skew")


@probe(
    ("systems/closed_forms/spins.py", "np.abs(units @ axis).max() <= 16 * UNIT_ROUNDOFF / min(size, 1.0)"),
    at=16 * U,
)
def an_axis_is_left_by_all_rows(tilt):
    """Two rows leave the third axis, up to the entry that the third row has there."""
    return bool(len(_kernel(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, tilt]]))))


@probe((SPHERE, "abs(conjugate - mirrored) > 1e-12 * abs(number)"), at=1e-12)
def modes_of_a_sphere_are_of_a_real_field(off):
    sphere = co.systems.sphere_euler(8)
    given = {(3, 2): 2.0 + 0.0j, (3, -2): 2.0 * (1.0 + off)}
    return accepted(lambda: sphere.from_modes(given), "real")


@probe((SPHERE, "violation > 1e-12 * np.abs(c).max(initial=0.0)"), at=1e-12)
def coefficients_of_a_sphere_are_of_a_real_field(off):
    """An array of coefficients [l, m]: those of m = 0 are real, those of m > l and of l = 0 vanish."""
    sphere, seen = co.systems.sphere_euler(8), set()
    for place, size in (((3, 0), 2j * off), ((2, 3), 2.0 * off), ((0, 0), 2.0 * off)):
        c = np.zeros((8, 8), dtype=complex)
        c[3, 2] = 2.0
        c[place] = size
        seen.add(accepted(lambda c=c: sphere.from_modes(c), "zero"))
    (found,) = seen
    return found


@probe((SPHERE, "np.abs(c) > 1e-14 * np.abs(c).max(initial=0.0)"), at=1e-14)
def a_mode_of_a_sphere_is_rounding(size):
    from coadjoint.systems.matrices.spherical_modes import as_mapping

    c = np.zeros((8, 8), dtype=complex)
    c[3, 2], c[4, 1] = 2.0, 2.0 * size
    return (4, 1) not in as_mapping(c)


@probe(
    (TORUS, "abs(coefficients.get((-n1, -n2), number.conjugate()) - number.conjugate()) > 1e-12 * abs(number)"),
    at=1e-12,
)
def modes_of_a_torus_are_of_a_real_field(off):
    torus = co.systems.torus_euler(5)
    return accepted(lambda: torus.from_modes({(1, 2): 2.0, (-1, -2): 2.0 * (1.0 + off)}), "real")


@probe((TORUS, "violation > 1e-12 * np.abs(w).max(initial=0.0)"), at=1e-12)
def coefficients_of_a_torus_are_of_a_real_field(off):
    torus, seen = co.systems.torus_euler(5), set()
    for place in ((-1, -2), (0, 0)):
        w = np.zeros((5, 5), dtype=complex)
        w[1, 2] = w[-1, -2] = 2.0
        w[place] += 2.0 * off
        seen.add(accepted(lambda w=w: torus.from_modes(w), "real"))
    (found,) = seen
    return found


@probe(("systems/fluids/torus_euler.py", "np.abs(w) > 1e-14 * size"), at=1e-14)
def a_mode_of_a_torus_is_rounding(size):
    """Of a matrix of the algebra: entries are sums of modes of size 1, so that the smaller one is added here."""
    torus = co.systems.torus_euler(5)
    return (1, 1) not in torus.modes(torus.from_modes({(1, 2): 1.0, (1, 1): size}))


@probe(
    ("systems/matrices/torus_grid.py", "np.abs(first - first[0] - step * np.arange(len(first))).max() <= 1e-05"),
    at=1e-5,
)
def coordinates_are_equally_spaced(off):
    return accepted(lambda: grid_orientation(perturbed(coordinates(8), (3,), off), "x"), "spaced")


@probe(("systems/forces/custom_force.py", "np.max(np.abs(unmoved - x)) > 1e-09 * np.max(np.abs(x))"), at=1e-9)
def a_flow_moves_nothing_in_no_time(off):
    force = co.forces.OwnForce(lambda x, t, tau: x * (1.0 + off))
    return accepted(lambda: co.ForcedSystem(co.systems.rigid_body((1, 2, 3)), [force]), "tau = 0")


@probe(("systems/forces/rates.py", "64 * n * UNIT_ROUNDOFF * size"), at=3 * 64 * U)
def a_metric_is_positive_up_to_rounding(below):
    return accepted(
        lambda: metric_root(((1.0, 0.0, 0.0), (0.0, -below, 0.0), (0.0, 0.0, 1.0)), "metric"), "semidefinite"
    )


@probe(("systems/forces/rates.py", "64 * n * UNIT_ROUNDOFF * size"), at=2 * 64 * U)
def a_small_entry_of_a_metric_is_rounding(size):
    return metric_root(((1.0, 0.0), (0.0, size)), "metric")[1, 1] == 0.0


def stream_off(N, part):
    """A linear stream of so(N), and part of another map."""
    algebra = co.MatrixAlgebra("so", N)
    return accepted(lambda: co.MatrixSystem(algebra, lambda W: 2.0 * W + part(W)))


@probe((ENERGY, "ROUNDING_TOLERANCE"), at=1e-12)
def a_stream_stays_in_the_algebra(off):
    """Times N = 4; a multiple of the unit matrix, which so(4) has not."""
    return stream_off(4, lambda W: 8.0 * off * np.abs(W).max() * np.eye(4))


@probe((ENERGY, "ROUNDING_TOLERANCE"), at=1e-12)
def a_stream_is_linear(off):
    """stream((A + B)/2) against the mean: a part of third degree that is `off` of the sizes."""
    from coadjoint.systems.matrices.matrix_energy import samples

    system = co.MatrixSystem(co.MatrixAlgebra("so", 4), lambda W: 2.0 * W)
    A, B = samples(system)
    cube = [M @ M @ M for M in (A, B, (A + B) / 2)]
    missed = np.abs(2.0 * cube[2] - cube[0] - cube[1]).max()
    size = 2.0 * (np.abs(A) + np.abs(B)).max()
    return stream_off(4, lambda W: 4.0 * off * size / missed * (W @ W @ W))


@probe((ENERGY, "ROUNDING_TOLERANCE"), at=1e-12)
def a_stream_is_symmetric(off):
    """A linear map whose matrix is `off` away from a symmetric one, of the sizes of the products."""
    from coadjoint.systems.matrices.matrix_energy import samples

    algebra = co.MatrixAlgebra("so", 4)
    A, B = samples(co.MatrixSystem(algebra, lambda W: 2.0 * W))

    def skew(W):
        return np.array([[0.0, W[0, 2], 0, 0], [-W[0, 2], 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])

    missed = abs(algebra.pairing(skew(A), B) - algebra.pairing(A, skew(B)))
    sizes = 2.0 * (np.sum(np.abs(A.T * B.T)) + np.sum(np.abs(B * A)))
    return stream_off(4, lambda W: 4.0 * off * sizes / missed * skew(W))


@probe((ENERGY, "AGREEMENT"), at=2.0**-24)
def a_stream_is_the_slope_of_the_energy(off):
    """<2 W, B> against the slope of (1 + c) times the energy; times N = 4, of the products and the energy."""
    from coadjoint.systems.matrices.matrix_energy import samples

    algebra = co.MatrixAlgebra("so", 4)
    A, B = samples(co.MatrixSystem(algebra, lambda W: 2.0 * W))
    slope = algebra.pairing(2.0 * A, B)
    size = np.sum(np.abs(2.0 * A) * np.abs(B.T)) + abs(algebra.pairing(A, A))
    c = 4.0 * off * size / abs(slope)
    return accepted(
        lambda: co.MatrixSystem(algebra, lambda W: 2.0 * W, energy=lambda W: (1.0 + c) * algebra.pairing(W, W)),
        "gradient",
    )


@probe(("systems/bodies/inertia.py", "MAX_MAGNITUDE"), at=1e30)
def a_unit_is_in_range(size):
    large, small = (accepted(lambda v=v: read_in_range(v, "mass"), "units") for v in (size, 1.0 / size))
    assert large == small
    return large


@probe(("systems/fluids/sphere_euler.py", "MAX_ROTATION"), at=1e100)
def a_sphere_turns_slowly_enough(rotation):
    return accepted(lambda: co.systems.sphere_euler(4, rotation), "rotation") and accepted(
        lambda: co.systems.sphere_euler(4, -rotation), "rotation"
    )


@sides(("systems/fluids/torus_euler.py", "MAX_N"), below=1001, above=1003)
def a_torus_is_not_too_large(N):
    return accepted(lambda: co.systems.torus_euler(N), "1001")


@probe((PARTICLES, "MAX_COEFFICIENT"), at=1e50)
def masses_and_potentials_are_in_range(size):
    given = ({"weights": (1.0, size)}, {"weights": (1.0, 1.0 / size)}, {"external": (0.0, 0.0, size)})
    (found,) = {accepted(lambda g=g: co.systems.decorated_particles(**g)) for g in given}
    return found


@limit((PARTICLES, "MAX_POTENTIAL_DEGREE"), at=20)
def a_potential_has_a_degree(degree):
    return accepted(lambda: co.systems.decorated_particles(external=(0.0,) * degree + (1.0,)), "degree")


@limit((PARTICLES, "MAX_DENSE_SQUARE"), at=64)
def the_energy_of_a_centre_is_given(count):
    system = co.systems.decorated_particles(np.ones(count), (0.0, 0.0, 0.5), (0.0, 0.0, 0.25))
    return bool(system.integrals)


@probe((LATTICE, "MAX_COUPLING"), at=1e100)
def couplings_are_in_range(size):
    return accepted(lambda: co.systems.spin_lattice("chain", 3, exchange=size), "beyond")


@limit((LATTICE, "MAX_RECORDED_SPINS"), at=682)
def lengths_of_spins_are_followed(sites):
    return "sum of |x|^2" not in co.systems.spin_lattice("chain", sites).casimirs


@sides((LATTICE, "MAX_STORED_VALUES"), below=2**15, above=2**17)
def parameters_of_a_lattice_are_kept(numbers):
    """Pairs of neighbours in a ring, given as a list."""
    sites = numbers // 2
    ring = np.stack([np.arange(sites), np.roll(np.arange(sites), -1)], axis=1)
    return co.systems.spin_lattice(ring, sites).parameters is not None


@limit(("systems/closed_forms/spins.py", "MAX_DENSE_SQUARE"), at=64)
def the_square_of_the_total_spin_is_given(sites):
    return "|total S|^2" in co.systems.spin_lattice("chain", sites, field=(0.0, 0.0, 0.5)).integrals


@limit(("systems/lattices/toda.py", "MAX_SITES_WITH_ALL_TRACES"), at=8)
def all_traces_of_a_toda_lattice_are_given(sites):
    return f"tr L^{sites}" in co.systems.toda(sites).integrals


@limit(("systems/lattices/toda.py", "MAX_POLYNOMIAL_SITES"), at=64)
def traces_of_a_toda_lattice_are_given(sites):
    ring = co.systems.toda_ring(sites)
    assert ("product of a" in ring.casimirs) == bool(ring.integrals)
    return bool(co.systems.toda(sites).integrals)


@limit(("systems/closed_forms/manakov_integrals.py", "MAX_SO_DIMENSION"), at=6)
def integrals_of_higher_degree_are_given(n):
    a = np.arange(1.0, n + 1)
    return "X^4 a" in co.systems.manakov_top(a, a**2).integrals


@limit(("systems/closed_forms/manakov_integrals.py", "MAX_TRACE_POWER"), at=12)
def there_is_a_quadratic_integral_for_each_power(n):
    """Powers from 1 to n - 2, and 10 at most."""
    a = np.arange(1.0, n + 1)
    return len(co.systems.manakov_top(a, a**2).integrals) == n - 2


@limit(("systems/forces/viscosity.py", "MAX_POWER"), at=32)
def a_power_of_the_laplacian_is_in_range(power):
    return accepted(lambda: co.forces.Viscosity(1e-3, power), "power")


@limit(("systems/forces/heat_bath.py", "MAX_SEED"), at=2**62)
def a_seed_is_in_range(seed):
    (found,) = {accepted(lambda k=k: co.forces.HeatBath(0.1, **({"seed": 1} | {k: seed}))) for k in ("seed", "stream")}
    return found


@limit(("systems/matrices/matrix_system.py", "MAX_POWERS"), at=64)
def traces_of_powers_are_not_too_many(powers):
    return accepted(lambda: co.MatrixSystem(co.MatrixAlgebra("so", 4), lambda W: 2.0 * W, powers=powers), "powers")


@limit(("systems/lattices/neighbours.py", "MAX_SITES"), at=2**30)
def sites_are_not_too_many(sites):
    """Refused for their number; below that for an edge that leaves the lattice."""
    try:
        co.systems.spin_lattice([[0, 2**31]], sites)
    except ValueError as refusal:
        return "shape" not in str(refusal)
    raise AssertionError("accepted")


@limit(("systems/fluids/vlasov_moments.py", "MAX_CHARACTERS"), at=10_000)
def a_written_potential_is_not_too_long(letters):
    return accepted(lambda: co.systems.vlasov_moments(potential="1/2*x20".ljust(letters)), "characters")


@probe(
    ("systems/recorded_invariants.py", "operations * UNIT_ROUNDOFF * size(x, bound).max(initial=0.0)"),
    at=(64 + 2 * 3 + 3) * U,
)
def a_function_is_a_casimir(off):
    """|x|^2 with a coefficient that is off: of 64, 2 n and 3 operations. Products are compared where they differ."""
    return _largest_casimir(off)


def _largest_casimir(off):
    # J grad C has the components off * x_i x_j, of products up to |x_i x_j| 2: the largest share over the points.
    shares = []
    for x in np.abs(sample_points(3)):
        shares.append(max(x[1] * x[2], x[0] * x[2]) / (2.0 * max(x[1] * x[2], x[0] * x[2], x[0] * x[1])))
    c = off / max(shares)
    casimir = co.Quadratic((1.0, 1.0, 1.0 + c))
    return accepted(
        lambda: co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((1, 2, 3)), casimirs={"C": casimir}), "Casimir"
    )


@probe(
    ("systems/recorded_invariants.py", "rate > (work + operations) * UNIT_ROUNDOFF * float(np.sum(scale * sizes))"),
    at=2 * (64 + 2 * 3 + 3) * U,
)
def a_function_is_an_integral(off):
    """H itself, with a coefficient that is off."""
    H = np.array([1.0, 2.0, 4.0])
    x = sample_points(3)[0]
    product = np.abs(x[0] * x[1] * x[2])
    # grad F . (x cross grad H) has the terms H_i (H_j - H_k) x1 x2 x3, of absolute products H_i (H_j + H_k).
    c = off * (1 * 6 + 2 * 5 + 4 * 3) * product / (4.0 * product)
    integral = co.Quadratic((1.0, 2.0, 4.0 * (1.0 + c)))
    return accepted(
        lambda: co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(H), integrals={"F": integral}), "integral"
    )


@probe(
    (
        "systems/user_functions.py",
        "16.0 * np.abs(coarse - fine).max(initial=0.0) + 2.0 ** 10 * UNIT_ROUNDOFF * size / step",
    ),
    ("systems/user_functions.py", "UNIT_ROUNDOFF ** (1.0 / 3.0) * float(np.linalg.norm(x)) / np.sqrt(x.size)"),
    at=2.0**10 * U ** (2.0 / 3.0),
)
def a_gradient_is_that_of_the_function(off):
    """The function is 1, and the gradient points along the direction that is tried; the largest state decides."""
    n = 4
    direction = np.random.default_rng(SEED + 2).standard_normal(n)
    direction /= np.linalg.norm(direction)
    widest = max(float(np.linalg.norm(x)) / np.sqrt(n) for x in sample_points(n))
    slope = off / widest * direction
    return accepted(
        lambda: check_derivative(
            lambda x: 1.0, lambda x: slope, names=("H", "dH"), shapes=((), (n,)), n=n, timed=False
        ),
        "contradicts",
    )


@probe(("systems/matrices/streams.py", "abs(pivot[0]) <= 1e-10 * abs(self.main[i, 0])"), at=1e-10)
def a_last_pivot_vanishes(pivot):
    """A tridiagonal operator on two entries of the diagonal, whose second pivot is a part of its entry."""
    main = np.array([[1.0, 2.0], [1.0 / (1.0 - pivot), 0.0]])
    beside = np.array([[0.0, 0.0], [1.0, 0.0]])
    return DiagonalSolve(main, beside, 1.0).table.reshape(2, 2, 2)[1, 1, 0] == 0.0
