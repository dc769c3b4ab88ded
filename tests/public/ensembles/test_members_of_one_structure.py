"""Members that differ in coefficients of their energies, which share one table: they have the bits of runs alone."""

import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import coadjoint as co
from matrix.forces import forces_on

STEP, SPAN, MEMBERS = 1.0 / 64.0, (0.0, 0.5), 6
METHODS = {
    "auto": co.Splitting(order=4),
    "coordinates": co.Splitting(order=2, parts="coordinates"),
    "composition": co.Composition(co.Splitting(order=2), (0.75, -0.5, 0.75)),
    "gauss": co.GaussLegendre(2),
    "frozen": co.ModifiedGaussLegendre(stages=1),
    "explicit": co.ExplicitRungeKutta(),
    "taylor": co.Taylor(order=8),
    "midpoint": co.SphericalMidpoint(),
}
SCHEMES = [method for name in co.methods.names() for method in co.methods.registry.scheme(name).examples()]


def varied(value, rng):
    """A parameter with its numbers changed by up to ten per cent; anything else unchanged."""
    if isinstance(value, float):
        return value * (1.0 + 0.1 * rng.random())
    if not isinstance(value, tuple | list | np.ndarray) or np.asarray(value).dtype != np.float64:
        return value
    return np.asarray(value) * (1.0 + 0.1 * rng.random(np.shape(value)))


def members_of(name):
    """The default system and others of other parameters, as far as its builder accepts them."""
    rng, first = np.random.default_rng(7), co.systems.get(name)
    systems = [first]
    for _ in range(3 * MEMBERS):
        try:
            systems.append(co.systems.get(name, **{p: varied(v, rng) for p, v in (first.parameters or {}).items()}))
        except (TypeError, ValueError):
            continue
        if len(systems) == MEMBERS:
            break
    return systems


def assert_as_alone(systems, method, states=None, whole=None, members=None, **options):
    """Compare the members of a batch with runs of them alone, bit for bit."""
    if states is None:
        states = 0.3 * np.random.default_rng(len(systems)).standard_normal((len(systems), systems[0].dim))
        if "z" in systems[0].casimirs:
            states[:, np.argmax(np.abs(systems[0].casimirs["z"].gradient(states[0])))] = 1.0
    if whole is None:
        whole = co.prepare(co.batch(systems), method, STEP, **options).run(states, SPAN, save_every=4)
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
    return whole


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning", "ignore:inertia")
@pytest.mark.parametrize("name", co.systems.names())
def test_ready_made_systems_of_several_parameters(name):
    systems = members_of(name)
    if not isinstance(systems[0], co.LiePoissonSystem) or systems[0].dim > 64 or len(systems) == 1:
        pytest.skip("no Lie-Poisson system with parameters that vary")
    try:
        co.batch(systems)
    except ValueError:
        pytest.skip("its parameters change the structure")
    compared = 0
    for label in ("auto", "gauss"):
        try:
            assert_as_alone(systems, METHODS[label])
        except ValueError as refused:
            assert "cannot be used" in str(refused)
            continue
        except co.IntegrationError:  # the motion of a member has no bound, or the step is too large
            continue
        compared += 1
    assert compared


def bodies(count, seed=1):
    rng = np.random.default_rng(seed)
    return [co.systems.rigid_body(np.sort(rng.uniform(1.0, 1.9, 3))) for _ in range(count)]


def tops(count, seed=1):
    rng = np.random.default_rng(seed)
    return [co.systems.heavy_top(np.sort(rng.uniform(1.0, 1.9, 3)), lever=rng.standard_normal(3)) for _ in range(count)]


def polynomials(count):
    """With coefficients in the linear, the quadratic and higher terms, and a constant."""
    return [
        co.LiePoissonSystem(
            co.algebras.so(3),
            co.Polynomial(
                {
                    (2, 0, 0): 0.5 + 0.01 * k,
                    (0, 3, 0): 0.1,
                    (0, 0, 2): 0.2,
                    (0, 1, 0): 0.3 * k + 0.1,
                    (0, 0, 0): 0.1 + k,
                }
            ),
        )
        for k in range(count)
    ]


def coupled(count):
    """Completed squares, whose forms depend on the coefficients in another way."""
    M = np.array([[1.0, 0.2, 0.1], [0.2, 0.6, 0.0], [0.1, 0.0, 0.3]])
    return [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M * (1.0 + 0.1 * k))) for k in range(count)]


