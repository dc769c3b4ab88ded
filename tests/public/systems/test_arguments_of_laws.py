"""Laws with arguments of their own: the bits of laws with literals, and derivatives by these numbers."""

import numba
import numpy as np
import pytest

import coadjoint as co
from long import long_where
from refusals import refused

BODY = co.systems.body((1.0, 2.0, 2.5))
GAIN, RATES = 0.5, (1.0, 0.75, 1.25)
SPAN, STEP = (0.5, 2.5), 0.125


def error(A):
    return np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])


def law(A, omega, gain, rates):
    return -gain * error(A) - rates * omega


def with_memory(omega, memory, gain, rates):
    return -gain * memory - rates * omega, memory + 0.25 * omega


KINDS = {
    "torque": (law, lambda torque: torque),
    "compiled by the user": (numba.njit(law), lambda torque: torque),
    "sampled": (law, lambda torque: co.forces.Sampled(torque, 0.25)),
    "with a memory": (with_memory, lambda torque: co.forces.Sampled(torque, 0.25, memory={"integral": 3})),
}
LITERAL = {
    law: lambda A, omega: -0.5 * error(A) - np.array([1.0, 0.75, 1.25]) * omega,
    with_memory: lambda omega, memory: (
        -0.5 * memory - np.array([1.0, 0.75, 1.25]) * omega,
        memory + 0.25 * omega,
    ),
}


def system_of(kind, gain=GAIN, rates=RATES):
    function, force = KINDS[kind]
    return BODY.with_forces(force(co.forces.Torque(function, arguments={"rates": rates, "gain": gain})))


def state_of(system):
    return system.state([0.0, 0.6, 0.0, 0.8], angular_velocity=(0.3, -0.2, 0.4))


@pytest.mark.parametrize("kind", long_where(["torque", "sampled"], KINDS))
def test_bits_are_those_of_literals_and_other_values_compile_nothing(kind, compiled):
    function, force = KINDS[kind]
    own = BODY.with_forces(force(co.forces.Torque(LITERAL[getattr(function, "py_func", function)])))
    start = state_of(own)
    ends = [co.integrate(one, start, SPAN, STEP).x for one in (own, system_of(kind))]
    np.testing.assert_array_equal(*ends)
    before = len(compiled)
    others = [system_of(kind, gain, rates) for gain, rates in ((0.6, RATES), (0.7, (0.5, 0.6, 0.7)))]
    together = co.integrate(co.batch(others), np.tile(start, (2, 1)), SPAN, STEP).x[-1]
    alone = [co.integrate(one, start, SPAN, STEP).x[-1] for one in others]
    np.testing.assert_array_equal(together, alone)
    assert len(compiled) == before and not np.array_equal(*alone)


@pytest.mark.parametrize("kind", long_where(["torque", "sampled"], KINDS))
def test_derivatives_by_arguments(kind):
    """One gradient by all of them, beside differences of runs with other values."""
    ready = co.prepare(system_of(kind), co.Splitting(), STEP)
    start, weights = state_of(ready.system), np.cos(np.arange(ready.system.dim))
    prefix = f"{ready.system.labels[0]}.{'' if ready.system.labels[0] == 'Torque' else 'law.'}arguments."
    sol, pullback = ready.vjp(start, SPAN)
    last = np.zeros_like(sol.x)
    last[-1] = weights
    found = pullback(x=last)

    def change(**values):
        h = 2.0**-12
        ends = []
        for by in (h, -h, 2 * h, -2 * h):
            moved = {name: np.add(value, by * np.asarray(along)) for name, (value, along) in values.items()}
            end = co.integrate(system_of(kind, **moved), start, SPAN, STEP, co.Splitting()).x[-1]
            ends.append(weights @ end)
        return (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * h)

    np.testing.assert_allclose(found[prefix + "gain"], change(gain=(GAIN, 1.0)), rtol=1e-8)
    expected = [change(rates=(RATES, np.eye(3)[k])) for k in range(3)]
    np.testing.assert_allclose(found[prefix + "rates"], expected, rtol=1e-8, atol=1e-10)
    _, tangents = ready.jvp(start, SPAN, {prefix + "gain": 1.0})
    np.testing.assert_allclose(weights @ tangents.x[-1], found[prefix + "gain"], rtol=1e-9)


def test_a_dataset_of_a_sweep_has_the_swept_argument():
    batch = co.batch([system_of("torque", gain) for gain in (0.5, 0.6, 0.7)])
    data = co.integrate(batch, state_of(batch[0]), SPAN, STEP).to_xarray()
    np.testing.assert_array_equal(data["swept_forces_0_arguments_gain"], [0.5, 0.6, 0.7])


REFUSED = {
    "a missing one": ({"gain": 1.0}, "(A, omega, gain, rates)", "last arguments"),
    "another one": ({"gain": 1.0, "rate": 2.0}, "gain, rate", "last arguments"),
    "the state": ({"omega": 1.0, "gain": 1.0, "rates": 1.0}, "last arguments"),
    "no number": ({"gain": np.nan, "rates": 1.0}, "gain", "finite"),
    "no mapping": ([1.0, 2.0], "arguments", '{"gain": 0.5}'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    given, *named = REFUSED[name]
    with refused((TypeError, ValueError), *named):
        co.forces.Torque(law, arguments=given)
    with refused(TypeError, "constant"):
        co.forces.Torque((0.1, 0.2, 0.3), arguments={"gain": 1.0})
