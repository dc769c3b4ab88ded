"""Runs with inputs have the bits of a new system with that linear term, for every scheme and many algebras."""

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables import inputs as input_tables
from coadjoint.program.parts import decompose
from coadjoint.program.parts.offsets_of_squares import offsets_of_squares
from coadjoint.program.parts.split import split
from coadjoint.runs.inputs import Inputs
from coadjoint.systems.hamiltonians.linear_term import linear_of, with_linear
from verification.schemes_under_test import schemes, serves
from verification.systems_under_test import full_matrix

pytestmark = pytest.mark.thinned(3)

U, STEP, SPANS = 2.0**-53, 0.0625, ((0.0, 0.5), (0.5, 0.0))


def spins(count):
    """A chain of spins with exchange and anisotropy, a field on each."""
    M = np.diag(np.tile([1.2, 1.4, 1.7], count))
    for s in range(count - 1):
        for k in range(3):
            M[3 * s + k, 3 * s + 3 + k] = M[3 * s + 3 + k, 3 * s + k] = -0.5
    return co.algebras.copies(co.algebras.so(3), count), M


ALGEBRAS = {
    "so(3)": (co.algebras.so(3), np.diag([1.0, 0.5, 1 / 3]), -1),
    "so(3), full": (co.algebras.so(3), full_matrix(3, 3), +1),
    "e(3)": (co.algebras.e(3), full_matrix(4, 6), -1),
    "so(4)": (co.algebras.so(4), np.diag(np.linspace(0.5, 1.5, 6)), +1),
    "A3,7": (co.algebras.get("A3,7", a=1.75), full_matrix(5, 3), -1),
    "spins": (*spins(3), +1),
}


def system(name, linear):
    algebra, M, sign = ALGEBRAS[name]
    return co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign)


def numbers(name, seed=0, *members):
    """Return a state, a linear term, and another one, or one for each member."""
    n, rng = ALGEBRAS[name][0].dim, np.random.default_rng(seed)
    return rng.uniform(0.3, 0.9, n), rng.uniform(-0.15, 0.15, n), rng.uniform(-0.15, 0.15, (*members, n))


def assert_same(one, other):
    assert np.array_equal(one.x, other.x) and np.array_equal(one.energy, other.energy)
    for name, values in other.casimirs.items():
        assert np.array_equal(one.casimirs[name], values)
    for name, drift in other.drift().items():
        assert np.array_equal(one.drift()[name].tenths, drift.tenths)
    assert one.attitude is None or np.array_equal(one.attitude, other.attitude)


# Every scheme where squares are completed and where not; elsewhere one of each family.
EVERYWHERE = ("so(3), full", "spins")
FAMILIES = ("Splitting 4", "Composition of Splitting", "GaussLegendre 3", "Modified 2 gradient", "Iterated 2", "rk4")
FAMILIES += ("RadauEnergy 2", "Taylor 5", "Projected(base=Splitting(order=2))")
PAIRS = [
    (scheme, name)
    for name in ALGEBRAS
    for scheme, method in schemes().items()
    # Free bodies take no inputs on their own coordinates.
    if "free body" not in scheme
    and (name in EVERYWHERE or scheme in FAMILIES)
    and serves(method, system(name, numbers(name)[1]))
]


@pytest.mark.thinned(24)
@pytest.mark.parametrize(("scheme", "name"), PAIRS)
def test_run_with_inputs_equals_run_of_a_new_system(scheme, name):
    method = schemes()[scheme]
    x, before, linear = numbers(name)
    attitude = False if method.properties(system(name, before)).attitude == "none" else "coadjoint"
    ready = co.prepare(system(name, before), method, STEP, inputs=True, attitude=attitude)
    for span in SPANS:
        expected = co.integrate(system(name, linear), x, span, STEP, ready.method, attitude=attitude, save_every=3)
        assert_same(ready.run(x, span, 3, linear=linear), expected)
    own = co.integrate(system(name, before), x, SPANS[0], STEP, ready.method, attitude=attitude)
    assert_same(ready.run(x, SPANS[0]), own)
    if "coordinates" not in scheme:
        linear[::2] = 0.0
        sol = ready.run(x, SPANS[0], linear=linear)
        assert_same(sol, co.integrate(sol.system, x, SPANS[0], STEP, sol.method, attitude=attitude))