def constants(count):
    """Linear parts that are zero for some, and constants of the energy."""
    return [
        co.LiePoissonSystem(
            co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25], linear=[0.0, float(k % 3), 0.1], constant=float(k))
        )
        for k in range(count)
    ]


def spins(count):
    """More invariants than fit in registers."""
    return [co.systems.spin_lattice(shape=5, exchange=1.0 + 0.1 * k) for k in range(count)]


def tied(count):
    """Tops of which some are symmetric: their fields have fewer products, or share them."""
    moments = [(1.0, 1.25, 2.0), (1.0, 1.0, 2.0), (1.0, 1.5, 1.75), (1.0, 2.0, 2.0), (1.0, 1.5, 2.0)]
    return [co.systems.heavy_top(moments[k % 5 if k < 8 else 2 + 2 * (k % 2)]) for k in range(count)]


def sums(count):
    """Two pieces with functions that are equal."""
    pieces = co.Separable({0: (np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x))})
    return [
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.5, 0.6 + 0.1 * k, 0.7]) + pieces) for k in range(count)
    ]


def energies(algebra, M, count, linear=False, size=1e-3, seed=3):
    """Quadratic energies near x.M.x/2, with the zeros of M."""
    rng, M = np.random.default_rng(seed), np.array(M)
    systems = []
    for k in range(count):
        change = size * rng.standard_normal(M.shape)
        N = M + (change + change.T) * (M != 0.0)
        systems.append(
            co.LiePoissonSystem(algebra, co.Quadratic(N, linear=[0.1 * (1 + k)] * len(M) if linear else None))
        )
    return systems


FULL = np.array([[1.0, 0.2, 0.1], [0.2, 0.6, 0.15], [0.1, 0.15, 0.3]])
PAIRS = np.array([[0.0, 0.7, 0.2], [0.7, 0.0, 0.0], [0.2, 0.0, 0.0]])


def squares(count):
    """Completed squares of forms that differ."""
    return energies(co.algebras.so(3), FULL, count)


def squares_with_linear_terms(count):
    return energies(co.algebras.so(3), FULL, count, linear=True)


def pairs_of_squares(count):
    """Squares along sums and differences of coordinates, for a zero diagonal, of which one vanishes."""
    return energies(co.algebras.so(3), PAIRS, count)


def squares_of_two_bodies(count):
    """Momenta that are coupled in pairs, and parts of several squares."""
    M = np.diag([1.0, 1.5, 2.0, 0.8, 1.2, 1.7])
    for i in range(3):
        M[i, i + 3] = M[i + 3, i] = 0.1 * (1 + i)
    return energies(co.algebras.so(4), M, count)


def squares_in_a_fluid(count):
    rng = np.random.default_rng(4)
    A = rng.standard_normal((6, 6))
    return energies(co.algebras.e(3), A @ A.T / 6 + np.eye(6), count, size=1e-5)


def different_squares(count):
    """Other pivots, zeros, singular and rational matrices, and coordinates that are not coupled."""
    singular = np.outer([1.0, 0.5, 0.25], [1.0, 0.5, 0.25])
    kinds = [FULL, FULL[::-1, ::-1], PAIRS, singular, np.round(4 * FULL) / 4, FULL * (np.eye(3) + np.eye(3)[::-1])]
    return [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((1.0 + 0.01 * k) * kinds[k % 6])) for k in range(count)]


SQUARES = [squares, squares_with_linear_terms, pairs_of_squares, squares_of_two_bodies, squares_in_a_fluid]

FAMILIES = {
    "squares": squares_with_linear_terms,
    "different squares": lambda count: different_squares(2 * count),
    "bodies": bodies,
    "tops": tops,
    "polynomials": polynomials,
    "coupled": coupled,
    "constants": constants,
    "spins": spins,
    "tied": tied,
}


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("method", [*METHODS.values(), *SCHEMES], ids=str)
def test_schemes_of_all_kinds(method, family):
    try:
        assert_as_alone(FAMILIES[family](MEMBERS), method)
    except ValueError as refused:
        assert any(reason in str(refused) for reason in ("needs", "cannot be used", "integrates", "changes its length"))
    except co.IntegrationError:  # at rest, or where a scheme is singular
        assert "speed" in str(method) or method.name in ("RadauEnergy", "ReversibleSteps")


