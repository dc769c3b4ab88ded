"""Forces on fluids of matrices: closed forms, what they do to energy and enstrophy, ensembles, refusals."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.reconstruction import system_of
from coadjoint.files.records.records import record_of
from coadjoint.methods.forced import Forced
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.forces.mode_force import ModeRates
from coadjoint.systems.matrices.streams import Weights
from coadjoint.systems.matrices.torus_modes import representatives
from long import long_beyond

GAUSS = co.IsospectralGauss()
FINE = co.IsospectralGauss(6)  # below which a steady state moves by rounding alone
SPHERES = [co.systems.sphere_euler(N=6), co.systems.sphere_euler(N=7)]
TORUS = co.systems.torus_euler(N=7)
FLUIDS = pytest.mark.parametrize("s", [*SPHERES, TORUS], ids=["sphere 6", "sphere 7", "torus 7"])
# of one degree, or one wave number: the stream is a multiple of W, so that the fluid alone stands still
SPHERICAL = {(3, 0): 0.7, (3, 1): 0.3 - 0.4j, (3, 3): 0.2j}
PERIODIC = {(1, 2): 0.4 + 0.1j, (2, 1): -0.3j, (-2, 1): 0.5}


def one_degree(s):
    return s.from_modes(PERIODIC if s is TORUS else SPHERICAL)


def random_state(s, seed=4):
    drawn = np.random.default_rng(seed).standard_normal((2, *s.shape))
    return s.algebra.projected(drawn[0] + 1j * drawn[1])


def forces(s):
    some = co.forces
    found = [
        some.Viscosity(0.02),
        some.Viscosity(1e-5, power=3, rotation=True),
        some.Friction(lambda k: 0.3 / k),
        some.LinearDamping(0.2),
        some.LinearDamping(0.2, toward=random_state(s, 5)),
        some.Torque(random_state(s, 6)),
        some.RandomForcing(0.4, band=(1, 2.5), seed=3),
    ]
    return [*found, some.BetaPlane(1.3)] if s is TORUS else found


def last(system, W, t, step, method=FINE):
    return co.integrate(system, W, (0, t), step, method, save_every=10**6).x[-1]


@FLUIDS
def test_each_force_is_compiled_as_it_is_read(s):
    W = 0.3 * random_state(s)
    for force in forces(s):
        driven = s.with_forces(force)
        step = Forced(GAUSS).step(driven, W, 0.0, 0.125)
        found = last(driven, W, 0.125, 0.125, GAUSS)
        assert np.abs(found - step).max() < 64 * UNIT_ROUNDOFF * s.algebra.N * np.abs(W).max(), force
        assert np.abs(step - last(s, W, 0.125, 0.125, GAUSS)).max() > 1e-5 * np.abs(W).max()
        assert np.array_equal(np.diagonal(found).real, np.zeros(s.algebra.N))
        # the flow is what the field says: differences of order four
        if not force.random:
            x, tau = s.to_vector(W), 2.0**-7
            flows = [force.flow(s, x, 0.0, k * tau) for k in (-2, -1, 1, 2)]
            slope = (flows[0] - 8 * flows[1] + 8 * flows[2] - flows[3]) / (12 * tau)
            assert np.abs(slope - force.field(s, x, 0.0)).max() < 1e-7


@FLUIDS
@pytest.mark.parametrize("power", [1, 4])
def test_one_degree_decays_exactly(s, power):
    W = one_degree(s)
    eigenvalue = 5 if s is TORUS else 3 * 4 - 2
    nu, t = 2.0 / eigenvalue**power, 1.5
    found = last(s.with_forces(co.forces.Viscosity(nu, power)), W, t, 0.25)
    assert np.abs(found - np.exp(-2.0 * t) * W).max() < 1e-14 * np.abs(W).max()


@pytest.mark.parametrize("s", SPHERES)
def test_a_solid_rotation_has_no_strain(s):
    W = s.from_modes({(1, 0): 0.3, (1, 1): 0.5j, (4, 2): 0.4})
    spared = co.integrate(s.with_forces(co.forces.Viscosity(0.05)), W, (0, 2), 0.125, FINE)
    momentum = s.angular_momentum(spared.x)
    assert np.abs(momentum - momentum[0]).max() < 1e-13
    decayed = co.integrate(s.with_forces(co.forces.Viscosity(0.05, rotation=True)), W, (0, 2), 0.125, FINE)
    momentum = s.angular_momentum(decayed.x)
    assert np.abs(momentum[-1] - np.exp(-0.05 * 2 * 2) * momentum[0]).max() < 1e-12 * np.abs(momentum).max()


@FLUIDS
def test_friction_by_scale(s):
    W = one_degree(s)
    scale = np.sqrt(5) if s is TORUS else 3
    drag = co.forces.Friction(lambda k: 0.4 * k)
    assert np.abs(last(s.with_forces(drag), W, 2, 0.25) - np.exp(-0.8 * scale) * W).max() < 1e-14 * np.abs(W).max()
    other = co.forces.Friction(lambda k: 0.0 if abs(k - scale) < 1e-9 else 1.0)
    x = s.to_vector(W)
    assert np.abs(other.flow(s, x, 0.0, 1.0) - x).max() < 64 * UNIT_ROUNDOFF * np.abs(W).max()
    plain, by_mode = co.forces.LinearDamping(0.3), co.forces.Friction(0.3)
    U = random_state(s)
    assert np.abs(last(s.with_forces(plain), U, 1, 0.25) - last(s.with_forces(by_mode), U, 1, 0.25)).max() < 1e-13


def test_on_a_rotating_sphere_the_relative_motion_decays():
    s = co.systems.sphere_euler(N=7, rotation=0.8)
    relative = s.from_modes({(1, 0): 0.2, (3, 0): 0.5})  # zonal: it stands still
    for force, rate in ((co.forces.Friction(0.3), 0.3), (co.forces.Friction(lambda l: 0.3), 0.3)):
        found = s.relative(last(s.with_forces(force), s.absolute(relative), 2, 0.25))
        assert np.abs(found - np.exp(-rate * 2) * relative).max() < 1e-14 * np.abs(relative).max()
    viscous = s.with_forces(co.forces.Viscosity(0.1, rotation=True))
    W = s.absolute(random_state(s))
    assert np.abs(last(viscous, W, 0.125, 0.125) - Forced(FINE).step(viscous, W, 0.0, 0.125)).max() < 1e-13
    found = s.modes(s.relative(last(viscous, s.absolute(relative), 2, 0.25)))
    assert found[1, 0] == pytest.approx(0.2 * np.exp(-0.4), rel=1e-13)
    assert found[3, 0] == pytest.approx(0.5 * np.exp(-2.4), rel=1e-13)


def test_a_force_of_ones_own_may_damp_and_turn():
    class Spiral(ModeRates):
        layer = "vorticity"

        def rates(self, modes, d, numbers):
            return 0.3 - 2j * representatives(modes.N)[numbers]

    found = TORUS.modes(last(TORUS.with_forces(Spiral()), one_degree(TORUS), 2, 0.25))
    for n, w in PERIODIC.items():
        assert abs(found[n] - w * np.exp(-0.6 + 4j * n[0])) < 1e-12


@pytest.mark.parametrize("N", [5, 9])
def test_rossby_waves_on_the_beta_plane(N):
    """Modes of one |n| do not feel one another, and each has its frequency, exactly; energy and enstrophy stay."""
    s = co.systems.torus_euler(N=N)
    modes, beta, t = {(1, 2): 0.4 + 0.1j, (2, 1): -0.3j, (-2, 1): 0.5}, 3.0, 4.0
    moving = s.with_forces(co.forces.BetaPlane(beta))
    sol = co.integrate(moving, s.from_modes(modes), (0, t), 0.125, FINE)
    found = s.modes(sol.x[-1])
    for n, w in modes.items():
        assert abs(found[n] - w * np.exp(1j * beta * n[0] / 5 * t)) < 1e-14
    assert max(sol.change(relative=False)["energy"], sol.change(relative=False)["tr W^2"]) < 1e-13
    # on the grid a crest of cos(x) goes to the west by beta t / |n|^2
    crest = co.integrate(moving, s.from_modes({(1, 0): 0.5}), (0, 0.5), 0.25, FINE).x[-1]
    x, _ = s.grid((16, 1))
    assert np.abs(s.to_grid(crest, (16, 1))[:, 0] - np.cos(x + beta * 0.5)).max() < 1e-14


def test_the_beta_term_keeps_energy_and_enstrophy_and_no_other_casimir():
    sol = co.integrate(TORUS.with_forces(co.forces.BetaPlane(3.0)), random_state(TORUS), (0, 2), 0.0625, GAUSS)
    assert max(np.abs(sol.work["BetaPlane"][name]).max() for name in ("energy", "tr W^2")) < 1e-12
    assert sol.change(relative=False)["tr W^2"] < 1e-12
    assert sol.change(relative=False)["tr W^3"] > 0.1


@FLUIDS
def test_work_and_balance(s):
    W = random_state(s)
    W /= np.abs(W).max()
    driven = s.with_forces(co.forces.Viscosity(0.02), co.forces.Torque(0.1 * one_degree(s)))
    coarse, fine = (co.integrate(driven, W, (0, 1), h, GAUSS) for h in (1 / 32, 1 / 64))
    assert sorted(fine.balance(relative=False)) == ["energy", "tr W^2"]
    assert fine.balance()["tr W^2"] < 64 * 64 * UNIT_ROUNDOFF < fine.change()["tr W^2"]
    # the scheme is of order two, and its energy error with it
    assert 3.5 < coarse.balance(relative=False)["energy"] / fine.balance(relative=False)["energy"] < 4.5
    done = sum(work["energy"][-1] for work in fine.work.values())
    assert abs(fine.energy[-1] - fine.energy[0] - done) <= fine.balance(relative=False)["energy"] + 1e-14
    # the work is the integral of the power, by Simpson's formula
    for label in driven.labels:
        power = np.array([driven.power(x, t)[label] for x, t in zip(fine.x, fine.t, strict=True)])
        simpson = (power[0] + power[-1] + 4 * power[1::2].sum() + 2 * power[2:-1:2].sum()) / (3 * 64)
        work = fine.work[label]["energy"]
        coarse_work = coarse.work[label]["energy"]
        assert abs(work[-1] - simpson) < 2 * abs(work[-1] - coarse_work[-1]) + 1e-7
    for name in ("energy", "tr W^2"):
        assert sum(work[name][-1] for work in fine.work.values()) < 0.0


KINDS = [("so", 4), ("u", 3), ("su", 3), ("gl", 3), ("sl", 3), ("sp", 4), ("gl(C)", 2), ("so(C)", 3)]


@pytest.mark.parametrize("kind", [*KINDS, ("so", 4, 1), ("su", 3, 1)], ids=str)
def test_account_is_kept_on_every_algebra(kind):
    """Linear damping multiplies by exp(-rate t): so do energy and trace, twice, but for what the scheme adds."""
    w = np.random.default_rng(9).uniform(0.5, 2.0, (kind[1], kind[1]))
    algebra = co.MatrixAlgebra(*kind)
    drawn = np.random.default_rng(2).standard_normal((2, *w.shape))
    W, A = (algebra.projected(drawn[k] + 1j * drawn[1 - k] if algebra.complex else drawn[k]) for k in range(2))
    weights = Weights(np.ones_like(w) if kind[0] == "sp" else w + w.T)
    try:
        body = co.MatrixSystem(algebra, weights, 0.1 * A, name="body", energy_sign=-1)
    except ValueError:  # weights that leave the algebra
        body = co.MatrixSystem(algebra, Weights(np.ones_like(w)), 0.1 * A, name="body", energy_sign=-1)
    sol = co.integrate(body.with_forces(co.forces.LinearDamping(0.1)), 0.3 * W, (0, 1), 1 / 32, co.IsospectralGauss(4))
    assert set(sol.balance(relative=False)) == {"energy", *body.quadratic_casimirs}
    for name, off in sol.balance(relative=False).items():
        series = sol.energy if name == "energy" else sol.casimirs[name]
        assert off < 1e-11
        assert np.abs(sol.work["LinearDamping"][name] - (series - series[0])).max() < 1e-11
        assert sol.change(relative=False)[name] > 1e-5
    for name in body.quadratic_casimirs:
        assert np.abs(sol.casimirs[name] - np.exp(-0.2 * sol.t) * sol.casimirs[name][0]).max() < 1e-12
    assert len(body.quadratic_casimirs) == 1


def test_an_energy_that_is_a_function_keeps_no_account():
    s = co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W: W.T @ W @ W.T, energy=lambda W: np.sum((W @ W.T) ** 2) / 4)
    with pytest.raises(ValueError, match="energy"):
        s.with_forces(co.forces.LinearDamping(0.1))


@FLUIDS
def test_order_two_and_backward(s):
    W = random_state(s)
    W /= np.abs(W).max()
    torque = co.forces.Torque(0.3 * one_degree(s))
    driven = s.with_forces(co.forces.Viscosity(0.02), torque)
    reference = last(driven, W, 1, 2.0**-9, GAUSS)
    errors = [np.abs(last(driven, W, 1, 2.0**-k, GAUSS) - reference).max() for k in (4, 5, 6)]
    slopes = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.all(np.abs(slopes - 2) < 0.15)
    there = last(driven, W, 1, 2.0**-5, GAUSS)
    back = co.integrate(driven, there, (1, 0), 2.0**-5, GAUSS).x[-1]
    # what rounding left grows by the viscosity of the smallest scale
    assert np.abs(back - W).max() < 1e-12


@FLUIDS
def test_a_noise_feeds_the_energy_in_that_it_says(s):
    """From rest, so that after one step the noise has acted alone: energy and enstrophy are sums of squares."""
    band, rate, members = ((2.0, 2.9) if s is TORUS else (2, 4)), 1e-4, 400
    noise = co.forces.RandomForcing(rate, band, seed=11)
    sol = co.integrate(s.with_forces(noise), np.zeros((members, *s.shape)), (0, 0.5), 0.5, FINE)
    if s is TORUS:
        eigenvalues = np.repeat([4.0, 5.0, 8.0], [4, 8, 4])
    else:
        eigenvalues = np.repeat([6.0, 12.0, 20.0], [5, 7, 9])
    parts = len(eigenvalues)
    spread = np.sqrt(2 / parts / members)
    assert sol.energy[-1].mean() == pytest.approx(0.5 * rate, rel=4 * spread)
    assert sol.casimirs["tr W^2"][-1].mean() == pytest.approx(2 * 0.5 * rate * eigenvalues.mean(), rel=4 * 1.2 * spread)
    assert np.abs(sol.work["RandomForcing"]["energy"] - sol.energy).max() < 1e-13 * rate
    # every part has the same share of the energy: so many are in the last degree
    spectrum = s.energy_spectrum(sol.x[-1])[1].mean(axis=0)
    count, degree = (4, 3) if s is TORUS else (9, 4)
    assert spectrum[degree - 1] / spectrum.sum() == pytest.approx(count / parts, rel=4 * np.sqrt(2 / count / members))


@pytest.mark.parametrize("s", long_beyond(1, [SPHERES[1], TORUS]))
def test_the_stationary_energy_of_one_degree(s):
    """Of an Ornstein-Uhlenbeck process, as the splitting has it: h/2 rate coth(r h), r that of the energy over two."""
    rate, nu, h, members = 0.6, 0.5, 0.25, 150
    band, eigenvalue, parts = ((2.2, 2.3), 5, 8) if s is TORUS else ((3, 3), 10, 7)
    nu /= eigenvalue
    driven = s.with_forces(co.forces.RandomForcing(rate, band, seed=7), co.forces.Viscosity(nu))
    sol = co.integrate(driven, np.zeros((members, *s.shape)), (0, 40), h, GAUSS, save_every=40)
    wanted = 0.5 * rate * h / np.tanh(0.5 * h)
    # saved points are ten times apart, and correlated by exp(-10): from the second on they are independent samples
    samples = sol.energy[2:]
    assert samples.mean() == pytest.approx(wanted, rel=4 * np.sqrt(2 / parts / samples.size))
    assert samples.std() == pytest.approx(wanted * np.sqrt(2 / parts), rel=0.2)


def test_the_noise_is_the_same_in_any_company():
    s = SPHERES[0]
    starts = np.stack([0.1 * random_state(s, seed) for seed in range(5)])
    noise = dict(energy_rate=0.3, band=(1, 3), seed=5)
    run = dict(t_span=(0, 1), step=0.125, method=GAUSS)
    together = co.integrate(s.with_forces(co.forces.RandomForcing(**noise)), starts, threads=2, **run)
    alone = co.integrate(s.with_forces(co.forces.RandomForcing(**noise, stream=3)), starts[3], threads=1, **run)
    assert np.array_equal(together.x[:, 3], alone.x)
    assert np.array_equal(together.work["RandomForcing"]["energy"][:, 3], alone.work["RandomForcing"]["energy"])
    other = co.integrate(s.with_forces(co.forces.RandomForcing(**{**noise, "seed": 6})), starts[0], **run)
    assert np.abs(other.x[-1] - together.x[-1, 0]).max() > 1e-2


@pytest.mark.long
def test_a_torque_is_a_function_of_time_with_matrices_for_values():
    s, F = SPHERES[0], one_degree(SPHERES[0])
    pushed = s.with_forces(co.forces.Torque(lambda t: np.cos(t) * F))
    assert np.abs(last(pushed, 0 * F, 2, 0.25) - np.sin(2.0) * F).max() < 1e-13
    field = pushed.vector_field(F, 1.0)
    assert field.shape == (6, 6)
    assert np.abs(field - np.cos(1.0) * F).max() < 1e-14


@pytest.mark.long
def test_functions_take_matrices():
    s = SPHERES[0]
    W = 0.3 * random_state(s)
    damped = last(s.with_forces(co.forces.LinearDamping(0.3)), W, 1, 0.125)
    for torque in (lambda x: -0.3 * x, lambda x, t: -0.3 * x + 0.0 * t):
        by_state = last(s.with_forces(co.forces.Torque(torque)), W, 1, 0.125)
        assert np.abs(by_state - damped).max() < 16 * (0.3 * 0.0625) ** 5 / 120 + 1e-14
    own = co.forces.OwnForce(lambda x, t, tau: np.exp(-0.3 * tau) * x, name="drag")
    assert np.abs(last(s.with_forces(own), W, 1, 0.125) - damped).max() < 1e-14


def test_a_run_is_continued_by_a_prepared_one():
    s = SPHERES[0]
    W = 0.3 * random_state(s)
    driven = s.with_forces(co.forces.Viscosity(0.02), co.forces.RandomForcing(0.1, (2, 3), seed=1))
    ready = co.prepare(driven, GAUSS, step=0.125)
    assert np.array_equal(ready.run(W, (0, 1)).x, co.integrate(driven, W, (0, 1), 0.125, GAUSS).x)


def prepared_with_input():
    s = SPHERES[0].with_forces(co.forces.Torque(one_degree(SPHERES[0])))
    return co.prepare(s, GAUSS, 0.125, inputs={"stirring": "Torque"})


WRONG = [
    (lambda: SPHERES[0].with_forces(co.forces.RandomForcing(1.0, (2.2, 2.8), seed=1)), "no degree l in it"),
    (lambda: SPHERES[0].with_forces(co.forces.BetaPlane(1.0)), "rotation"),
    (lambda: SPHERES[0].with_forces(co.forces.Viscosity(0.1, layer="carried")), "one field"),
    (lambda: SPHERES[0].with_forces(co.forces.Friction(lambda l: np.inf)), "rate of Friction"),
    (lambda: SPHERES[0].with_forces(co.forces.Torque(np.eye(6))), "su"),
    (lambda: SPHERES[0].with_forces(co.forces.Torque(np.zeros((5, 5)))), "shape"),
    (lambda: SPHERES[0].with_forces(co.forces.Torque(lambda t: np.eye(6))), "su"),
    (lambda: SPHERES[0].with_forces(co.forces.LinearDamping(0.1, toward=1.0)), "shape"),
    (lambda: SPHERES[0].with_forces(co.forces.LinearDamping(np.ones(72))), "Friction"),
    (lambda: SPHERES[0].with_forces(co.forces.DoubleBracketDamping(0.1)), "structure constants"),
    (lambda: SPHERES[0].with_forces(co.forces.HeatBath(0.1, temperature=1.0, seed=1)), "structure constants"),
    (lambda: prepared_with_input(), "matrix"),
    (lambda: co.forces.Viscosity(-0.1), "nu of Viscosity is -0.1; it must be zero or positive"),
    (lambda: co.forces.Viscosity(0.1, power=0), "power of Viscosity"),
    (lambda: co.forces.Friction(lambda k: 0.1, layer="stream"), "layer of Friction"),
    (lambda: co.forces.Viscosity(0.1, layer="stream"), "layer of Viscosity"),
    (lambda: co.forces.BetaPlane(np.nan), "beta of BetaPlane"),
    (lambda: co.forces.RandomForcing(-1.0, (2, 3), seed=1), "energy_rate of RandomForcing is -1.0"),
    (lambda: co.forces.LinearDamping(0.1, toward=[[0.0, 1j], [np.inf * 1j, 0.0]]), "finite numbers"),
    (lambda: co.systems.rigid_body().with_forces(co.forces.Viscosity(0.1)), "modes of a fluid"),
    (lambda: co.systems.rigid_body().with_forces(co.forces.Torque(np.zeros((3, 3)))), "matrix"),
]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("make", "said"), WRONG)
def test_refused_by_name(make, said):
    with pytest.raises((ValueError, TypeError), match=said):
        make()


def test_a_noise_does_not_run_backward():
    s = SPHERES[0].with_forces(co.forces.RandomForcing(1.0, (2, 3), seed=1))
    with pytest.raises(ValueError, match="backward"):
        co.integrate(s, random_state(s.system), (1, 0), 0.125, GAUSS)
    with pytest.raises(TypeError, match="noise"):
        s.power(random_state(s.system))
    with pytest.raises(TypeError, match="balance"):
        co.integrate(s, random_state(s.system), (0, 1), 0.125, GAUSS).drift(relative=False)


def test_records_and_datasets():
    """A record makes the run again to the same bits; a dataset has no balance where no account is kept."""
    s = SPHERES[0]
    W = 0.3 * random_state(s)
    driven = s.with_forces(
        co.forces.Viscosity(0.02, power=2), co.forces.Torque(0.1 * W), co.forces.RandomForcing(0.1, (2, 3), seed=1)
    )
    sol = co.integrate(driven, W, (0, 1), 0.125, GAUSS)
    again = system_of(record_of(driven))
    assert np.array_equal(co.integrate(again, W, (0, 1), 0.125, GAUSS).x, sol.x)
    found = sol.to_xarray()
    assert list(found.account.values)[:2] == ["Viscosity: energy", "Viscosity: tr W^2"]
    known = [str(name) for name in found.invariant.values if np.isfinite(found.balance.sel(invariant=name)).all()]
    assert known == ["energy", "tr W^2"]
    with pytest.raises(TypeError, match="member 0"):
        co.batch([driven, driven])


def test_torques_are_functions_of_matrices():
    """In Python, where states are vectors, as in the compiled loops."""
    for s in (SPHERES[0], TORUS):
        W = random_state(s)
        x, steady = s.to_vector(W), one_degree(s)
        for torque, wanted in (
            (lambda W, t: (1 + t) * np.abs(np.trace(W @ W)) * W, 1.7 * np.abs(np.trace(W @ W)) * W),
            (lambda t, W=steady: np.sin(t) * W, np.sin(0.7) * steady),
            (steady, steady),
        ):
            force = co.forces.Torque(torque)
            found = s.from_vector(force.field(s, x, 0.7))
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
            size = np.abs(force.flow(s, x, 0.7, 1e-6) - x - 1e-6 * s.to_vector(wanted)).max()
            assert size < 1e-9 * np.abs(wanted).max()


def test_flows_of_ones_own_are_those_of_matrices():
    """In Python, where states are vectors, as in the compiled loops; not linear, and dependent on time."""

    def flow(W, t, tau):
        return W / (1 + tau * (1 + t) * np.abs(np.trace(W @ W)))

    for s in (SPHERES[0], TORUS):
        own, W = co.forces.OwnForce(flow, name="drag"), random_state(s)
        x = s.to_vector(W)
        np.testing.assert_allclose(s.from_vector(own.flow(s, x, 0.7, 0.25)), flow(W, 0.7, 0.25), rtol=0, atol=1e-14)
        slope = s.from_vector(own.field(s, x, 0.7))
        np.testing.assert_allclose(slope, -1.7 * np.abs(np.trace(W @ W)) * W, rtol=0, atol=1e-6 * np.abs(slope).max())


@pytest.mark.thinned(1)
@FLUIDS
def test_derivatives_of_flows_are_those_of_linear_maps(s):
    """Every column, of states in the algebra: the flow is linear but for its rest state."""
    x, moved = s.to_vector(random_state(s)), np.random.default_rng(7).standard_normal((5, s.dim))
    moved = s.to_vector(s.algebra.projected(s.from_vector(moved)))
    modes = [co.forces.Viscosity(0.02, power=2, rotation=True), co.forces.Friction(lambda k: 0.3 / k)]
    if s is TORUS:
        modes.append(co.forces.BetaPlane(0.7))
    for force in modes:
        matrix = np.asarray(force.tangent(s, x, 0.7, 0.25))
        assert matrix.shape == (s.dim, s.dim)
        start = force.flow(s, x, 0.7, 0.25)
        changes = np.array([force.flow(s, x + y, 0.7, 0.25) - start for y in moved])
        np.testing.assert_allclose(moved @ matrix.T, changes, rtol=0, atol=1e-12 * np.abs(moved).max())
