"""Forces on fluids of matrices: rates mode by mode, closed forms, energy and enstrophy, noise, refusals."""

import warnings

import numpy as np
import pytest
from fluids_by_modes import FINE, last, random_matrix
from scipy.integrate import simpson

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

some = co.forces

GAUSS = co.IsospectralGauss()

SPHERES = [co.systems.sphere_euler(N=6), co.systems.sphere_euler(N=7)]

TORUS = co.systems.torus_euler(N=7)

FLUIDS = pytest.mark.parametrize("s", [*SPHERES, TORUS], ids=["sphere 6", "sphere 7", "torus 7"])

# of one degree, or one wave number: the stream is a multiple of W, so that the fluid alone stands still
SPHERICAL = {(3, 0): 0.7, (3, 1): 0.3 - 0.4j, (3, 3): 0.2j}

PERIODIC = {(1, 2): 0.4 + 0.1j, (2, 1): -0.3j, (-2, 1): 0.5}


def one_degree(s):
    return s.from_modes(PERIODIC if s is TORUS else SPHERICAL)


def every_force(s):
    found = [
        some.Viscosity(0.02),
        some.Viscosity(1e-5, power=3, rotation=True),
        some.Friction(lambda k: 0.3 / k),
        some.LinearDamping(0.2),
        some.LinearDamping(0.2, toward=random_matrix(s, 5)),
        some.Torque(random_matrix(s, 6)),
        some.RandomForcing(0.4, band=(1, 2.5), seed=3),
        some.SelectiveDecay(0.1),
    ]
    return [*found, some.BetaPlane(1.3)] if s is TORUS else found


@FLUIDS
def test_each_force_is_compiled_as_it_is_read(s):
    W = 0.3 * random_matrix(s)
    for force in every_force(s):
        driven = s.with_forces(force)
        step = co.methods.Forced(GAUSS).step(driven, W, 0.0, 0.125)
        found = last(driven, W, 0.125, 0.125, GAUSS)
        assert np.abs(found - step).max() < 64 * UNIT_ROUNDOFF * s.algebra.N * np.abs(W).max(), force
        assert np.abs(step - last(s, W, 0.125, 0.125, GAUSS)).max() > 1e-5 * np.abs(W).max()
        assert np.array_equal(np.diagonal(found).real, np.zeros(s.algebra.N))
        # the flow is what the field says: differences of order four
        if force.reversible:
            x, tau = s.to_vector(W), 2.0**-7
            flows = [force.flow(s, x, 0.0, k * tau) for k in (-2, -1, 1, 2)]
            slope = (flows[0] - 8 * flows[1] + 8 * flows[2] - flows[3]) / (12 * tau)
            assert np.abs(slope - force.field(s, x, 0.0)).max() < 1e-7


def test_the_beta_term_keeps_energy_and_enstrophy_and_no_other_casimir():
    sol = co.integrate(TORUS.with_forces(some.BetaPlane(3.0)), random_matrix(TORUS), (0, 2), 0.0625, GAUSS)
    assert max(np.abs(sol.work["BetaPlane"][name]).max() for name in ("energy", "tr W^2")) < 1e-12
    assert sol.change(relative=False)["tr W^2"] < 1e-12
    assert sol.change(relative=False)["tr W^3"] > 0.1


@FLUIDS
def test_work_and_balance(s):
    W = random_matrix(s)
    W /= np.abs(W).max()
    driven = s.with_forces(some.Viscosity(0.02), some.Torque(0.1 * one_degree(s)))
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
        work, coarse_work = (sol.work[label]["energy"][-1] for sol in (fine, coarse))
        assert abs(work - simpson(power, dx=1 / 64)) < 2 * abs(work - coarse_work) + 1e-7
    for name in ("energy", "tr W^2"):
        assert sum(work[name][-1] for work in fine.work.values()) < 0.0


