"""Splittings whose parts are free bodies, bonds of spins, or functions that are sums: order, exactness."""

from fractions import Fraction
from itertools import permutations, product

import mpmath
import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

SO3, E3 = co.algebras.so(3), co.algebras.e(3)


def scaled(p, q, r):
    """so(3), or sl(2), with [e1, e2] = p e3, [e2, e3] = q e1, [e3, e1] = r e2."""
    return co.LieAlgebra.from_brackets(3, {(0, 1): {2: p}, (1, 2): {0: q}, (0, 2): {1: -r}})


def graph(seed, sites=6, **more):
    """Spins on a random graph that is connected, each coupling of its own."""
    rng = np.random.default_rng(seed)
    edges = [(i, j) for i in range(sites) for j in range(i + 1, sites) if j == i + 1 or rng.random() < 0.4]
    return co.systems.spin_lattice(edges, sites, exchange=rng.standard_normal(len(edges)), **more)


def systems_of_bodies():
    B = np.random.default_rng(2).standard_normal((6, 6))
    potential = {(0, 0, 0, 1, 0, 0): 0.5, (0, 0, 0, 0, 3, 0): 0.25, (2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.75}
    permuted = co.algebras.change_of_basis(E3, np.eye(6)[[4, 0, 3, 2, 5, 1]])
    return {
        "scaled": co.LiePoissonSystem(scaled(2.0, 3.0, 0.5), co.Quadratic(B[:3, :3] + B[:3, :3].T)),
        "negative": co.LiePoissonSystem(
            scaled(-1.0, -2.0, -0.25), co.Quadratic([1.0, 0.5, 0.25], linear=[0.1, 0.2, -0.3]), sign=-1
        ),
        "permuted": co.LiePoissonSystem(permuted, co.Quadratic(np.diag(np.arange(1.0, 7.0)), linear=B[0]), sign=-1),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(0.3 * (B + B.T)), sign=-1),
        "su(3)": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(np.linspace(0.5, 1.5, 8))),
        "Kirchhoff": co.systems.kirchhoff_body(),
        "gyrostat": co.systems.gyrostat((1.0, 2.0, 3.0), (0.25, 0.5, -0.75)),
        "potential": co.LiePoissonSystem(E3, co.Polynomial(potential | {(0, 0, 2, 0, 0, 0): 1.0}), sign=-1),
        "copies": co.LiePoissonSystem(co.algebras.copies(SO3, 3), co.Quadratic(np.diag(np.arange(1.0, 10.0)) + 0.1)),
    }


def systems_of_bonds():
    rng = np.random.default_rng(2)
    tensors = np.stack([np.eye(3), np.diag([1.0, 1.0, 0.5]), np.eye(3), np.eye(3) + 0.2 * rng.standard_normal((3, 3))])
    mixed = np.zeros((12, 12))
    mixed[:3, 3:6] = mixed[3:6, :3] = -0.8 * np.eye(3)
    mixed[6:, 6:] = np.diag([1.0, 0.5, 0.25, 0.0, 0.0, 0.0])
    mixed[2, 9] = mixed[9, 2] = 0.5
    return {
        "graph": graph(1, field=rng.standard_normal((6, 3)), on_site=(0.3, 0.0, -0.2)),
        "ring of tensors": co.systems.spin_lattice(
            [(0, 1), (1, 2), (2, 3), (0, 3)], 4, tensor=tensors,
            dm=[[0, 0, 0], [0, 0, 0], [0, 0.2, 0.1], [0, 0, 0]],
        ),
        "stretched": co.LiePoissonSystem(  # isotropic where [e2, e3] = 2 e1
            co.algebras.copies(scaled(1.0, 2.0, 1.0), 2),
            co.Quadratic(np.kron([[0.5, 1.0], [1.0, 0.0]], np.diag([1.0, 0.5, 0.5]))),
            sign=-1,
        ),
        "mirrored": co.LiePoissonSystem(
            co.algebras.copies(scaled(-1.0, -1.0, -1.0), 3),
            co.Quadratic(np.kron(np.ones((3, 3)) - np.eye(3), np.eye(3))),
        ),
        "with a body": co.LiePoissonSystem(
            co.algebras.direct_sum(SO3, SO3, E3), co.Quadratic(mixed, linear=0.1 * rng.standard_normal(12)), sign=-1
        ),
    }  # fmt: skip


