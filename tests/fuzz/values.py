"""Hostile values of arguments, and of entries of configuration files."""

from __future__ import annotations

import math
from datetime import date, datetime, timedelta
from fractions import Fraction

import numpy as np

import coadjoint as co


class NoRepresentation:
    def __repr__(self):
        raise RuntimeError("no representation")


class Quantity:
    """A number with a unit, as pint has them."""

    magnitude, units = 0.5, "second"

    def __repr__(self):
        return "0.5 second"

    def __float__(self):
        return 0.5

    def __array__(self, *_, **__):
        return np.array(0.5)


class QuantityArray(np.ndarray):
    """An array with a unit, as astropy has them."""

    unit = "s"


def nested(value, levels, lists=True):
    for _ in range(levels):
        value = [value] if lists else {"a": value}
    return value


HOSTILE = {
    "None": None,
    "an empty string": "",
    "a digit": "3",
    "bytes": b"3",
    "a long string": "x" * 10**6,
    **{f"an empty {kind.__name__}": kind() for kind in (list, dict, set)},
    **{str(number): number for number in (float("nan"), float("inf"), -1, 0, 0.5, 1e308, 5e-324, True)},
    **{f"10^{k}": 10**k for k in (9, 400, 5000)},
    "-10^400": -(10**400),
    "2^64": 2**64,
    "complex": 1j,
    "a fraction": Fraction(10**400, 3),
    "a ragged list": [1.0, [2.0, 3.0]],
    "complex numbers": [1j, 2.0, 3.0],
    "masked": np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "a masked matrix": np.ma.masked_array(np.eye(3), np.eye(3) > 0),
    "the masked constant": np.ma.masked,
    "digits": np.array(["1", "2", "3"], dtype=object),
    "a duration": timedelta(seconds=0.5),
    "durations": [timedelta(0), timedelta(seconds=1)],
    "a NumPy duration": np.timedelta64(1, "s"),
    "an array of durations": np.array([0, 1, 2], dtype="timedelta64[s]"),
    "a date": date(2026, 1, 2),
    "a NumPy date": np.datetime64("2026-01-02"),
    "a quantity": Quantity(),
    "an array with a unit": np.ones(3).view(QuantityArray),
    "a number with a unit": np.array(1.0).view(QuantityArray),
    "truth values": [True, False, True],
    "Nones": [None, None, None],
    "large numbers": [10**400, 1, 1],
    "1e308 thrice": [1e308, -1e308, 1e308],
    "tiny numbers": [5e-324, 5e-324, 5e-324],
    "nans": [float("nan")] * 3,
    "no representation": NoRepresentation(),
    "many without one": [NoRepresentation()] * 3,
    "uint8": np.uint8(200),
    "float16": np.float16(3),
    "uint8 numbers": np.array([200, 100, 200], dtype=np.uint8),
    "a number in an array": np.array(3.0),
    "a large array": np.ones(10**6),
    "a huge array": np.broadcast_to(1.0, (10**7, 10**6)),
    "a huge vector": np.broadcast_to(1.0, (10**12,)),
    "many dimensions": np.ones((2,) * 20),
    "records": np.zeros(3, dtype=[("a", float)]),
    "times": np.array(["2020-01-01"] * 3, dtype="datetime64[D]"),
    "a deep list": nested([], 100_000),
    "a type": int,
    "a function": lambda: None,
    "a dict of anything": {NoRepresentation(): [None]},
}


