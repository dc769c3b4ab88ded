"""Bonds as parts: where they are found, their colours, what is left, what is refused, and exact readings of them."""

import json
from fractions import Fraction
from itertools import permutations, product

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.methods.registry import description_of, from_description
from coadjoint.program.parts.bonds import bonds, colours
from coadjoint.program.parts.part_polynomials import part_polynomials
from coadjoint.program.parts.split import NotSplittable

U = 2.0**-53
SO3 = co.algebras.so(3)


def by_bonds(**options):
    return co.Splitting(parts="bonds", **options)


def graph(seed, sites=6, **more):
    """Spins on a random graph that is connected, each coupling of its own."""
    rng = np.random.default_rng(seed)
    edges = [(i, j) for i in range(sites) for j in range(i + 1, sites) if j == i + 1 or rng.random() < 0.4]
    return co.systems.spin_lattice(edges, sites, exchange=rng.standard_normal(len(edges)), **more)


def systems():
    rng = np.random.default_rng(2)
    yield graph(1, field=rng.standard_normal((6, 3)), on_site=(0.3, 0.0, -0.2))
    yield graph(2, field=(0.0, 0.0, 0.7))
    edges = [(0, 1), (1, 2), (2, 3), (0, 3)]
    tensors = np.stack([np.eye(3), np.diag([1.0, 1.0, 0.5]), np.eye(3), np.eye(3) + 0.2 * rng.standard_normal((3, 3))])
    yield co.systems.spin_lattice(edges, 4, tensor=tensors, dm=[[0, 0, 0], [0, 0, 0], [0, 0.2, 0.1], [0, 0, 0]])
    M = np.kron([[0.5, 1.0], [1.0, 0.0]], np.diag([1.0, 0.5, 0.5]))  # isotropic where [e2, e3] = 2 e1
    stretched = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 2.0}, (0, 2): {1: -1.0}})
    yield co.LiePoissonSystem(co.algebras.copies(stretched, 2), co.Quadratic(M), sign=-1)
    mirrored = co.LieAlgebra.from_brackets(3, {(0, 1): {2: -1.0}, (1, 2): {0: -1.0}, (0, 2): {1: 1.0}})
    M = np.kron(np.ones((3, 3)) - np.eye(3), np.eye(3))
    yield co.LiePoissonSystem(co.algebras.copies(mirrored, 3), co.Quadratic(M), sign=1)
    mixed = np.zeros((12, 12))
    mixed[:3, 3:6] = mixed[3:6, :3] = -0.8 * np.eye(3)
    mixed[6:, 6:] = np.diag([1.0, 0.5, 0.25, 0.0, 0.0, 0.0])
    mixed[2, 9] = mixed[9, 2] = 0.5
    whole = co.algebras.direct_sum(SO3, SO3, co.algebras.e(3))
    yield co.LiePoissonSystem(whole, co.Quadratic(mixed, linear=0.1 * rng.standard_normal(12)), sign=-1)


