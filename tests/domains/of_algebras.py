"""Domains of the parameters of algebras, as documented; ranges of algebras of the catalogue as published."""

from __future__ import annotations

import functools
import math
from fractions import Fraction

import numpy as np

import coadjoint as co
from domains.kinds import Case, Domain, case_of, choice, instance, optional, real, structured, title, whole

SO3, SL2, UNIT = co.algebras.so(3), co.algebras.sl(2), np.eye(3)
ROTATIONS, E3 = SO3.representation, co.algebras.e(3)
NAMES = structured(
    (None, ("a", "b", "c"), ["x", "y", "z"]), (("a", "b"), ("a", "a", "b"), ("a", "b", 3)), keep=(None, [], {})
)
TWO_NAMES = structured((None, ("a", "b")), (("a",), ("a", "a"), ("a", 1)), keep=(None, [], {}))
MATRIX = structured(
    (UNIT, [[1, 1, 0], [0, 1, 0], [0, 0, Fraction(1, 3)]]),
    (np.zeros((3, 3)), np.ones((3, 3)), np.eye(2), UNIT[:2], np.ones(3), UNIT * math.nan, UNIT * 1j, UNIT > 0),
    r"\bnew basis\b",
)
REPRESENTATION = structured(
    (None, ROTATIONS),
    (2 * ROTATIONS, ROTATIONS[:2], np.ones((3, 2, 3)), ROTATIONS * math.nan, ROTATIONS * 1j),
    keep=(None, {}),
)
CASIMIRS = structured(
    (None, {}, {"C": co.Polynomial({(0, 0): 1})}),
    (
        {"C": 1.0},
        {"C": None},
        {1: co.Polynomial({(0, 2): 1})},
        {"C": co.Polynomial({(0, 0, 2): 1})},
        {"C": co.Polynomial({(0, 2): 1})},
        {"C": co.Invariant(lambda x: x[0])},
    ),
    keep=(None, "", {}),
).but_called("[cC]asimir")
CONSTANTS = structured(
    ([(0, 1, 1, 1.0)], [], [(0, 1, 0, 2), (1, 0, 0, -2)], np.zeros((2, 2, 2))),
    ([(0, 1, 2, 1.0)], [(-1, 1, 0, 1.0)], [(0, 0, 1, 1.0)], [(0, 1, 1, math.nan)], [(0, 1, 1, 1j)], [(0, 1, 1, "1")],
     [(0, 1, 1)], [(0, 1.5, 1, 1.0)], [(0, 1, 0, 2), (1, 0, 0, 2)], np.ones((2, 2, 2)), np.zeros((2, 2, 3))),
    r"\bconstants?\b|\[e1, e[12]\]", keep=([], {}),
)  # fmt: skip
BRACKETS = structured(
    ({(0, 1): {1: 1.0}}, {}, {(1, 0): {0: 2}}, ["[e1, e2] = e2"]),
    ({(0, 1): {2: 1.0}}, {(0, 0): {1: 1.0}}, {(-1, 1): {0: 1.0}}, {(0, 1): {1: math.nan}}, {(0, 1): {1: 1j}},
     {(0, 1): 1.0}, {(0, 1): {1: True}}, {0: {1: 1.0}}, ["[e1, e3] = e2"], ["e1 = e2"], [""]),
    r"\bbrackets?\b|\bconstants?\b|\[e1, e1\]", keep=(None, [], {}),
)  # fmt: skip
VECTORS = structured(
    (["e1"], [[1, 0, 0]], np.array([[0.0, 0.5, 1.0]]), UNIT),
    (UNIT[:2], ["e1", "e2"], ["e1", "e1"], ["e4"], ["e1", 2], np.zeros((1, 3)), [[1, 0]], [[1j, 0, 0]]),
    r"\bsubalgebra\b|\bvectors?\b", keep=({},),
)  # fmt: skip
IDEAL = structured(
    (["e4", "e5", "e6"], np.eye(6)[3:], [[0, 0, 0, 0, 0, 2], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 1]]),
    (np.eye(6)[:3], ["e4"], np.eye(6), ["e4", "e4", "e5"], ["e7"], np.eye(5)[:2], np.zeros((1, 6)), np.eye(6)[3:] * 1j),
    keep=([], {}),
)  # fmt: skip
MATRICES = structured(
    ([[[1, 0], [0, 0]], [[0, 1], [0, 0]]], [[[Fraction(1, 3), 0], [0, 0]], [[0, 1], [0, 0]]]),
    (np.ones((2, 2, 2)), np.ones((2, 2)), np.ones((5, 2, 2)), np.ones((2, 2, 3)), np.full((2, 2, 2), math.nan),
     np.zeros((2, 2, 2)), [np.eye(2), UNIT], np.ones((2, 2, 2)) > 0, [[["a"]]]),
    r"\bmatri(x|ces)\b", keep=({},),
)  # fmt: skip
A_LIE_ALGEBRA = instance(SO3, SL2).but_called(r"\bLieAlgebras?\b")
SHARED = {
    "g": A_LIE_ALGEBRA,
    "constants": CONSTANTS,
    "dim": whole(2, tried=3).but_called(r"\bdim\b|\bindex j = 1\b"),
    "brackets": BRACKETS,
    "matrices": MATRICES,
    "basis": TWO_NAMES,
    "name": optional(title("g")),
    "casimirs": CASIMIRS,
    "representation": structured(
        (None, co.algebras.get("A2_1").representation), (np.ones((2, 2, 2)), np.ones((2, 2))), keep=(None, {})
    ),
    "q": whole(0),
    "count": whole(1, usual=2),
}
LEAST = {"e": 2, "gl": 1, "heisenberg": 1, "se": 2, "sl": 2, "so": 2, "su": 2, "u": 1}
ALGEBRAS = {
    **{name: case_of(getattr(co.algebras, name), SHARED, n=whole(least)) for name, least in LEAST.items()},
    "A3_7": case_of(co.algebras.A3_7, SHARED, a=real(2.0).plus(Fraction(1, 3))),
    "change_of_basis": case_of(co.algebras.change_of_basis, SHARED, matrix=MATRIX, basis=NAMES),
    "copies": case_of(co.algebras.copies, SHARED),
    "direct_sum": Case(lambda algebras: co.algebras.direct_sum(SL2, algebras), {"algebras": A_LIE_ALGEBRA}),
    "quotient": Case(co.algebras.quotient, {"g": A_LIE_ALGEBRA.first(E3), "ideal": IDEAL}),
    "semidirect": Case(co.algebras.semidirect, {
        "g": A_LIE_ALGEBRA.first(SO3),
        "representation": REPRESENTATION,
        "ideal": optional(instance(SO3).but_called("LieAlgebra|ideal|Jacobi")).plus(outside=(SL2, co.algebras.so(4))),
    }),
    "sp": Case(co.algebras.sp, {"size": whole(2, tried=4).plus(outside=(0, 3, 5))}),
    "subalgebra": Case(co.algebras.subalgebra, {
        "g": A_LIE_ALGEBRA.first(SO3), "vectors": VECTORS, "basis": NAMES,
    }, usual={"vectors": UNIT}),
    "LieAlgebra": case_of(co.LieAlgebra, SHARED),
    "LieAlgebra.from_brackets": case_of(
        co.LieAlgebra.from_brackets, SHARED, dim=SHARED["dim"].plus(outside=(["[a, b]"], ["a"]))),
    "LieAlgebra.from_matrices": case_of(co.LieAlgebra.from_matrices, SHARED),
    "LieAlgebra.closure": Case(co.LieAlgebra.closure, {key: SHARED[key] for key in ("matrices", "basis", "name")}),
    "MatrixAlgebra": Case(co.MatrixAlgebra, {
        "kind": choice("u", "su", "so", "gl", "sl", "sp", "gl(C)", "sl(C)", "so(C)", "sp(C)").plus(
            outside=("U", "SO", "sum")).but_called("kind|sum|blocks"),
        "N": whole(2, 4096, usual=4, tried=6),
        "q": whole(0, 4, tried=4),
    }, usual={"kind": "so", "q": 0}),
}  # fmt: skip