FULL6 = (lambda M: M @ M.T + 6 * np.eye(6))(np.random.default_rng(53).standard_normal((6, 6)))
FUNCTIONS = {
    "so(3)": (SO3, lambda x: x[0] ** 2 / 2 + np.cos(x[1]) + x[2] ** 4 / 4),
    "e(3)": (
        co.algebras.se(3),
        lambda x: (
            sum(FULL6[i, j] * x[i] * x[j] for i in range(6) for j in range(6)) / 20
            + 3 - 0.5 * (np.sin(x[2]) + 1) + np.exp(x[3] * x[4] / 4) * x[5]
        ),
    ),
    "so(4)": (
        co.algebras.so(4),
        lambda x: (x[0] + 2 * x[5]) ** 2 / 2 - (np.cosh(x[0]) - x[1] * x[4]) / 3 + np.sqrt(1 + x[5] ** 2) + x[2] * x[3],
    ),
    "solvable": (
        co.algebras.get("A4,9", b=0.5),
        lambda x: -np.log(1 + x[0] ** 2) + x[3] * (x[3] - 1) / 2 + np.tanh(x[1]) / 2 - (-x[2]) ** 2,
    ),
    "in time": (SO3, lambda x, t: x[0] ** 2 / 2 + np.cos(t) * np.sin(x[1]) + x[2] * np.exp(-t) + t**2),
}  # fmt: skip
CASES = [
    *(("free_body", name) for name in systems_of_bodies()),
    *(("bonds", name) for name in systems_of_bonds()),
    *(("auto", name) for name in FUNCTIONS),
]


def case(parts, name):
    if parts == "auto":
        return co.LiePoissonSystem(*FUNCTIONS[name], sign=-1)
    return (systems_of_bodies() if parts == "free_body" else systems_of_bonds())[name]


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("parts", "name"), CASES)
def test_steps_converge_to_the_motion_with_their_order(parts, name):
    """The parts add up to the energy; also for the group element. A body or a bond alone has no error."""
    system = case(parts, name)
    x0 = 0.5 * np.random.default_rng(4).standard_normal(system.dim)
    with_group = {"attitude": "coadjoint"} if parts == "bonds" else {}
    fine = co.integrate(system, x0, (0.0, 1.0), 2.0**-8, co.GaussLegendre(4), **with_group)
    for order in (1, 2, 4):
        runs = [
            co.integrate(system, x0, (0.0, 1.0), h, co.Splitting(order=order, parts=parts), **with_group)
            for h in (2.0**-5, 2.0**-6)
        ]
        errors = np.array([np.abs(run.x[-1] - fine.x[-1]).max() for run in runs])
        if with_group:
            own = [np.abs(run.attitude[-1] - fine.attitude[-1]).max() for run in runs]
            errors = np.stack([errors, own], axis=1)
        # The ratio of a scheme of order p is 2^p (1 + O(h)).
        assert np.all((errors[0] / errors[1] > 2.0 ** (order - 0.6)) | (errors[0] < 2.0**10 * U)), (order, errors)
        assert all(runs[0].drift()[casimir] < 2.0**-40 for casimir in system.casimirs)


def isotropic_couplings():
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            yield np.diag(signs)[list(order)]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.0, 2.0), (2.0, 2.0), (-1.0, 1.0), (-0.5, -0.5)])
def test_a_bond_is_a_multiple_of_the_identity_between_momenta_of_one_scale(factors):
    """Of all couplings by signed permutations of the axes, in bases e -> f e of the factors f of the two spins."""
    spins = [co.algebras.change_of_basis(SO3, f * np.eye(3)) for f in factors]
    whole, method, found = co.algebras.direct_sum(*spins), co.Splitting(parts="bonds"), 0
    x = np.array([0.5, -0.25, 1.0, 0.75, 0.5, -1.0])
    for coupling in isotropic_couplings():
        M = np.kron([[0.0, 1.0], [0.0, 0.0]], 0.75 * coupling)
        system = co.LiePoissonSystem(whole, co.Quadratic(M + M.T))
        if factors[0] == factors[1] and np.array_equal(coupling, coupling[0, 0] * np.eye(3)):
            found += 1
            # One step is the motion.
            fine = co.integrate(system, x, (0, 1), 1 / 32, co.GaussLegendre(6)).x[-1]
            assert np.abs(co.stepper(system, method, 1.0)(x) - fine).max() <= 2.0**10 * U
        else:
            with refused(ValueError, "no isotropic coupling"):
                method.describe(system)
    assert found == 2 * (factors[0] == factors[1])


