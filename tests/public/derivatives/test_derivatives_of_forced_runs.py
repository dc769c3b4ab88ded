"""Derivatives of runs with forces, forward and backward, against each other and against differences of the runs."""

import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from derivative_checks import DIFFERENCE_ERROR, assert_derivatives, outputs
from scipy.spatial.transform import Rotation

import coadjoint as co
from guards import bounded_work
from matrix.forces import first_fitting, force_on
from refusals import refused

F, H = co.forces, 0.0625
BODY, TOP = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)), co.systems.heavy_top(inertia=(1.0, 2.0, 2.5))
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
FULL = np.array([[0.3, 0.2, -0.1], [0.0, 0.2, 0.1], [0.1, -0.2, 0.4]])
AIM = (0.1, 0.2, 0.4)
METRIC = np.array([[0.7, 0.2, 0.1], [0.2, 0.5, 0.0], [0.1, 0.0, 0.9]])


def changed(system):
    """Return the builder of a ready-made system with forces for changed values of its parameters."""

    def build(values):
        forces, numbers = [], {name: one.item() if np.ndim(one) == 0 else one for name, one in values.items()}
        for label, force in zip(system.labels, system.forces, strict=True):
            own = {k.removeprefix(f"{label}."): one for k, one in numbers.items() if k.startswith(f"{label}.")}
            named = {k.removeprefix("arguments."): one for k, one in own.items() if k.startswith("arguments.")}
            own = {k: one for k, one in own.items() if "." not in k}
            forces.append(replace(force, **own, **({"arguments": named} if named else {})))
        plain, own = system.unforced, {k: one for k, one in numbers.items() if "." not in k}
        if own:
            plain = getattr(co.systems, plain.name)(**{**plain.parameters, **own})
        return plain.with_forces(*forces)

    return build


def acting(base, *forces):
    """Return the builder of a system with forces."""
    return changed(base.with_forces(*forces))


def law(x, t, gain, tilt):
    return -gain * x * x + tilt * np.sin(t)


def filled(x, t, gain, power, none):
    found = np.zeros(3)
    for i in range(3):
        found[i] = -gain * x[i] * (x @ x) ** 0.5 + none * np.sin(t)
    found[0] += 0.1 * np.exp(-x[1]) ** power
    return 1.0 * found


def in_branches(x, t, early, late, bound):
    if t < 0.4:
        return -early * x * np.abs(x)
    if t < 0.6 and x[0] < np.inf:
        return -late * np.maximum(x, 0.5 * x[0])
    return early * x if x[1] > bound else np.copysign(np.minimum(late * x, np.inf), -x)


