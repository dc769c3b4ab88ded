"""Hostile values of arguments."""

from datetime import date, datetime, timedelta
from fractions import Fraction

import numpy as np


class NoRepresentation:
    def __repr__(self):
        raise RuntimeError("no representation")


class Quantity:
    """A number with a unit, as pint has them."""

    magnitude = property(lambda self: 0.5)
    units = property(lambda self: "second")

    def __repr__(self):
        return "0.5 second"

    def __float__(self):
        return 0.5

    def __array__(self, *_, **__):
        return np.array(0.5)


class QuantityArray(np.ndarray):
    """An array with a unit, as astropy has them."""

    unit = "s"


def deep(levels):
    nested = []
    for _ in range(levels):
        nested = [nested]
    return nested


HOSTILE = {
    "None": None,
    "an empty string": "",
    "a digit": "3",
    "bytes": b"3",
    "a long string": "x" * 10**6,
    "an empty list": [],
    "an empty dict": {},
    "an empty set": set(),
    "nan": float("nan"),
    "inf": float("inf"),
    "-1": -1,
    "0": 0,
    "0.5": 0.5,
    "True": True,
    "10^400": 10**400,
    "-10^400": -(10**400),
    "10^5000": 10**5000,
    "2^64": 2**64,
    "10^9": 10**9,
    "1e308": 1e308,
    "5e-324": 5e-324,
    "complex": 1j,
    "a fraction": Fraction(10**400, 3),
    "a ragged list": [1.0, [2.0, 3.0]],
    "complex numbers": [1j, 2.0, 3.0],
    "a complex array": np.array([1j, 2.0, 3.0]),
    "masked": np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "a masked matrix": np.ma.masked_array(np.eye(3), np.eye(3) > 0),
    "the masked constant": np.ma.masked,
    "digits": np.array(["1", "2", "3"], dtype=object),
    "a duration": timedelta(seconds=0.5),
    "durations": [timedelta(0), timedelta(seconds=1)],
    "a NumPy duration": np.timedelta64(1, "s"),
    "an array of durations": np.array([0, 1, 2], dtype="timedelta64[s]"),
    "a date": date(2026, 1, 2),
    "times of day": (datetime(2026, 1, 2), datetime(2026, 1, 3)),
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
    "int8": np.int8(-128),
    "float16": np.float16(3),
    "uint8 numbers": np.array([200, 100, 200], dtype=np.uint8),
    "a number in an array": np.array(3.0),
    "a large array": np.ones(10**6),
    "a huge array": np.broadcast_to(1.0, (10**7, 10**6)),
    "a huge vector": np.broadcast_to(1.0, (10**12,)),
    "many dimensions": np.ones((2,) * 20),
    "records": np.zeros(3, dtype=[("a", float)]),
    "times": np.array(["2020-01-01"] * 3, dtype="datetime64[D]"),
    "a deep list": deep(100_000),
    "a type": int,
    "a function": lambda: None,
    "a dict of anything": {NoRepresentation(): [None]},
}
