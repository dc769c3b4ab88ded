"""Errors of what sampled laws measure: their distribution and independence, and the same bits however runs are made."""

import os

import numpy as np
import pytest
from scipy.stats import kstest

import coadjoint as co
from refusals import refused

F, S = co.forces, co.systems
MOMENTS, PERIOD, H = np.array([1.0, 2.0, 2.5]), 0.5, 0.125
NOISE = {"attitude": (1e-3, 2e-3, 5e-4), "angular_velocity": (0.02, 0.01, 0.005)}
SIZES = np.array([*NOISE["attitude"], *NOISE["angular_velocity"]])
SPIN = np.array([0.2, -0.1, 0.3])
EXACT = co.Splitting(parts="free_body")
SIGMAS = 5.0  # of estimates; those of a wrong size or of dependent numbers are off by far more


def record(A, omega, memory, gain):
    new = memory.copy()
    for i in range(3):
        new[9 + i] = omega[i]
        for j in range(3):
            new[3 * i + j] = A[i, j]
    return -gain * omega, new


def recorder(noise=NOISE, bias=None, gain=0.3, period=PERIOD, seed=7, **more):
    """Return a damper that remembers what it has measured."""
    law = F.Torque(record, arguments={"gain": gain})
    return F.Sampled(law, period, memory={"seen": 12}, noise=noise, bias=bias, seed=seed, **more)


def flown(moments=MOMENTS, **more):
    return S.body(moments).with_forces(recorder(**more))


def starts(system, members):
    """Return starts of members that differ."""
    scale = 1.0 + np.arange(members)[:, None] / members
    turned = np.tile(np.array([0.0, 0.6, 0.0, 0.8]), (members, 1))
    return system.state(turned, SPIN * scale)


def errors(system, x, every, place=15):
    """Return the errors (samples, ..., 6) of a law whose memory begins at a place, of states at all steps."""
    at, after = x[:-1:every], x[1::every]
    seen = after[..., place : place + 12]
    R = np.swapaxes(system.attitudes(at), -1, -2) @ seen[..., :9].reshape(*seen.shape[:-1], 3, 3)
    sine = 0.5 * (R - np.swapaxes(R, -1, -2))[..., [2, 0, 1], [1, 2, 0]]
    turned = 4.0 * sine / (1.0 + np.trace(R, axis1=-2, axis2=-1))[..., None]
    return np.concatenate([turned, seen[..., 9:] - system.angular_velocity(at)], axis=-1)


def test_noise_is_normal_and_independent():
    """Of each axis, sample and member, by 10 000 numbers of each axis."""
    sat = flown()
    sol = co.integrate(sat, starts(sat, 40), (-3.0, 122.0), H, threads=1)
    z = errors(sat, sol.x, 4) / SIZES
    assert z.shape == (250, 40, 6)
    count = z[..., 0].size
    assert np.abs(z.mean(axis=(0, 1))).max() < SIGMAS / np.sqrt(count)
    assert np.abs(z.var(axis=(0, 1)) - 1.0).max() < SIGMAS * np.sqrt(2.0 / count)
    assert min(kstest(z[..., k].ravel(), "norm").pvalue for k in range(6)) > 1e-4
    axes = np.corrcoef(z.reshape(-1, 6).T) - np.eye(6)
    members = np.corrcoef(z.transpose(1, 0, 2).reshape(40, -1)) - np.eye(40)
    assert np.abs(axes).max() < SIGMAS / np.sqrt(count)
    assert np.abs(members).max() < SIGMAS / np.sqrt(250 * 6)
    assert np.abs((z[1:] * z[:-1]).mean(axis=(0, 1))).max() < SIGMAS / np.sqrt(count)