@pytest.mark.parametrize("attitude", [None, "coadjoint", True])
@pytest.mark.parametrize("family", [*SQUARES, different_squares])
@pytest.mark.parametrize("parts", ["auto", "coordinates", "chosen"])
def test_completed_squares(family, parts, attitude):
    """Enough members for blocks of lanes and some that are left over."""
    systems = family(21)
    if parts == "chosen":
        choice = co.Splitting(order=2).program(systems[0]).choice
        parts = replace(choice, order=choice.order[::-1])
    options = {} if attitude is None else {"attitude": attitude}
    try:
        whole = assert_as_alone(systems, co.Splitting(order=2, parts=parts), members=range(0, 21, 4), **options)
    except ValueError as refused:
        assert "parts" in str(refused) or "representation" in str(refused)
        return
    method = co.Splitting(order=2, parts=parts)
    prepared = pickle.loads(pickle.dumps(co.prepare(co.batch(systems), method, STEP, **options)))
    assert np.array_equal(prepared.run(whole.x0, SPAN, save_every=4).x, whole.x)


SERIES = [
    co.Taylor(9),
    co.Taylor(4, projected=False),
    co.Taylor(tolerance=1e-9),
]


@pytest.mark.parametrize("span", [(0.75, 0.25), (0.5, 1.5)])
@pytest.mark.parametrize("family", [tops, polynomials, constants, spins, tied])
@pytest.mark.parametrize("method", SERIES, ids=str)
def test_series_of_members_as_lanes(method, family, span):
    """Blocks of lanes and members that are left over, some with another field; also where events are located."""
    systems = family(21)
    states = 0.3 * np.random.default_rng(9).standard_normal((21, systems[0].dim))
    crossings = co.Event(lambda x, t: x[0] - 0.01)
    for options in ({}, {"events": crossings}):
        run = (span, STEP, method), {"save_every": 4, **options}
        whole = co.integrate(co.batch(systems), states, *run[0], **run[1])
        for m, one in enumerate(systems):
            alone = co.integrate(one, states[m], *run[0], **run[1])
            assert np.array_equal(whole.x[:, m], alone.x) and np.array_equal(whole.energy[:, m], alone.energy), m
            assert whole.stats.evaluations >= alone.stats.evaluations > 0


@pytest.mark.parametrize("method", ["auto", "gauss"])
def test_functions_that_are_equal_are_shared(method):
    pytest.importorskip("numba")
    assert_as_alone(sums(3), METHODS[method])


@pytest.mark.parametrize("parts", ["auto", "coordinates", ((0, 3), (1, 4), (2, 5)), "tuned"])
def test_choices_of_parts(parts):
    systems = tops(MEMBERS)
    if parts == "tuned":
        parts = co.Splitting.tuned(systems[0], (0.1, 1.0, 0.1, 0.3, 0.0, 1.0)).parts
    try:
        assert_as_alone(systems, co.Splitting(order=2, parts=parts))
    except ValueError as refused:
        assert "parts" in str(refused)


def mixed():
    """Members of several structures in turn, one of them so often that it fills the lanes, and some repeated."""
    kinds = [[*bodies(5), *bodies(4, 2)], polynomials(4), coupled(3), constants(4)]
    systems = [kind[k] for k in range(9) for kind in kinds if k < len(kind)]
    return [*systems, systems[0], systems[3], *[systems[1]] * 40, *bodies(33, 3), systems[2]]


@pytest.mark.parametrize("method", ["auto", "gauss"])
def test_mixed_structures_blocks_threads_and_pickled_runs(method, tmp_path, no_fsync):
    systems = [co.LiePoissonSystem(co.algebras.so(3), one.hamiltonian) for one in mixed()]
    states = 0.3 * np.random.default_rng(5).standard_normal((len(systems), 3))
    prepared = co.prepare(co.batch(systems), METHODS[method], STEP, threads=1)
    whole = prepared.run(states, SPAN, save_every=4)
    assert_as_alone(systems, METHODS[method], states, whole, range(0, len(systems), 7))
    again = pickle.loads(pickle.dumps(prepared)).run(states, SPAN, save_every=4)
    threaded = co.prepare(co.batch(systems), METHODS[method], STEP, threads=3).run(states, SPAN, save_every=4)
    assert np.array_equal(again.x, whole.x) and np.array_equal(threaded.x, whole.x)
    assert np.array_equal(again.energy, whole.energy) and np.array_equal(threaded.energy, whole.energy)
    blocks = co.integrate_ensemble(
        co.batch(systems),
        states,
        SPAN,
        STEP,
        METHODS[method],
        save_every=4,
        archive=tmp_path / "a",
        members_per_block=17,
    )
    assert np.array_equal(np.asarray(blocks.x), whole.x) and np.array_equal(np.asarray(blocks.energy), whole.energy)
    back = prepared.run(whole.x[-1], SPAN[::-1], save_every=4)
    alone = co.prepare(systems[7], METHODS[method], STEP).run(whole.x[-1, 7], SPAN[::-1], save_every=4)
    assert np.array_equal(back.x[:, 7], alone.x)


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