SYSTEMS = list(systems())
COUNTS = [None, None, 1, 1, 3, 1]


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("system", "count"), list(zip(SYSTEMS, COUNTS, strict=True)))
def test_the_parts_add_up_to_the_energy_and_converge_to_its_motion(system, count):
    rng = np.random.default_rng(4)
    parts, shift = bonds(system)
    assert count is None or len(parts.bodies) == count
    ring = ExactPolynomials(system.algebra)
    total = sum((ring.polynomial(piece) for piece in part_polynomials(ring, parts)), co.Polynomial({}, dim=system.dim))
    for x in rng.standard_normal((8, system.dim)):
        taken = sum(factor * casimir(x) for casimir, factor in shift)
        expected = system.energy(x) - system.energy(np.zeros(system.dim))
        assert abs(total(x) + taken - expected) <= 2.0**6 * U * (x @ x) * 10.0
    x0 = 0.7 * rng.standard_normal(system.dim)
    fine = co.integrate(system, x0, (0.0, 1.0), 2.0**-7, co.Splitting(order=8), attitude="coadjoint")
    for order, least in ((1, 1.6), (2, 3.3), (4, 11.0)):
        errors = np.array(
            [
                (np.abs(run.x[-1] - fine.x[-1]).max(), np.abs(run.attitude[-1] - fine.attitude[-1]).max())
                for h in (2.0**-4, 2.0**-5)
                for run in [co.integrate(system, x0, (0.0, 1.0), h, by_bonds(order=order), attitude="coadjoint")]
            ]
        )
        # A single bond has no error.
        assert np.all((errors[0] / errors[1] > least) | (errors[0] < 2.0**9 * U)), (order, errors)
        assert order < 4 or np.all(errors[1] < 1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_bonds_of_one_colour_share_no_spin_and_are_few(seed):
    rng = np.random.default_rng(seed)
    edges = [(i, j) for i in range(12) for j in range(i + 1, 12) if rng.random() < 0.5]
    found = colours(edges, 12)
    for colour in range(max(found) + 1):
        ends = [i for edge, own in zip(edges, found, strict=True) if own == colour for i in edge]
        assert ends and len(set(ends)) == len(ends)
    assert max(found) + 1 < 2 * np.bincount(np.ravel(edges)).max()


def test_a_ring_has_two_parts_and_a_description():
    ring = co.systems.spin_lattice("ring", 4)
    said = str(by_bonds().describe(ring))
    assert "2 parts" in said and "bond of S1[1], S2[1], S3[1] and S1[2], S2[2], S3[2]" in said


ANISOTROPIC = co.systems.spin_lattice("chain", 3, tensor=(1.0, 1.0, 0.9))
ON_E3 = co.LiePoissonSystem(
    co.algebras.copies(co.algebras.e(3), 2), co.Quadratic(np.kron([[0, 1], [1, 0]], np.diag([1.0, 1, 1, 0, 0, 0])))
)
ON_SO4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.eye(6) + 0.5 * np.eye(6)[::-1]))


@pytest.mark.parametrize("system", [ANISOTROPIC, ON_E3, ON_SO4, co.systems.rigid_body((1, 2, 3))])
def test_what_has_no_bond_is_refused_by_name(system):
    for refused in (
        lambda: by_bonds().properties(system),
        lambda: co.integrate(system, np.ones(system.dim), (0, 1), 0.5, by_bonds()),
    ):
        with pytest.raises(ValueError, match="no isotropic coupling"):
            refused()


def signed_permutations():
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            yield np.diag(signs)[list(order)]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.0, 2.0), (2.0, 2.0), (-1.0, 1.0), (-0.5, -0.5)])
def test_a_bond_is_a_multiple_of_the_identity_between_momenta_of_one_scale(factors):
    """Of all couplings by signed permutations of the axes, in bases e -> f e of the factors f of the two spins."""
    spins = [co.algebras.change_of_basis(SO3, f * np.eye(3)) for f in factors]
    whole, found = co.algebras.direct_sum(*spins), 0
    for coupling in signed_permutations():
        M = np.kron([[0.0, 1.0], [0.0, 0.0]], 0.75 * coupling)
        system = co.LiePoissonSystem(whole, co.Quadratic(M + M.T))
        isotropic = factors[0] == factors[1] and np.array_equal(coupling, coupling[0, 0] * np.eye(3))
        if not isotropic:
            with pytest.raises(NotSplittable, match="no isotropic coupling"):
                bonds(system)
            continue
        found += 1
        parts, shift = bonds(system)
        ((_, body),) = parts.bodies.items()
        assert (body.coordinates, body.other) == ((0, 1, 2), (3, 4, 5))
        # c z.w = c |z + w|^2/2 - c (|z|^2 + |w|^2)/2; the Casimirs taken off are those of both spins.
        x = np.array([0.5, -0.25, 1.0, 0.75, 0.5, -1.0])
        total = np.array(body.matrix) @ (x[:3] + x[3:]) @ (x[:3] + x[3:]) / 2
        taken = sum(factor * C(x) for C, factor in shift)
        assert abs(system.energy(x) - total - taken) <= 16 * U * np.abs(x).sum() ** 2
    assert found == 2 * (factors[0] == factors[1])


