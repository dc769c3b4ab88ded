"""Members that differ in coefficients of their energies, which share one table: they have the bits of runs alone."""

import tracemalloc

import numpy as np
import pytest

import coadjoint as co

STEP, SPAN = 1.0 / 64.0, (0.0, 0.5)
PAIRS = (3, 4), (3, 5), (4, 5)
METHODS = {
    "auto": co.Splitting(order=4),
    "gauss": co.GaussLegendre(2),
    "taylor": co.Taylor(order=8),
}


def assert_as_alone(systems, method, states=None, whole=None, members=None, **options):
    """Compare the members of a batch with runs of them alone, bit for bit."""
    if states is None:
        states = 0.3 * np.random.default_rng(len(systems)).standard_normal((len(systems), systems[0].dim))
    if whole is None:
        whole = co.prepare(co.batch(systems), method, STEP, **options).run(states, SPAN, save_every=4)
    largest = {}
    for m, one in enumerate(systems):
        if members is not None and m not in members:
            continue
        alone = co.prepare(one, method, STEP, **options).run(states[m], SPAN, save_every=4)
        assert np.array_equal(whole.x[:, m], alone.x), m
        assert np.array_equal(whole.energy[:, m], alone.energy), m
        for label, values in alone.casimirs.items():
            assert np.array_equal(whole.casimirs[label][:, m], values), (m, label)
        if "attitude" in options:
            assert np.array_equal(whole.attitude[:, m], alone.attitude), m
        for name, value in alone.balance(relative=False).items():
            largest[name] = max(largest.get(name, 0.0), value)
    if members is None:
        assert whole.balance(relative=False) == largest
    return whole


def test_products_cancel_in_some_members_only():
    """With equal coefficients of the top's axis some products of the field cancel, in a part of its rows or in all."""
    rng, systems = np.random.default_rng(0), []
    for equal in [0, 1, 2, 0, 1, 0, 1, 2, 0, 0, 1, 1] * 2:
        d = rng.uniform(0.5, 2.0, 6)
        if equal:
            d[4] = d[3]
        if equal == 2:
            d[5], d[1] = d[3], d[0]
        energy = {tuple(2 * int(i == k) for i in range(6)): float(d[k] / 2) for k in range(6)}
        energy |= {(2, 0, 1, 0, 1, 0): float(d[0] / 8), (0, 3, 0, 0, 0, 1): float(d[1] / 8)}
        systems.append(co.LiePoissonSystem(co.systems.heavy_top().algebra, co.Polynomial(energy)))
    for method in ("gauss", "taylor"):
        assert_as_alone(systems, METHODS[method])


def bodies(count, seed=1):
    rng = np.random.default_rng(seed)
    return [co.systems.rigid_body(np.sort(rng.uniform(1.0, 1.9, 3))) for _ in range(count)]


def test_products_of_quartic_energies_cancel_in_some_members_only():
    """Of a function of the length of an axis alone, r cross its gradient vanishes; not with other coefficients."""
    rng, systems = np.random.default_rng(1), []
    for equal in [0, 1, 0, 0, 1, 0, 0]:
        fourth, mixed = rng.uniform(0.5, 1.5, (2, 3))
        if equal:
            fourth[:] = mixed[:] = fourth[0]
        energy = {tuple(2 * int(i == k) for i in range(6)): 0.5 + 0.25 * k for k in range(3)}
        energy |= {tuple(4 * int(i == 3 + k) for i in range(6)): float(fourth[k]) for k in range(3)}
        energy |= {
            tuple(2 * int(i in pair) for i in range(6)): 2.0 * c for pair, c in zip(PAIRS, mixed.tolist(), strict=True)
        }
        systems.append(co.LiePoissonSystem(co.systems.heavy_top().algebra, co.Polynomial(energy)))
    # Rounding of the products, of the fourth power of the axis, reaches the digits of the momenta.
    states = np.random.default_rng(2).standard_normal((len(systems), 6)) * ([0.01] * 3 + [2.0] * 3)
    for method in ("auto", "gauss"):
        assert_as_alone(systems, METHODS[method], states)


