"""Free bodies as parts: where they are found, what is left, what is refused, and their flow in other number types."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.program.parts.free_bodies import free_bodies, triples_of
from coadjoint.program.parts.part_polynomials import part_polynomials

U = 2.0**-53


def free_body(**options):
    return co.Splitting(parts="free_body", **options)


def scaled(p, q, r):
    """so(3), or sl(2), with [e1, e2] = p e3, [e2, e3] = q e1, [e3, e1] = r e2."""
    return co.LieAlgebra.from_brackets(3, {(0, 1): {2: p}, (1, 2): {0: q}, (0, 2): {1: -r}})


def test_triples_that_span_so3():
    assert [t.coordinates for t in triples_of(co.algebras.so(4))] == [(0, 1, 3), (0, 2, 4), (1, 2, 5), (3, 4, 5)]
    assert triples_of(co.algebras.sl(2)) == [] and triples_of(co.algebras.get("A3,7", a=2.0)) == []
    assert [t.coordinates for t in triples_of(co.algebras.copies(co.algebras.so(3), 2))] == [(0, 1, 2), (3, 4, 5)]
    for constants in ((1.0, 1.0, 1.0), (2.0, 3.0, 0.5), (-1.0, -2.0, -0.25)):
        ((_, scale),) = triples_of(scaled(*constants))
        for k, c in enumerate(constants):
            # [s_i e_i, s_j e_j] = s_k e_k
            i, j, own = scale[k], scale[(k + 1) % 3], scale[(k + 2) % 3]
            assert abs(i * j * c - own) <= 4 * U * abs(own)
    for constants in ((1.0, 1.0, -1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, -1.0)):
        assert triples_of(scaled(*constants)) == []


def systems():
    rng = np.random.default_rng(2)
    B = rng.standard_normal((6, 6))
    yield co.LiePoissonSystem(scaled(2.0, 3.0, 0.5), co.Quadratic(B[:3, :3] + B[:3, :3].T), sign=1)
    yield co.LiePoissonSystem(
        scaled(-1.0, -2.0, -0.25), co.Quadratic([1.0, 0.5, 0.25], linear=[0.1, 0.2, -0.3]), sign=-1
    )
    permuted = co.algebras.change_of_basis(co.algebras.e(3), np.eye(6)[[4, 0, 3, 2, 5, 1]])
    yield co.LiePoissonSystem(permuted, co.Quadratic(np.diag(np.arange(1.0, 7.0)), linear=B[0]), sign=-1)
    yield co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(0.3 * (B + B.T)), sign=-1)
    yield co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(np.linspace(0.5, 1.5, 8)), sign=1)
    yield co.systems.kirchhoff_body()
    yield co.systems.clebsch_body()
    yield co.systems.gyrostat((1.0, 2.0, 3.0), (0.25, 0.5, -0.75))
    potential = {(0, 0, 0, 1, 0, 0): 0.5, (0, 0, 0, 0, 3, 0): 0.25, (2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.75}
    yield co.LiePoissonSystem(co.algebras.e(3), co.Polynomial(potential | {(0, 0, 2, 0, 0, 0): 1.0}), sign=-1)
    yield co.LiePoissonSystem(
        co.algebras.copies(co.algebras.so(3), 3), co.Quadratic(np.diag(np.arange(1.0, 10.0)) + 0.1)
    )


SYSTEMS = list(systems())


@pytest.mark.thinned(4)
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_the_parts_add_up_to_the_energy_and_converge_to_its_motion(system):
    rng = np.random.default_rng(4)
    parts = free_bodies(system)
    ring = ExactPolynomials(system.algebra)
    total = sum((ring.polynomial(piece) for piece in part_polynomials(ring, parts)), co.Polynomial({}, dim=system.dim))
    for x in rng.standard_normal((8, system.dim)):
        constant = system.energy(np.zeros(system.dim))
        assert abs(total(x) + constant - system.energy(x)) <= 2.0**6 * U * (x @ x) * 10.0
    x0 = 0.5 * rng.standard_normal(system.dim)
    reference = co.integrate(system, x0, (0.0, 1.0), 2.0**-7, co.Splitting(order=8)).x[-1]
    errors = [
        np.abs(co.integrate(system, x0, (0.0, 1.0), h, free_body(order=4)).x[-1] - reference).max()
        for h in (2.0**-4, 2.0**-5)
    ]
    assert errors[1] < 1e-4
    # Alone, a body has no error.
    assert errors[0] / errors[1] > 10.0 or errors[0] < 2.0**8 * U


def test_bodies_of_a_sum_that_do_not_touch_are_one_part():
    found = free_bodies(SYSTEMS[-1])
    first = [s for s in found.bodies if s < found.share[1]]
    assert [found.bodies[s].coordinates for s in first] == [(0, 1, 2), (3, 4, 5), (6, 7, 8)]
    said = str(free_body().describe(SYSTEMS[-1]))
    assert all(f"free body of x1[{k}], x2[{k}], x3[{k}]" in said.split("\n")[1] for k in (1, 2, 3))


@pytest.mark.parametrize(
    ("system", "said"),
    [
        (co.systems.paper_a37(2.0, (1.0, 1.5, 0.3)), "no three coordinates that span so\\(3\\)"),
        (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 1.0])), "quadratic in at least two of them"),
        (co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(4, 0, 0): 1.0})), "no three coordinates"),
    ],
)
def test_what_has_no_free_body_is_refused_by_name(system, said):
    for refused in (
        lambda: free_body().properties(system),
        lambda: co.integrate(system, np.ones(3), (0, 1), 0.5, free_body()),
    ):
        with pytest.raises(ValueError, match=said):
            refused()
    with pytest.raises(ValueError, match="no rational rotations"):
        free_body(rotation="rational")


def test_gravity_may_be_an_input_and_rotors_may_not():
    def top(linear):
        return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1, 0.5, 0.25, 0, 0, 0], linear=linear), sign=-1)

    x0 = (0.5, 1.0, -0.3, 0.0, 0.6, 0.8)
    prepared = co.prepare(top([0, 0, 0, 0.1, 0.2, 0.3]), free_body(order=4), 0.125, inputs={"gravity": (3, 4, 5)})
    for gravity in ((0.4, -0.1, 0.2), (0.0, 0.0, 0.0), (0.0, 2.0, 0.0)):
        found = prepared.run(x0, (0.0, 2.0), gravity=gravity).x[-1]
        expected = co.integrate(top([0, 0, 0, *gravity]), x0, (0.0, 2.0), 0.125, free_body(order=4)).x[-1]
        np.testing.assert_allclose(found, expected, rtol=0, atol=2.0**8 * U)
    with pytest.raises(ValueError, match=r"no inputs for x2 \(coordinate 1\)"):
        co.prepare(top([0, 0, 0, 0.1, 0.2, 0.3]), free_body(), 0.125, inputs={"rotors": (1,)})


@pytest.mark.long
def test_a_flow_in_thirty_digits_is_that_of_elliptic_functions():
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1)
    with mpmath.workdps(40):
        x0 = np.array([mpmath.mpf(v) for v in (2, 1, 0.5)], dtype=object)
        x = free_body().step(body, x0, mpmath.mpf(0), mpmath.mpf(3))
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


def test_the_modified_hamiltonian_is_the_bracket_of_body_and_gravity():
    """24 H2 = -{A, {A, D}} + 2 {D, {D, A}}, A outside and D inside, with rational coefficients."""
    top = co.systems.heavy_top((1.0, 2.0, 2.5), (0.0, 0.0, 1.0))
    found = co.modified_hamiltonian(top, free_body(), order=4)
    pieces = [
        co.Polynomial({(0, 0, 0, 0, 0, 1): 1}),
        co.Polynomial(
            {(2, 0, 0, 0, 0, 0): Fraction(1, 2), (0, 2, 0, 0, 0, 0): Fraction(1, 4), (0, 0, 2, 0, 0, 0): Fraction(1, 5)}
        ),
    ]
    inner, outer = pieces

    def bracket(F, G, x):
        return F.gradient(x) @ top.algebra.structure_matrix(x) @ G.gradient(x)

    def nested(F, G, x):
        """{F, {F, G}} by an exact directional derivative."""
        step, direction = 2.0**-10, top.algebra.structure_matrix(x).T @ F.gradient(x)
        ahead, back = (bracket(F, G, x + s * step * direction) for s in (1, -1))
        return (ahead - back) / (2 * step)

    x = np.array([0.5, 0.25, -0.75, 0.5, -0.25, 0.75])
    expected = -nested(outer, inner, x) / 24 + nested(inner, outer, x) / 12
    h = 2.0**-3
    # The difference quotient has an error of step^2 times third derivatives of size one.
    assert abs((found(x, h) - top.energy(x)) / h**2 - expected) <= 2.0**-16
    x0 = np.array([0.5, 0.3, -0.2, 0.6, 0.0, 0.8])
    run = co.integrate(top, x0, (0.0, 20.0), 0.0625, free_body())
    better = co.modified_hamiltonian(top, free_body(), order=6)
    drifts = [
        np.ptp(values) for values in (run.energy, [found(x, 0.0625) for x in run.x], [better(x, 0.0625) for x in run.x])
    ]
    assert drifts[1] < drifts[0] / 100 and drifts[2] < drifts[1] / 30


def described():
    e3, so3 = co.algebras.e(3), co.algebras.so(3)
    full = co.Quadratic([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 0.5]])
    top = co.Quadratic([1.0, 2.0, 3.0, 0, 0, 0], linear=[0, 0, 0, 0.5, 0, 0.25])
    bond = co.Quadratic(np.kron([[0, 0.75], [0.75, 0]], np.eye(3)))
    spiral, third = co.algebras.get("A3,7", a=0.5), {(2, 0, 0): 0.5, (0, 3, 0): 0.25, (1, 2, 0): 0.5, (0, 0, 2): 1.0}
    return {
        "free body": (so3, full, "free_body"),
        "free body and gravity": (e3, top, "free_body"),
        "bond": (co.algebras.copies(so3, 2), bond, "bonds"),
        "coordinates": (so3, co.Quadratic([1.0, 2.0, 2.75]), "auto"),
        "polynomial": (spiral, co.Polynomial(third), [[0, 1], [2]]),
    }


@pytest.mark.parametrize("name", described())
def test_two_copies_of_a_system_have_twice_the_operations_in_as_many_flows(name):
    algebra, H, parts = described()[name]
    n, doubled = algebra.dim, parts
    if isinstance(H, co.Quadratic):
        M, linear = np.kron(np.eye(2), matrix_of(H, n)), np.tile(H.gradient(np.zeros(n)), 2)
        twice = co.Quadratic(M, linear=linear)
    else:
        none = (0,) * n
        twice = co.Polynomial({whole: c for e, c in H.monomials.items() for whole in ((*e, *none), (*none, *e))})
        doubled = [[*some, *(i + n for i in some)] for some in parts]
    one = co.Splitting(order=4, parts=parts).describe(co.LiePoissonSystem(algebra, H))
    two = co.Splitting(order=4, parts=doubled).describe(co.LiePoissonSystem(co.algebras.copies(algebra, 2), twice))
    assert (two.flows, two.multiplications) == (one.flows, 2 * one.multiplications)
    assert one.multiplications > 0 and one.functions > 0
    for single, both in zip(one.parts, two.parts, strict=True):
        assert both.multiplications == 2 * single.multiplications
        # Rotations about one angle are one sine; shears have none.
        assert both.functions == 2 * single.functions
        assert both.blocks == {kind: 2 * count for kind, count in single.blocks.items()}
        assert len(both.generators) == 2 * len(single.generators)
    for said in (one, two):
        assert f"{said.multiplications} multiplications" in str(said) and f"{said.functions} sines" in str(said)


def matrix_of(H, n):
    return np.array([H.gradient(e) - H.gradient(np.zeros(n)) for e in np.eye(n)])
