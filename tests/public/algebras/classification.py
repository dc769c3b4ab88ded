"""The 62 real Lie algebras once more, in another form: ideals with matrices that act on them, and sets of matrices.

Each is an ideal (abelian, Heisenberg or filiform) with matrices that act on it, in blocks of Jordan's form, or a set of
matrices. On an ideal that is not abelian only what the action does to generators is said: the rest follows by Leibniz'
rule. So built by G. M. Mubarakzyanov, Izv. Vyssh. Uchebn. Zaved. Mat. 1 (32) 114 and 3 (34) 99 (1963). Dimensions up to
4 were compared with the English list of R. O. Popovych, V. M. Boyko, M. O. Nesterenko, M. W. Lutfullin, J. Phys. A 36
(2003) 7337. In dimension 5 the form of each class is what its nilradical leaves: the matrices of R^4 up to conjugation
and scaling, the derivations of Heisenberg's algebra beside a line and of the filiform one up to inner ones.

`STRUCTURE` has dimensions that no change of basis alters, counted on these forms by hand: for an abelian ideal of
dimension m under one D (not nilpotent, or of rank 2 and more) there are m + sum (2 i - 1) l_i derivations, l_1 >= l_2
... the sizes of the Jordan blocks of each eigenvalue (Frobenius), and one more where D is nilpotent; else the inner
ones, scalings of the generators, and what maps a weight to an equal one. `ROOTS` has the eigenvalues of N(x),
N e_i = [e_i, x], as functions of x.
"""

from collections.abc import Callable
from fractions import Fraction
from itertools import combinations
from typing import NamedTuple

import numpy as np
from lie_invariants import Invariants

Constants = np.ndarray  # (n, n, n), of Fractions: [e_i, e_j] = sum_k c[i, j, k] e_k
Matrix = list[list[Fraction | int]]


def jordan(weight, size=1):
    """A block of Jordan's form: e_j goes to e_(j - 1) + weight e_j."""
    return [[weight if i == j else int(i == j - 1) for j in range(size)] for i in range(size)]


def turning(p, s):
    """A block with the weights p +- i s: e_1 goes to p e_1 - s e_2, e_2 to s e_1 + p e_2."""
    return [[p, s], [-s, p]]


def blocks(*parts, order=None):
    """The blocks along the diagonal; `order` says on which basis elements (from 1) they stand, one after the other."""
    size = sum(len(part) for part in parts)
    places = [i - 1 for i in order] if order else list(range(size))
    matrix = [[0] * size for _ in range(size)]
    at = 0
    for part in parts:
        for i, row in enumerate(part):
            for j, value in enumerate(row):
                matrix[places[at + i]][places[at + j]] = value
        at += len(part)
    return matrix


def commutators(*matrices) -> Constants:
    """The algebra that linearly independent matrices span."""
    n = len(matrices)
    rho = [np.array([[Fraction(v) for v in row] for row in m], dtype=object) for m in matrices]
    columns = np.array([m.ravel() for m in rho], dtype=object).T
    c = np.full((n, n, n), Fraction(0), dtype=object)
    for i, j in combinations(range(n), 2):
        c[i, j] = combination(columns, (rho[i] @ rho[j] - rho[j] @ rho[i]).ravel())
        c[j, i] = -c[i, j]
    return c


def combination(columns, wanted):
    """The coefficients of a vector in the span of independent columns, by elimination in fractions."""
    rows = [[*row, value] for row, value in zip(columns.tolist(), wanted.tolist(), strict=True)]
    n = columns.shape[1]
    for k in range(n):
        pivot = next(i for i in range(k, len(rows)) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [v / rows[k][k] for v in rows[k]]
        for i in range(len(rows)):
            if i != k and rows[i][k]:
                rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k], strict=True)]
    assert not any(row[n] for row in rows[n:])
    return [row[n] for row in rows[:n]]


