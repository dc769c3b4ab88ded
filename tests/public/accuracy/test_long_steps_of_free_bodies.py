"""Steps of free bodies of any length: thin, nearly symmetric and fast bodies beside the closed form."""

import numpy as np
import pytest

import coadjoint as co
from exported_run import RunInC, assert_same, builds
from long import long_beyond
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore:.*no body has")
UNIT = 2.0**-53
SHAPES = {
    "thin rod": (1.0, 1.0, 1e-6),
    "nearly symmetric thin rod": (1.0, 1.001, 1e-9),
    "needle": (1e-12, 1.0, 1.0),
    "asymmetric": (1.0, 2.0, 2.5),
    "nearly symmetric": (2.0, 1.0, 1.0 + 1e-9),
    "disc": (1.0, 1.0, 2.0),
    "satellite in kg m^2": (5e-7, 5e-7, 1e-6),
    "not of a body": (1.0, 1.5, 40.0),
}
SPINS = {
    "tumbling": (0.3, 0.2, 0.1),
    "about the third axis": (1e-3, -2e-3, 5.0),
    "about the second axis": (0.0, 3.0, 0.0),
    "near the second axis": (1e-5, 2.0, -1e-5),
}


def unit_of_error(inertia, x0, h):
    """Return the rounding of a turn, and of the motion of the momentum, in the time, as the page of the header says."""
    m = 1.0 / np.array(inertia)
    a = np.roll(m, -1) - np.roll(m, -2)
    p = np.roll(a, -1) * np.roll(a, -2) * x0**2
    gap = np.sort(p)
    separatrix = np.sqrt((gap[2] - gap[0]) / (gap[1] - gap[0])) if gap[1] > gap[0] else 1.0
    return UNIT * (1.0 + (np.linalg.norm(m * x0) + np.sqrt(np.ptp(p))) * abs(h) * separatrix)


@pytest.mark.parametrize("h", [0.05, -3.0, *long_beyond(2, (400.0, -2e5, 1e6))])
@pytest.mark.parametrize("spin", SPINS)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_step_is_exact_to_rounding(shape, spin, h):
    """Of momentum and attitude, and of another unit of time and of mass."""
    inertia = np.array(SHAPES[shape])
    for unit in (1.0, 1e30):
        body, x0 = co.systems.rigid_body(inertia * unit), np.array(SPINS[spin]) * inertia * unit
        sol = co.integrate(body, x0, (2.0, 2.0 + h), abs(h), co.Splitting(parts="free_body"), attitude=True)
        step = sol.t[-1] - sol.t[0]
        x, A = body.exact(x0, step, attitude=True)
        bound = 20 * unit_of_error(SHAPES[shape], x0 / unit, step)
        assert np.abs(sol.x[-1] - x).max() <= bound * np.linalg.norm(x0)
        assert np.abs(sol.attitude[-1] - A).max() <= bound


@pytest.mark.thinned(1)
@pytest.mark.parametrize("shape", SHAPES)
def test_thousands_of_periods_are_exact_to_rounding(shape):
    """Whole periods of the momentum are one power of a rotation, forward and backward."""
    test_a_step_is_exact_to_rounding(shape, "tumbling", -4e4)
    test_a_step_is_exact_to_rounding(shape, "about the third axis", 2e4)
    test_a_step_is_exact_to_rounding(shape, "near the second axis", 7e3)


@pytest.mark.parametrize("threads", [1, 2])
def test_members_with_long_and_short_flows_have_their_bits(threads):
    """Lanes beside each other are divided into pieces, or into periods, each for itself."""
    body, scheme = co.systems.rigid_body((1.0, 1.0, 1e-3)), co.Splitting(parts="free_body")
    x0 = np.random.default_rng(3).standard_normal((40, 3)) * 10.0 ** np.linspace(-4, 2, 40)[:, None]
    together = co.integrate(body, x0, (0.0, 5.0), 0.5, scheme, threads=threads, attitude=True)
    for k in range(0, 40, 3):
        alone = co.integrate(body, x0[k], (0.0, 5.0), 0.5, scheme, attitude=True)
        assert_same(together.x[:, k], alone.x)
        assert_same(together.attitude[:, k], alone.attitude)