def test_biases_are_constant_and_differ_by_member():
    bias = {"attitude": 2e-3, "angular_velocity": 0.01}
    both, noisy, biased = (flown(noise=n, bias=b) for n, b in ((NOISE, bias), (NOISE, None), (None, bias)))
    x0 = starts(both, 400)
    all_errors, noises, biases = (errors(one, co.integrate(one, x0, (0, 3), H).x, 4) for one in (both, noisy, biased))
    # Rounding of attitudes and of momenta below one, in some ten operations.
    np.testing.assert_allclose(biases, np.broadcast_to(biases[:1], biases.shape), rtol=0, atol=1e-14)
    np.testing.assert_allclose(all_errors, noises + biases, rtol=0, atol=1e-14)
    z = biases[0] / np.repeat([2e-3, 0.01], 3)
    assert abs(z.mean()) < SIGMAS / np.sqrt(z.size) and abs(z.var() - 1.0) < SIGMAS * np.sqrt(2.0 / z.size)
    off = np.corrcoef(np.concatenate([z, noises[0]], axis=1).T) - np.eye(12)
    assert np.abs(off).max() < SIGMAS / np.sqrt(400)


@pytest.mark.parametrize("begin, mass, members", [(0.0, 1.0, 500), (-40.0, 1e30, 20), (7.0, 1e-7, 20)])
def test_a_damper_makes_an_autoregressive_process(begin, mass, members):
    """w' = (1 - b) w - b e with b = k T / I of a sphere, exactly, whose variance is that of e times b / (2 - b)."""
    inertia, gain, size = 2.0 * mass, 1.2 * mass, 0.02
    b = gain * PERIOD / inertia
    sat = flown((inertia,) * 3, noise={"attitude": 0.0, "angular_velocity": size}, gain=gain)
    apart = 64  # samples after which the memory of the process, (1 - b)^64, is below 2^-32
    sol = co.integrate(sat, np.tile(sat.state(), (members, 1)), (begin, begin + 3 * apart * PERIOD), PERIOD, EXACT)
    omega, e = sat.angular_velocity(sol.x), errors(sat, sol.x, 1)[..., 3:]
    np.testing.assert_allclose(omega[1:], (1.0 - b) * omega[:-1] - b * e, rtol=0, atol=1e-15)
    found, wanted = omega[apart::apart], size**2 * b / (2.0 - b)
    assert abs(found.var() / wanted - 1.0) < SIGMAS * np.sqrt(2.0 / found.size)
    lag = (omega[apart - 2 :: apart][:3] * found).mean() / wanted
    assert abs(lag - (1.0 - b) ** 2) < SIGMAS * np.sqrt(2.0 / found.size)


def test_noise_belongs_to_the_number_of_a_sample():
    """Not to the step, nor to when a run begins, so that a run continues from its end."""
    sat, x0 = flown(), starts(flown(), 3)
    sol = co.integrate(sat, x0, (-1.0, 3.0), H)
    fine = co.integrate(sat, x0, (-1.0, 3.0), 0.1 * PERIOD)
    np.testing.assert_allclose(errors(sat, fine.x, 10), errors(sat, sol.x, 4), rtol=0, atol=1e-14)
    rest = co.integrate(sat, sol.x[16], (1.0, 3.0), H)
    np.testing.assert_array_equal(rest.x[1:], sol.x[17:])


def test_a_step_is_that_of_numpy():
    """With the noise of member 0, whose deviates agree to rounding."""
    sat = flown(bias=NOISE)
    x, step = starts(sat, 1)[0], co.methods.Forced(co.Splitting())
    sol = co.integrate(sat, x, (2.0, 4.0), H)
    for k in range(16):
        x = step.step(sat, x, 2.0 + k * H, H)
    np.testing.assert_allclose(x, sol.x[-1], rtol=0, atol=1e-14)


def members_alone(systems, x0, span):
    found = []
    for m, (one, start) in enumerate(zip(systems, x0, strict=True)):
        force = one.forces[0]
        more = {"noise": force.noise, "bias": force.bias, "seed": force.seed, "stream": force.stream + m}
        own = S.body(one.unforced.parameters["inertia"]).with_forces(
            F.Sampled(force.law, PERIOD, memory=force.memory, **more)
        )
        found.append(co.integrate(own, start, span, H).x)
    return np.stack(found, axis=1)