@pytest.mark.parametrize(
    "scheme", ["Splitting 4", "GaussLegendre 2", "Taylor 5", "rk4", "Projected(base=Splitting(order=2))"]
)
@pytest.mark.parametrize("name", ["so(3)", "e(3)", "spins"])
def test_inputs_per_member(scheme, name):
    method = schemes()[scheme]
    x, before, linear = numbers(name, 1, 5)
    ready = co.prepare(system(name, before), method, STEP, inputs=True, threads=2)
    states = x * np.linspace(0.8, 1.2, 5)[:, None]
    together, of_one_state = ready.run(states, SPANS[0], linear=linear), ready.run(x, SPANS[0], linear=linear)
    for m in range(5):
        assert np.array_equal(together.x[:, m], ready.run(states[m], SPANS[0], linear=linear[m]).x)
        assert np.array_equal(of_one_state.x[:, m], ready.run(x, SPANS[0], linear=linear[m]).x)
        assert np.array_equal(together.energy[:, m], ready.run(states[m], SPANS[0], linear=linear[m]).energy)
    assert len(together.system) == 5 and np.array_equal(linear_of(together.system[4].hamiltonian, len(x)), linear[4])
    shared = ready.run(states, SPANS[0], linear=linear[2])
    assert np.array_equal(shared.x[:, 3], ready.run(states[3], SPANS[0], linear=linear[2]).x)


@pytest.mark.parametrize(
    "method", [co.Splitting(order=4), co.Splitting(order=2, parts="coordinates"), co.GaussLegendre(3)], ids=str
)
@pytest.mark.parametrize("name", ["so(3)", "so(3), full", "e(3)", "A3,7"])
def test_zero_input_converges_to_no_input(name, method):
    """In the limit of small steps, since the parts for the inputs may change the order of the splitting."""
    x, _, _ = numbers(name)
    ready = co.prepare(system(name, None), method, STEP / 4, inputs=True)
    exact = co.integrate(system(name, None), x, SPANS[0], STEP / 4, co.GaussLegendre(6)).x[-1]
    tolerance = 5 * (STEP / 4) ** method.order + 1e-13
    assert np.abs(ready.run(x, SPANS[0], linear=np.zeros(len(x))).x[-1] - exact).max() < tolerance
    assert np.array_equal(ready.run(x, SPANS[0]).x, ready.run(x, SPANS[0], linear=np.zeros(len(x))).x)


def kinds():
    """Hamiltonians with a linear term, and the same with other coefficients of the last two coordinates."""
    well = (lambda y: 0.25 * y**4, lambda y: y**3, lambda y: 3 * y**2)
    cubic = co.Polynomial({(3, 0, 0): 0.2, (0, 2, 0): 0.5, (0, 0, 2): 0.25, (0, 1, 0): 0.3, (0, 0, 1): -0.4})
    yield cubic, co.Polynomial({**cubic.monomials, (0, 1, 0): 0.6, (0, 0, 1): -0.7})
    first, second, third = (
        ((0,), co.Separable({0: well})),
        ((1,), co.Quadratic([0.5], [0.3])),
        ((2,), co.Separable({0: well})),
    )
    fields = [((k,), co.Quadratic(0.0, linear=[b])) for k, b in ((1, 0.6), (2, -0.7))]
    changed = ((1,), co.Quadratic([0.5], [0.6]))
    yield co.SplitHamiltonian([first, second, third]), co.SplitHamiltonian([first, changed, third, fields[1]])
    yield co.Separable({0: well, 2: well}), co.SplitHamiltonian([first, third, *fields])