@pytest.mark.parametrize("method", ["gauss", "taylor"])
def test_a_member_that_fails_leaves_the_others(method):
    systems = [
        co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(3, 0, 0): scale, (0, 2, 0): 1.0}), name=f"{scale:g}")
        for scale in (0.1, 0.2, 1e200, 0.3, 0.4, 0.5, 0.6, 0.7)
    ]
    states = np.full((8, 3), 0.5)
    states[2] *= 1e80
    prepared = co.prepare(co.batch(systems), METHODS[method], STEP)
    with pytest.raises(co.IntegrationError) as failed:
        prepared.run(states, SPAN, save_every=4)
    whole = failed.value.partial
    assert np.flatnonzero(whole.failed).tolist() == [2]
    assert_as_alone(systems, METHODS[method], states, whole, [0, 1, 3, 7])


def test_a_member_with_large_squares_fails_alone():
    systems = [
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((1e200 if k == 2 else 1 + 0.01 * k) * FULL))
        for k in range(6)
    ]
    states = np.full((6, 3), 0.5)
    states[2] *= 1e120
    with pytest.raises(co.IntegrationError, match="member 2") as failed:
        co.prepare(co.batch(systems), METHODS["auto"], STEP).run(states, SPAN, save_every=4)
    whole = failed.value.partial
    assert np.flatnonzero(whole.failed).tolist() == [2]
    assert_as_alone(systems, METHODS["auto"], states, whole, [0, 1, 3, 5])


def test_gradients_of_members_with_squares():
    systems = squares(9)
    states = np.random.default_rng(4).standard_normal((9, 3))
    solution, pullback = co.prepare(co.batch(systems), METHODS["auto"], STEP).vjp(states, SPAN)
    gradient = pullback(solution.x)
    for m, one in enumerate(systems):
        alone, pullback = co.prepare(one, METHODS["auto"], STEP).vjp(states[m], SPAN)
        for name, value in pullback(alone.x).items():
            assert np.array_equal(gradient[name][m], value), (m, name)


def test_members_with_noise_keep_their_numbers():
    noise = co.forces.HeatBath(alpha=0.1, temperature=0.1, seed=3)
    systems = [one.with_forces(noise) for one in bodies(5)]
    states = np.random.default_rng(2).standard_normal((5, 3))
    whole = co.prepare(co.batch(systems), METHODS["auto"], STEP).run(states, SPAN)
    repeated = co.prepare(co.batch([systems[3]] * 5), METHODS["auto"], STEP).run(np.tile(states[3], (5, 1)), SPAN)
    assert np.array_equal(repeated.x[:, 3], whole.x[:, 3])


@pytest.mark.parametrize("count", [MEMBERS, 33])
@pytest.mark.parametrize("attitude", [True, "coadjoint"])
@pytest.mark.parametrize(("method", "family"), [("auto", bodies), ("auto", tops), ("gauss", bodies), ("taylor", tops)])
def test_attitudes_of_members(method, family, attitude, count):
    """Multiples of Casimirs are subtracted from the energies of bodies, which rotate the attitude of each by another
    angle."""
    systems = family(count)
    whole = assert_as_alone(systems, METHODS[method], members=range(0, count, 5), attitude=attitude)
    x0, initial = whole.x[-1], whole.attitude[-1]
    prepared = co.prepare(co.batch(systems), METHODS[method], STEP, attitude=attitude)
    back = prepared.run(x0, SPAN[::-1], attitude=initial)
    alone = co.prepare(systems[4], METHODS[method], STEP, attitude=attitude).run(x0[4], SPAN[::-1], attitude=initial[4])
    assert np.array_equal(back.x[:, 4], alone.x) and np.array_equal(back.attitude[:, 4], alone.attitude)
    again = pickle.loads(pickle.dumps(prepared)).run(x0, SPAN[::-1], attitude=initial)
    assert np.array_equal(again.attitude, back.attitude)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("attitude", [False, "coadjoint"])