@pytest.mark.parametrize("kind", ["one system", "a batch"])
def test_bits_of_members(kind, tmp_path, monkeypatch, no_fsync):
    """Alone, on threads, in blocks, and in archives that are interrupted and resumed."""
    span, bias = (-1.0, 4.0), {"attitude": 1e-3}
    systems = [flown(bias=bias, stream=2)] * 7
    if kind == "a batch":
        numbers = [
            (MOMENTS, NOISE, 0.3),
            (2.0 * MOMENTS, NOISE, 0.3),
            (MOMENTS, {"attitude": 0.0, "angular_velocity": 0.1}, 0.5),
        ]
        distinct = [flown(moments, noise=n, gain=g, bias=bias, stream=2) for moments, n, g in numbers]
        systems = [distinct[k] for k in (0, 1, 0, 2, 1, 0, 0)]
    system = systems[0] if kind == "one system" else co.batch(systems)
    x0 = starts(systems[0], 7)
    wanted = co.integrate(system, x0, span, H, threads=1).x
    assert len(np.unique(wanted[-1, :, 0])) == 7
    np.testing.assert_array_equal(members_alone(systems, x0, span), wanted)
    np.testing.assert_array_equal(co.integrate(system, x0, span, H, threads=2).x, wanted)
    prepared = co.prepare(system, co.Splitting(), H)
    np.testing.assert_array_equal(prepared.run(x0, span).x, wanted)
    np.testing.assert_array_equal(prepared.end(x0, span), wanted[-1])
    path = tmp_path / "run.zarr"
    co.integrate(system, x0, (-1.0, 0.0), H, archive=path)
    for t_end, until in ((4.0, 13), (None, 22), (None, None)):
        found = co.resume(path, t_end, until=until, system=system)
    np.testing.assert_array_equal(found.x, wanted)
    path, blocks = tmp_path / "blocks.zarr", {"archive": tmp_path / "blocks.zarr", "members_per_block": 3}
    replace = os.replace

    def interrupted(source, target, **folders):
        if os.path.basename(target) == "block-000001":
            raise KeyboardInterrupt
        replace(source, target, **folders)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(os, "replace", interrupted)
        co.integrate_ensemble(system, x0, span, H, **blocks)
    assert np.isfinite(co.open_archive(path).x[-1]).all(axis=1).tolist() == [True] * 3 + [False] * 4
    np.testing.assert_array_equal(co.resume(path, system=system).x, wanted)


def test_states_within_steps_and_events_have_the_noise_of_the_member():
    """Also in the step of a sample, where the law of each member is evaluated with its own errors."""
    system, t_eval = flown(stream=1), [0.0, 1.05, 2.0, 2.1]
    x0, event = starts(system, 5), co.Event(co.Polynomial("L1 - 0.15", basis=system.algebra.basis), terminal=True)
    sol = co.integrate(system, x0, (0, 4), H)
    found = co.integrate(system, x0, (0, 4), H, t_eval=t_eval)
    np.testing.assert_array_equal(found.x[[0, 2]], sol.x[[0, 16]])
    np.testing.assert_array_equal(sol.at(1.05).x, found.x[1])
    events = co.integrate(system, x0, (0, 4), H, events=event)
    assert len(events.events.t) == 5 and len({*events.events.t.tolist()}) == 5
    blocks = co.integrate_ensemble(system, x0, (0, 4), H, events=event, members_per_block=2)
    np.testing.assert_array_equal(blocks.events.t, events.events.t)
    for m, start in enumerate(x0):
        alone = flown(stream=1 + m)
        for k, point in ((8, 1), (16, 3)):
            t = float(sol.t[k])
            step = co.stepper(alone, co.Splitting(), t_eval[point] - t)(sol.x[k, m], t)
            np.testing.assert_allclose(step, found.x[point, m], rtol=0, atol=1e-15)
        one = co.integrate(alone, start, (0, 4), H, events=event).events
        np.testing.assert_array_equal(one.t, events.events.t[events.events.member == m])
        np.testing.assert_array_equal(one.x, events.events.x[events.events.member == m])
    ready = co.prepare(system, co.Splitting(), H)
    with refused(ValueError, "noise", "derivatives"):
        ready.vjp(x0, (0, 4), t_eval=t_eval)
    with refused((TypeError, ValueError), "noise", "derivatives"):
        ready.vjp(x0[0], (0, 4), events=event)