def semidirect(dim, ideal, outer, actions, commutator=None) -> Constants:
    """[e_i, e_j] on the ideal, [e_i, outer] = the column i of its action, and one commutator of the outer elements."""
    c = np.full((dim, dim, dim), Fraction(0), dtype=object)

    def put(i, j, values):
        for k, value in values.items():
            c[i - 1, j - 1, k - 1] += value
            c[j - 1, i - 1, k - 1] -= value

    for (i, j), values in ideal.items():
        put(i, j, values)
    for element, action in zip(outer, actions, strict=True):
        for i, image in action.items():
            put(i, element, image)
    if commutator is not None:
        put(outer[0], outer[1], {commutator: 1})
    return c


def abelian(*matrices: Matrix, commutator=None) -> Constants:
    """Commuting matrices on an abelian ideal; the commutator of the two outer elements may be an e_k of the ideal."""
    m = len(matrices[0])
    actions = [{j + 1: {i + 1: d[i][j] for i in range(m)} for j in range(m)} for d in matrices]
    return semidirect(m + len(matrices), {}, range(m + 1, m + 1 + len(matrices)), actions, commutator)


def leibniz(ideal, generators):
    """Images of all elements: of [a, b] = e it is [Da, b] + [a, Db]."""
    images = {i: dict(image) for i, image in generators.items()}

    def bracket(u, v):
        total: dict[int, Fraction | int] = {}
        for (i, j), values in ideal.items():
            size = u.get(i, 0) * v.get(j, 0) - u.get(j, 0) * v.get(i, 0)
            for k, value in values.items():
                total[k] = total.get(k, 0) + size * value
        return total

    for (i, j), values in ideal.items():
        (element,) = values
        one, two = bracket(images[i], {j: 1}), bracket({i: 1}, images[j])
        images[element] = {k: one.get(k, 0) + two.get(k, 0) for k in one.keys() | two.keys()}
    return images


HEISENBERG = {(2, 3): {1: 1}}
FILIFORM = {(3, 4): {2: 1}, (2, 4): {1: 1}}


def on_heisenberg(*generators, dim) -> Constants:
    """Derivations of <e1, e2, e3>, and of an e4 beside it in dimension 5 with one of them."""
    outer = range(dim - len(generators) + 1, dim + 1)
    return semidirect(dim, HEISENBERG, outer, [leibniz(HEISENBERG, given) for given in generators])


def on_filiform(third, fourth) -> Constants:
    """A derivation of <e1, e2, e3, e4>, [e3, e4] = e2, [e2, e4] = e1, by the images of e3 and e4."""
    return semidirect(5, FILIFORM, [5], [leibniz(FILIFORM, {3: third, 4: fourth})])


def unit(i, j, size=3):
    return [[int((row, column) == (i - 1, j - 1)) for column in range(size)] for row in range(size)]


J, C, B = jordan, turning, blocks
half = Fraction(1, 2)