def test_steps_between_forces_have_the_stream_of_their_own_time():
    """Each step but the first has an initial guess from the step before it, and not the time of that step."""

    def stream(W, t):
        return (1.0 + 0.5 * np.sin(3.0 * t)) * W.T

    system = co.MatrixSystem(co.MatrixAlgebra("gl", 3), stream, name="timed")
    W, h, method = np.random.default_rng(1).uniform(-0.5, 0.5, (3, 3)), 0.25, co.IsospectralGauss(1)
    sol = co.integrate(system.with_forces(some.LinearDamping(0.5)), W, (0.5, 2.5), h, method)
    for k, found in enumerate(sol.x):
        assert np.abs(found - W).max() < 64 * (1 + k) * UNIT_ROUNDOFF
        W = np.exp(-0.25 * h) * method.step(system, np.exp(-0.25 * h) * W, 0.5 + k * h, h)


KINDS = [("so", 4), ("u", 3), ("su", 3), ("gl", 3), ("sl", 3), ("sp", 4), ("gl(C)", 2), ("so(C)", 3)]


@pytest.mark.parametrize("kind", [*KINDS, ("so", 4, 1), ("su", 3, 1)], ids=str)
def test_account_is_kept_on_every_algebra(kind):
    """Linear damping multiplies by exp(-rate t): so do energy and trace, twice, but for what the scheme adds."""
    algebra = co.MatrixAlgebra(*kind)
    drawn = np.random.default_rng(2).standard_normal((2, *algebra.shape))
    W, A = (algebra.projected(drawn[k] + 1j * drawn[1 - k] if algebra.complex else drawn[k]) for k in range(2))
    body = co.MatrixSystem(algebra, co.systems.Weights(np.ones(algebra.shape)), 0.1 * A, name="body", energy_sign=-1)
    sol = co.integrate(body.with_forces(some.LinearDamping(0.1)), 0.3 * W, (0, 1), 1 / 32, co.IsospectralGauss(4))
    assert set(sol.balance(relative=False)) == {"energy", *body.quadratic_casimirs}
    for name, off in sol.balance(relative=False).items():
        series = sol.energy if name == "energy" else sol.casimirs[name]
        assert off < 1e-11
        assert np.abs(sol.work["LinearDamping"][name] - (series - series[0])).max() < 1e-11
        assert sol.change(relative=False)[name] > 1e-5
    for name in body.quadratic_casimirs:
        assert np.abs(sol.casimirs[name] - np.exp(-0.2 * sol.t) * sol.casimirs[name][0]).max() < 1e-12
    assert len(body.quadratic_casimirs) == 1


@FLUIDS
def test_a_noise_feeds_the_energy_in_that_it_says(s):
    """From rest, so that after one step the noise has acted alone: the energy is a sum of squares."""
    band, rate, members = ((2.0, 2.9) if s is TORUS else (2, 4)), 1e-4, 400
    noise = some.RandomForcing(rate, band, seed=11)
    sol = co.integrate(s.with_forces(noise), np.zeros((members, *s.shape)), (0, 0.5), 0.5, FINE)
    parts = 16 if s is TORUS else 21
    assert sol.energy[-1].mean() == pytest.approx(0.5 * rate, rel=4 * np.sqrt(2 / parts / members))
    assert np.abs(sol.work["RandomForcing"]["energy"] - sol.energy).max() < 1e-13 * rate


@pytest.mark.parametrize("N", [16, 32, pytest.param(64, marks=pytest.mark.long)])
@pytest.mark.parametrize("surface", ["sphere", "torus"])
def test_the_energy_fed_in_is_that_of_the_spectrum_at_every_resolution(N, surface):
    """At rate 0.05 over the time 20 the mean is 1; the scheme changes it by less than the scatter.

    The energy of n parts with equal variances has the relative variance 2/n, and transfer between modes adds none.
    """
    fluid = co.systems.sphere_euler(N) if surface == "sphere" else co.systems.torus_euler(N - 1)
    band, parts, members = ((3, 5), 27, 16) if surface == "sphere" else ((3, 4), 24, 16)
    stirred = fluid.with_forces(some.RandomForcing(0.05, band, seed=5))
    sol = co.integrate(stirred, np.zeros((members, *fluid.shape)), (0, 20), 0.1, GAUSS, save_every=200)
    energy = fluid.energy_spectrum(sol.x[-1])[1].sum(axis=-1)
    np.testing.assert_allclose(sol.energy[-1], energy, rtol=1e-11)
    assert energy.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / parts / members))
    # The rest is the energy error of the scheme, 0.03 at N = 64.
    np.testing.assert_allclose(sol.work["RandomForcing"]["energy"][-1], energy, rtol=0.06)