@pytest.mark.parametrize("shape", long_beyond(2, ["thin rod", "asymmetric", "nearly symmetric", "not of a body"]))
def test_derivatives_of_long_steps(shape):
    """Against central differences of the closed form."""
    body, h = co.systems.rigid_body(SHAPES[shape]), 300.0
    x0, step = np.array(SPINS["tumbling"]) * SHAPES[shape], co.stepper(body, co.Splitting(parts="free_body"), h)
    J = step.tangent(x0)
    # The motion turns some thousand radians: steps of a millionth of each coordinate leave an error of 1e-6.
    for l, change in enumerate(np.diag(x0) * 1e-7):
        ends = [body.exact(x0 + k * change, h) for k in (-2, -1, 1, 2)]
        wanted = np.array((1, -8, 8, -1)) @ ends / (12 * change[l])
        assert np.abs(J[:, l] - wanted).max() <= 1e-5 * np.abs(J).max()


@pytest.mark.parametrize("shape", ["thin rod", "asymmetric"])
def test_the_exported_step_has_the_bits_of_long_steps(tmp_path, shape):
    body = co.systems.rigid_body(SHAPES[shape])
    for h in (0.05, 7.0, -4e4):
        ready = co.prepare(body, co.Splitting(parts="free_body"), step=abs(h))
        x0 = np.array((0.3, 0.2, 0.1)) * SHAPES[shape]
        exported = RunInC(ready, tmp_path / f"{abs(h):.0f}", builds()[0], tangent=h == 7.0)
        assert_same(exported.call("run", x0, h, steps=3), ready.run(x0, (0.0, 3 * h)).x[-1])
        if h == 7.0:
            moved, tangents = exported.call("step_with_tangents", x0, h, v=np.eye(3))
            _, wanted = ready.jvp(x0, (0.0, h), {"x0": np.eye(3)})
            assert_same(moved, ready.end(x0, (0.0, h)))
            assert np.abs(tangents.T - wanted.x[-1]).max() <= 1e-9 * np.abs(tangents).max()


def test_two_bodies_of_different_shapes_in_one_part():
    """A thin one and a thick one, each in its own pieces and periods; the step has two flows, with rounding between."""
    inertias, spins = ((1e-4, 1.0, 1.0), (1.0, 2.0, 2.5)), ((0.3, 0.2, 0.1), (0.1, 0.7, 0.3))
    pair = co.systems.bodies(inertias, (1.0, 2.0))
    x0 = pair.state([[0, 0, 0], [1, 0, 0]], angular_velocities=spins)
    end = co.integrate(pair, x0, (0.0, 40.0), 40.0, co.Splitting(parts="free_body")).x[-1]
    for k, (inertia, spin) in enumerate(zip(inertias, spins, strict=True)):
        start = np.multiply(inertia, spin)
        _, A = co.systems.rigid_body(inertia).exact(start, 40.0, attitude=True)
        between = UNIT * np.linalg.norm(start) / min(inertia) * 20.0
        assert np.abs(pair.attitudes(end)[k] - A).max() <= 20 * (unit_of_error(inertia, start, 40.0) + between)


def test_a_step_of_too_many_periods_names_the_limit():
    """After 2^30 periods six digits are left."""
    body, spin = co.systems.rigid_body((1.0, 2.0, 2.5)), (0.3, 0.8, -0.5)
    assert np.isfinite(co.integrate(body, spin, (0.0, 1e10), 1e10, co.Splitting(parts="free_body")).x).all()
    with refused(co.IntegrationError, "2^30 periods", "take a smaller step than 1e+12"):
        co.integrate(body, spin, (0.0, 1e12), 1e12, co.Splitting(parts="free_body"))