FORMS: dict[str, Callable[..., Constants]] = {
    "A2_1": lambda: commutators(unit(1, 1, 2), unit(1, 2, 2)),
    "A3_1": lambda: abelian(J(0, 2)),
    "A3_2": lambda: abelian(J(1, 2)),
    "A3_3": lambda: abelian(B(J(1), J(1))),
    "A3_4": lambda: abelian(B(J(1), J(-1))),
    "A3_5": lambda a: abelian(B(J(1), J(a))),
    "A3_6": lambda: abelian(C(0, 1)),
    "A3_7": lambda a: abelian(C(a, 1)),
    "A3_8": lambda: commutators([[0, 1], [0, 0]], [[-half, 0], [0, half]], [[0, 0], [1, 0]]),
    "A3_9": lambda: commutators(
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]
    ),
    "A4_1": lambda: abelian(J(0, 3)),
    "A4_2": lambda a: abelian(B(J(a), J(1, 2))),
    "A4_3": lambda: abelian(B(J(1), J(0, 2))),
    "A4_4": lambda: abelian(J(1, 3)),
    "A4_5": lambda a, b: abelian(B(J(1), J(a), J(b))),
    "A4_6": lambda a, b: abelian(B(J(a), C(b, 1))),
    "A4_7": lambda: on_heisenberg({2: {2: 1}, 3: {2: 1, 3: 1}}, dim=4),
    "A4_8": lambda: on_heisenberg({2: {2: 1}, 3: {3: -1}}, dim=4),
    "A4_9": lambda b: on_heisenberg({2: {2: 1}, 3: {3: b}}, dim=4),
    "A4_10": lambda: on_heisenberg({2: {3: -1}, 3: {2: 1}}, dim=4),
    "A4_11": lambda a: on_heisenberg({2: {2: a, 3: -1}, 3: {2: 1, 3: a}}, dim=4),
    "A4_12": lambda: abelian(B(J(1), J(1)), C(0, 1)),
    "A5_1": lambda: abelian(B(J(0, 2), J(0, 2), order=(1, 3, 2, 4))),
    "A5_2": lambda: abelian(J(0, 4)),
    "A5_3": lambda: abelian(unit(2, 3), unit(1, 3), commutator=3),
    "A5_4": lambda: abelian(unit(1, 2), unit(1, 3)),
    "A5_5": lambda: abelian(unit(1, 3), J(0, 3)),
    "A5_6": lambda: abelian(unit(1, 3), J(0, 3), commutator=3),
    "A5_7": lambda a, b, c: abelian(B(J(1), J(a), J(b), J(c))),
    "A5_8": lambda c: abelian(B(J(0, 2), J(1), J(c))),
    "A5_9": lambda b, c: abelian(B(J(1, 2), J(b), J(c))),
    "A5_10": lambda: abelian(B(J(0, 3), J(1))),
    "A5_11": lambda c: abelian(B(J(1, 3), J(c))),
    "A5_12": lambda: abelian(J(1, 4)),
    "A5_13": lambda a, p, s: abelian(B(J(1), J(a), C(p, s))),
    "A5_14": lambda p: abelian(B(J(0, 2), C(p, 1))),
    "A5_15": lambda a: abelian(B(J(1, 2), J(a, 2))),
    "A5_16": lambda p, s: abelian(B(J(1, 2), C(p, s))),
    "A5_17": lambda p, q, s: abelian(B(C(p, 1), C(q, s))),
    # Jordan's block over the complex numbers: the one of p - i above itself, joined by the unit matrix.
    "A5_18": lambda p: abelian([[p, 1, 1, 0], [-1, p, 0, 1], [0, 0, p, 1], [0, 0, -1, p]]),
    "A5_19": lambda a, b: on_heisenberg({2: {2: 1}, 3: {3: a - 1}, 4: {4: b}}, dim=5),
    "A5_20": lambda a: on_heisenberg({2: {2: 1}, 3: {3: a - 1}, 4: {1: 1, 4: a}}, dim=5),
    "A5_21": lambda: on_heisenberg({2: {2: 1, 3: 1}, 3: {3: 1, 4: 1}, 4: {4: 1}}, dim=5),
    "A5_22": lambda: on_heisenberg({2: {3: 1}, 3: {}, 4: {4: 1}}, dim=5),
    "A5_23": lambda b: on_heisenberg({2: {2: 1, 3: 1}, 3: {3: 1}, 4: {4: b}}, dim=5),
    "A5_24": lambda eps: on_heisenberg({2: {2: 1, 3: 1}, 3: {3: 1}, 4: {1: eps, 4: 2}}, dim=5),
    "A5_25": lambda p, b: on_heisenberg({2: {2: p, 3: 1}, 3: {2: -1, 3: p}, 4: {4: b}}, dim=5),
    "A5_26": lambda p, eps: on_heisenberg({2: {2: p, 3: 1}, 3: {2: -1, 3: p}, 4: {1: eps, 4: 2 * p}}, dim=5),
    "A5_27": lambda: on_heisenberg({2: {}, 3: {3: 1, 4: 1}, 4: {1: 1, 4: 1}}, dim=5),
    "A5_28": lambda a: on_heisenberg({2: {2: a - 1}, 3: {3: 1, 4: 1}, 4: {4: 1}}, dim=5),
    "A5_29": lambda: on_heisenberg({2: {2: 1}, 3: {4: 1}, 4: {}}, dim=5),
    "A5_30": lambda a: on_filiform({3: a - 1}, {4: 1}),
    "A5_31": lambda: on_filiform({3: 1}, {3: 1, 4: 1}),
    "A5_32": lambda a: on_filiform({1: a, 3: 1}, {}),
    "A5_33": lambda a, b: abelian(B(J(1), J(0), J(b)), B(J(0), J(1), J(a))),
    "A5_34": lambda a: abelian(B(J(a), J(1), J(1)), B(J(1), J(0, 2))),
    "A5_35": lambda a, b: abelian(B(J(b), J(1), J(1)), B(J(a), C(0, 1))),
    "A5_36": lambda: on_heisenberg({2: {2: 1}, 3: {}}, {2: {2: -1}, 3: {3: 1}}, dim=5),
    "A5_37": lambda: on_heisenberg({2: {2: 1}, 3: {3: 1}}, {2: {3: -1}, 3: {2: 1}}, dim=5),
    "A5_38": lambda: abelian(B(J(1), J(0), J(0)), B(J(0), J(1), J(0)), commutator=3),
    "A5_39": lambda: abelian(B(J(1), J(1), J(0)), B(C(0, 1), J(0)), commutator=3),
    # The plane as the last column of affine matrices, under all matrices of trace zero.
    "A5_40": lambda: commutators(unit(2, 1), [[1, 0, 0], [0, -1, 0], [0, 0, 0]], unit(1, 2), unit(1, 3), unit(2, 3)),
}