# Of systems whose energies are shifted if they have an attitude: forces, a scheme, and a number of members.
CASES = {
    "one rate": (BODY, (F.LinearDamping(0.3),), co.Splitting(), 1),
    "rates of axes": (BODY, (F.LinearDamping((0.3, 0.2, 0.1), toward=AIM),), co.Splitting(order=4), 3),
    "matrix of rates": (BODY, (F.LinearDamping(FULL, toward=AIM),), co.Splitting(order=6), 1),
    "large rates": (BODY, (F.LinearDamping(30.0 * FULL, toward=AIM),), co.Splitting(), 1),
    "amplified": (BODY, (F.LinearDamping(-0.3, toward=0.25),), co.GaussLegendre(1), 40),
    "constant, then damped": (BODY, (F.Torque(AIM), F.LinearDamping(0.3)), co.GaussLegendre(1), 1),
    "of time": (BODY, (F.Torque(lambda t: np.array([np.sin(t), 0.2, 0.1 * t])),), co.Splitting(order=4), 2),
    "law": (BODY, (F.Torque(law, arguments={"gain": 0.3, "tilt": AIM}),), co.Splitting(order=8), 1),
    "law that fills an array": (
        BODY,
        (F.Torque(filled, arguments={"gain": 1.0, "power": 1.0, "none": 0.0}), F.LinearDamping(0.1)),
        co.Splitting(),
        2,
    ),
    "law with branches": (
        BODY,
        (F.Torque(in_branches, arguments={"early": 0.3, "late": 0.2, "bound": 0.5}),),
        co.Splitting(order=4),
        1,
    ),
    "given flow": (BODY, (F.OwnForce(lambda x, t, tau: x / (1.0 + 0.2 * tau * x * x)),), co.Splitting(), 2),
    "double bracket": (BODY, (F.DoubleBracketDamping(0.4, (0.5, 1.0, 2.0)),), co.Splitting(order=4), 1),
    "matrix as metric": (BODY, (F.DoubleBracketDamping(0.4, METRIC),), co.Splitting(), 1),
    "of a top": (TOP, (F.DoubleBracketDamping(0.4), F.LinearDamping(0.1)), co.Splitting(order=4), 1),
    "selective decay": (BODY, (F.Torque(AIM), F.SelectiveDecay(0.4), F.LinearDamping(0.1)), co.Splitting(), 3),
}
NOISES = {
    "bath": (BODY, (F.HeatBath(0.3, temperature=0.5, seed=7),), co.Splitting(), 1),
    "bath with metric": (BODY, (F.HeatBath(0.3, (0.5, 1.0, 2.0), 0.5, seed=7), F.Torque(AIM)), co.GaussLegendre(1), 1),
    "two layers": (TOP, (F.HeatBath(0.3, temperature=0.5, seed=7),), co.Splitting(), 1),
    "thermal": (BODY, (F.Langevin(0.3, temperature=0.5, seed=7),), co.Splitting(), 1),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("attitude", [True, False])
@pytest.mark.parametrize("name", CASES)
def test_flows_are_differentiated_around_steps(name, attitude):
    base, forces, method, members = CASES[name]
    x0 = X3 if base is BODY else X6
    x0 = x0 if members == 1 else np.outer(np.linspace(0.5, 1.5, members), x0)
    backward = attitude and all(force.reversible for force in forces)
    backward = backward and "large" not in name
    span = (0.5, 0.5 + (-5 if backward else 5) * H)
    # Those of a damping in coordinates grow with its rates.
    error = DIFFERENCE_ERROR * (16 if members > 8 or "large" in name else 1)
    options = {"t_eval": [0.5, 0.5 + (span[1] - 0.5) * 0.3, span[1]]} if name == "rates of axes" else {}
    assert_derivatives(acting(base, *forces), method, x0, span, H, attitude=attitude, error=error, **options)


@pytest.mark.parametrize("name", NOISES)
def test_noise_is_frozen(name):
    base, forces, method, _ = NOISES[name]
    x0 = X3 if base is BODY else X6
    assert_derivatives(acting(base, *forces), method, x0, (0.5, 0.5 + 6 * H), H, attitude=True)


RING = co.systems.spin_lattice("ring", 3)
X9 = np.concatenate([X3, -X3, X3[::-1]])
SAT, X12 = co.systems.body((1.0, 2.0, 2.5)), np.concatenate([X3, np.eye(3).ravel()])
AXIAL, CUBIC = co.Polynomial({(1, 0, 0): 0.7}), co.Polynomial({(2, 1, 0): 0.3, (0, 0, 1): 0.2})
WAVE = co.Hamiltonian(lambda x: np.sin(x[0]) * x[1] + 0.5 * x[2] ** 2)
SQUARES = co.Polynomial({(2, 0, 0): 0.3, (0, 1, 1): 0.5})


def shaken(strength, *energies, **more):
    return F.HamiltonianNoise(energies, strength, seed=3, **more)


OF_WAVE = co.LiePoissonSystem(co.algebras.so(3), WAVE + co.Polynomial({(4, 0, 0): 0.3}))
FIELD = co.systems.spin_lattice("ring", 3, field=(0.2, 0.3, 0.1))
# Noise whose flows are rotations, exponentials of parts, and midpoint rules, damping of spins, and kicks.
ON_ORBITS = {
    "of spins": (RING, X9, F.Gilbert((0.3, 0.2, 0.5), temperature=(0.5, 0.2, 0.3), seed=7), co.SphericalMidpoint()),
    "of spins at rest": (RING, X9, F.Gilbert((0.3, 0.0, 0.5)), co.SphericalMidpoint()),
    "of one constant": (RING, X9, F.Gilbert(0.3), co.Splitting()),
    "decay of spins": (FIELD, X9, F.SelectiveDecay(0.4), co.SphericalMidpoint()),
    "decay of a function": (OF_WAVE, X3, F.SelectiveDecay(0.4), co.GaussLegendre(1)),
    "field": (RING, X9, F.RandomField((0.4, 0.2, 0.3), seed=1), co.Splitting()),
    "one axis": (BODY, X3, shaken(0.4, AXIAL, levels=2), co.Splitting()),
    "cubic": (BODY, X3, shaken((0.4, 0.3), CUBIC, AXIAL), co.Splitting()),
    "mixed": (BODY, X3, shaken(((0.4, 0.1), (0.2, 0.3)), CUBIC, AXIAL), co.Splitting()),
    "function": (BODY, X3, shaken(0.4, WAVE), co.GaussLegendre(1)),
    "squares": (BODY, X3, shaken(0.4, SQUARES), co.Splitting()),
    "of a top": (TOP, X6, shaken(0.4, co.Polynomial({(1, 0, 0, 0, 1, 0): 0.3})), co.Splitting()),
    "in body axes": (SAT, X12, F.RandomTorque((0.4, 0.2, 0.3), seed=13), co.Splitting()),
    "in axes of space": (SAT, X12, F.RandomTorque(FULL, "space", seed=13), co.Splitting()),
}


@pytest.mark.parametrize("others", [(), (F.LinearDamping(0.1),)], ids=["alone", "behind a damping"])
@pytest.mark.parametrize("name", ON_ORBITS)
def test_damping_and_noise_on_orbits_and_kicks(name, others):
    base, x0, force, method = ON_ORBITS[name]
    assert_derivatives(acting(base, *others, force), method, x0, (0.5, 0.5 + 6 * H), H)


TURNED = {name: case[:3] for name, case in ON_ORBITS.items() if case[2].around_steps and case[0] is not RING}


@pytest.mark.parametrize("others", [(), (F.LinearDamping(0.1),)], ids=["alone", "behind a damping"])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2)], ids=["splitting", "Gauss"])
@pytest.mark.parametrize("name", TURNED)
def test_noise_that_turns_the_attitude(name, method, others):
    """Of members, whose energies are shifted in splittings; attitudes are linear in the initial one."""
    base, x0, force = TURNED[name]
    attitude = "coadjoint" if base is TOP else True
    x0, span = np.outer([1.0, 0.5, -1.5], x0), (0.5, 0.5 + 6 * H)
    assert_derivatives(acting(base, *others, force), method, x0, span, H, attitude=attitude)
    sol, pullback = co.prepare(base.with_forces(*others, force), method, H, attitude=attitude).vjp(x0, span)
    weights = np.random.default_rng(5).standard_normal(sol.attitude.shape)
    along_start = np.sum(pullback(attitude=weights)["attitude0"] * sol.attitude[0])
    assert abs(along_start - np.sum(weights * sol.attitude)) < 1e-12 * np.abs(weights * sol.attitude).sum()
    assert np.abs(sol.attitude[-1] - sol.attitude[-1][[1, 2, 0]]).max() > 0.01  # each member has its own noise


def test_noise_without_second_derivatives_is_not_differentiated_with_an_attitude():
    """Without it, the flow is differentiated in Python."""
    H1 = co.Hamiltonian(lambda x: np.sin(x[0]), gradient=lambda x: np.array([np.cos(x[0]), 0.0, 0.0]))
    system = BODY.with_forces(shaken(0.4, H1))
    with refused(TypeError, "HamiltonianNoise", "attitude=", "hessian"):
        co.prepare(system, co.Splitting(), H, attitude=True).jvp(X3, (0.0, 1.0), {"x0": X3})
    assert np.isfinite(co.prepare(system, co.Splitting(), H).jvp(X3, (0.0, 1.0), {"x0": X3})[1].x).all()