@pytest.mark.parametrize("parameter", ["weights", "external", "pair"])
def test_polynomials_share_a_table(parameter, tables_built):
    """Of degree four, in coordinates that commute; a weight, and the coefficient of a power, of each member."""
    given = {"weights": (1.0, 2.0), "external": (0.0, 0.0, 0.5, 0.1), "pair": (0.0, 0.0, -0.5, 0.0, 0.25)}
    systems = []
    for scale in np.linspace(0.5, 1.5, 9):
        moved = [*given[parameter][:-1], scale * given[parameter][-1]]
        systems.append(co.systems.decorated_particles(**{**given, parameter: moved}))
    states = 0.5 + 0.1 * np.random.default_rng(4).standard_normal((len(systems), systems[0].dim))
    states[:, 4] = 1.0
    for name in ("auto", "gauss"):
        tables_built.clear()
        whole = co.prepare(co.batch(systems), METHODS[name], STEP).run(states, SPAN, save_every=4)
        assert len(tables_built) <= 2
        assert_as_alone(systems, METHODS[name], states, whole, members=(0, 4, 8))


def test_choices_that_rounding_decides_are_those_of_each_member():
    """Orders and shifts that tie exactly, or nearly, among members whose choices are clear."""
    ties = [(1.0, 1.0, 2.0), (1.0, 2.0, 2.0), (1.5, 1.5, 1.5), (1.0, 1.0 + 2e-16, 2.0), (1.0, 1.0 + 1e-9, 2.0)]
    clear = [(1.0, 1.5, 2.0), (2.0, 1.5, 1.0), (1.5, 1.0, 2.0), (1.0, 2.0, 2.5)]
    assert_as_alone([co.systems.rigid_body(one) for one in [*ties, *clear, *ties[::-1]]], METHODS["auto"])
    assert_as_alone([co.systems.heavy_top(one, lever=(0, 0, 1)) for one in [*ties, *clear]], METHODS["auto"])


def test_products_that_cancel_for_some_members():
    """An isotropic mass of a body in a fluid: a product of the field cancels, in other members it does not."""
    masses = [(1.5, 2.5, 2.0), (2.0, 2.0, 2.0), (1.5, 2.5, 2.25), (2.0, 2.0, 3.0), (1.5, 2.75, 2.0)]
    systems = [co.systems.kirchhoff_body(inertia=(1.0, 2.0, 3.0), mass=mass) for mass in masses]
    for method in ("auto", "gauss"):
        assert_as_alone(systems, METHODS[method])


def test_members_with_noise_keep_their_numbers():
    noise = co.forces.HeatBath(alpha=0.1, temperature=0.1, seed=3)
    systems = [one.with_forces(noise) for one in bodies(5)]
    states = np.random.default_rng(2).standard_normal((5, 3))
    method = co.Splitting(order=2)
    whole = co.prepare(co.batch(systems), method, STEP).run(states, SPAN)
    repeated = co.prepare(co.batch([systems[3]] * 5), method, STEP).run(np.tile(states[3], (5, 1)), SPAN)
    assert np.array_equal(repeated.x[:, 3], whole.x[:, 3])


SHARED = {
    "auto": (METHODS["auto"], {}, None),
    "gauss": (METHODS["gauss"], {}, None),
    "taylor": (METHODS["taylor"], {}, None),
    "attitude": (METHODS["auto"], {"attitude": "coadjoint"}, None),
    "forces": (METHODS["auto"], {}, co.forces.LinearDamping(0.1)),
}


@pytest.mark.parametrize("case", SHARED)
@pytest.mark.thinned(2)
def test_memory_of_a_prepared_batch(case):
    """A member takes a column of constants, not tables of its own; with forces copies of these constants."""
    method, options, force = SHARED[case]
    bound = 6500 if force else 2500  # bytes
    count = 500 if force else 2000
    systems, few = (
        co.batch([one.with_forces(force) for one in those] if force else those)
        for those in (bodies(count), bodies(3, 4))
    )
    co.prepare(few, method, STEP, **options)
    tracemalloc.start()
    prepared = co.prepare(systems, method, STEP, **options)
    used, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert prepared.system is systems
    assert used < bound * count and peak < 2 * bound * count, (used, peak)