@pytest.mark.parametrize("seed", range(4))
def test_bonds_of_one_part_share_no_spin_and_are_few(seed):
    rng = np.random.default_rng(seed)
    edges = [(i, j) for i in range(12) for j in range(i + 1, 12) if rng.random() < 0.5 or j == i + 1]
    found = co.Splitting(parts="bonds").describe(co.systems.spin_lattice(edges, 12))
    assert len(found.parts) < 2 * np.bincount(np.ravel(edges)).max()
    assert sum(len(part.generators) for part in found.parts) <= 6 * len(edges)
    for part in found.parts:
        assert len(set(part.generators)) == len(part.generators)


def test_what_was_found_is_described():
    ring = str(co.Splitting(parts="bonds").describe(co.systems.spin_lattice("ring", 4)))
    assert "2 parts" in ring and "bond of S1[1], S2[1], S3[1] and S1[2], S2[2], S3[2]" in ring
    bodies = str(co.Splitting(parts="free_body").describe(systems_of_bodies()["copies"])).split("\n")
    assert all(f"free body of x1[{k}], x2[{k}], x3[{k}]" in bodies[1] for k in (1, 2, 3))
    text = str(co.Splitting().describe(case("auto", "so(3)")))
    assert "a function in H is the sum of a polynomial of x1, x3 and a function of x2\n" in text
    assert co.Splitting().describe(co.systems.rigid_body()).found == ()
    heisenberg = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1}}, basis=("q", "p", "z"))
    named = co.LiePoissonSystem(heisenberg, lambda x: np.cos(x[0]) + np.sin(x[1]))
    assert co.Splitting().describe(named).found == ("the sum of a function of q and a function of p",)


def test_repeated_doubling_is_counted_once():
    """2^60 terms if they were multiplied out."""

    def H(x):
        y = np.cos(x[0])
        for _ in range(60):
            y = y + y
        return y * 2.0**-60 + np.sin(x[1]) + x[2] - x[2] + (x[1] - 0.5) ** 12

    found = co.Splitting().describe(co.LiePoissonSystem(SO3, H))
    assert len(found.parts) == 2


def test_inputs_of_parts():
    """Gravity may be an input and rotors may not; spins with bonds may not."""

    def top(linear):
        return co.LiePoissonSystem(E3, co.Quadratic([1, 0.5, 0.25, 0, 0, 0], linear=linear), sign=-1)

    method, x0 = co.Splitting(order=4, parts="free_body"), (0.5, 1.0, -0.3, 0.0, 0.6, 0.8)
    prepared = co.prepare(top([0, 0, 0, 0.1, 0.2, 0.3]), method, 0.125, inputs={"gravity": (3, 4, 5)})
    for gravity in ((0.4, -0.1, 0.2), (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)):
        found = prepared.run(x0, (0.0, 2.0), gravity=gravity).x[-1]
        expected = co.integrate(top([0, 0, 0, *gravity]), x0, (0.0, 2.0), 0.125, method).x[-1]
        np.testing.assert_allclose(found, expected, rtol=0, atol=2.0**8 * U)
    with refused(ValueError, "inputs", "x2"):
        co.prepare(top([0, 0, 0, 0.1, 0.2, 0.3]), method, 0.125, inputs={"rotors": (1,)})
    for spin in range(6):
        here = (3 * spin, 3 * spin + 1, 3 * spin + 2)
        with refused(ValueError, "inputs", f"S1[{spin + 1}]"):
            co.prepare(graph(1), co.Splitting(parts="bonds"), 0.1, inputs={"here": here})