def test_a_spin_with_almost_no_damping_does_not_hide_another_one():
    """Two spins without coupling, whose fixed points converge in one iteration and in twenty: for the first one, whose
    numbers are far larger, changes are round-off before those of the other one are. Against differences of order four.
    """
    spins = co.systems.spin_lattice("chain", 2, exchange=0.0, field=(0.0, 0.0, 1.0))
    system = spins.with_forces(F.DoubleBracketDamping(1.0, metric=np.diag(np.repeat([1e-5, 1.0], 3))))
    x0, w, h, d = np.array([0.6, 0.0, 0.8, 0.0, 0.8, -0.6]), np.array([0.3, -0.5, 0.7, 0.2, 0.4, -0.6]), 1.2, 1e-5
    ready = co.prepare(system, co.Splitting(), h)

    def at(x):
        return w @ ready.run(x, (0.0, h)).x[-1]

    moves = d * np.eye(6)
    wanted = [(8 * (at(x0 + v) - at(x0 - v)) - at(x0 + 2 * v) + at(x0 - 2 * v)) / (12 * d) for v in moves]
    sizes = np.repeat([1.0, 1e-9], 3)
    _, pullback = ready.vjp(x0, (0.0, h))
    found = pullback(np.stack([np.zeros(6), sizes * w]))["x0"] / sizes
    # Round-off of the first one is up to 1e-6 of what is solved for the other.
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5)


def test_noise_and_damping_of_spins_take_bounded_work():
    """They are differentiated by the kernels: in Python a flow took ten milliseconds, and a noise half of one."""
    system = RING.with_forces(F.Gilbert(0.1, temperature=0.5, seed=7), F.RandomField(0.1, seed=1))
    ready = co.prepare(system, co.Splitting(), H)
    ready.vjp(X9, (0.0, 1.0))
    with bounded_work(8.0):
        sol, pullback = ready.vjp(X9, (0.0, 2000 * H), save_every=500)
        pullback(np.ones(sol.x.shape))


def test_arguments_that_enter_by_arithmetic_of_the_law_have_differences():
    """Of x' = -gain^3 x on a round body, -3 gain^2 t exp(-gain^3 t) x0; by a gain that is a factor, they are exact."""
    base, exact = co.systems.rigid_body((1.0, 1.0, 1.0)), -3 * 0.3**2 * np.exp(-(0.3**3)) * X3
    torques = (lambda x, t, gain: -gain * x), (lambda x, t, gain: -(gain**3) * x)
    for torque, gain, rule in zip(torques, (0.3**3, 0.3), ("exact", "differences"), strict=True):
        ready = co.prepare(base.with_forces(F.Torque(torque, arguments={"gain": gain})), co.Splitting(), H)
        tangents = ready.jvp(X3, (0.0, 1.0), {"Torque.arguments.gain": 1.0})[1]
        assert tangents.rule == {"Torque.arguments.gain": rule}
        scale = 1.0 if rule == "differences" else 1 / (3 * 0.3**2)
        np.testing.assert_allclose(tangents.x[-1], scale * exact, rtol=1e-9)


NOISES_OF_MEMBERS = {
    "random field": (RING, F.RandomField(0.5, seed=1), co.SphericalMidpoint()),
    "spins in a bath": (RING, F.Gilbert(0.3, temperature=0.5, seed=7), co.SphericalMidpoint()),
    "of two Hamiltonians": (
        BODY,
        F.HamiltonianNoise([co.Polynomial({(1, 0, 0): 1.0}), co.Polynomial({(0, 1, 1): 1.0})], 0.4, seed=3),
        co.Splitting(),
    ),
}


@pytest.mark.parametrize("name", NOISES_OF_MEMBERS)
def test_each_member_has_the_derivatives_of_its_own_noise(name):
    """Members that start alike differ by their noise alone, and so do their derivatives."""
    base, force, method = NOISES_OF_MEMBERS[name]
    x0 = np.tile(X3, (3, base.dim // 3)) / np.linalg.norm(X3)
    ready, end, d = co.prepare(base.with_forces(force), method, H), 0.5 + 3 * H, 1e-5
    ahead, behind = (ready.run(x0 + sign * d, (0.5, end)).x[-1] for sign in (1, -1))
    wanted = (ahead - behind) / (2 * d)
    tangent = ready.jvp(x0, (0.5, end), {"x0": np.ones_like(x0)})[1].x[-1]
    np.testing.assert_allclose(tangent, wanted, rtol=0, atol=1e-8)
    sol, pullback = ready.vjp(x0, (0.5, end))
    weights = np.zeros_like(sol.x)
    weights[-1] = np.random.default_rng(4).standard_normal(x0.shape)
    by_member = pullback(weights)["x0"].sum(axis=1)
    np.testing.assert_allclose(by_member, (weights[-1] * wanted).sum(axis=1), rtol=0, atol=1e-7)
    assert np.ptp(wanted, axis=0).max() > 0.05


@pytest.mark.parametrize("name", ["random field", "of two Hamiltonians"])
def test_several_directions_of_a_parameter_at_once(name):
    """The first of them may be zero; the others have the tangents that they have alone."""
    base, force, method = NOISES_OF_MEMBERS[name]
    x0, span, label = np.tile(X3, base.dim // 3), (0.5, 0.5 + 3 * H), f"{type(force).__name__}.strength"
    ready = co.prepare(base.with_forces(force), method, H)
    alone = ready.jvp(x0, span, {label: 1.0})[1].x
    together = ready.jvp(x0, span, {label: np.array([0.0, 1.0, -2.0])})[1].x
    np.testing.assert_allclose(together, np.multiply.outer(alone, [0.0, 1.0, -2.0]), rtol=0, atol=1e-13)
    assert np.abs(alone[-1]).max() > 0.05


def test_several_directions_of_a_parameter_of_a_stream_at_once():
    """By steps and by a damping, whose first direction is zero; in more flows than their predictions read."""
    base, span = MATRICES["parameters"], (0.5, 0.5 + 12 * H)
    x0 = drawn(base, np.random.default_rng(3))
    ready = co.prepare(base.with_forces(DAMPED), co.IsospectralGauss(), H)
    together = ready.jvp(x0, span, {"gamma": np.array([0.0, 1.0, -2.0])})[1].x
    ends = [
        co.prepare(
            co.systems.sphere_qg(N=4, lamb=2.0, gamma=0.5 + d, rotation=0.5).with_forces(DAMPED),
            co.IsospectralGauss(),
            H,
        )
        .run(x0, span)
        .x[-1]
        for d in (2.0**-14, -(2.0**-14))
    ]
    wanted = np.multiply.outer((ends[0] - ends[1]) * 2.0**13, [0.0, 1.0, -2.0])
    np.testing.assert_allclose(together[-1], wanted, rtol=0, atol=1e-8)
    assert np.abs(wanted).max() > 1e-3


def test_each_entry_of_a_matrix_of_hamiltonians_has_a_derivative():
    """Also those that are zero, which the tables of the noise leave out."""
    fields, d = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 2.0]]), 1e-5

    def prepared(fields):
        noise = F.HamiltonianNoise(fields, (0.1, 0.2), seed=3)
        return co.prepare(BODY.with_forces(noise), co.Splitting(), H)

    sol, pullback = prepared(fields).vjp(X3, (0.5, 1.0))
    weights = np.zeros_like(sol.x)
    weights[-1] = 1.0, -2.0, 0.5
    found = pullback(weights)["HamiltonianNoise.hamiltonians"]
    for k in np.ndindex(fields.shape):
        moved = np.zeros(fields.shape)
        moved[k] = d
        ahead, behind = (prepared(fields + sign * moved).run(X3, (0.5, 1.0)).x[-1] for sign in (1, -1))
        assert abs(found[k] - weights[-1] @ (ahead - behind) / (2 * d)) < 1e-8
    assert np.abs(found).min() > 1e-4