def test_errors_of_bodies_with_rotors():
    """With momenta of wheels and gyros that do not change, as the same errors of a body alone."""
    tensor = np.array([[1.2, 0.1, -0.05], [0.1, 2.0, 0.15], [-0.05, 0.15, 2.4]])
    wheels, gyros = 0.05 * np.eye(3), np.eye(3)[[(0, 1), (1, 2)]]
    found = []
    for carried in ({}, {"wheels": wheels}, {"gyros": gyros}, {"wheels": wheels, "gyros": gyros}):
        sat = S.body(tensor, **carried).with_forces(recorder())
        speeds = {"wheel_speeds": (3.0, -2.0, 1.0)} if "wheels" in carried else {}
        x = sat.state((0.0, 0.6, 0.0, 0.8), SPIN, **speeds)
        after = sat.flows[0][1].flow(sat.unforced, x, 1.5, 0.5 * H)
        found.append(errors(sat, np.stack([x, after]), 1, sat.dim - 12)[0])
    assert np.abs(found[0]).min() > 1e-5
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (4, 6)), rtol=0, atol=1e-14)


def damper(omega):
    return -0.25 * omega


def test_laws_have_the_noise_of_their_seeds():
    """Also beside other laws, with noise and without, in any place and at other rates."""
    sizes = {"angular_velocity": NOISE["angular_velocity"]}
    first, quiet, last = (
        F.Sampled(F.Torque(damper), period, **more)
        for period, more in ((PERIOD, {"seed": 7, "noise": sizes}), (PERIOD, {}), (0.25, {"seed": 8, "noise": sizes}))
    )
    sat = S.body(MOMENTS).with_forces(first, quiet, last)
    x0 = np.tile(sat.state(angular_velocity=SPIN), (3, 1))
    x = co.integrate(sat, x0, (0, 3), H).x
    np.testing.assert_allclose(x[1::4, :, 15:18], damper(sat.angular_velocity(x[:-1:4])), rtol=0, atol=1e-15)
    for force, held, every in ((first, 12, 4), (last, 18, 2)):
        found = x[1::every, :, held : held + 3] / -0.25 - sat.angular_velocity(x[:-1:every])
        alone = flown(period=force.period, seed=force.seed)
        run = co.integrate(alone, np.tile(alone.state(), (3, 1)), (0, 3), H)
        np.testing.assert_allclose(found, errors(alone, run.x, every)[..., 3:], rtol=0, atol=1e-14)
    with refused(ValueError, "seed", "stream"):
        S.body(MOMENTS).with_forces(first, first)


def test_derivatives_are_those_with_the_same_noise():
    def build(gain=0.3, attitude=2e-3, bias=0.01):
        return flown(noise={"attitude": attitude, "angular_velocity": 0.02}, bias={"angular_velocity": bias}, gain=gain)

    span, x0 = (-0.5, 1.0), starts(build(), 2)
    weights = np.cos(1.0 + np.arange(27)) * np.array([1.0, -0.7])[:, None]

    def value(x0=x0, **changed):
        return float((co.integrate(build(**changed), x0, span, H).x[-1] * weights).sum())

    ready = co.prepare(build(), co.Splitting(), H)
    sol, pullback = ready.vjp(x0, span)
    cotangent = np.zeros(sol.x.shape)
    cotangent[-1] = weights
    found = pullback(x=cotangent)
    names = {"gain": "law.arguments.gain", "attitude": "noise.attitude", "bias": "bias.angular_velocity"}
    for name, own in names.items():
        at = {"gain": 0.3, "attitude": 2e-3, "bias": 0.01}[name]
        step = 2.0**-10 * at
        difference = (value(**{name: at + step}) - value(**{name: at - step})) / (2.0 * step)
        assert found[f"Sampled.{own}"] == pytest.approx(difference, rel=2e-6), name
    direction = np.zeros_like(x0)
    direction[:, :3] = [[1.0, -0.5, 0.25], [0.5, 1.0, -1.0]]
    step = 2.0**-16
    difference = (value(x0 + step * direction) - value(x0 - step * direction)) / (2.0 * step)
    assert (found["x0"] * direction).sum() == pytest.approx(difference, rel=1e-7)
    _, tangents = ready.jvp(x0, span, directions={"x0": direction})
    assert (tangents.x[-1] * weights).sum() == pytest.approx(difference, rel=1e-7)