def test_members_with_forces(method, attitude):
    options = {"attitude": attitude} if attitude else {}
    if attitude and METHODS[method].properties(bodies(1)[0]).attitude == "none":
        pytest.skip("the scheme computes no attitude")
    damping = co.forces.LinearDamping(0.1, toward=(0.0, 0.1, 0.0))
    rng = np.random.default_rng(8)
    systems = [
        one.with_forces(damping if k % 3 else co.forces.LinearDamping(0.2), co.forces.Torque(rng.standard_normal(3)))
        for k, one in enumerate(bodies(MEMBERS))
    ]
    whole = assert_as_alone(systems, METHODS[method], **options)
    alone = co.prepare(systems[2], METHODS[method], STEP, **options).run(whole.x0[2], SPAN, save_every=4)
    for label in ("LinearDamping", "Torque"):
        assert np.array_equal(whole.work[label]["energy"][:, 2], alone.work[label]["energy"])


@pytest.mark.parametrize("method", ["auto", "gauss"])
@pytest.mark.parametrize("name", ["gyrostat", "rigid_body"])
def test_members_with_every_force(name, method):
    """Forces that read the angular velocity differ between members although their parameters are equal."""
    systems = [co.systems.get(name, inertia=(1.0, 2.0, third)) for third in (2.5, 2.25)]
    forces = forces_on(systems[0])
    assert co.forces.Pointing in map(type, forces)
    for force in forces:
        if not force.random:  # noise differs between members
            assert_as_alone([one.with_forces(force) for one in systems], METHODS[method])


@pytest.mark.parametrize("count", [3, 33])
@pytest.mark.parametrize("method", [METHODS["coordinates"], METHODS["auto"], METHODS["gauss"]], ids=str)
def test_completed_squares_of_one_form(method, count):
    """Energies that differ in their linear terms alone: offsets of squares are exact sums of these."""
    M = np.array([[1.0, 0.2, 0.1], [0.2, 0.6, 0.0], [0.1, 0.0, 0.3]])
    rng = np.random.default_rng(6)
    systems = [
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=rng.standard_normal(3))) for _ in range(count)
    ]
    assert_as_alone(systems, method, members=range(0, count, 4))


SHARED = {
    "auto": (METHODS["auto"], {}, None),
    "gauss": (METHODS["gauss"], {}, None),
    "taylor": (METHODS["taylor"], {}, None),
    "attitude": (METHODS["auto"], {"attitude": "coadjoint"}, None),
    "forces": (METHODS["auto"], {}, co.forces.LinearDamping(0.1)),
    "squares": (METHODS["auto"], {}, None),
}


@pytest.mark.parametrize("case", SHARED)
def test_memory_of_a_prepared_batch(case):
    """A member takes a column of constants, not tables of its own; with forces copies of these constants."""
    method, options, force = SHARED[case]
    bound = 6500 if force else 2500  # bytes
    count = 500 if force else 2000
    family = squares if case == "squares" else bodies
    systems, few = (
        co.batch([one.with_forces(force) for one in those] if force else those) for those in (family(count), family(3))
    )
    co.prepare(few, method, STEP, **options)
    tracemalloc.start()
    prepared = co.prepare(systems, method, STEP, **options)
    used, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert prepared.system is systems
    together = (1 << 24) if case == "squares" else 0  # numbers of some members, while their squares are completed
    assert used < bound * count and peak < 2 * bound * count + together, (used, peak)


@pytest.mark.parametrize("method", ["auto", "taylor"])
@pytest.mark.parametrize("count", [33, 70])
def test_states_between_steps_of_members_in_several_rows_of_lanes(count, method):
    """Several times in each step, so that rows of columns follow each other more than once."""
    rng, systems = np.random.default_rng(count), tops(count)
    states, times = 0.3 * rng.standard_normal((count, 6)), [0.001, 0.003, 0.01, 0.02, 0.021, 0.5]
    method, thinned = METHODS[method], (0, 31, 32, count - 1)
    whole = co.prepare(co.batch(systems), method, STEP).run(states, (0.0, 0.5), t_eval=times)
    for m in thinned:
        alone = co.prepare(systems[m], method, STEP).run(states[m], (0.0, 0.5), t_eval=times)
        assert np.array_equal(whole.x[:, m], alone.x), m