@pytest.mark.parametrize("force", [F.DoubleBracketDamping(0.3), F.HeatBath(0.3, temperature=0.2, seed=5)], ids=repr)
def test_a_damping_by_a_stream_of_the_time_is_differentiated_at_its_time(force):
    """Backward as forward, in substeps of two lengths, against differences of runs, whose error is d^2."""
    g, rng, d = co.MatrixAlgebra("su", 3), np.random.default_rng(1), 1e-5
    weights = np.array([[1.0, 2.0, 3.0], [2.0, 1.0, 1.5], [3.0, 1.5, 1.0]])
    pulsed = co.MatrixSystem(g, lambda W, t: (1.0 + 0.8 * np.sin(2.0 * t)) * weights * W)
    x0, along, w = (g.projected(rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))) for _ in range(3))
    composed, span = co.Composition(co.IsospectralGauss(), (0.75, -0.5, 0.75)), (0.3, 0.8)
    ready = co.prepare(pulsed.with_forces(force), composed, 0.1)
    ahead, behind = (ready.run(x0 + sign * d * along, span).x[-1] for sign in (1, -1))
    wanted = (ahead - behind) / (2 * d)
    np.testing.assert_allclose(ready.jvp(x0, span, {"x0": along})[1].x[-1], wanted, rtol=0, atol=1e-7)
    sol, pullback = ready.vjp(x0, span)
    at_end = np.zeros_like(sol.x)
    at_end[-1] = w
    assert abs(np.vdot(pullback(at_end)["x0"], along).real - np.vdot(w, wanted).real) < 1e-7


C1 = 1 / (2 - 2 ** (1 / 3))
COMPOSED = co.Composition(co.IsospectralGauss(), (C1, 1 - 2 * C1, C1))

NEAR = abs(np.subtract.outer(np.arange(5), np.arange(5)))
WEIGHTS = 1.0 / (1.0 + NEAR + (np.minimum.outer(NEAR[0], NEAR[0]) >= 2))
BLOCKS = co.MatrixAlgebra.sum(co.MatrixAlgebra("su", 2), co.MatrixAlgebra("so", 3))
MATRICES = {
    "parameters": co.systems.sphere_qg(N=4, lamb=2.0, gamma=0.5, rotation=0.5),
    "torus": co.systems.torus_euler(N=5),
    "two fields": co.systems.reduced_mhd(N=4),
    "carried field": co.systems.passive_scalar(N=4),
    "buoyancy": co.systems.thermal_qg(N=4, lamb=2.0, gamma=0.5, rotation=0.5),
    "real": co.systems.matrix_body((1.0, 1.5, 2.0, 3.0)),
    "function on blocks": co.MatrixSystem(BLOCKS, lambda W: WEIGHTS * W, linear=BLOCKS.projected(0.3j * WEIGHTS)),
}


def drawn(system, rng, members=()):
    """Return states of a system of matrices."""
    shape = (*members, *system.shape)
    x = rng.standard_normal(shape) + (1j * rng.standard_normal(shape) if system.complex else 0.0)
    return system.algebra.projected(x) / np.sqrt(system.algebra.N)


def stirred(strength, **more):
    """Return a function that makes a noise of matrices; they are single ones where the second field is only carried."""

    def noise(system):
        found = drawn(
            system, np.random.default_rng(5), (np.size(strength) if np.ndim(strength) < 2 else len(strength),)
        )
        elements = found[:, 0] if found.ndim == 4 and system.second_stream is None else found
        return F.HamiltonianNoise(tuple(elements), strength, seed=4, **more)

    return noise


def along_orbits(system, *forces):
    """Return a system with forces, or with those that functions of it make."""
    return system.with_forces(*(one(system) if callable(one) else one for one in forces))