# Derived series, lower central series, upper central series; derivations; nilradical.
STRUCTURE = """
A2_1                   | 2 1 0   | 2 1       | 0       |  2 | 1
A3_1                   | 3 1 0   | 3 1 0     | 1 3     |  6 | 3
A3_2                   | 3 2 0   | 3 2       | 0       |  4 | 2
A3_3                   | 3 2 0   | 3 2       | 0       |  6 | 2
A3_4                   | 3 2 0   | 3 2       | 0       |  4 | 2
A3_5 a=1/3             | 3 2 0   | 3 2       | 0       |  4 | 2
A3_5 a=-1/2            | 3 2 0   | 3 2       | 0       |  4 | 2
A3_6                   | 3 2 0   | 3 2       | 0       |  4 | 2
A3_7 a=2               | 3 2 0   | 3 2       | 0       |  4 | 2
A3_7 a=-1/3            | 3 2 0   | 3 2       | 0       |  4 | 2
A3_7 a=0               | 3 2 0   | 3 2       | 0       |  4 | 2
A3_8                   | 3       | 3         | 0       |  3 | 0
A3_9                   | 3       | 3         | 0       |  3 | 0
A4_1                   | 4 2 0   | 4 2 1 0   | 1 2 4   |  7 | 4
A4_2 a=3               | 4 3 0   | 4 3       | 0       |  6 | 3
A4_2 a=-2/5            | 4 3 0   | 4 3       | 0       |  6 | 3
A4_2 a=1               | 4 3 0   | 4 3       | 0       |  8 | 3
A4_3                   | 4 2 0   | 4 2 1     | 1 2     |  6 | 3
A4_4                   | 4 3 0   | 4 3       | 0       |  6 | 3
A4_5 a=1/2 b=-1/3      | 4 3 0   | 4 3       | 0       |  6 | 3
A4_5 a=-1 b=1          | 4 3 0   | 4 3       | 0       |  8 | 3
A4_5 a=1 b=1           | 4 3 0   | 4 3       | 0       | 12 | 3
A4_6 a=2 b=1/2         | 4 3 0   | 4 3       | 0       |  6 | 3
A4_6 a=-1/3 b=0        | 4 3 0   | 4 3       | 0       |  6 | 3
A4_7                   | 4 3 1 0 | 4 3       | 0       |  5 | 3
A4_8                   | 4 3 1 0 | 4 3       | 1       |  5 | 3
A4_9 b=1/2             | 4 3 1 0 | 4 3       | 0       |  5 | 3
A4_9 b=1               | 4 3 1 0 | 4 3       | 0       |  7 | 3
A4_9 b=0               | 4 2 0   | 4 2       | 0       |  5 | 3
A4_9 b=-2/3            | 4 3 1 0 | 4 3       | 0       |  5 | 3
A4_10                  | 4 3 1 0 | 4 3       | 1       |  5 | 3
A4_11 a=2              | 4 3 1 0 | 4 3       | 0       |  5 | 3
A4_11 a=1/7            | 4 3 1 0 | 4 3       | 0       |  5 | 3
A4_12                  | 4 2 0   | 4 2       | 0       |  4 | 2
A5_1                   | 5 2 0   | 5 2 0     | 2 5     | 13 | 5
A5_2                   | 5 3 0   | 5 3 2 1 0 | 1 2 3 5 |  9 | 5
A5_3                   | 5 3 0   | 5 3 2 0   | 2 3 5   | 10 | 5
A5_4                   | 5 1 0   | 5 1 0     | 1 5     | 15 | 5
A5_5                   | 5 2 0   | 5 2 1 0   | 1 3 5   | 10 | 5
A5_6                   | 5 3 0   | 5 3 2 1 0 | 1 2 3 5 |  8 | 5
A5_7 a=1/2 b=-1/3 c=1/5 | 5 4 0   | 5 4       | 0       |  8 | 4
A5_7 a=-1 b=1 c=-1     | 5 4 0   | 5 4       | 0       | 12 | 4
A5_8 c=1/2             | 5 3 0   | 5 3 2     | 1 2     |  8 | 4
A5_8 c=-1              | 5 3 0   | 5 3 2     | 1 2     |  8 | 4
A5_9 b=1/2 c=-2        | 5 4 0   | 5 4       | 0       |  8 | 4
A5_9 b=1 c=1           | 5 4 0   | 5 4       | 0       | 14 | 4
A5_10                  | 5 3 0   | 5 3 2 1   | 1 2 3   |  8 | 4
A5_11 c=1/2            | 5 4 0   | 5 4       | 0       |  8 | 4
A5_11 c=1              | 5 4 0   | 5 4       | 0       | 10 | 4
A5_12                  | 5 4 0   | 5 4       | 0       |  8 | 4
A5_13 a=1/2 p=1/3 s=2  | 5 4 0   | 5 4       | 0       |  8 | 4
A5_13 a=-1 p=0 s=-1/3  | 5 4 0   | 5 4       | 0       |  8 | 4
A5_14 p=1/3            | 5 3 0   | 5 3 2     | 1 2     |  8 | 4
A5_14 p=0              | 5 3 0   | 5 3 2     | 1 2     |  8 | 4
A5_15 a=1/2            | 5 4 0   | 5 4       | 0       |  8 | 4
A5_15 a=0              | 5 3 0   | 5 3 2     | 1 2     |  8 | 4
A5_15 a=1              | 5 4 0   | 5 4       | 0       | 12 | 4
A5_16 p=1/3 s=2        | 5 4 0   | 5 4       | 0       |  8 | 4
A5_16 p=0 s=-1         | 5 4 0   | 5 4       | 0       |  8 | 4
A5_17 p=1/3 q=-1/2 s=2 | 5 4 0   | 5 4       | 0       |  8 | 4
A5_17 p=1/3 q=0 s=-3/7 | 5 4 0   | 5 4       | 0       |  8 | 4
A5_17 p=0 q=1/5 s=1    | 5 4 0   | 5 4       | 0       |  8 | 4
A5_17 p=0 q=0 s=2/3    | 5 4 0   | 5 4       | 0       |  8 | 4
A5_18 p=1/3            | 5 4 0   | 5 4       | 0       |  8 | 4
A5_18 p=0              | 5 4 0   | 5 4       | 0       |  8 | 4
A5_19 a=3 b=1/2        | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_19 a=0 b=1          | 5 4 1 0 | 5 4       | 1       |  8 | 4
A5_19 a=1 b=-2         | 5 3 0   | 5 3       | 0       |  7 | 4
A5_20 a=3              | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_20 a=0              | 5 3 1 0 | 5 3       | 1 2     |  7 | 4
A5_20 a=1              | 5 3 0   | 5 3       | 0       |  8 | 4
A5_21                  | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_22                  | 5 3 0   | 5 3 2 1   | 1 2 3   |  7 | 4
A5_23 b=1/2            | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_23 b=2              | 5 4 1 0 | 5 4       | 0       |  8 | 4
A5_24 eps=1            | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_24 eps=-1           | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_25 p=1/3 b=1/2      | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_25 p=0 b=1          | 5 4 1 0 | 5 4       | 1       |  7 | 4
A5_26 p=1/3 eps=1      | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_26 p=0 eps=-1       | 5 3 1 0 | 5 3       | 1 2     |  7 | 4
A5_27                  | 5 3 0   | 5 3       | 0       |  7 | 4
A5_28 a=3              | 5 4 1 0 | 5 4       | 0       |  7 | 4
A5_28 a=0              | 5 4 1 0 | 5 4       | 1       |  7 | 4
A5_28 a=1              | 5 3 0   | 5 3       | 0       |  8 | 4
A5_29                  | 5 3 0   | 5 3 2     | 1       |  7 | 4
A5_30 a=3              | 5 4 2 0 | 5 4       | 0       |  6 | 4
A5_30 a=0              | 5 4 2 0 | 5 4       | 0       |  6 | 4
A5_30 a=-1             | 5 4 2 0 | 5 4       | 1       |  6 | 4
A5_30 a=1              | 5 3 1 0 | 5 3       | 0       |  6 | 4
A5_31                  | 5 4 2 0 | 5 4       | 0       |  6 | 4
A5_32 a=3              | 5 3 0   | 5 3       | 0       |  6 | 4
A5_32 a=0              | 5 3 0   | 5 3       | 0       |  7 | 4
A5_33 a=1/2 b=3        | 5 3 0   | 5 3       | 0       |  6 | 3
A5_33 a=0 b=-1         | 5 3 0   | 5 3       | 0       |  6 | 3
A5_33 a=1 b=0          | 5 3 0   | 5 3       | 0       |  8 | 3
A5_34 a=1/2            | 5 3 0   | 5 3       | 0       |  6 | 3
A5_34 a=0              | 5 3 0   | 5 3       | 0       |  6 | 3
A5_35 a=1/2 b=3        | 5 3 0   | 5 3       | 0       |  6 | 3
A5_35 a=0 b=-1         | 5 3 0   | 5 3       | 0       |  6 | 3
A5_35 a=1 b=0          | 5 3 0   | 5 3       | 0       |  6 | 3
A5_36                  | 5 3 1 0 | 5 3       | 0       |  5 | 3
A5_37                  | 5 3 1 0 | 5 3       | 0       |  5 | 3
A5_38                  | 5 3 0   | 5 3 2     | 1       |  6 | 3
A5_39                  | 5 3 0   | 5 3 2     | 1       |  6 | 3
A5_40                  | 5       | 5         | 0       |  6 | 2
"""