@pytest.mark.long
def test_hamiltonians_of_all_kinds_with_linear_terms():
    x, new = np.array([0.4, -0.3, 0.5]), np.array([0.6, -0.7])
    for H, changed in kinds():
        for method in (co.Splitting(order=2), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")):
            ready = co.prepare(co.LiePoissonSystem(co.algebras.sl(2), H), method, STEP, inputs=(1, 2))
            expected = co.integrate(co.LiePoissonSystem(co.algebras.sl(2), changed), x, SPANS[0], STEP, ready.method)
            assert_same(ready.run(x, SPANS[0], linear=new), expected)
    skew = co.PoissonSystem(
        lambda x: np.array([[0.0, x[2], 0.1], [-x[2], 0.0, x[0]], [-0.1, -x[0], 0.0]]), co.Quadratic(np.ones(3))
    )
    ready = co.prepare(skew, co.GaussLegendre(2), STEP, inputs=True)
    linear = np.array([0.1, 0.2, -0.3])
    changed = co.PoissonSystem(skew.structure_function, co.Quadratic(np.ones(3), linear=linear))
    assert_same(ready.run(x, SPANS[0], linear=linear), co.integrate(changed, x, SPANS[0], STEP, co.GaussLegendre(2)))


def test_calls_with_inputs_reuse_the_tables(monkeypatch):
    x, before, linear = numbers("e(3)", 2, 40)
    ready = co.prepare(system("e(3)", before), co.Splitting(order=4), STEP, inputs=True)
    ready.run(x, SPANS[0], linear=linear[0])

    def refuse(*_):
        raise AssertionError

    monkeypatch.setattr(decompose, "split", refuse)
    monkeypatch.setattr(co.Splitting, "loop", refuse)
    monkeypatch.setattr(input_tables, "offsets_of_squares", refuse)
    for own in linear:
        ready.run(x, SPANS[0], linear=own)
    ready.run(x, SPANS[0], linear=linear)


@pytest.mark.parametrize("scheme", ["Splitting 4", "GaussLegendre 2", "RadauEnergy 2", "Taylor 5"])
def test_threads_share_a_run_with_different_inputs(scheme):
    x, before, linear = numbers("so(4)", 3, 8)
    ready = co.prepare(system("so(4)", before), schemes()[scheme], STEP / 4, inputs=True, threads=1)
    expected = [ready.run(x, (0, 2), linear=own).x for own in linear]
    gate = threading.Barrier(len(linear))

    def work(m):
        gate.wait()
        return [ready.run(x, (0, 2), linear=linear[m]).x for _ in range(3)]

    with ThreadPoolExecutor(len(linear)) as pool:
        found = list(pool.map(work, range(len(linear))))
    assert all(np.array_equal(x, expected[m]) for m, runs in enumerate(found) for x in runs)


def test_named_inputs_take_coordinates_in_any_shape():
    algebra, M, _ = ALGEBRAS["spins"]
    chain, x = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=np.full(9, 0.1))), numbers("spins")[0]
    ready = co.prepare(chain, co.Splitting(order=2), STEP, inputs={"ends": [[0, 1, 2], [8, 7, 6]], "middle": (4,)})
    ends = np.arange(6.0).reshape(2, 3) / 7
    linear = np.full(9, 0.1)
    linear[[0, 1, 2, 8, 7, 6]], linear[4] = ends.ravel(), -0.3
    sol = ready.run(x, SPANS[0], ends=ends, middle=[-0.3])
    assert np.array_equal(linear_of(sol.system.hamiltonian, 9), linear)
    assert np.array_equal(sol.x, co.integrate(with_linear(chain, linear), x, SPANS[0], STEP, ready.method).x)
    assert sol.energy[-1] == pytest.approx(sol.system.energy(sol.x[-1]), rel=1e-13)
    several = ready.run(x, SPANS[0], ends=np.stack([ends, 2 * ends]), middle=[-0.3])
    assert np.array_equal(several.x[:, 0], sol.x)
    assert np.array_equal(several.x[:, 1], ready.run(x, SPANS[0], ends=2 * ends, middle=[-0.3]).x)