BELOW, ABOVE = math.nextafter(1.0, 0.0), math.nextafter(1.0, 2.0)
TINY = 5e-324
ANY, NOT_ZERO = ((), (0, -2.5)), ((0, 0.0), (1e-3, -2.5))
UP_TO_ONE = ((-ABOVE, ABOVE, 2), (-1, 1, -0.5, 0))
UP_TO_ONE_NOT_ZERO = ((0, -ABOVE, ABOVE), (-1, 1, 0.5))
SIGN = ((0, 0.5, 2, -2, BELOW), (1, -1))
# algebra -> parameter -> numbers outside and numbers inside, each with 0.5, or 1 for a sign, as the others
RANGES = {
    **{name: {"a": ANY} for name in ("A3_7", "A5_20", "A5_28", "A5_30", "A5_32", "A5_34")},
    **{name: {"a": ANY, "b": ANY} for name in ("A5_33", "A5_35")},
    "A3_5": {"a": ((0, -1, 1, 2), (BELOW, -BELOW, 1e-3))},
    "A4_2": {"a": NOT_ZERO},
    "A4_5": {"a": UP_TO_ONE_NOT_ZERO, "b": UP_TO_ONE_NOT_ZERO},
    "A4_6": {"a": NOT_ZERO, "b": ((-TINY, -1), (0, 1e-3))},
    "A4_9": {"b": ((-1, ABOVE, -2), (1, -BELOW, 0))},
    "A4_11": {"a": ((0, -TINY, -1), (1e-3, 2))},
    "A5_7": {"a": NOT_ZERO, "b": NOT_ZERO, "c": NOT_ZERO},
    "A5_8": {"c": UP_TO_ONE_NOT_ZERO},
    "A5_9": {"b": ((math.nextafter(0.5, 0.0), 0), (0.5, 1)), "c": ((0, math.nextafter(0.5, 1.0)), (0.25, -3))},
    "A5_11": {"c": NOT_ZERO},
    "A5_13": {"a": UP_TO_ONE_NOT_ZERO, "p": ANY, "s": NOT_ZERO},
    "A5_14": {"p": ANY},
    "A5_15": {"a": UP_TO_ONE},
    "A5_16": {"p": ANY, "s": NOT_ZERO},
    "A5_17": {"p": ANY, "q": ANY, "s": NOT_ZERO},
    "A5_18": {"p": ((-TINY, -1), (0, 1e-3))},
    "A5_19": {"a": ANY, "b": NOT_ZERO},
    "A5_23": {"b": NOT_ZERO},
    "A5_24": {"eps": SIGN},
    "A5_25": {"p": ANY, "b": NOT_ZERO},
    "A5_26": {"p": ANY, "eps": SIGN},
}


def in_range(parameter, limits):
    wrong, right = limits
    anything = real(1 if parameter == "eps" else 0.5)
    return Domain((anything.inside[0], *right), (*wrong, *anything.outside))


DOMAINS = {name: {key: in_range(key, limits) for key, limits in ranges.items()} for name, ranges in RANGES.items()}
DOMAINS |= {f"{name}(n)": {"n": whole(least)} for name, least in LEAST.items()} | {"sp(2n)": {"n": whole(1)}}
DOMAINS["so(p,q)"] = dict.fromkeys(("p", "q"), whole(0, usual=2))
CATALOGUE = {name: Case(functools.partial(co.algebras.get, name), domains) for name, domains in DOMAINS.items()}