def satellites(count):
    """Bodies of other inertia under torques of each kind: of the inertia, of closures, constant, sampled, damped."""
    rng, wheels = np.random.default_rng(7), 0.1 * np.eye(3)
    for _ in range(count):
        stiffness, phase, torque = rng.uniform(0.1, 0.3), rng.uniform(0.0, 6.0), rng.uniform(-0.1, 0.1, 3)
        body = co.systems.body(np.sort(rng.uniform(1.0, 1.9, 3)), wheels=wheels)
        yield body.with_forces(
            co.forces.GravityGradient(
                1.0, lambda t, phase=phase: np.array([np.cos(t + phase), np.sin(t + phase), 0.0])
            ),
            co.forces.ReactionWheels(co.forces.Pointing(stiffness, 0.2), 4.0 * STEP),
            co.forces.Torque(torque),
            co.forces.LinearDamping(rng.uniform(0.01, 0.1)),
        )


BODIES = {
    "satellites": lambda count: list(satellites(count)),
    "bodies": lambda count: [
        co.systems.bodies([(1.0, 1.5 + k / 64, 2.0), (2.0, 2.5, 3.0 + k / 32)], [1.0 + k / 16, 2.0])
        for k in range(count)
    ],
    "on orbits": lambda count: [co.systems.satellite_on_orbit((1.0, 1.5, 2.0 + k / 32)) for k in range(count)],
    "damped orbits": lambda count: [
        one.with_forces(co.forces.DoubleBracketDamping(0.1 + k / 64, metric=(1.0 + k / 8, 2.0, 3.0)))
        for k, one in enumerate(bodies(count))
    ],
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_and_forces_of_members_share_a_table(name, tables_built):
    """They have the bits of members alone; only in parts of other orders there are further tables."""
    systems = BODIES[name](9)
    state = np.concatenate([np.linspace(0.2, 0.9, systems[0].dim - 1), [1.0]])
    if name == "satellites":
        state = systems[0].state(angular_velocity=(0.3, -0.2, 0.1))
    for method in (co.Splitting(order=2), co.GaussLegendre(2)):
        tables_built.clear()
        whole = co.prepare(co.batch(systems), method, STEP).run(state, SPAN, save_every=4)
        assert len(tables_built) <= 6
        assert_as_alone(systems, method, np.tile(state, (9, 1)), whole)


def test_a_law_of_the_angular_velocity_that_members_share():
    """One object, which is evaluated with the inertia of each member."""
    law = co.forces.Torque(lambda omega: -0.25 * omega)
    systems = [co.systems.body((1.0 + k / 8, 1.5, 2.0)).with_forces(law) for k in range(3)]
    states = np.stack([one.state(angular_velocity=(0.3, -0.2, 0.1)) for one in systems])
    assert_as_alone(systems, co.Splitting(order=2), states)


def test_noise_of_members_at_temperatures_of_their_own(tables_built):
    """Each member has its stream: that of the member of this number in an ensemble at one temperature."""
    baths = [co.forces.HeatBath(alpha=0.1 + k / 64, temperature=0.1 + k / 32, seed=3) for k in range(5)]
    systems = [one.with_forces(bath) for one, bath in zip(bodies(5), baths, strict=True)]
    states = np.random.default_rng(2).standard_normal((5, 3))
    method = co.Splitting(order=2)
    whole = co.prepare(co.batch(systems), method, STEP).run(states, SPAN)
    assert len(tables_built) <= 6
    for m in range(5):
        repeated = co.prepare(co.batch([systems[m]] * 5), method, STEP).run(np.tile(states[m], (5, 1)), SPAN)
        assert np.array_equal(repeated.x[:, m], whole.x[:, m])


def test_a_force_that_cannot_act_names_its_member():
    """Samples of one member are not at steps, and the function of another one does not compile."""
    good = next(iter(satellites(1)))
    late = co.systems.body((1, 2, 2.5), wheels=0.1 * np.eye(3)).with_forces(
        *(co.forces.ReactionWheels(one.law, 0.3) if one.label == "ReactionWheels" else one for one in good.forces)
    )
    with pytest.raises(ValueError, match="period"):
        co.prepare(co.batch([good, good, late]), co.Splitting(), STEP)
    torques = [lambda x: -0.1 * x, lambda x: 0.1 * x * float(open.__name__ == "open")]
    with pytest.raises(TypeError, match="member 1"):
        co.prepare(
            co.batch([co.systems.rigid_body((1, 2, 2.5)).with_forces(co.forces.Torque(one)) for one in torques]),
            co.Splitting(),
            STEP,
        )