def test_other_refusals(monkeypatch):
    with pytest.raises(ValueError, match='"bonds" has no rational rotations'):
        by_bonds(rotation="rational")
    bound = graph(1)
    for spin in range(bound.dim // 3):
        # Each of them is the first or the second one of some bond.
        with pytest.raises(ValueError, match=rf'parts="bonds" takes no inputs for S1\[{spin + 1}\]'):
            co.prepare(bound, by_bonds(), 0.1, inputs={"here": (3 * spin, 3 * spin + 1, 3 * spin + 2)})
    monkeypatch.setattr("coadjoint.program.parts.bonds.MAX_BONDS", 4)
    with pytest.raises(ValueError, match=r"it has 5 bonds; .* at most 4"):
        by_bonds().properties(co.systems.spin_lattice("chain", 6))


def test_a_large_lattice_goes_without_its_attitude():
    chain = co.systems.spin_lattice("chain", 700)
    x0 = np.random.default_rng(1).standard_normal(2100)
    run = co.integrate(chain, x0, (0.0, 0.2), 0.1, by_bonds(), watch=False)
    total = np.abs(run.x.reshape(3, 700, 3).sum(axis=1) - x0.reshape(700, 3).sum(axis=0)).max()
    assert total <= 2.0**6 * U * np.sqrt(700)
    with pytest.raises(ValueError, match="too many terms for the attitude"):
        by_bonds().program(chain, group=np.zeros((2100, 2, 2)))


@pytest.mark.long
def test_a_flow_in_thirty_digits_is_the_closed_form():
    pair = co.systems.spin_lattice("chain", 2, exchange=0.75)
    with mpmath.workdps(40):
        x0 = np.array([mpmath.mpf(v) for v in (2, 1, 0.5, -0.25, 1, 3)], dtype=object)
        x = by_bonds().step(pair, x0, mpmath.mpf(0), mpmath.mpf(3))
        K = x0[:3] + x0[3:]
        k = mpmath.sqrt(K @ K)
        phi = -mpmath.mpf(0.75) * k * 3
        S = x0[:3]
        turned = S * mpmath.cos(phi) + np.cross(K / k, S) * mpmath.sin(phi) + K * (K @ S) / k**2 * (1 - mpmath.cos(phi))
        assert max(abs(x[:3] - turned)) < mpmath.mpf(10) ** -36
        assert max(abs(x[:3] + x[3:] - K)) < mpmath.mpf(10) ** -36


def test_the_modified_hamiltonian_is_the_bracket_of_two_bonds():
    """24 H2 = -{A, {A, D}} + 2 {D, {D, A}}, A outside and D inside, with rational coefficients."""
    chain = co.systems.spin_lattice("chain", 3, exchange=(1.0, 0.5))
    ring = ExactPolynomials(chain.algebra)
    A, D = part_polynomials(ring, bonds(chain).parts)
    expected = (ring.bracket(D, ring.bracket(D, A)) * 2 - ring.bracket(A, ring.bracket(A, D))) / 24
    found = co.modified_hamiltonian(chain, by_bonds(), order=4)
    x = np.array([Fraction(k % 5 - 2, 4) for k in range(9)], dtype=object)
    h = 2.0**-6
    value = (found(x.astype(float), h) - chain.energy(x.astype(float))) / h**2
    assert abs(value - float(ring.polynomial(expected)(x.astype(float)))) <= 2.0**13 * U * 2.0**4
    assert expected != 0


def test_it_is_certified_and_written_and_read_again():
    system = graph(3, 3, field=(0.1, 0.2, 0.3))
    x0 = np.random.default_rng(7).standard_normal(9)
    certificate = co.certify(system, by_bonds(), x0, 0.05, steps=20)
    assert certificate.passed, str(certificate)
    table = by_bonds(order=4).program(system).to_mapping()
    assert table["bodies"] and json.dumps([int(k) for k in table["bodies"]])
    assert from_description(description_of(by_bonds(order=4))) == by_bonds(order=4)


def test_a_field_is_one_rotation_about_its_axis():
    pair = co.systems.spin_lattice("chain", 2, field=(0.1, 0.2, 0.3))
    parts, _ = bonds(pair)
    assert len(parts) == 2 and [len(form[0]) for form in parts[1].forms] == [3, 3]
    along = co.systems.spin_lattice("chain", 2, field=(0.0, 0.2, 0.0))
    assert [form[0] for form in bonds(along).parts[1].forms] == [(1,), (4,)]