PLACES = (
    "run", "a", "../run", "../../run", "./run", "//tmp//", "~/run", "link", "a/../run", "missing/run", "", ".",
    "..", "$HOME/run", "`touch pwned`", "run; touch pwned", "C:\\run", "\\\\host\\run", "CON", "-", "--out",
    "%s",
)  # fmt: skip
SUFFIXES = (
    ".nc", ".zarr", ".png", ".svg", ".gif", ".npy", ".toml", "", ".", "/", ".nc/.", ".NC", ".zarr/..",
)  # fmt: skip
EXECUTED = (
    "__import__('os').system('touch pwned')", "(lambda: open('pwned', 'w'))()", "x1.__class__.__mro__", "${x1}",
    "{x1.__class__}", "{{7*7}}", "!!python/object/apply:os.system ['touch pwned']", "%n%s%x",
    "'; touch pwned; '",
)  # fmt: skip
FORMULAS = (
    "x1", "x0", "x-1", "x99999999999999999999", "x1^-1", "x1^0.5", "x1**2", "x1^x1", "1/0", "1/0*x1", "x1/x2",
    "0*x1", "((((x1", "x1)", "+", "-", "--x1", "x1 x2", "2x1", "1e400*x1", "1e-400*x1", "nan*x1", "inf",
    "x1^1024", "x1^1025", "x1 + " * 200 + "x2", "(" * 300 + "x1" + ")" * 300, "\u0661*x1", "x\uff11", "x1\xb2",
    "0x10*x1", "1_000*x1", "x1\x00", "e1", "x1\x00", "e1", "[e1, e2] = e3", "[e2, e1] = -e3", "[e1, e1] = e2",
    "[e1, e9] = e1", "[e1 e2] = e3", "[e1, e2] = e3^2",
)  # fmt: skip
TEXTS = (
    "", " ", "a", "\n", "\t", "\x00", "\x1b[31m", "\u202e", "\ufeff", "\xe9", "\U0001d524", "\U0001f600",
    "a\u0301", "\u2028", "null", "None", "null", "None", "true", "1", "nan", "auto", "coordinates", "a" * 300,
    "a" * 100000, "é" * 5000, "x" * 70 + ".npy", "states.npy", "matrices.npy", "pickle.npy", "objects.npy",
    "text.npy", "huge.npy", "cut.npy", "missing.npy", "../states.npy", "a/../states.npy", "link.npy", "loop.npy",
    "/dev/zero.npy", "folder.npy", "bool.npy", "nan.npy",
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 3, 4, 5, 7, 16, 64, 100, 1000, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, -(2**63), 2**63,
    2**64, 10**30, 10**308, 10**309, -(10**400), 10**5000, 0.0, -0.0, 0.1, 0.5, 1.0, 1.5, -0.25, 0.001, 1e-15,
    5e-324, 1e-300, 1e-300, 1e+300, 1.7e+308, 1000000000000000.0, 1e+16, 1e+22, math.nan, math.inf, -math.inf,
    math.pi,
)  # fmt: skip
DATES = (date(1979, 5, 27), datetime(1979, 5, 27, 7, 32), datetime.max)
KEYS = (
    "name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces", "initial", "method", "run",
    "observe", "events", "output", "parameters", "x", "kind", "attitude", "step", "t_span", "order", "stages",
    "base", "M", "polynomial", "brackets", "basis", "dim", "g", "count", "file", "", "a.b", "\xe9", "\x00",
    "__class__",
)  # fmt: skip


def wild(chosen, depth=0):
    """Return an unexpected value."""
    kind, nothing = chosen.random(), depth > 3
    for limit, draw in (
        (0.4, lambda: chosen.choice(NUMBERS)),
        (0.5, lambda: chosen.choice(TEXTS)),
        (0.55, lambda: chosen.choice(FORMULAS)),
        (0.6, lambda: chosen.choice(EXECUTED)),
        (0.65, lambda: chosen.choice(PLACES) + chosen.choice(SUFFIXES)),
        (0.7, lambda: any_name(chosen)),
        (0.77, lambda: chosen.choice((True, True, True, False, False, False, *DATES))),
        (1.0 if nothing else 0.77, lambda: []),
        (0.8, lambda: nested(chosen.choice(([], {}, 1.0, "a")), chosen.choice((1, 2, 5, 40, 70, 120)), kind < 0.79)),
        (0.9, lambda: [wild(chosen, depth + 1) for _ in range(chosen.choice((0, 1, 2, 3, 3, 3, 6, 9)))]),
        (0.96, lambda: [chosen.choice(NUMBERS[:20])] * chosen.choice((1, 2, 3, 4, 6, 9, 100, 3000))),
    ):
        if kind < limit:
            return draw()
    return {chosen.choice(KEYS): wild(chosen, depth + 1) for _ in range(chosen.choice((0, 1, 2, 3)))}


def any_name(chosen):
    modules = (co.systems, co.methods, co.algebras, co.forces)
    name = chosen.choice((*chosen.choice(modules).names(), *(("random", "blobs") if chosen.random() < 0.2 else ())))
    return name.replace("n)", f"{chosen.choice((0, 1, 2, 3, 4, 30, 10**6))})") if chosen.random() < 0.7 else name