@pytest.mark.long
def test_a_flow_of_a_bond_in_thirty_digits_is_the_closed_form():
    """That of a bond is a rotation about the sum of the spins."""
    with mpmath.workdps(40):
        x0 = np.array([mpmath.mpf(v) for v in (2, 1, 0.5, -0.25, 1, 3)], dtype=object)
        pair = co.systems.spin_lattice("chain", 2, exchange=0.75)
        x = co.Splitting(parts="bonds").step(pair, x0, mpmath.mpf(0), mpmath.mpf(3))
        K, S = x0[:3] + x0[3:], x0[:3]
        k = mpmath.sqrt(K @ K)
        phi = -mpmath.mpf(0.75) * k * 3
        turned = S * mpmath.cos(phi) + np.cross(K / k, S) * mpmath.sin(phi) + K * (K @ S) / k**2 * (1 - mpmath.cos(phi))
        assert max(abs(x[:3] - turned)) < mpmath.mpf(10) ** -36
        assert max(abs(x[:3] + x[3:] - K)) < mpmath.mpf(10) ** -36


@pytest.mark.long
def test_a_flow_of_a_free_body_in_thirty_digits_is_that_of_elliptic_functions():
    body = co.LiePoissonSystem(SO3, co.Quadratic([1.0, 0.5, 0.25]), sign=-1)
    with mpmath.workdps(40):
        x0 = np.array([mpmath.mpf(v) for v in (2, 1, 0.5)], dtype=object)
        x = co.Splitting(parts="free_body").step(body, x0, mpmath.mpf(0), mpmath.mpf(3))
        m = [mpmath.mpf(v) for v in (1, 0.5, 0.25)]
        square, doubled = sum(v * v for v in x0), sum(a * v * v for a, v in zip(m, x0, strict=True))
        # About the first axis: dn there, cn along the third, sn along the second.
        rate = mpmath.sqrt((m[0] - m[1]) * (doubled - m[2] * square))
        k2 = (m[1] - m[2]) * (m[0] * square - doubled) / ((m[0] - m[1]) * (doubled - m[2] * square))
        largest = mpmath.sqrt((doubled - m[2] * square) / (m[0] - m[2]))
        other = mpmath.sqrt((m[0] * square - doubled) / (m[0] - m[2]))
        start = mpmath.ellipf(mpmath.acos(x0[2] / other), k2)
        phases = [s * start + t * rate * 3 for s in (1, -1) for t in (1, -1)]
        found = [
            abs(largest * mpmath.ellipfun("dn", u, m=k2) - x[0]) + abs(other * mpmath.ellipfun("cn", u, m=k2) - x[2])
            for u in phases
        ]
        assert min(found) < mpmath.mpf(10) ** -36
        assert abs(sum(v * v for v in x) - square) < mpmath.mpf(10) ** -36


def test_functions_are_taken_apart_however_they_are_given():
    """With derivatives, as a written sum, and as a multiple beside a quadratic form."""
    system, x = case("auto", "so(3)"), np.array([0.3, 0.5, 0.8])
    given = co.Hamiltonian(FUNCTIONS["so(3)"][1], lambda x: np.array([x[0], -np.sin(x[1]), x[2] ** 3]))
    cosine = co.Separable({1: (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))})
    written = co.Polynomial("x1^2/2 + x3^4/4", dim=3) + cosine
    method = co.Splitting(order=4)
    ends = [co.integrate(system, x, (0, 1), 0.1, method).x]
    ends += [co.integrate(co.LiePoissonSystem(SO3, H, sign=-1), x, (0, 1), 0.1, method).x for H in (given, written)]
    np.testing.assert_array_equal(ends[0], ends[1])
    assert np.abs(ends[0] - ends[2]).max() < 2.0**-46
    H = 2 * co.Hamiltonian(FUNCTIONS["so(4)"][1]) + co.Quadratic(np.arange(1.0, 7.0))
    whole, x = co.LiePoissonSystem(co.algebras.so(4), H), np.array([0.3, -0.4, 0.5, 0.2, 0.1, 0.6])
    fine = [co.integrate(whole, x, (0, 1), 1 / 64, m).x[-1] for m in (co.Splitting(order=6), co.GaussLegendre(5))]
    assert np.abs(fine[0] - fine[1]).max() < 1e-8


