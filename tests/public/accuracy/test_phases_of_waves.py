"""Warnings of large steps in fluids: phases of waves count over the whole run, against waves of known frequencies."""

import re
import warnings
from functools import partial

import numpy as np
import pytest

import coadjoint as co

OVER_RUN, PROMISED = 0.05, 0.005
"""Largest error over a run without a warning, and with the step that a warning names, as docs/accuracy.md states."""
LAYERS = co.systems.layered_qg(8, [[1.0, -1.0], [-0.5, 0.5]], [1.0, 2.0], rotation=-30.0)
WAVES = {
    "constant radius": (co.systems.sphere_qg(8, 0.0, 80.0, gamma=5.0), (3, 2), 2.0),
    "radius by latitude": (co.systems.sphere_qg(8, 20.0, 80.0), (2, 1), 2.0),
    "small": (co.systems.sphere_qg(8, 0.0, 80.0), (3, 2), 1e-4),
    "layers": (LAYERS, (2, 2, 1), 0.3),
}


def told(call):
    """Return the result of a call, and its warnings of large steps."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    return result, [str(one.message) for one in found if one.category is co.LargeStepWarning]


def step_of(message):
    """Return the step that a warning names."""
    return float(re.search(r"take a step of about (\S+)$", message).group(1))


def phase_error(stages, angle):
    """Error of the angle by which Gauss methods turn a linear wave in a step that should turn it by `angle`."""
    return angle - 2 * np.arctan(angle / 2 if stages == 1 else angle / 2 / (1 - angle**2 / 12))


def norms(states):
    return np.linalg.norm(states.reshape(len(states), -1), axis=1)


@pytest.mark.thinned(4)
@pytest.mark.parametrize(("stages", "angle"), [(1, 0.06), (1, 0.33), (1, 0.45), (2, 0.5)])
@pytest.mark.parametrize(("share", "t0", "sense"), [(0.85, 0.0, 1), (1.15, 0.0, 1), (1.15, 7.0, -1), (0.85, 7.0, -1)])
@pytest.mark.parametrize("name", WAVES)
def test_a_wave_whose_phase_is_wrong_is_warned_of(name, stages, angle, share, t0, sense):
    """The span is that over which the phase errors of steps sum to a share of the threshold; the step named does."""
    s, numbers, amplitude = WAVES[name]
    speed = s.rossby_speed(*numbers)
    h = angle / abs(numbers[1] * speed)
    steps = round(share * 2 * OVER_RUN / phase_error(stages, angle))

    def error_of(count):
        end = t0 + sense * steps * h
        sol, found = told(lambda: co.integrate(
            s, s.rossby_wave(*numbers, wave=amplitude), (t0, end), steps * h / count,
            co.IsospectralGauss(stages), save_every=max(1, count // 50),
        ))  # fmt: skip
        exact = np.array([s.rossby_wave(*numbers, wave=amplitude, longitude=speed * (t - t0)) for t in sol.t])
        return norms(sol.x - exact).max() / norms(exact - exact[0]).max(), found

    error, found = error_of(steps)
    assert bool(found) == (error > OVER_RUN) and 0.7 * OVER_RUN < error < 2 * OVER_RUN
    if found:
        error, found = error_of(int(np.ceil(steps * h / step_of(found[0]))))
        assert error < 1.2 * PROMISED and not found


CASES = {
    "waves": (co.systems.sphere_qg(10, rotation=60.0), lambda s: s.random(1)),
    "jet": (co.systems.sphere_euler(10, rotation=20.0), lambda s: s.zonal_jet(perturbation=0.1)),
    "a zonal flow at rest": (co.systems.sphere_qg(10, 5.0, 60.0), lambda s: s.from_modes({(1, 0): 2.0, (3, 0): 1.0})),
    "friction": (
        co.systems.sphere_qg(10, rotation=60.0).with_forces(co.forces.Friction(1.0)),
        lambda s: s.unforced.random(1),
    ),
    "dye": (
        co.systems.passive_scalar(10, rotation=40.0),
        lambda s: s.absolute(np.array([s.fluid.relative(s.fluid.random(seed)) for seed in (1, 2)])),
    ),
    "field": (
        co.systems.reduced_mhd(9, "torus"),
        lambda s: np.array([s.fluid.from_modes({(0, 1): 9.0}), 0.1 * s.fluid.random(2)]),
    ),
    "layers": (LAYERS, lambda s: s.absolute([s.fluid.random(1), 0.5 * s.fluid.random(2)])),
    "buoyancy": (
        co.systems.thermal_qg(10, 20.0, 40.0),
        lambda s: s.from_potential([0.1 * s.fluid.from_modes({(2, 1): 1.0}, absolute=True), s.fluid.random(1)]),
    ),
}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("stages", [1, 2])
@pytest.mark.parametrize("h", [0.004, 0.016, 0.032, 0.064])
@pytest.mark.parametrize("name", CASES)
def test_fields_of_many_waves_are_warned_of_where_they_are_wrong(name, h, stages):
    """Against a sixteenth of the step with order four; the step named makes the error small."""
    s, start = CASES[name]
    x0, span = start(s), (1.0, 1.0 + 256 * 0.016)
    run = partial(co.integrate, s, x0, span)
    fine = told(lambda: run(h / 16, co.IsospectralGauss(2), save_every=16))[0].x
    motion = max(norms(fine - fine[0]).max(), 1e-9 * norms(fine)[0])

    def error_of(times):
        sol, found = told(lambda: run(h / times, co.IsospectralGauss(stages), save_every=times))
        return norms(sol.x - fine).max() / motion, found

    try:
        error, found = error_of(1)
    except co.IntegrationError:  # the iteration of so large a step fails, which is no silence
        assert h > 0.03 and stages == 2
        return
    assert bool(found) == (error > OVER_RUN) or 0.5 * OVER_RUN < error < 2 * OVER_RUN, (error, found)
    if found:
        error, found = error_of(int(np.ceil(h / step_of(found[0]))))
        assert error < 2 * PROMISED and not found


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_steps_whose_parts_do_not_converge_are_warned_of(steps):
    """The wave turns by 20/3 in a step of the midpoint rule: half steps and thirds fail, and all of a step is error."""
    s = co.systems.sphere_qg(N=24, rotation=100.0)
    sol, found = told(lambda: co.integrate(s, s.rossby_wave(3, 2), (0, 0.2 * steps), 0.2, co.IsospectralGauss()))
    assert len(found) == 1 and step_of(found[0]) < 0.01
    assert sol.step_error() == 1.0
