"""Systems and forces with other numbers run by the machine code of those before: numbers are its data."""

from dataclasses import fields, replace

import numba
import numpy as np
import pytest

import coadjoint as co
from matrix.results import fixed
from satellite_forces import CASES

WITHOUT_NUMBERS = "Sampled with a memory and a delay"
METHODS = [co.Splitting(order=2), co.GaussLegendre(2)]
pytestmark = pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")


def scaled(value, factor):
    """Return floats, perhaps in tuples, times a factor; None for other values."""
    if isinstance(value, float):
        return value * factor
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value * factor
    entries = [scaled(one, factor) for one in value] if isinstance(value, tuple) else [None]
    return None if None in entries else tuple(entries)


def others_of(force):
    """Yield forces with other numbers in one field, also in that of a law; directions and periods are structure."""
    for one in fields(force):
        value = getattr(force, one.name)
        if one.name in ("normals", "period", "attitude", "sun"):
            continue
        if isinstance(value, co.forces.Force):
            yield from ((f"law.{name}", *(replace(force, law=law) for law in pair)) for name, *pair in others_of(value))
        elif scaled(value, 1.0) is not None:
            yield one.name, *(replace(force, **{one.name: scaled(value, factor)}) for factor in (0.875, 0.9375))


def end_of(system, start, method, step=0.125, steps=4):
    return co.integrate(system, start, (0.0, steps * step), step, method).x[-1]


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", [*filter(lambda name: name != WITHOUT_NUMBERS, CASES)])
def test_satellite_forces(name, compiled):
    """In runs beyond the second sample of a law whose command is delayed by a period."""
    case = CASES[name]
    count = 0
    for field, *pair in others_of(case.force):
        first, second = (end_of(case.free.with_forces(force), case.start, METHODS[0], steps=12) for force in pair)
        before = len(compiled)
        third = end_of(case.free.with_forces(scaled_again(pair[1], field)), case.start, METHODS[0], steps=12)
        assert len(compiled) == before, field
        count += not np.array_equal(first, second) and not np.array_equal(second, third)
    assert count >= 1


def scaled_again(force, field):
    outer, _, inner = field.rpartition(".")
    if outer:
        return replace(force, law=scaled_again(force.law, inner))
    return replace(force, **{field: scaled(getattr(force, field), 1.0625)})


LENGTHS_OF_A_BOX = "box", "cutoff", "switch_from", "dielectric"
WITH_FUNCTIONS = {
    "gravitating_bodies": {"order": 4},
    "rigid_molecules": {},
    "satellite": {},
    "separable_cosh": {},
    "double_spherical_pendulum": {},
}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("name", WITH_FUNCTIONS)
def test_systems_with_functions(name, method, compiled):
    """Numbers that are 0 or 1, or equal to each other, may have machine code of their own."""
    base, ends = co.systems.get(name, **WITH_FUNCTIONS[name]), []
    for factor in (0.9, 1.1, 1.2):
        numbers = {key: scaled(value, factor) for key, value in base.parameters.items() if key not in LENGTHS_OF_A_BOX}
        given = {key: value for key, value in numbers.items() if value is not None}
        assert given
        system = co.systems.get(name, **{**base.parameters, **given})
        before = len(compiled)
        try:
            start = fixed(system, np.cos(np.arange(1.0, system.dim + 1.0)), 1.0)
            ends.append(end_of(system, start, method, 2.0**-7))
        except (TypeError, ValueError) as refused:
            assert "cannot be used" in str(refused)
            pytest.skip(str(refused))
    assert len(compiled) == before
    assert not np.array_equal(ends[0], ends[1]) and not np.array_equal(ends[1], ends[2])


def law_of(gain, bias):
    def law(x, A):
        error = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
        return -gain * error - bias * x[:3]

    return law


def test_laws_of_one_factory_have_the_bits_of_functions_of_their_own(compiled):
    """As torques, sampled, as laws of wheels and as a batch; the numbers as literals for comparison."""
    gains = [(0.5, np.array([1.0, 0.9, 1.1])), (0.625, np.array([0.5, 1.2, 1.0]))]

    def literal(x, A):
        return -0.625 * ERROR(A) - np.array([0.5, 1.2, 1.0]) * x[:3]

    wheels = [(0.05, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.06)]
    kinds = {
        "torque": (co.systems.body((1, 2, 2.5)), co.forces.Torque),
        "sampled": (co.systems.body((1, 2, 2.5)), lambda f: co.forces.Sampled(co.forces.Torque(f), 0.25)),
        "wheels": (
            co.systems.body((1, 2, 2.5), wheels=wheels),
            lambda f: co.forces.ReactionWheels(co.forces.Torque(f), 0.25),
        ),
    }
    for name, (body, force) in kinds.items():
        systems = [body.with_forces(force(law_of(*one))) for one in gains]
        start, ends, counts = systems[0].state(angular_velocity=(0.3, -0.2, 0.1)), [], []
        for system in systems:
            ends.append(end_of(system, start, METHODS[0]))
            counts.append(len(compiled))
        assert counts[0] == counts[-1], name
        together = co.integrate(co.batch(systems), np.tile(start, (2, 1)), (0, 0.5), 0.125, METHODS[0]).x[-1]
        assert np.array_equal(together, ends), name
        assert len(compiled) == counts[0], name
        assert np.array_equal(end_of(body.with_forces(force(literal)), start, METHODS[0]), ends[1]), name


@numba.njit
def ERROR(A):
    return np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