def test_two_fields_have_the_unit_of_one():
    """The magnetic energy is the integral of |grad Theta|^2/2."""
    for surface, fluid in (("sphere", co.systems.sphere_euler(6)), ("torus", co.systems.torus_euler(5))):
        W, theta = fluid.random(seed=1, degrees=(1, 2)), fluid.random(seed=2, degrees=(1, 2))
        kinetic = fluid.energy_spectrum(W)[1].sum()
        magnetic = fluid.spectrum_of_modes(fluid.mode_array(theta), 0.5 * fluid.squares * fluid.eigenvalues)[1].sum()
        N = fluid.algebra.N
        mhd, scalar = co.systems.reduced_mhd(N, surface), co.systems.passive_scalar(N, surface)
        state = np.stack([theta, W])
        assert mhd.energy(state) == pytest.approx(kinetic + magnetic, rel=1e-13)
        assert scalar.energy(state) == pytest.approx(kinetic, rel=1e-13)


def test_torques_are_functions_of_matrices():
    """In Python, where states are vectors, as in the compiled loops."""
    for s in (SPHERES[0], TORUS):
        W = random_matrix(s)
        x, steady = s.to_vector(W), one_degree(s)
        for torque, wanted in (
            (lambda W, t: (1 + t) * np.abs(np.trace(W @ W)) * W, 1.7 * np.abs(np.trace(W @ W)) * W),
            (lambda t, W=steady: np.sin(t) * W, np.sin(0.7) * steady),
            (steady, steady),
        ):
            force = some.Torque(torque)
            found = s.from_vector(force.field(s, x, 0.7))
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
            size = np.abs(force.flow(s, x, 0.7, 1e-6) - x - 1e-6 * s.to_vector(wanted)).max()
            assert size < 1e-9 * np.abs(wanted).max()


def test_a_noise_does_not_run_backward():
    s = SPHERES[0].with_forces(some.RandomForcing(1.0, (2, 3), seed=1))
    W = random_matrix(s.unforced)
    with refused(ValueError, "backward"):
        co.integrate(s, W, (1, 0), 0.125, GAUSS)
    with refused(TypeError, "noise"):
        s.power(W)
    with refused(TypeError, "balance"):
        co.integrate(s, W, (0, 1), 0.125, GAUSS).drift(relative=False)


N = 5
BY_SURFACE = {"sphere": co.systems.sphere_euler(N=N), "torus": co.systems.torus_euler(N=N)}
CASES = [  # system, the fluid of its modes, layer
    (BY_SURFACE["sphere"], "sphere", "vorticity"),
    (co.systems.sphere_euler(N=N, rotation=0.8), "sphere", "vorticity"),
    (BY_SURFACE["torus"], "torus", "vorticity"),
    (co.systems.reduced_mhd(N=N), "sphere", "vorticity"),
    (co.systems.reduced_mhd(N=N), "sphere", "carried"),
    (co.systems.reduced_mhd(N=N, surface="torus"), "torus", "vorticity"),
    (co.systems.reduced_mhd(N=N, surface="torus"), "torus", "carried"),
    (co.systems.passive_scalar(N=N), "sphere", "carried"),
    (co.systems.passive_scalar(N=N, surface="torus"), "torus", "carried"),
]
IDS = [f"{s.name} {surface} {layer} {getattr(s, 'rotation', '')}" for s, surface, layer in CASES]


def layers_of(s, x):
    """The carried field, if there is one, and the vorticity relative to the frame."""
    state = s.from_vector(x)
    planetary = getattr(s, "planetary", np.zeros((N, N)))
    return {"vorticity": state - planetary} if state.ndim == 2 else {"carried": state[0], "vorticity": state[1]}


