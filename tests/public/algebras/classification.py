"""The 62 real Lie algebras once more, in another form: ideals with matrices that act on them, and sets of matrices.

Each is an ideal (abelian, Heisenberg or filiform) with matrices that act on it, in blocks of Jordan's form, or a set of
matrices. On an ideal that is not abelian only what the action does to generators is said: the rest follows by Leibniz'
rule. So built by G. M. Mubarakzyanov, Izv. Vyssh. Uchebn. Zaved. Mat. 1 (32) 114 and 3 (34) 99 (1963). Dimensions up to
4 were compared with the English list of R. O. Popovych, V. M. Boyko, M. O. Nesterenko, M. W. Lutfullin, J. Phys. A 36
(2003) 7337. In dimension 5 the form of each class is what its nilradical leaves: the matrices of R^4 up to conjugation
and scaling, the derivations of Heisenberg's algebra beside a line and of the filiform one up to inner ones.
"""

from collections.abc import Callable
from fractions import Fraction
from itertools import combinations

import numpy as np

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


# Parameters inside the ranges: rational ones, and those where terms of the invariants vanish.
CHOSEN = """
A3_5: a=1/3, a=-1/2; A3_7: a=2, a=-1/3, a=0; A4_2: a=3, a=-2/5, a=1; A4_5: a=1/2 b=-1/3, a=-1 b=1, a=1 b=1;
A4_6: a=2 b=1/2, a=-1/3 b=0; A4_9: b=1/2, b=1, b=0, b=-2/3; A4_11: a=2, a=1/7;
A5_7: a=1/2 b=-1/3 c=1/5, a=-1 b=1 c=-1; A5_8: c=1/2, c=-1; A5_9: b=1/2 c=-2, b=1 c=1; A5_11: c=1/2, c=1;
A5_13: a=1/2 p=1/3 s=2, a=-1 p=0 s=-1/3; A5_14: p=1/3, p=0; A5_15: a=1/2, a=0, a=1; A5_16: p=1/3 s=2, p=0 s=-1;
A5_17: p=1/3 q=-1/2 s=2, p=1/3 q=0 s=-3/7, p=0 q=1/5 s=1, p=0 q=0 s=2/3; A5_18: p=1/3, p=0;
A5_19: a=3 b=1/2, a=0 b=1, a=1 b=-2; A5_20: a=3, a=0, a=1; A5_23: b=1/2, b=2; A5_24: eps=1, eps=-1;
A5_25: p=1/3 b=1/2, p=0 b=1; A5_26: p=1/3 eps=1, p=0 eps=-1; A5_28: a=3, a=0, a=1; A5_30: a=3, a=0, a=-1, a=1;
A5_32: a=3, a=0; A5_33: a=1/2 b=3, a=0 b=-1, a=1 b=0; A5_34: a=1/2, a=0; A5_35: a=1/2 b=3, a=0 b=-1, a=1 b=0
"""


def rows() -> list[tuple[str, dict[str, Fraction]]]:
    """Name and parameters of each algebra of the tests; at least one for each entry."""
    chosen = dict(entry.split(": ") for entry in CHOSEN.strip().replace("\n", "").split(";"))
    chosen = {name.strip(): text for name, text in chosen.items()}
    return [
        (name, {key: Fraction(value) for key, value in (pair.split("=") for pair in given.split())})
        for name in FORMS
        for given in chosen.get(name, "").split(",")
    ]