def structure() -> list[tuple[str, dict[str, Fraction], Invariants]]:
    """The rows of the table: name, parameters, dimensions."""
    found = []
    for line in STRUCTURE.strip().splitlines():
        label, *series, derivations, nilradical = line.split("|")
        name, *chosen = label.split()
        parameters = {key: Fraction(value) for key, value in (pair.split("=") for pair in chosen)}
        derived, lower, upper = (tuple(map(int, text.split())) for text in series)
        found.append((name, parameters, Invariants(derived, lower, upper, int(derivations), int(nilradical))))
    return found


class Pair(NamedTuple):
    """Two roots, those of s^2 - total s + product."""

    total: Fraction
    product: Fraction


def spiral(real, imaginary) -> Pair:
    """The roots real +- i imaginary."""
    return Pair(2 * real, real**2 + imaginary**2)


def opposite(square) -> Pair:
    """The roots +- sqrt(square)."""
    return Pair(0, -square)


# x is counted from 1; roots that vanish are left out.
ROOTS: dict[str, Callable[..., list[Fraction | Pair]]] = {
    "A2_1": lambda x: [-x[1]],
    "A3_1": lambda x: [],
    "A3_2": lambda x: [x[3]] * 2,
    "A3_3": lambda x: [x[3]] * 2,
    "A3_4": lambda x: [x[3], -x[3]],
    "A3_5": lambda x, a: [x[3], a * x[3]],
    "A3_6": lambda x: [spiral(0, x[3])],
    "A3_7": lambda x, a: [spiral(a * x[3], x[3])],
    "A3_8": lambda x: [opposite(x[2] ** 2 + 4 * x[1] * x[3])],
    "A3_9": lambda x: [opposite(-(x[1] ** 2) - x[2] ** 2 - x[3] ** 2)],
    "A4_1": lambda x: [],
    "A4_2": lambda x, a: [a * x[4], x[4], x[4]],
    "A4_3": lambda x: [x[4]],
    "A4_4": lambda x: [x[4]] * 3,
    "A4_5": lambda x, a, b: [x[4], a * x[4], b * x[4]],
    "A4_6": lambda x, a, b: [a * x[4], spiral(b * x[4], x[4])],
    "A4_7": lambda x: [2 * x[4], x[4], x[4]],
    "A4_8": lambda x: [x[4], -x[4]],
    "A4_9": lambda x, b: [(1 + b) * x[4], x[4], b * x[4]],
    "A4_10": lambda x: [spiral(0, x[4])],
    "A4_11": lambda x, a: [2 * a * x[4], spiral(a * x[4], x[4])],
    "A4_12": lambda x: [spiral(x[3], x[4])],
    **{f"A5_{k}": lambda x: [] for k in range(1, 7)},
    "A5_7": lambda x, a, b, c: [x[5], a * x[5], b * x[5], c * x[5]],
    "A5_8": lambda x, c: [x[5], c * x[5]],
    "A5_9": lambda x, b, c: [x[5], x[5], b * x[5], c * x[5]],
    "A5_10": lambda x: [x[5]],
    "A5_11": lambda x, c: [x[5], x[5], x[5], c * x[5]],
    "A5_12": lambda x: [x[5]] * 4,
    "A5_13": lambda x, a, p, s: [x[5], a * x[5], spiral(p * x[5], s * x[5])],
    "A5_14": lambda x, p: [spiral(p * x[5], x[5])],
    "A5_15": lambda x, a: [x[5], x[5], a * x[5], a * x[5]],
    "A5_16": lambda x, p, s: [x[5], x[5], spiral(p * x[5], s * x[5])],
    "A5_17": lambda x, p, q, s: [spiral(p * x[5], x[5]), spiral(q * x[5], s * x[5])],
    "A5_18": lambda x, p: [spiral(p * x[5], x[5])] * 2,
    "A5_19": lambda x, a, b: [a * x[5], x[5], (a - 1) * x[5], b * x[5]],
    "A5_20": lambda x, a: [a * x[5], x[5], (a - 1) * x[5], a * x[5]],
    "A5_21": lambda x: [2 * x[5], x[5], x[5], x[5]],
    "A5_22": lambda x: [x[5]],
    "A5_23": lambda x, b: [2 * x[5], x[5], x[5], b * x[5]],
    "A5_24": lambda x, eps: [2 * x[5], x[5], x[5], 2 * x[5]],
    "A5_25": lambda x, p, b: [2 * p * x[5], spiral(p * x[5], x[5]), b * x[5]],
    "A5_26": lambda x, p, eps: [2 * p * x[5], spiral(p * x[5], x[5]), 2 * p * x[5]],
    "A5_27": lambda x: [x[5]] * 3,
    "A5_28": lambda x, a: [a * x[5], (a - 1) * x[5], x[5], x[5]],
    "A5_29": lambda x: [x[5]] * 2,
    "A5_30": lambda x, a: [(a + 1) * x[5], a * x[5], (a - 1) * x[5], x[5]],
    "A5_31": lambda x: [3 * x[5], 2 * x[5], x[5], x[5]],
    "A5_32": lambda x, a: [x[5]] * 3,
    "A5_33": lambda x, a, b: [x[4], x[5], b * x[4] + a * x[5]],
    "A5_34": lambda x, a: [a * x[4] + x[5], x[4], x[4]],
    "A5_35": lambda x, a, b: [b * x[4] + a * x[5], spiral(x[4], x[5])],
    "A5_36": lambda x: [x[4], x[4] - x[5], x[5]],
    "A5_37": lambda x: [2 * x[4], spiral(x[4], x[5])],
    "A5_38": lambda x: [x[4], x[5]],
    "A5_39": lambda x: [spiral(x[4], x[5])],
    "A5_40": lambda x: [opposite(x[2] ** 2 + x[1] * x[3]), opposite(4 * (x[2] ** 2 + x[1] * x[3]))],
}