def test_states_preserve_their_shape():
    class Column(co.LiePoissonSystem):
        shape = (3, 1)

    column = Column(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), -1)
    x, ready = np.array([[0.3], [0.4], [0.5]]), co.prepare(column, None, STEP, inputs=True)
    assert np.array_equal(ready.run(x, SPANS[0]).x, co.integrate(column, x, SPANS[0], STEP, ready.method).x)
    assert ready.run(x, SPANS[0], linear=np.ones((2, 3))).x.shape == (9, 2, 3, 1)


def test_stepper_with_inputs():
    x, before, linear = numbers("e(3)", 4)
    s = system("e(3)", before)
    for method in (co.Splitting(order=2), co.GaussLegendre(2)):
        step = co.stepper(s, method, 0.125, inputs=(3, 4, 5))
        for gravity in (linear[3:], np.zeros(3)):
            after = step(x, linear=gravity)
            moved, K = step.both(x, attitude="coadjoint", linear=gravity)
            assert np.array_equal(moved, after)
            assert np.array_equal(K, step.group(x, attitude="coadjoint", linear=gravity))
            assert np.abs(K @ after - x).max() < 64 * U
            near = [(step(x + d, linear=gravity) - step(x - d, linear=gravity)) / 2e-5 for d in 1e-5 * np.eye(6)]
            assert np.abs(step.tangent(x, linear=gravity) - np.transpose(near)).max() < 1e-8
        assert step.tangent_by(x, linear=linear[3:]) == "formula"
    with pytest.raises(ValueError, match="at one state"):
        step.tangent(x, linear=np.zeros((2, 3)))


def test_both_returns_state_and_group_element():
    body, x = co.systems.rigid_body((1, 2, 3)), np.array([0.3, 1.0, -0.4])
    step = co.stepper(body, co.Splitting(order=2), -0.125)
    g0 = co.integrate(body, x, (0, 1), 0.125, attitude=True).attitude[-1]
    after, g = step.both(x, g0)
    assert np.array_equal(after, step(x)) and np.array_equal(g, step.group(x, attitude=g0))
    many, elements = step.both(np.stack([x, 2 * x]), np.stack([g0, np.eye(3)]))
    assert np.array_equal(many[0], after) and np.array_equal(elements[0], g)
    assert np.array_equal(elements[1], step.group(2 * x))
    assert np.array_equal(step.both(x)[1], step.group(x))
    with pytest.raises(TypeError, match="give the initial group element as g"):
        step.both(x, attitude=np.eye(3))
    with pytest.raises(ValueError, match="attitude is False"):
        step.both(x, attitude=False)


@pytest.mark.long
def test_run_is_repeated_from_its_scheme():
    """Its parts are explicit: the modified energy is that of the run, and a description rebuilds the scheme."""
    x, before, linear = numbers("e(3)")
    linear[:4] = 0.0
    ready = co.prepare(system("e(3)", before), co.Splitting(order=2), STEP, inputs=True)
    sol = ready.run(x, (0, 4), linear=linear)
    wander, modified = (np.ptp(values) for values in (sol.energy, sol.modified_energy(order=4)))
    assert modified < STEP * wander
    parts = sol.method.parts
    again = co.Splitting(parts=parts.to_mapping())
    assert again == sol.method and parts.linear == tuple(range(6)) and "linear=(0, 1" in repr(parts)
    assert np.array_equal(co.integrate(sol.system, x, (0, 4), STEP, again).x, sol.x)
    tuned = co.Splitting.tuned(system("e(3)", before), x)
    assert co.prepare(system("e(3)", before), tuned, STEP, inputs=True).method.parts.order == tuned.parts.order
    with pytest.raises(ValueError, match="parts names coordinate 5"):
        co.integrate(system("so(3)", None), x[:3], SPANS[0], STEP, again)


def test_offsets_of_squares_are_exact_rationals():
    rng = np.random.default_rng(7)
    for name in ("so(3), full", "e(3)"):
        algebra, M, _ = ALGEBRAS[name]
        linear = rng.standard_normal(algebra.dim) * 10.0 ** rng.integers(-8, 8, algebra.dim)
        parts = split(co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear)))
        ((angles, rule),) = offsets_of_squares(parts)
        assert angles == list(range(algebra.dim))
        for angle, factors, below, value in zip(angles, rule.factors, rule.denominators, rule.at(linear), strict=True):
            exact = sum(f * Fraction(linear[k]) for k, f in zip(rule.coordinates, factors, strict=True))
            assert Fraction(exact, below) == Fraction(parts.offset[angle])
            assert value == float(parts.offset[angle])