def rates_of(layer, surface):
    """Each force with its rate, a function of (n1, scale, eigenvalue), the scale l or |n|."""
    spared = 2.0 if surface == "sphere" and layer == "vorticity" else 0.0
    found = [
        (some.Viscosity(0.03, layer=layer), lambda n1, k, e: 0.03 * (e - spared)),
        (some.Viscosity(0.002, power=3, layer=layer), lambda n1, k, e: 0.002 * (e - spared) ** 3),
        (some.Viscosity(0.03, power=2, rotation=True, layer=layer), lambda n1, k, e: 0.03 * e**2),
        (some.Friction(0.2, layer=layer), lambda n1, k, e: 0.2 + 0 * e),
        (some.Friction(lambda k: 0.1 * k if k < 2.9 else 0.0, layer), lambda n1, k, e: np.where(k < 2.9, 0.1 * k, 0)),
    ]
    if surface == "torus" and layer == "vorticity":
        found.append((some.BetaPlane(1.7), lambda n1, k, e: -1.7j * n1 / np.maximum(e, 1)))
    return found


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("s", "surface", "layer"), CASES, ids=IDS)
@pytest.mark.parametrize("tau", [0.75, -0.5])
def test_each_mode_of_the_layer_decays_by_its_own_rate_and_nothing_else_moves(s, surface, layer, tau):
    fluid = BY_SURFACE[surface]
    state = random_matrix(s, 2)
    x, e, n1 = s.to_vector(state), fluid.eigenvalues, np.fft.fftfreq(N, 1 / N)[:, None]
    scale = np.sqrt(e) if surface == "torus" else fluid.degrees
    for force, rate in rates_of(layer, surface):
        force.check(s)
        late = layers_of(s, force.flow(s, x, 0.4, tau))
        for name, W in layers_of(s, x).items():
            factor = np.exp(-tau * rate(n1, scale, e)) if name == layer else 1.0
            wanted = fluid.mode_array(W) * factor
            # Sums of at most N^2 products, in the way there and back.
            tolerance = 64 * N**2 * UNIT_ROUNDOFF * max(1.0, np.abs(wanted).max())
            assert np.abs(fluid.mode_array(late[name]) - wanted).max() < tolerance, (force, name)
        moved = s.to_vector(random_matrix(s, 7))
        change = force.flow(s, x + moved, 0.4, tau) - force.flow(s, x, 0.4, tau)
        found = np.asarray(force.tangent(s, x, 0.4, tau)) @ moved
        np.testing.assert_allclose(found, change, rtol=0, atol=1e-12 * np.abs(change).max())
        field = s.from_vector(force.field(s, x, 0.4))
        W, moved = layers_of(s, x)[layer], field if field.ndim == 2 else field[1 if layer == "vorticity" else 0]
        wanted = -rate(n1, scale, e) * fluid.mode_array(W)
        tolerance = 64 * N**2 * UNIT_ROUNDOFF * max(1.0, np.abs(wanted).max())
        assert np.abs(fluid.mode_array(moved) - wanted).max() < tolerance


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: SPHERES[0].with_forces(some.RandomForcing(1.0, (2.2, 2.8), seed=1)), ("2.2", "2.8")),
        (lambda: SPHERES[0].with_forces(some.BetaPlane(1.0)), ("BetaPlane", "rotation")),
        (lambda: SPHERES[0].with_forces(some.Viscosity(0.1, layer="carried")), ("one field",)),
        (lambda: SPHERES[0].with_forces(some.Friction(lambda l: np.inf)), ("rate of Friction",)),
        (lambda: SPHERES[0].with_forces(some.Torque(np.eye(6))), ("Torque", "su")),
        (lambda: SPHERES[0].with_forces(some.Torque(np.zeros((5, 5)))), ("Torque", "(5, 5)")),
        (lambda: SPHERES[0].with_forces(some.Torque(lambda t: np.eye(6))), ("su",)),
        (lambda: SPHERES[0].with_forces(some.LinearDamping(0.1, toward=1.0)), ("toward", "shape")),
        (lambda: SPHERES[0].with_forces(some.LinearDamping(np.ones(72))), ("LinearDamping", "Friction")),
        (
            lambda: SPHERES[0].with_forces(some.DoubleBracketDamping(0.1, np.ones(72))),
            ("metric", "DoubleBracketDamping", "(72,)", "a number"),
        ),
        (
            lambda: co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W: W.T).with_forces(
                some.HeatBath(0.1, temperature=1.0, seed=1)
            ),
            ("HeatBath", "gl(3, R)", "skew-Hermitian", "LinearDamping"),
        ),
        (
            lambda: co.prepare(
                SPHERES[0].with_forces(some.Torque(one_degree(SPHERES[0]))), GAUSS, 0.125, inputs={"stirring": "Torque"}
            ),
            ("matrix",),
        ),
        (lambda: some.LinearDamping(0.1, toward=[[0.0, 1j], [np.inf * 1j, 0.0]]), ("toward", "finite")),
        (lambda: co.systems.rigid_body().with_forces(some.Viscosity(0.1)), ("Viscosity", "modes of a fluid")),
        (lambda: co.systems.rigid_body().with_forces(some.Torque(np.zeros((3, 3)))), ("torque", "(3, 3)", "(3,)")),
        (
            lambda: co.systems.passive_scalar(5).with_forces(some.RandomForcing(1.0, (1, 2), 3, layer="carried")),
            ("carried", "passive_scalar", "energy"),
        ),
        (lambda: co.batch([SPHERES[0].with_forces(some.Viscosity(0.02))] * 2), ("member 0",)),
        (
            lambda: co.MatrixSystem(
                co.MatrixAlgebra("gl", 3), lambda W: W.T @ W @ W.T, energy=lambda W: np.sum((W @ W.T) ** 2) / 4
            ).with_forces(some.LinearDamping(0.1)),
            ("energy",),
        ),
    ],
)
def test_refused_forces(call, named):
    with refused((ValueError, TypeError), *named):
        call()


