"""Members whose forces differ in numbers take their steps together, with the bits of each alone."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from matrix.forces import FIRST_FITTING, force_on

F = co.forces
T0, STEP, STEPS = 0.3125, 0.0625, 6  # exact, also in runs that are resumed
MEMBERS = 35  # more than are lanes, and not a multiple of them
BODY = (1.0, 2.0, 2.5)
FIXED = {"period", "normals"}  # that have few values: whole numbers of steps, unit vectors


def scaled(value: Any, factor: float) -> Any:
    """Return a number, or numbers of which the first that is not zero is multiplied."""
    array = np.array(value, dtype=float)
    array.flat[np.flatnonzero(array)[:1]] *= factor
    return array if array.ndim else float(array)


def parameters_of_forces() -> list[Any]:
    """Return (force, parameter, number of the system that takes it) of each registered force of vectors."""
    found = []
    for name in F.names():
        for number in (0, 1):
            plain = FIRST_FITTING[number]()
            try:
                force = plain.with_forces(force_on(name, plain)).forces[0]
            except (TypeError, ValueError):
                continue
            for field in fields(force):
                value = getattr(force, field.name)
                numbers = np.ravel(np.array(value, dtype=object)).tolist()
                if field.name in FIXED or not any(type(one) is float and one for one in numbers):
                    continue
                # Functions on bodies take Numba some time.
                marks = [pytest.mark.long] if number and name != "Pointing" else []
                found.append(pytest.param(name, field.name, number, id=f"{name}.{field.name}", marks=marks))
            break
    return found


def sweep(name: str, field: str, number: int, members: int) -> list[Any]:
    plain = FIRST_FITTING[number]()
    force = force_on(name, plain)
    value = getattr(force, field)
    factors = 1.0 + np.arange(members) / 64.0
    return [plain.with_forces(replace(force, **{field: scaled(value, factor)})) for factor in factors.tolist()]


def states(system: Any, members: int) -> Any:
    x = np.random.default_rng(7).normal(size=(members, system.dim))
    if system.dim > 3:
        x[:] = 0.125 * x + np.ravel(system.state(angular_velocity=(0.1, 0.2, 0.3)))
    return x / (np.linalg.norm(x, axis=1, keepdims=True) if system.dim == 3 else 1.0)


def of_member(system: Any, m: int) -> Any:
    """Return the system with the noise of member m."""
    shifted = [replace(one, stream=one.stream + m) if one.random else one for one in system.forces]
    return system.unforced.with_forces(*shifted)


def run(system: Any, x0: Any, method: Any = None, **options: Any) -> Any:
    return co.integrate(system, x0, (T0, T0 + STEPS * STEP), options.pop("step", STEP), method, **options)


def numbers_of(sol: Any, member: int | None = None) -> dict[str, Any]:
    """Return everything that depends on the bits of a run, of one of its members."""
    work = {f"{label}, {name}": one[name] for label, one in sol.work.items() for name in one}
    found = {"x": sol.x, **work, "energy": sol.energy}
    return {name: np.array(one if member is None else one[:, member]) for name, one in found.items()}


def assert_as_alone(systems: Any, x0: Any, whole: Any, members: Any, method: Any = None, alone: Any = run) -> None:
    for m in members:
        expected, found = numbers_of(alone(of_member(systems[m], m), x0[m], method)), numbers_of(whole, m)
        for name, one in expected.items():
            assert one.tobytes() == found[name].tobytes(), (m, name)


@pytest.mark.parametrize(("name", "field", "number"), parameters_of_forces())
def test_members_that_differ_in_a_parameter_of_a_force(name, field, number):
    systems = sweep(name, field, number, MEMBERS)
    x0 = states(systems[0], MEMBERS)
    whole = run(co.batch(systems), x0)
    assert_as_alone(systems, x0, whole, (0, 1, 33))
    assert np.ptp(whole.x[-1] - x0, axis=0).max() > 0.0


def damped(members: int, **kinds: Any) -> list[Any]:
    """Return bodies that differ in inertia, damping and torque."""
    return [
        co.systems.rigid_body((1.0 + k / 256, 2.0, 2.5)).with_forces(
            F.LinearDamping(0.1 + k / 64, toward=(0.0, 0.1, k / 32)),
            F.Torque((0.1, -0.0, k / 16)),
            *(kind(k) for kind in kinds.values()),
        )
        for k in range(members)
    ]


def noises(members: int) -> list[Any]:
    """Return bodies of which each has noise of its own, one of them none."""
    return damped(
        members,
        bath=lambda k: F.HeatBath(alpha=0.1 + k / 64, temperature=(k % 3) / 32, seed=3),
        noise=lambda k: F.HamiltonianNoise(("x1", "x2*x2"), strength=(0.1 + k / 64, 0.25), seed=4),
        kicks=lambda k: F.RandomTorque(0.1 + k / 32, seed=5),
        of_inertia=lambda k: F.Langevin(0.25, temperature=0.1 + k / 64, seed=6),
    )


METHODS: dict[str, Any] = {
    "order 4": (co.Splitting(order=4), damped),
    "compensated": (co.Splitting(compensated=True), damped),
    "Gauss": (co.GaussLegendre(1), damped),
    "Gauss with noise": (co.GaussLegendre(1), noises),
    "Taylor": (co.Taylor(8), damped),
}


def assert_together(systems: Any, method: Any) -> None:
    x0 = states(systems[0], MEMBERS)
    whole = run(co.batch(systems), x0, method)
    assert_as_alone(systems, x0, whole, (0, 2, 31, 33), method)
    threads = run(co.batch(systems), x0, method, threads=2)
    assert threads.x.tobytes() == whole.x.tobytes()


@pytest.mark.parametrize("case", METHODS)
def test_schemes(case):
    method, make = METHODS[case]
    assert_together(make(MEMBERS), method)


def test_noise_of_members():
    assert_together(noises(MEMBERS), co.Splitting())


def test_backward_and_units():
    for factor in (1e-7, 1.0, 1e30):
        systems = [
            co.systems.rigid_body((factor * (1.0 + k / 256), 2.0 * factor, 2.5 * factor)).with_forces(
                F.LinearDamping(0.1 + k / 64), F.Torque((0.1 * factor, 0.0, factor * k / 16))
            )
            for k in range(MEMBERS)
        ]
        x0 = factor * states(systems[0], MEMBERS)

        def run_back(system: Any, x: Any, method: Any = None) -> Any:
            return co.integrate(system, x, (T0, T0 - STEPS * STEP), STEP, co.Splitting())

        assert_as_alone(systems, x0, run_back(co.batch(systems), x0), (0, 33), alone=run_back)
        end = run(co.batch(systems), x0).x[-1] / factor
        for m in (0, 33):
            inertia = np.array([1.0 + m / 256, 2.0, 2.5])

            def slope(_: float, J: Any, m: int = m, inertia: Any = inertia) -> Any:
                return np.cross(J, J / inertia) - (0.1 + m / 64) * J + np.array([0.1, 0.0, m / 16])

            exact = solve_ivp(slope, (0.0, STEPS * STEP), x0[m] / factor, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
            coarse = run(systems[m], x0[m], step=STEP / 2).x[-1] / factor
            # The error of order two is three times the change at half the step, to a fifth.
            error, change = np.abs(end[m] - exact).max(), np.abs(end[m] - coarse).max()
            assert 0.8 * 4.0 / 3.0 * change < error < 1.2 * 4.0 / 3.0 * change


def test_events_end_members_that_differ():
    systems = damped(MEMBERS)
    x0 = states(systems[0], MEMBERS)
    event = co.Event(co.Polynomial("x3 - 0.1*x1", basis=("x1", "x2", "x3")), terminal=True, name="reached")
    whole = co.integrate(co.batch(systems), x0, (0.0, 4.0), STEP, co.Splitting(), events=event)
    times = whole.events["reached"]
    ended = np.unique(times.member)
    assert 5 < len(ended) == len(times.t)
    for m in (0, 33, *ended[:3]):
        alone = co.integrate(systems[m], x0[m], (0.0, 4.0), STEP, co.Splitting(), events=event)
        last = len(alone.x) - (m in ended)  # alone, the last state is that of the event
        assert alone.x[:last].tobytes() == np.ascontiguousarray(whole.x[:last, m]).tobytes()
        assert alone.events["reached"].t.tobytes() == times.t[times.member == m].tobytes()


def test_archives_and_resuming(tmp_path):
    systems = noises(MEMBERS)
    x0, batch = states(systems[0], MEMBERS), co.batch(systems)
    whole = run(batch, x0, co.Splitting())
    run(batch, x0, co.Splitting(), archive=tmp_path / "a")
    assert np.array(co.load(tmp_path / "a").x).tobytes() == whole.x.tobytes()


def test_inputs_follow_numbers_of_forces():
    systems = damped(MEMBERS)
    x0 = states(systems[0], MEMBERS)
    inputs = {"rotors": (0, 1, 2)}
    prepared = co.prepare(co.batch(systems), co.Splitting(), STEP, inputs=inputs)
    values = np.arange(3 * MEMBERS).reshape(MEMBERS, 3) / 64.0
    span = (T0, T0 + STEPS * STEP)
    whole = prepared.run(x0, span, rotors=values)
    for m in (0, 33):
        alone = co.prepare(systems[m], co.Splitting(), STEP, inputs=inputs)
        expected = alone.run(x0[m], span, rotors=values[m])
        assert expected.x.tobytes() == np.ascontiguousarray(whole.x[:, m]).tobytes()


def test_a_member_that_overflows_stops_alone():
    systems = [
        co.systems.rigid_body(BODY).with_forces(F.Torque((1e308 if k == 3 else k / 8, 0.0, 0.0))) for k in range(5)
    ]
    x0 = states(systems[0], 5)
    with pytest.raises(co.IntegrationError) as caught:
        co.integrate(co.batch(systems), x0, (0.0, 40.0), 1.0, co.Splitting())
    found = caught.value.partial
    for m in (0, 4):
        alone = co.integrate(systems[m], x0[m], (0.0, 40.0), 1.0, co.Splitting())
        assert alone.x.tobytes() == np.ascontiguousarray(found.x[:, m]).tobytes()


def test_derivatives_by_numbers_of_forces():
    systems = damped(MEMBERS)
    x0 = states(systems[0], MEMBERS)
    prepared = co.prepare(co.batch(systems), co.Splitting(), STEP)
    span, w = (T0, T0 + STEPS * STEP), np.ones((MEMBERS, 3))
    found = prepared.vjp(x0, span, STEPS)[1](x=np.stack([0.0 * w, w]))
    for m in (0, 33):
        alone = co.prepare(systems[m], co.Splitting(), STEP).vjp(x0[m], span, STEPS)[1](x=np.stack([0.0 * w[m], w[m]]))
        for name in ("x0", "inertia", "LinearDamping.rate", "LinearDamping.toward", "Torque.torque"):
            np.testing.assert_array_equal(found[name][m], alone[name])