def test_wrong_inputs_are_refused():
    body = co.systems.rigid_body((1, 2, 3))
    x = (0.1, 1.0, 0.2)
    ready = co.prepare(body, None, 0.1, inputs={"rotors": (0, 1, 2)})
    cases = [
        (ValueError, "no input of this run 'rotor'|rotors", {"rotor": np.zeros(3)}),
        (
            ValueError,
            r"rotors has the shape \(2,\).*\(3,\), or \(members, 3\)",
            {"rotors": (1, 2)},
        ),
        (ValueError, "rotors contains NaN", {"rotors": (1, 2, np.nan)}),
        (TypeError, "rotors is 'fast'", {"rotors": "fast"}),
    ]
    for kind, words, given in cases:
        with pytest.raises(kind, match=words):
            ready.run(x, (0, 1), **given)
    steep = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1.0, 0.7, 0.0], [0.7, 0.9, 0.3], [0.0, 0.3, 1.0]]))
    apart = co.Splitting(order=2, parts="coordinates")
    with pytest.raises(ValueError, match="the linear term is too large"):
        co.prepare(steep, apart, 0.1, inputs=True).run(x, (0, 1), linear=(1.7e308, -1.7e308, 1.7e308))
    with pytest.raises(ValueError, match=r"x0 has 3 members.*inputs.* 2"):
        ready.run(np.tile(x, (3, 1)), (0, 1), rotors=np.zeros((2, 3)))
    with pytest.raises(TypeError, match="prepared without inputs"):
        co.prepare(body, None, 0.1).run(x, (0, 1), linear=np.zeros(3))
    two = co.prepare(body, None, 0.1, inputs={"a": (0,), "b": (1, 2)})
    with pytest.raises(ValueError, match=r"b has the shape \(3, 2\)"):
        two.run(x, (0, 1), a=np.zeros((2, 1)), b=np.zeros((3, 2)))
    given = [
        (ValueError, "coordinate 1 more than once", {"a": (0, 1), "b": (1,)}),
        (ValueError, "run from 0 to 2", (0, 3)),
        (TypeError, "whole numbers from 0 to 2", (0.5,)),
        (TypeError, "whole numbers from 0 to 2", ()),
        (ValueError, "inputs is empty", {}),
        (ValueError, "'attitude', which is reserved", {"attitude": (0,)}),
        (TypeError, "valid Python identifier", {"two words": (0,)}),
    ]
    for kind, words, inputs in given:
        with pytest.raises(kind, match=words):
            co.prepare(body, None, 0.1, inputs=inputs)
    with pytest.raises(TypeError, match="inputs are for one system"):
        co.prepare(co.batch([body, body]), None, 0.1, inputs=True)
    whole = co.Hamiltonian(lambda x: x[0] ** 2, lambda x: np.array([2 * x[0], 0.0, 0.0]))
    with pytest.raises(TypeError, match="Hamiltonian, which has no linear term"):
        co.prepare(co.LiePoissonSystem(co.algebras.so(3), whole), co.GaussLegendre(2), 0.1, inputs=True)
    split_up = co.SplitHamiltonian([((0,), co.Quadratic(2.0)), ((0,), co.Quadratic(1.0))])
    with pytest.raises(ValueError, match=r"pieces 0 and 1 .* coordinate 0"):
        co.prepare(co.LiePoissonSystem(co.algebras.so(3), split_up), None, 0.1, inputs=True)