DAMPED, HEATED = F.DoubleBracketDamping(0.4, 0.7), F.HeatBath(0.4, 0.7, temperature=0.3, seed=5)
ON_MATRICES = {
    "damping": ((DAMPED,), co.IsospectralGauss(), 1),
    "bath": ((HEATED,), co.IsospectralGauss(), 1),
    "composed": ((DAMPED,), COMPOSED, 1),
    "backward": ((DAMPED,), COMPOSED, -1),
    "damping, then bath": ((DAMPED, HEATED), co.IsospectralGauss(2), 1),
    "bath, then damping": ((HEATED, DAMPED), co.IsospectralGauss(), 1),
    "cold": ((F.HeatBath(0.4, temperature=0.0, seed=5),), co.IsospectralGauss(), 1),
    "hot": ((F.HeatBath(0.4, temperature=10.0, seed=5),), co.IsospectralGauss(), 1),
    "noise, then damping": ((stirred(0.4), DAMPED), co.IsospectralGauss(), 1),
    "damping, then noise": ((DAMPED, stirred((0.3, 0.2))), co.IsospectralGauss(2), 1),
    "noise, composed": ((stirred(((0.3, 0.1, 0.0), (0.2, -0.1, 0.4)), levels=1),), COMPOSED, 1),
    "noise of many turns": ((stirred((8.0, 10.0)),), co.IsospectralGauss(), 1),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("acting", ON_MATRICES)
@pytest.mark.parametrize("name", MATRICES)
def test_dampings_baths_and_noise_of_matrices(name, acting):
    """With streams of each kind, by x0, strengths, and the parameters of the streams."""
    base, (forces, method, direction) = MATRICES[name], ON_MATRICES[acting]
    draw = partial(drawn, base, members=(2,) if acting == "bath" else ())
    system, x0, end = along_orbits(base, *forces), draw(np.random.default_rng(3)), 0.5 + 4 * direction * H
    points = (0.5, 0.5 + (2 if system.has_noise else 1.3) * direction * H, end)
    gradient = assert_derivatives(changed(system), method, x0, (0.5, end), H, draw=draw, t_eval=points)
    strengths = ["alpha", "metric", "strength", *(["temperature"] if acting == "bath" else [])]
    for name in (name for name in gradient if name.split(".")[-1] in strengths):
        assert np.all(np.abs(gradient[name]) > 1e-5)


ALONG = DAMPED, HEATED, stirred((0.3, 0.2))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("force", ALONG, ids=["damping", "bath", "noise"])
@pytest.mark.parametrize("name", MATRICES)
def test_steps_of_matrices_in_the_kernels_have_the_tangents_of_numpy(name, force):
    base, rng = MATRICES[name], np.random.default_rng(4)
    system, x0, direction = along_orbits(base, force), drawn(base, rng), drawn(base, rng)
    matrix = co.stepper(system, co.IsospectralGauss(), H).tangent(x0)
    found = co.prepare(system, co.IsospectralGauss(), H).jvp(x0, (0.0, H), {"x0": direction})[1].x[-1]
    np.testing.assert_allclose(base.to_vector(found), matrix @ base.to_vector(direction), rtol=0, atol=1e-13)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("force", ALONG, ids=["damping", "bath", "noise"])
@pytest.mark.parametrize("name", ["two fields", "function on blocks"])
def test_cotangents_outside_of_the_algebra_are_projected(name, force):
    """By the flow of a force, which comes first and last, on each number of threads with the same bits."""
    base, rng, found = MATRICES[name], np.random.default_rng(6), list[dict[str, object]]()
    x0, other = drawn(base, rng, (3,)), rng.standard_normal((2, 3, *base.shape, 2)) @ [1.0, 1.0j]
    other[0] = 0.0
    for threads in (1, 2):
        ready = co.prepare(along_orbits(base, force), co.IsospectralGauss(), H, threads=threads)
        pullback = ready.vjp(x0, (0.0, H))[1]
        found += [pullback(one) for one in (other, base.algebra.projected(other))]
    np.testing.assert_allclose(found[0]["x0"], found[1]["x0"], rtol=0, atol=1e-13)
    np.testing.assert_allclose(base.algebra.projected(found[0]["x0"]), found[0]["x0"], rtol=0, atol=1e-13)
    assert all(np.array_equal(value, found[2][name]) for name, value in found[0].items())


@pytest.mark.parametrize("forces", [(DAMPED, HEATED), (stirred(0.3),)], ids=["dampings", "noise"])
def test_forces_along_orbits_of_matrices_take_bounded_work(forces):
    """They are differentiated by the kernels: in Python a flow took milliseconds."""
    base = co.systems.sphere_euler(N=8)
    ready = co.prepare(along_orbits(base, *forces), co.IsospectralGauss(), H)
    x0 = drawn(base, np.random.default_rng(3))
    ready.vjp(x0, (0.0, 1.0))
    with bounded_work(8.0):
        sol, pullback = ready.vjp(x0, (0.0, 2000 * H), save_every=500)
        pullback(np.ones(sol.x.shape))


@pytest.mark.parametrize(
    ("fluid", "force"),
    [
        ("torus_euler", F.Friction(lambda k: 0.1 * k)),
        ("torus_euler", F.BetaPlane(0.7)),
        ("sphere_euler", F.Viscosity(0.05)),
    ],
)
def test_substeps_of_several_lengths_decay_by_their_own_lengths(fluid, force):
    """Of modes of a fluid, around steps forward and backward, by the state and by the strength of the force."""
    s, rng = co.systems.get(fluid, N=5), np.random.default_rng(2)
    x0, direction, weight = (
        s.algebra.projected(rng.standard_normal((5, 5)) + 1j * rng.standard_normal((5, 5))) for _ in range(3)
    )
    ready, span, d = co.prepare(s.with_forces(force), COMPOSED, 0.05), (0.2, 0.5), 1e-5
    ahead, behind = (ready.run(x0 + sign * d * direction, span).x[-1] for sign in (1, -1))
    wanted = (ahead - behind) / (2 * d)
    tangent = ready.jvp(x0, span, {"x0": direction})[1].x[-1]
    np.testing.assert_allclose(tangent, wanted, rtol=0, atol=1e-8)
    sol, pullback = ready.vjp(x0, span)
    weights = np.zeros_like(sol.x)
    weights[-1] = weight
    gradient = pullback(weights)
    np.testing.assert_allclose(
        np.sum(gradient["x0"].conj() * direction).real, np.sum(weight.conj() * wanted).real, rtol=0, atol=1e-7
    )
    for name in gradient.keys() - {"x0", "rotation"}:
        field = name.split(".")[1]
        moved = (replace(force, **{field: getattr(force, field) + sign * d}) for sign in (1, -1))
        ahead, behind = (co.prepare(s.with_forces(one), COMPOSED, 0.05).run(x0, span).x[-1] for one in moved)
        wanted = np.sum(weight.conj() * (ahead - behind)).real / (2 * d)
        np.testing.assert_allclose(gradient[name], wanted, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("scale", [1e-7, 1e30])
def test_derivatives_follow_the_unit_of_the_momentum(scale):
    """Of a free body with moments and momenta in another unit, and of its damping."""

    def derivatives(unit):
        body = co.systems.rigid_body(inertia=unit * np.array([1.0, 2.0, 2.5]))
        system = body.with_forces(F.LinearDamping((0.3, 0.2, 0.1)), F.Torque(unit * np.array(AIM)))
        ready = co.prepare(system, co.Splitting(), H, attitude=True)
        sol, pullback = ready.vjp(unit * X3, (0.0, 1.0))
        gradient = pullback(sol.x / unit**2, attitude=sol.attitude)
        _, tangents = ready.jvp(unit * X3, (0.0, 1.0), {"x0": unit * X3, "Torque.torque": unit * X3})
        found = [unit * gradient["x0"], gradient["LinearDamping.rate"], unit * gradient["inertia"]]
        return [*found, unit * gradient["Torque.torque"], tangents.x / unit, tangents.attitude]

    for one, other in zip(derivatives(scale), derivatives(1.0), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.mark.parametrize(
    "function",
    [lambda x, gain: -gain * x * np.abs(x), lambda x, gain: np.minimum(gain * x, 0.306 * x)],
    ids=["modulus", "kink beside the gain"],
)
def test_functions_that_take_no_complex_numbers_are_differentiated_by_differences(function):
    """The kink is within the nodes of differences by the gain, so that nearer ones are taken."""
    force = F.Torque(function, arguments={"gain": 0.3})
    assert_derivatives(acting(BODY, force), co.Splitting(), X3, (0.5, 0.5 + 3 * H), H, attitude=True, error=2.0**-28)


def test_a_law_with_the_length_of_a_vector_that_vanishes_is_differentiated():
    """Quadratic drag on a body at rest: its derivative is zero, although that of the length is not defined."""
    for law in (lambda x: -0.3 * np.sqrt(x @ x) * x, lambda x: -0.3 * (x @ x) ** 0.5 * x):
        ready = co.prepare(BODY.with_forces(F.Torque(law)), co.Splitting(), H)
        sol, pullback = ready.vjp(np.zeros(3), (0.0, 4 * H))
        weights = np.zeros_like(sol.x)
        weights[-1] = X3
        np.testing.assert_allclose(pullback(weights)["x0"], X3, rtol=0, atol=1e-12)
        tangents = ready.jvp(np.zeros(3), (0.0, 4 * H), {"x0": X3})[1]
        np.testing.assert_allclose(tangents.x[-1], X3, rtol=0, atol=1e-12)


def size_of_gain(x, gain, factors):
    return -np.abs(gain) * factors * x


@pytest.mark.parametrize("gain", [-0.3, -1e-12])
def test_a_modulus_of_an_argument_is_noticed_however_weak_the_law(gain):
    """The complex step of the modulus has no derivative: differences are taken, whose rounding is that of the state."""
    force = F.Torque(size_of_gain, arguments={"gain": gain, "factors": (1.0, 2.0, 0.5)})
    ready, span = co.prepare(BODY.with_forces(force), co.Splitting(), H), (0.5, 0.5 + 4 * H)
    known = F.Torque(size_of_gain, arguments={"gain": -gain, "factors": (1.0, 2.0, 0.5)})
    of_known = co.prepare(BODY.with_forces(known), co.Splitting(), H)
    found, wanted = (one.jvp(X3, span, {"Torque.arguments.gain": 1.0})[1].x[-1] for one in (ready, of_known))
    exact = BODY.with_forces(F.LinearDamping(abs(gain) * np.array([1.0, 2.0, 0.5])))
    rates = (
        co.prepare(exact, co.Splitting(), H).jvp(X3, span, {"LinearDamping.rate": np.array([1.0, 2.0, 0.5])})[1].x[-1]
    )
    error = 1e-5 if gain == -0.3 else 64 * 2.0**-53 / abs(gain)
    np.testing.assert_allclose(found, -rates, rtol=0, atol=error)
    np.testing.assert_allclose(wanted, rates, rtol=0, atol=error)


@pytest.mark.parametrize("scale", [1e-7, 1.0, 1e30])
def test_arguments_of_laws_in_other_units_backward(scale):
    """Arrays and numbers, of members, with another force between: the formulas of the same forces are exact."""

    def law(x, t, rates, torque, ratio):
        return torque / ratio - rates * x

    values = {"rates": (0.3, 0.2, 0.1), "torque": tuple(scale * np.array(AIM)), "ratio": 2.0}
    x0, span = scale * np.outer([1.0, 0.5, 1.5], X3), (0.5, 0.5 - 6 * H)
    body = co.systems.rigid_body(inertia=scale * np.array([1.0, 2.0, 2.5]))
    ready = co.prepare(
        body.with_forces(F.Torque(law, arguments=values), F.LinearDamping(0.2)), co.Splitting(order=4), H
    )
    sol, pullback = ready.vjp(x0, span)
    found = pullback(sol.x / scale**2)
    d = 2.0**-10

    def difference(name, change):
        """Return the derivative of |x|^2 / 2 at all points by Richardson's extrapolation of runs."""

        def at(by):
            moved = {**values, name: np.asarray(values[name]) + by * np.asarray(change)}
            law_moved = F.Torque(law, arguments=moved)
            run = co.prepare(body.with_forces(law_moved, F.LinearDamping(0.2)), co.Splitting(order=4), H)
            return 0.5 * np.sum((run.run(x0, span).x / scale) ** 2)

        near, far = ((at(by) - at(-by)) / (2 * by) for by in (d, 2 * d))
        return (4 * near - far) / 3

    change = np.array([0.3, -0.5, 0.7])
    assert abs(found["Torque.arguments.rates"] @ change - difference("rates", change)) < 1e-8
    assert abs(scale * found["Torque.arguments.torque"] @ change - difference("torque", scale * change)) < 1e-8
    assert abs(found["Torque.arguments.ratio"] - difference("ratio", 1.0)) < 1e-8


def test_a_kink_at_the_state_is_differentiated_as_before():
    """A function that has two derivatives at the state is differentiated by differences on both sides."""
    force = F.Torque(lambda x: -0.3 * np.maximum(x, 0.0))
    ready = co.prepare(BODY.with_forces(force), co.Splitting(), H)
    _, pullback = ready.vjp(np.array([1.0, 0.0, 0.0]), (0.0, H))
    gradient = pullback(np.stack([np.zeros(3), [0.0, 1.0, 0.0]]))["x0"]
    one, other = (ready.run([1.0, by, 0.0], (0.0, H)).x[-1][1] / by for by in (1e-6, -1e-6))
    assert abs(one - other) > 1e-3
    np.testing.assert_allclose(gradient[1], 0.5 * (one + other), rtol=0, atol=1e-4)


def test_members_have_the_derivatives_of_single_runs():
    """Each from an attitude of its own."""
    system = BODY.with_forces(F.LinearDamping(FULL, toward=AIM), F.HeatBath(0.2, temperature=0.3, seed=5))
    ready, x0 = co.prepare(system, co.Splitting(), H, attitude=True), np.outer(np.linspace(0.5, 1.5, 35), X3)
    attitudes = Rotation.from_rotvec(np.linspace(0.0, 1.0, 35)[:, None] * AIM).as_matrix()
    sol, pullback = ready.vjp(x0, (0.5, 1.0), attitude=attitudes)
    weights = np.random.default_rng(2).standard_normal(sol.attitude.shape)
    found = pullback(sol.x, attitude=weights)
    parts = []
    for m in (0, 34):
        of_member = co.prepare(system.among(m, m + 1), co.Splitting(), H, attitude=True)
        one, pullback = of_member.vjp(x0[m], (0.5, 1.0), attitude=attitudes[m])
        assert np.array_equal(one.x, sol.x[:, m])
        parts.append((m, pullback(one.x, attitude=weights[:, m])))
    for m, gradient in parts:
        np.testing.assert_allclose(found["x0"][m], gradient["x0"], rtol=0, atol=1e-13 * np.abs(gradient["x0"]).max())


def of_members(*forces, count, build=co.systems.rigid_body):
    """Return systems with unlike energies, and with forces of unlike numbers by the `forces` of a factor near one."""
    factors = 1.0 + 0.1 * np.arange(count) / count
    bodies = [build((1.0, 2.0 * f, 2.5)) for f in factors]
    return [body.with_forces(*(force(f) for force in forces)) for body, f in zip(bodies, factors, strict=True)]


def damping(f):
    return F.LinearDamping((0.3 * f, 0.2, 0.1 * f), toward=(0.1, 0.2 * f, 0.4))


def driven(f):
    return F.Torque(law, arguments={"gain": 0.3 * f, "tilt": (0.1, 0.2, 0.4 * f)})


def sampled(f):
    return F.Sampled(F.Torque(lambda x, t, gain: np.sin(t) - gain * x[:3] ** 2, arguments={"gain": 0.3 * f}), H)


# Forces, a scheme, how many members, whether with the attitude, and in which direction of time.
BATCHES = {
    "damping": ((damping,), co.Splitting(), 45, False, 1),  # of one order of parts are 39, in two blocks of lanes
    "damping, then a law, backward": ((damping, driven), co.Splitting(order=4), 3, True, -1),
    "law, then a damping": ((driven, damping), co.Splitting(order=4), 9, False, 1),
    "matrix of rates": ((lambda f: F.LinearDamping(f * FULL, toward=AIM),), co.GaussLegendre(1), 3, True, 1),
    "torques": ((lambda f: F.Torque((0.1, 0.2 * f, 0.4)), damping), co.Splitting(parts="coordinates"), 4, True, -1),
    "on orbits": ((lambda f: F.DoubleBracketDamping(0.4 * f, (0.5, f, 2.0)), damping), co.Splitting(), 9, False, 1),
    "sampled": ((sampled, lambda f: F.Torque((0.1 * f, 0.2, 0.3))), co.Splitting(), 9, False, 1),
    "own functions": ((lambda f: F.Torque(lambda x: -f * x * x), damping), co.Splitting(), 3, True, 1),
    "noise": ((lambda f: F.HeatBath(0.3 * f, temperature=0.5 * f, seed=7), damping), co.Splitting(), 9, True, 1),
    "fields": ((lambda f: shaken(0.4 * f, AXIAL, CUBIC), damping), co.Splitting(), 9, True, 1),
}


@pytest.mark.parametrize("name", BATCHES)
def test_unlike_members_with_forces_have_the_derivatives_of_single_runs(name):
    """In one call of the loops, by their own constants and noise, on one and on two threads; and between steps."""
    forces, method, count, attitude, sign = BATCHES[name]
    held = name == "sampled"  # in the state
    build = partial(co.systems.body, attitude=False) if held else co.systems.rigid_body
    systems, rng = of_members(*forces, count=count, build=build), np.random.default_rng(5)
    x0, span = rng.uniform(0.2, 0.9, (count, systems[0].dim)), (0.5, 0.5 + sign * 4 * H)
    noisy = systems[0].has_noise
    options = {} if noisy or name == "sampled" else {"t_eval": [0.5, 0.5 + sign * 1.3 * H, span[1]]}
    found = []
    for threads in (1, 2):
        ready = co.prepare(co.batch(systems), method, H, attitude=attitude, threads=threads)
        directions = {name: rng.standard_normal((*v.shape, 2)) for name, v in [("x0", x0), *ready.parameters.items()]}
        sol, tangents = ready.jvp(x0, span, directions, **options)
        weights = {name: rng.standard_normal(value.shape) for name, value in outputs(sol).items()}
        _, pullback = ready.vjp(x0, span, **options)
        found.append((sol, tangents, pullback(**weights)))
        rng = np.random.default_rng(5)
        rng.uniform(0.2, 0.9, x0.shape)
    one, two = ([*outputs(tangents).values(), *gradient.values()] for _, tangents, gradient in found)
    assert all(map(np.array_equal, one, two))
    sol, tangents, gradient = found[-1]
    for m in {0, 1, count - 1}:
        # Loops of single runs have other lanes, of the vectors, whose products are the same numbers.
        single = co.prepare(systems[m].among(m, m + 1), method, H, attitude=attitude)
        own = {name: value[m] for name, value in directions.items()}
        alone, one = single.jvp(x0[m], span, own, **options)
        assert np.array_equal(sol.x[:, m], alone.x)
        assert all(np.array_equal(value, outputs(tangents)[name][:, m]) for name, value in outputs(one).items())
        by_one = single.vjp(x0[m], span, **options)[1](**{name: value[:, m] for name, value in weights.items()})
        assert {*by_one} == {*gradient}
        assert all(np.array_equal(gradient[name][m], value) for name, value in by_one.items())


def test_members_of_the_same_system_have_noise_of_their_own():
    """Beside another system, of which the derivatives are taken together."""
    first, second = of_members(lambda f: F.HeatBath(0.3 * f, temperature=0.5, seed=7), count=2)
    systems, span = [first, second, first, second], (0.5, 0.5 + 4 * H)
    ready = co.prepare(co.batch(systems), co.Splitting(), H)
    _, tangents = ready.jvp(X3, span, {"x0": np.tile(X3, (4, 1))})
    for m, system in enumerate(systems):
        alone = co.prepare(system.among(m, m + 1), co.Splitting(), H).jvp(X3, span, {"x0": X3})[1].x
        np.testing.assert_allclose(tangents.x[:, m], alone, rtol=0, atol=1e-14)


def test_members_of_which_one_needs_differences():
    """They have one rule, and are differentiated together or not by the parameters of each call."""
    laws = (lambda x, gain: -gain * x), (lambda x, gain: -(gain**3) * x)
    systems = [BODY.with_forces(F.Torque(law, arguments={"gain": 0.3})) for law in laws]
    ready, span, name = co.prepare(co.batch(systems), co.Splitting(), H), (0.5, 0.5 + 4 * H), "Torque.arguments.gain"
    assert ready.jvp(X3, span, {"x0": np.tile(X3, (2, 1))})[1].rule == {}
    sol, pullback = ready.vjp(X3, span)
    gradient = pullback(sol.x)
    assert gradient.rule[name] == ready.jvp(X3, span, {name: np.ones(2)})[1].rule[name] == "differences"
    for m, system in enumerate(systems):
        one, pullback = co.prepare(system, co.Splitting(), H).vjp(X3, span)
        np.testing.assert_allclose(gradient[name][m], pullback(one.x)[name], rtol=0, atol=1e-13)


def test_gradients_of_unlike_members_with_forces_take_few_times_those_of_an_ensemble():
    """Forces of members one after the other, with a call for each, took ten times as long."""
    count, x0 = 32, np.random.default_rng(5).uniform(0.2, 0.9, (32, 3))
    systems, times = of_members(damping, count=count), []
    for system in (systems[0], co.batch(systems)):
        ready = co.prepare(system, co.Splitting(), H)
        sol, pullback = ready.vjp(x0, (0.0, 400 * H), 400)
        pullback(sol.x)
        each = []
        for _ in range(5):
            began = time.process_time()
            ready.vjp(x0, (0.0, 400 * H), 400)[1](sol.x)
            each.append(time.process_time() - began)
        times.append(min(each))
    assert times[1] < 4 * times[0]


def test_gradients_of_long_runs_take_bounded_work():
    """The loop over steps is not in Python: a step there took two milliseconds."""
    system = BODY.with_forces(F.LinearDamping(0.01), F.DoubleBracketDamping(0.01))
    ready = co.prepare(system, co.Splitting(), H, attitude=True)
    ready.vjp(X3, (0.0, 1.0))
    with bounded_work(8.0):
        sol, pullback = ready.vjp(X3, (0.0, 10_000 * H), save_every=1000)
        pullback(np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape))


def taken_by(name):
    """Return a system with a registered force; None for forces on satellites, which are tested beside this file."""
    with suppress(ValueError):
        system = first_fitting(name)
        return None if system.has_attitude else system
    return None  # a noise that needs a larger grid


REGISTERED = {name: system for name in co.forces.names() if (system := taken_by(name)) is not None}


FLUIDS = {
    "torus": co.systems.torus_euler(N=5),
    "turning sphere": co.systems.sphere_euler(N=5, rotation=1.5),
    "mhd": co.systems.reduced_mhd(N=5),
    "scalar": co.systems.passive_scalar(N=5),
    "buoyancy": co.systems.thermal_qg(N=5, gamma=0.5),
    "layers": co.systems.layered_qg(N=5, gamma=[[3.0, -3.0], [-1.5, 1.5]], thicknesses=[1.0, 2.0], rotation=0.25),
    "body of matrices": co.systems.matrix_body((1.0, 2.0, 3.5, 4.0)),
}


def on_fluids():
    """Yield names of registered forces on systems of matrices, with these."""
    for (label, fluid), name in product(FLUIDS.items(), co.forces.names()):
        with suppress(TypeError, ValueError):  # forces that do not act on it
            yield f"{name} on {label}", fluid.with_forces(force_on(name, fluid))


REGISTERED |= dict(on_fluids())
REGISTERED["Friction of one layer"] = FLUIDS["layers"].with_forces(F.Friction(0.3, layer=1))
REGISTERED["Viscosity of the carried field"] = FLUIDS["buoyancy"].with_forces(F.Viscosity(0.03, layer="carried"))


@pytest.mark.thinned(12)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("place", ["alone", "before a damping", "behind a damping"])
@pytest.mark.parametrize("name", REGISTERED)
def test_every_registered_force_is_differentiated(name, place):
    alone = REGISTERED[name]
    damping = F.Friction(0.2) if getattr(alone, "fluid", None) is not None else F.LinearDamping(0.2)
    orders = {
        "alone": alone.forces,
        "before a damping": (*alone.forces, damping),
        "behind a damping": (damping, *alone.forces),
    }
    system = alone.unforced.with_forces(*orders[place])
    step = getattr(alone.forces[0], "period", H)
    step = step if np.ndim(step) == 0 and np.isfinite(step) else H

    def drawn(rng):
        entries = rng.standard_normal((2, *system.shape))
        return system.unforced.algebra.projected(entries[0] + 1j * entries[1] if system.complex else entries[0])

    draw, method = (drawn, co.IsospectralGauss()) if system.has_matrices else (None, co.Splitting())
    x0 = 0.3 + 0.4 * np.cos(1.0 + np.arange(system.dim)) if draw is None else draw(np.random.default_rng(3))
    span = 8 * step, 11 * step
    assert_derivatives(changed(system), method, x0, span, step, draw=draw, error=2.0**-24)