def test_a_carried_field_of_degree_one_decays():
    """Rotation keeps only the vorticity of degree 1."""
    system = co.systems.passive_scalar(N=6)
    field = 1j * np.diag(np.arange(6) - 2.5)
    forced = system.with_forces(co.forces.Viscosity(0.1, layer="carried"))
    run = co.integrate(forced, np.stack([field, 0 * field]), (0, 1), 0.125, co.IsospectralGauss())
    np.testing.assert_allclose(run.x[-1, 0], np.exp(-0.2) * field, rtol=0, atol=1e-12)


FLOWS = {
    "sphere_euler": lambda rotation: co.systems.sphere_euler(N=12, rotation=rotation),
    "sphere_qg": lambda rotation: co.systems.sphere_qg(N=12, lamb=20.0, rotation=rotation),
    "passive_scalar": lambda rotation: co.systems.passive_scalar(N=12, rotation=rotation),
    "layered_qg": lambda rotation: co.systems.layered_qg(
        N=12, gamma=((3.0, -3.0), (-3.0, 3.0)), thicknesses=(1.0, 1.0), rotation=rotation
    ),
}


@pytest.mark.parametrize("amplitude", [1e-6, 1.0, 1e3])
@pytest.mark.parametrize("rotation", [0.0, 10.0])
@pytest.mark.parametrize("name", FLOWS)
def test_the_work_of_friction_is_that_on_the_flow_however_fast_the_planet_turns(name, rotation, amplitude):
    """All of the relative vorticity decays at one rate, so that the energy of the flow decays at twice that rate."""
    system, rate = FLOWS[name](rotation), 0.25
    modes = {(3, 2): 0.5 * amplitude, (4, 1): 0.3 * amplitude, (5, 3): -0.4 * amplitude}
    if len(system.shape) == 3:
        relative = system.fluid.relative(system.fluid.from_modes(modes, absolute=False))
        x0 = system.absolute([relative, 0.5 * relative] if system.independent_layers else [relative, relative])
    else:
        x0 = system.from_modes(modes, absolute=False)
    h = 0.02 / max(1.0, amplitude)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sol = co.integrate(system.with_forces(co.forces.Friction(rate)), x0, (0, 40 * h), h, co.IsospectralGauss())
    wanted = system.energy(x0) * np.expm1(-2 * rate * 40 * h)
    assert sol.work["Friction"]["energy"][-1] == pytest.approx(wanted, rel=1e-4)