def coupled(kind, n):
    """Coordinates that are all coupled, some by entries beside which the diagonal is small."""
    if kind == "dense":
        M = full_matrix(1, n)
        M[3, 3] = M[4, 4] = 0.0
        M[3, 4] = M[4, 3] = 2.0
        return M
    M = np.diag(np.linspace(0.5, 1.5, n))
    for k in range(n - 1):
        M[k, k + 1] = M[k + 1, k] = 0.25 + 0.01 * k
    M[7, 7] = M[8, 8] = 0.0
    return M


@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_inputs_beyond_the_limit_of_exact_squares(kind):
    algebra, n = (co.algebras.so(7), 21) if kind == "dense" else (co.algebras.copies(co.algebras.so(3), 12), 36)
    M, rng = coupled(kind, n), np.random.default_rng(5)
    x, before, linear = rng.uniform(-0.5, 0.5, (3, n))
    linear[:3] = 0.0
    for where in (np.arange(n), np.array([2, 9, 5])):
        ready = co.prepare(
            co.LiePoissonSystem(algebra, co.Quadratic(M, linear=before), -1, casimirs={}), None, STEP, inputs=where
        )
        new = before.copy()
        new[where] = linear[where]
        changed = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=new), -1, casimirs={})
        sol = ready.run(x, SPANS[0], linear=linear[where])
        assert_same(sol, co.integrate(changed, x, SPANS[0], STEP, ready.method))
        exact = co.integrate(changed, x, SPANS[0], STEP, co.GaussLegendre(4)).x[-1]
        assert np.abs(sol.x[-1] - exact).max() < 5 * STEP**2


def test_python_steps_take_no_inputs():
    class Called(co.methods.StepMethod):
        order, explicit, symmetric, compiles = 1, True, False, False

        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

        def step(self, system, x, t, h):
            return x + h * system.vector_field(x, t)

    with pytest.raises(ValueError, match=r"takes no inputs for rigid_body: .*tables\.whole"):
        co.prepare(co.systems.rigid_body((1, 2, 3)), Called(), 0.1, inputs=True)


@pytest.mark.parametrize("shape", [(3,), (3, 1)])
def test_inputs_in_any_order_of_coordinates(shape):
    body, x = co.systems.rigid_body((1, 2, 3)), np.array([0.4, -0.3, 0.5])
    field = np.array([[0.1, -0.2, 0.4], [0.3, 0.5, -0.6]])
    for where in itertools.permutations(range(3)):
        inputs = Inputs(body, {"field": np.reshape(where, shape)})
        shared, each = inputs.read({"field": field[0].reshape(shape)}), inputs.read({"field": field.reshape(2, *shape)})
        assert shared[list(where)].tolist() == field[0].tolist() and each[:, list(where)].tolist() == field.tolist()
    ready = co.prepare(body, co.Splitting(order=2), STEP, inputs={"field": np.reshape((2, 0, 1), shape)})
    found = ready.run(x, SPANS[0], field=field.reshape(2, *shape))
    for m in range(2):
        expected = co.integrate(with_linear(body, field[m][[1, 2, 0]]), x, SPANS[0], STEP, ready.method)
        assert np.array_equal(found.x[:, m], expected.x)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_states_at_any_time_use_the_inputs_of_the_run(way):
    """Also if the array of inputs is changed afterwards."""
    x, before, linear = numbers("e(3)", 6, 3)
    ready = co.prepare(system("e(3)", before), co.GaussLegendre(2), STEP, inputs=(3, 4, 5))
    times, given = 0.25 + way * np.array([0.0, 0.1, 0.55, 1.0]), linear[:, 3:].copy()
    together = ready.run(x, (0.25, 0.25 + way), 4, linear=given)
    given[:] = 7.0
    found = together.at(times)
    for m in range(3):
        alone = ready.run(x, (0.25, 0.25 + way), 4, linear=linear[m, 3:])
        own, asked = alone.at(times), ready.run(x, (0.25, 0.25 + way), t_eval=times, linear=linear[m, 3:])
        assert np.array_equal(found.x[:, m], own.x) and np.array_equal(found.energy[:, m], own.energy)
        # From a saved point four steps at most, whose iterations begin from another guess: some roundings each.
        assert np.abs(own.x - asked.x).max() < 16 * 50 * U and np.abs(own.energy - asked.energy).max() < 16 * 50 * U
        assert abs(own.energy[-1] - own.energy[0]) < 0.1 * STEP**2 < np.abs(own.energy[0] - found.energy[0, m - 1])