def test_the_modified_hamiltonian_of_two_bonds():
    """24 H2 = -{A, {A, D}} + 2 {D, {D, A}}, A outside and D inside, of the brackets of their gradients."""
    chain, h = co.systems.spin_lattice("chain", 3, exchange=(1.0, 0.5)), 2.0**-6
    method = co.Splitting(parts="bonds")
    found = co.modified_hamiltonian(chain, method, order=4)
    pairs = [co.systems.spin_lattice([edge], 3, exchange=J).hamiltonian for edge, J in (((0, 1), 1.0), ((1, 2), 0.5))]
    first = method.describe(chain).parts[0].generators
    A, D = pairs if "S1[1]" in first[0] else pairs[::-1]

    def nested(F, G, x):
        """{F, {F, G}}, of which the inner bracket is cubic, by an exact directional derivative of third order."""
        step, direction = Fraction(1, 8), chain.structure_matrix(x).T @ F.gradient(x)
        values = [
            (lambda y: F.gradient(y) @ chain.structure_matrix(y) @ G.gradient(y))(x + float(k * step) * direction)
            for k in (-2, -1, 1, 2)
        ]
        return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * float(step))

    x = np.array([k % 5 - 2 for k in range(9)]) / 4
    expected = (2 * nested(D, A, x) - nested(A, D, x)) / 24
    value = (found(x, h) - chain.energy(x)) / h**2
    assert abs(value - expected) <= 2.0**13 * U * 2.0**4 and expected != 0


def test_modified_energies_of_a_free_body_with_gravity():
    """Of a run the modified Hamiltonian changes less than the energy, by h^2 for each order."""
    top, method = co.systems.heavy_top(), co.Splitting(parts="free_body")
    run = co.integrate(top, (0.5, 0.3, -0.2, 0.6, 0.0, 0.8), (0.0, 20.0), 0.0625, method)
    series = [co.modified_hamiltonian(top, method, order=order) for order in (4, 6)]
    drifts = [np.ptp(run.energy), *(np.ptp([found(x, 0.0625) for x in run.x]) for found in series)]
    assert drifts[1] < drifts[0] / 100 and drifts[2] < drifts[1] / 30


def test_a_large_lattice_goes_without_its_attitude():
    chain, method = co.systems.spin_lattice("chain", 700), co.Splitting(parts="bonds")
    x0 = np.random.default_rng(1).standard_normal(2100)
    run = co.integrate(chain, x0, (0.0, 0.2), 0.1, method, watch=False)
    total = np.abs(run.x.reshape(3, 700, 3).sum(axis=1) - x0.reshape(700, 3).sum(axis=0)).max()
    assert total <= 2.0**6 * U * np.sqrt(700)
    with refused(ValueError, "too many terms", "attitude"):
        method.flow_table(chain, group=np.zeros((2100, 2, 2)))


def is_bond(system):
    try:
        co.Splitting(parts="bonds").flow_table(system)
    except ValueError as error:
        assert "no isotropic coupling" in str(error)
        return False
    return True


@pytest.mark.parametrize(("off", "isotropic"), [(0.0, True), (2.0 * U, False)])
def test_couplings_of_spins_are_compared_to_the_last_bit(off, isotropic):
    assert is_bond(co.systems.spin_lattice("chain", 2, tensor=(1.0, 1.0, 1.0 + off))) is isotropic


@pytest.mark.parametrize(("off", "isotropic"), [(0.0, True), (6 * U, True), (12 * U, False)])
@pytest.mark.parametrize("place", [0, 2])
def test_couplings_of_scaled_momenta_are_compared_up_to_rounding(off, isotropic, place):
    """[e1, e2] = 4 e3, [e2, e3] = e1, [e3, e1] = e2: an isotropic energy has the form (1, 1, 4) or the like."""
    algebra = co.algebras.copies(scaled(4.0, 1.0, 1.0), 2)

    def coupled(form):
        return co.LiePoissonSystem(algebra, co.Quadratic(np.kron([[0.0, 1.0], [1.0, 0.0]], np.diag(form))))

    (form,) = [form for form in ((1.0, 1.0, 0.25), (1.0, 1.0, 4.0)) if is_bond(coupled(form))]
    changed = [value * (1.0 + off * (k == place)) for k, value in enumerate(form)]
    assert is_bond(coupled(changed)) is isotropic