def field(t):
    return np.array([0.3, 0.2 * np.cos(0.1 * t), 0.4 * np.sin(0.1 * t)])


def test_magnetometers_have_noise():
    """That of B-dot is what it remembers; moments for a torque are those across the field that is measured."""
    sizes, limit = np.array([0.01, 0.02, 0.03]), (0.0, 250.0)
    errors_of = {"B": field, "noise": {"field": tuple(sizes)}, "seed": 3}
    sat = S.body(MOMENTS).with_forces(F.Magnetorquers(F.BDot(0.02), PERIOD, **errors_of))
    sol = co.integrate(sat, np.tile(sat.state(angular_velocity=SPIN), (20, 1)), limit, PERIOD)

    def in_body(system, sol):
        b = np.array([field(t) for t in sol.t[:-1]])
        return np.einsum("tmij,ti->tmj", system.attitudes(sol.x[:-1]), b)

    e = sol.x[1:, :, -3:] - in_body(sat, sol)
    z = e / sizes
    assert np.abs(z.mean(axis=(0, 1))).max() < SIGMAS / np.sqrt(z[..., 0].size)
    assert np.abs(z.var(axis=(0, 1)) - 1.0).max() < SIGMAS * np.sqrt(2.0 / z[..., 0].size)
    wanted = np.array([0.02, 0.05, -0.04])
    coils = F.Magnetorquers(F.Torque(wanted), PERIOD, **errors_of)
    driven = S.body(MOMENTS).with_forces(coils)
    run = co.integrate(driven, np.tile(driven.state(), (20, 1)), (0.0, 5.0), PERIOD)
    b = in_body(driven, run) + e[:10]
    held = np.cross(b, wanted) / (b * b).sum(axis=-1, keepdims=True)
    np.testing.assert_allclose(run.x[1:, :, 12:15], held, rtol=0, atol=1e-14)


def test_what_is_refused(tmp_path):
    law, size = F.Pointing(0.1, 0.2), {"attitude": 0.01}
    for more, named in (
        ({"noise": size}, ("noise of Sampled", "seed")),
        ({"bias": size}, ("seed",)),
        ({"noise": {"attitude": -0.1}, "seed": 1}, ("attitude in noise", "-0.1")),
        ({"noise": {"attitude": 3.0}, "seed": 1}, ("attitude", "radians", "3.0")),
        ({"bias": {"omega": 0.1}, "seed": 1}, ("bias of Sampled", "omega", "angular_velocity")),
        ({"noise": {"field": 0.1}, "seed": 1}, ("field", "measure")),
        ({"noise": {"attitude": (0.1, 0.2)}, "seed": 1}, ("attitude", "(3,)")),
        ({"noise": 0.1, "seed": 1}, ("noise of Sampled", "0.1")),
        ({"noise": size, "seed": -1}, ("seed", "-1")),
        ({"noise": size, "seed": 1.5}, ("seed", "1.5")),
    ):
        with refused((TypeError, ValueError), *named):
            F.Sampled(law, PERIOD, **more)
    with refused(ValueError, "attitude", "field"):
        F.Magnetorquers(F.BDot(1.0), PERIOD, B=(0, 0, 1), noise=size, seed=1)
    with refused(TypeError, "Sampled", "attitude"):
        S.body(MOMENTS, attitude=False).with_forces(F.Sampled(F.Pointing(0.0, 0.2), PERIOD, noise=size, seed=1))
    rate = F.Sampled(law, PERIOD, noise={"angular_velocity": 0.1}, seed=1)
    with refused(ValueError, "Sampled", "rod"):
        S.body((0.0, 1.0, 1.0)).with_forces(rate)
    sat = S.body(MOMENTS).with_forces(rate)
    with refused(ValueError, "Sampled", "backward"):
        co.integrate(flown(), flown().state(), (1, 0), H)
    with refused(TypeError, "Sampled", "exported"):
        co.export_c(co.prepare(flown(), co.Splitting(), H), tmp_path / "run.h")
    with refused(ValueError, "noise", "member 1"):
        co.batch([sat, S.body(MOMENTS).with_forces(F.Sampled(law, PERIOD))])
