"""Blocks: their closed forms are exp(theta D) to round-off for any angle, alone and beside each other."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.program.actions import generator_entries
from coadjoint.program.block_table import block_table
from coadjoint.program.blocks import RULES, Block, BlockKind
from coadjoint.program.generators import Generators
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.table import build_flow_table
from commuting_actions import acting
from cubic_blocks import cubic_bound
from drawn_matrices import constants_of, whole_matrix

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53
ANGLES = (0.0, 1e-12, -1e-12, 0.37, -0.37, 3.1, -7.7, 50.0, -50.0)


def turning(algebra, coordinates):
    """The Hamiltonian with the angles x_i, i in the coordinates, at step 1."""
    M = np.zeros(algebra.dim)
    M[list(coordinates)] = 1.0
    return co.LiePoissonSystem(algebra, co.Quadratic(M))


def reading_of(algebra, *coordinates):
    read = Interpreter(build_flow_table(turning(algebra, coordinates), co.Splitting(order=1)))
    assert len(read.flow_table.parts) == 1
    return read


def kinds_of(read):
    return {BlockKind(k) for k in read.flow_table.state.kind}


def entries(matrix):
    return {(i, j): float(matrix[i, j]) for i, j in np.argwhere(np.asarray(matrix) != 0)}


def blocks_of(entries, u):
    """Decompose one sparse matrix D, (row, column) -> nonzero value, into blocks sorted by first coordinate."""
    keys = sorted(entries)
    value_list = [entries[key] for key in keys]
    values = np.array(value_list, dtype=np.float64 if all(isinstance(value, float) for value in value_list) else object)
    row, column = np.array(keys, dtype=np.int64).reshape(-1, 2).T
    table = block_table(Generators(np.zeros(len(keys), dtype=np.int64), row, column, values), u)
    return [block_of(table, b) for b in range(len(table.angle))]


def block_of(table, b):
    kind, width, count = BlockKind(int(table.kind[b])), int(table.width[b]), int(table.entries[b])
    index = table.indices[table.begin[b] : table.begin[b + 1]].tolist()
    constants = table.constants[table.constant_begin[b] : table.constant_begin[b + 1]].tolist()
    if not count:
        return Block(kind, tuple(index), tuple(constants))
    rows = np.repeat(np.arange(width), np.diff(index[width : 2 * width + 1])).tolist()
    header = RULES[kind].header
    values = [constants[first : first + count] for first in range(header, len(constants), count)]
    entries = tuple(zip(rows, index[2 * width + 1 :], *values, strict=True))
    return Block(kind, tuple(index[:width]), tuple(constants[:header]), entries, int(table.degree[b]))


PLANES = {
    "rotation with damping": [[-0.5, 2.0], [-1.5, -0.5]],
    "rotation damped along one axis": [[0.0, 2.0], [-2.0, -0.5]],
    "rotation damped along the other": [[-0.5, 1.0], [-1.0, 0.0]],
    "saddle": [[0.0, 2.0], [0.5, 0.0]],
    "decay at two rates": [[0.0, 1.0], [1e-3, -2.0]],
    "growth at two rates": [[1.5, 0.25], [0.5, 0.5]],
    "uneven rotation": [[0.0, -0.25], [4.0, 0.0]],
    "Jordan": [[1.0, 1.0], [0.0, 1.0]],
    "Jordan turned": [[1.5, 0.5], [-0.5, 0.5]],
    "nearly Jordan, real": [[1.5, 0.5], [-0.5 + 1e-14, 0.5]],
    "nearly Jordan, complex": [[1.5, 0.5], [-0.5 - 1e-14, 0.5]],
    "nilpotent turned": [[1.0, 1.0], [-1.0, -1.0]],
    "triangular": [[2.0, 1.0], [0.0, -1.0]],
}
CHAIN = np.diag([1.0, 2.0, 3.0], 1)
GENERAL = np.array([[0.0, 1.0, 0.0, 0.5], [-1.0, 0.2, 0.0, 0.0], [0.3, 0.0, -0.1, 2.0], [0.0, 0.4, -2.0, 0.0]])
CANCELLING = np.array([[-2.0, 1.0, 0.5], [1.0, -2.0, 0.5], [1.0, 1.0, -1.0]])  # the sum of every column is zero
SHEARED = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [0.0, 0.0, 0.0]])
MATRICES = {
    "scale": (np.diag([1.0, -0.5, 1.0]), {BlockKind.SCALE}),
    "rotation": (np.array([[0.0, -1.5], [1.5, 0.0]]), {BlockKind.ROTATE}),
    "two rotations": (np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]]), {BlockKind.ROTATE}),
    "shear": (SHEARED, {BlockKind.SHEAR}),
    "chain": (CHAIN, {BlockKind.SERIES}),
    "Jordan 3": (np.eye(3) + np.diag([1.0, 1.0], 1), {BlockKind.SERIES}),
    "general": (GENERAL, {BlockKind.SERIES}),
    "cancelling columns": (CANCELLING, {BlockKind.SERIES}),
    "mixed": (np.diag([1.0, 0, 0, 0, 0, 0]) + np.diag([0.0, 0, 1.0, 0, 0], 1), {BlockKind.SCALE, BlockKind.SHEAR}),
    **{name: (np.array(D), {BlockKind.PLANE}) for name, D in PLANES.items()},
}
ALGEBRAS = {
    "so(3)": (co.algebras.so(3), {BlockKind.ROTATE}),
    "so(4)": (co.algebras.so(4), {BlockKind.ROTATE}),
    "so(5)": (co.algebras.so(5), {BlockKind.ROTATE}),
    "Heisenberg": (co.algebras.heisenberg(2), {BlockKind.SHEAR}),
    "A3,7": (co.algebras.get("A3,7", a=1.75), {BlockKind.PLANE, BlockKind.SHEAR}),
    "e(3)": (co.algebras.e(3), {BlockKind.ROTATE, BlockKind.SHEAR}),
    "sl(2)": (co.algebras.sl(2), {BlockKind.SCALE, BlockKind.SERIES}),
    "so(3) other basis": (co.algebras.change_of_basis(co.algebras.so(3), whole_matrix(3, 7)), {BlockKind.CUBIC}),
    "sl(2) other basis": (co.algebras.change_of_basis(co.algebras.sl(2), whole_matrix(3, 2)), None),
    "e(3) other basis": (co.algebras.change_of_basis(co.algebras.e(3), whole_matrix(6, 8)), None),
}


def exact_exponential(D, theta):
    with mpmath.workdps(60):
        D = mpmath.matrix(D.tolist())
        return mpmath.expm(D * mpmath.mpf(theta), method="taylor")


def exponential_bound(D, theta):
    """Return the first-order effect on exp(theta D) of relative changes by u of theta and of every entry of D.

    |int exp((1 - s) A) E exp(s A) ds| <= |E| max_s |exp((1 - s) A)| |exp(s A)| with |E| <= u |A|, A = theta D: no
    method that rounds its input can do better; sampled at 9 values of s.
    """
    norm = np.linalg.norm
    ends = [norm(expm(s * theta / 8 * D)) for s in range(9)]
    spread = max(a * b for a, b in zip(ends, ends[::-1], strict=True))
    return U * (1.0 + abs(theta) * norm(D)) * max(spread, ends[-1], 1.0)


def error_of(read, D, x, theta):
    n = len(D)
    y = np.concatenate([x, np.zeros(read.flow_table.state.size - n)])
    read.act(read.flow_table.state, 0, [theta], y)
    with mpmath.workdps(60):
        exact = exact_exponential(D, theta) * mpmath.matrix(x.tolist())
        return float(max(abs(mpmath.mpf(float(a)) - b) for a, b in zip(y[:n], exact, strict=True)))


@pytest.mark.thinned(9)
@pytest.mark.parametrize("theta", ANGLES)
@pytest.mark.parametrize("name", MATRICES)
def test_exponential_of_a_matrix(name, theta):
    """16 roundings in a closed form; 4 (n + 2) in each of at most 1 + |theta| |D| substeps of a series."""
    D, _ = MATRICES[name]
    x = np.random.default_rng(1).uniform(-1, 1, len(D))
    read = reading_of(acting(D), len(D))
    assert error_of(read, D, x, theta) <= 4 * (len(D) + 2) * exponential_bound(D, theta) * np.linalg.norm(x)


def plane(mean, half, upper, lower):
    return np.array([[mean + half, upper], [lower, mean - half]])


NEARLY_ALIKE = {
    BlockKind.PLANE: [plane(*constants) for constants in np.array([0.5, 0.25, 1.0, -2.0]) + 0.125 * np.eye(5, 4, -1)],
    BlockKind.ROTATE: [plane(0.0, 0.0, -w, w) for w in (1.0, 1.0 + 2.0**-52, -1.0, 2.0, 1.0)],
    BlockKind.SCALE: [np.diag([a, b]) for a, b in ((1.0, 2.0), (1.0 + 2.0**-52, -1.0), (2.0, -2.0), (1.0, 1.0))],
    BlockKind.SHEAR: [plane(0.0, 0.0, value, 0.0) for value in (1.0, -1.0, 2.0, 1.0)],
}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("kind", NEARLY_ALIKE, ids=lambda kind: kind.name)
def test_blocks_that_differ_in_one_constant_have_their_own(kind):
    """In one generator, in any order: blocks of a run share their constants only if all of these are equal."""
    rng = np.random.default_rng(int(kind))
    blocks = [*NEARLY_ALIKE[kind], NEARLY_ALIKE[kind][1]]
    for _ in range(2):
        D = np.zeros((2 * len(blocks),) * 2)
        places = rng.permutation(len(D)).reshape(-1, 2)
        for block, place in zip(blocks, places, strict=True):
            D[np.ix_(place, place)] = block
        system, method = turning(acting(D), [len(D)]), co.Splitting(order=1, parts="coordinates")
        read = Interpreter(build_flow_table(system, method))
        assert kinds_of(read) == {kind}
        row, column, value = (each.tolist() for each in generator_entries(read.flow_table.state, 0, 0))
        assert dict(zip(zip(row, column, strict=True), value, strict=True)) == entries(D)
        x = rng.uniform(-1, 1, len(D) + 1)
        x[-1] = 1.0
        # The angle is the last coordinate, and the closed forms have some 16 roundings.
        expected = expm(0.7 * D) @ x[:-1]
        found = co.stepper(system, method, 0.7)(x)[:-1]
        assert np.abs(found - expected).max() <= 64 * U * np.exp(0.7 * 4.0) * 2  # no block has a norm above 4


@pytest.mark.thinned(9)
@pytest.mark.parametrize("theta", ANGLES)
@pytest.mark.parametrize("base", ["so(3)", "sl(2)"])
def test_exponential_of_cubic_blocks_in_random_bases(base, theta):
    rng = np.random.default_rng(5)
    for seed in range(6):
        algebra = co.algebras.change_of_basis(ALGEBRAS[base][0], whole_matrix(3, 20 + seed))
        form = rng.standard_normal(3)
        D = algebra.coadjoint(form)
        (block,) = blocks_of(entries(D), U)
        assert block.kind == BlockKind.CUBIC
        x = rng.uniform(-1, 1, 3)
        assert error_of(reading_of(acting(D), 3), D, x, theta) <= cubic_bound(D, theta) * np.linalg.norm(x)


COMMUTING = {
    # A single block of one generator that does not commute with a single block of the other: they overlap.
    "shears across a scale and a Jordan block": (
        np.block([[np.eye(1), np.zeros((1, 3))], [np.zeros((3, 1)), np.eye(3) + np.diag([1.0, 1.0], 1)]]),
        np.array([[0, 0, 0, 0], [1.0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]),
    ),
    "chains of two lengths": (
        np.diag([1.0, 0.0, 1.0, 1.0], 1),
        np.array([[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0], [0, 0, 0, 0, 0]]),
    ),
    "planes that are alike but not equal": (
        np.array([[1.0, 2.0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 3.0], [0, 0, 0, 1.0]]),
        np.array([[0, 0, 1.5, 0], [0, 0, 0, 2.25], [1.0, 0, 0, 0], [0, 2 / 3, 0, 0]]),
    ),
    "rotation of a double scale": (np.diag([0.5, 0.5, -1.0]), np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, 0]])),
}


def abelian_pairs():
    """Pairs of basis elements, also where a diagonal change of basis makes equal rotations uneven and different."""
    for base in ("so(3)", "e(3)", "so(4)"):
        plain = ALGEBRAS[base][0]
        scale = 2.0 ** np.random.default_rng(8).integers(-2, 3, plain.dim)
        scaled = co.LieAlgebra(np.einsum("i,j,ijk,k->ijk", scale, scale, constants_of(plain), 1 / scale))
        for algebra in (plain, scaled):
            yield from ((algebra, j, i) for i in range(algebra.dim) for j in range(i) if algebra.commuting(i, j))


def test_generators_of_one_part_act_as_their_sum():
    drawn = [(acting(*pair), len(A), len(A) + 1) for A, B in COMMUTING.values() for pair in ((A, B), (B, A))]
    for algebra, *pair in [*drawn, *abelian_pairs()]:
        assert algebra.commuting(*pair)
        read, theta, u = reading_of(algebra, *pair), [0.7, -1.1], np.zeros(algebra.dim)
        # The angles are those of the state: products that cancel for these are left out.
        x = np.random.default_rng(9).uniform(-1, 1, algebra.dim)
        x[pair] = u[pair] = theta
        y = x.copy()
        read.act(read.flow_table.state, 0, theta, y)
        exact = np.array(exact_exponential(algebra.coadjoint(u), 1.0).tolist(), dtype=float)
        assert np.abs(y - exact @ x).max() <= 256 * U * max(1.0, np.linalg.norm(exact)), (algebra, pair)