def product_of_ends(x):
    return x[0] * x[5]


# Functions of time and state, which change sign however the state moves.
OTHER = co.Event(lambda x, t: np.sin(4.0 * t - x[5]), name="other")
END = co.Event(lambda x, t: np.cos(0.5 * t + x[0]), terminal=True, name="end")


@pytest.mark.thinned(5)
@pytest.mark.parametrize(
    "method",
    [
        co.Splitting(order=2),
        co.Splitting(order=2, parts="coordinates"),
        co.GaussLegendre(2),
        co.ReversibleSteps(co.GaussLegendre(1), 0.1),
        co.Projected(co.ExplicitRungeKutta("rk4")),
    ],
    ids=str,
)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_events_and_observables_with_inputs_per_member(method, way):
    x, before, linear = numbers("e(3)", 8, 3)
    attitude = False if method.properties(system("e(3)", before)).attitude == "none" else "coadjoint"
    observe, events = {"product": product_of_ends}, [OTHER, END]
    ready = co.prepare(system("e(3)", before), method, STEP, inputs=True, attitude=attitude, observe=observe)
    span, times = (0.7, 0.7 + 8 * way), 0.7 + way * np.array([0.0, 0.03, 2.125, 7.9])
    together = ready.run(x, span, 16, linear=linear, events=events)
    between = ready.run(x, span, t_eval=times, linear=linear)
    stopped = 0
    for m in range(3):
        own = system("e(3)", linear[m])
        options = {"attitude": attitude, "observe": observe}
        expected = co.integrate(own, x, span, STEP, ready.method, save_every=16, events=events, **options)
        alone = ready.run(x, span, 16, linear=linear[m], events=events)
        for found in (alone.events, together.events.of(m)):
            for name in ("t", "x", "which", "direction", "attitude"):
                assert np.array_equal(getattr(found, name), getattr(expected.events, name)), name
        assert_same(alone, expected)
        assert alone.t_span == expected.t_span and alone.stats.steps == expected.stats.steps
        assert np.array_equal(alone.observed["product"], expected.observed["product"])
        stopped += len(expected.events["end"])
        seen = co.integrate(own, x, span, STEP, ready.method, t_eval=times, **options)
        assert np.array_equal(between.x[:, m], seen.x) and np.array_equal(between.energy[:, m], seen.energy)
        assert np.array_equal(between.observed["product"][:, m], seen.observed["product"])
        assert attitude is False or np.array_equal(between.attitude[:, m], seen.attitude)
        for name, values in seen.casimirs.items():
            assert np.array_equal(between.casimirs[name][:, m], values)
    assert stopped == 3 and len(together.events["other"]) >= 3


def test_names_of_parameters_are_no_names_of_the_linear_term():
    satellite = co.systems.gyrostat(inertia=(1, 2, 3), rotors=(0, 0, 0.5))
    with pytest.raises(ValueError, match=r"'rotors', a parameter of gyrostat, .*coefficients of the linear term"):
        co.prepare(satellite, None, 0.1, inputs={"rotors": (0, 1, 2)})
    with pytest.raises(ValueError, match="'field', a parameter of spin_lattice"):
        co.prepare(co.systems.spin_lattice(shape=2), co.Splitting(order=2), 0.1, inputs={"field": (0, 1, 2)})
    own = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, 3], linear=[0, 0, 1]), sign=-1)
    assert co.prepare(own, None, 0.1, inputs={"linear": (0, 2), "field": (1,)}).takes_inputs
    pushed = satellite.with_forces(co.forces.Torque((0, 0, 0)))
    ready = co.prepare(pushed, co.Splitting(order=2), 0.1, inputs={"rotors": "Torque"})  # a torque is no coefficient
    assert ready.run((1, 0, 0), (0, 0.1), rotors=(0, 0, 1)).x.shape == (2, 3)
