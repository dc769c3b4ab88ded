"""A scheme of the user's own, in Python: it runs wherever a scheme runs, compiled by Numba or not."""

import dataclasses
import warnings

import numpy as np
import pytest
from own_schemes import NOTHING, Asking, Classical, Failing, Interpreted, OwnKahan, Relaxed

import coadjoint as co
from coadjoint.kernels.functions import step_functions
from coadjoint.kernels.functions.step_functions import StepFunction

pytestmark = pytest.mark.thinned(3)

RNG = np.random.default_rng(10)
C1 = 1 / (2 - 2 ** (1 / 3))
JUMPS = (C1, 1 - 2 * C1, C1)


def cubic(n):
    exponents = [tuple(int(k == i) + 2 * int(k == (i + 1) % n) for k in range(n)) for i in range(n)]
    return co.Polynomial({e: 0.1 * (i + 1) for i, e in enumerate(exponents)})


SYSTEMS = {
    "so(3)": co.systems.rigid_body(inertia=(1, 2, 3)),
    "e(3), full": co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, np.ones(6))),
    "A3,7, sign -1": co.LiePoissonSystem(co.algebras.get("A3,7", a=0.5), co.Quadratic([1.0, 2, 3]), sign=-1),
    "so(4), cubic": co.LiePoissonSystem(co.algebras.so(4), cubic(6)),
    "driven": co.LiePoissonSystem(
        co.algebras.so(3),
        co.Hamiltonian(lambda x, t: x @ x * np.cos(t) + x[0], lambda x, t: 2 * np.cos(t) * x + np.array([1.0, 0, 0])),
    ),
    "J(x)": co.PoissonSystem(
        lambda x: x[0] * np.array([[0.0, x[2], -x[1]], [-x[2], 0.0, x[0]], [x[1], -x[0], 0.0]]),
        co.Quadratic([1.0, 2, 3]),
    ),
}


def start_of(system):
    return 0.4 * np.cos(np.arange(system.dim) + 1.0)


def schemes_for(name):
    # Derivatives of functions are not given here, so that Kahan's method has none.
    return [Classical(), Relaxed(0.5)] + ([] if name in ("driven", "J(x)") else [OwnKahan()])


CASES = [(name, scheme) for name in SYSTEMS for scheme in schemes_for(name)]


@pytest.mark.thinned(10)
@pytest.mark.parametrize(("name", "scheme"), CASES, ids=str)
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_the_compiled_step_is_the_step(name, scheme, h):
    system = SYSTEMS[name]
    function = StepFunction(scheme, system)
    assert function.compiled
    x0, t0 = start_of(system), 0.3
    sol = co.integrate(system, x0, (t0, t0 + 4 * h), abs(h), scheme)
    x = x0
    for k in range(4):
        x = scheme.step(system, x, t0 + k * h, h)
    assert np.max(np.abs(sol.x[-1] - x)) < 200 * system.dim * 2.0**-53 * max(1.0, np.max(np.abs(x)))
    # It moves, and the way the field says.
    moved = system.vector_field(x0, t0)
    assert (sol.x[1] - x0) @ moved * h > 0


@pytest.mark.long
def test_all_that_a_compiled_step_may_ask():
    polynomial = co.Polynomial({(2, 0, 0): 0.5, (0, 2, 1): 0.3, (1, 1, 1): -0.2, (0, 0, 0): 7.0})
    systems = [
        co.LiePoissonSystem(co.algebras.get("A3,7", a=0.5), polynomial, sign=-1),
        co.LiePoissonSystem(
            co.algebras.e(3), co.Quadratic.from_polynomial(co.Polynomial({(2,) + (0,) * 5: 1.0, (0,) * 6: 3.0}))
        ),
    ]
    for system in systems:
        function = StepFunction(Asking(), system)
        assert function.compiled
        x0 = start_of(system)
        found = co.integrate(system, x0, (0, 0.3), 0.1, Asking()).x[-1]
        x = x0
        for k in range(3):
            x = Asking().step(system, x, 0.1 * k, 0.1)
        assert np.max(np.abs(found - x)) < 1e-14


def test_a_complex_step_is_compared_with_a_difference():
    """A step that drops the imaginary part of a factor is no analytic function."""

    @dataclasses.dataclass(frozen=True)
    class Dropping(co.methods.StepMethod):
        order, explicit, symmetric = 1, True, False

        def properties(self, system):
            return NOTHING

        def step(self, system, x, t, h):
            return x * (1 + h * np.real(x))

    step, x = co.stepper(SYSTEMS["so(3)"], Dropping(), 0.1), np.array([1.0, -2.0, 0.5])
    assert step.tangent_by(x) == "differences"
    assert np.max(np.abs(step.tangent(x) - np.diag(1 + 0.2 * x))) < 1e-8


def test_the_classical_method_is_the_one_that_is_built_in():
    for name, system in SYSTEMS.items():
        x0 = start_of(system)
        own, known = (co.integrate(system, x0, (0, 2), 0.05, m) for m in (Classical(), co.ExplicitRungeKutta("rk4")))
        assert np.max(np.abs(own.x - known.x)) < 40 * 64 * 2.0**-53, name
        assert own.energy == pytest.approx(known.energy, abs=1e-12)
        assert own.stats.steps == 40 and own.stats.evaluations == 40


@pytest.mark.long
def test_ensembles_batches_and_threads_are_the_members_alone():
    system = SYSTEMS["e(3), full"]
    x0 = start_of(system) * RNG.uniform(0.5, 1.5, (11, 1))
    whole = co.integrate(system, x0, (0, 1), 0.05, OwnKahan(), threads=2, save_every=3)
    for m in (0, 4, 10):
        alone = co.integrate(system, x0[m], (0, 1), 0.05, OwnKahan(), save_every=3)
        assert np.array_equal(alone.x, whole.x[:, m]) and np.array_equal(alone.energy, whole.energy[:, m])
        assert all(alone.drift()[name] == whole.drift()[name].members[m] for name in alone.drift())
    bodies = [co.systems.rigid_body(inertia=(1, 2, third)) for third in (2.25, 2.5, 2.75)]
    states = RNG.standard_normal((3, 3))
    together = co.integrate(co.batch(bodies), states, (0, 1), 0.05, OwnKahan())
    for m, body in enumerate(bodies):
        assert np.array_equal(together.x[:, m], co.integrate(body, states[m], (0, 1), 0.05, OwnKahan()).x)


def test_inputs_reach_compiled_steps():
    system, linear = SYSTEMS["e(3), full"], 0.2 * np.cos(np.arange(6.0))
    other = co.LiePoissonSystem(system.algebra, co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, linear))
    ready = co.prepare(system, OwnKahan(), 0.05, inputs=True)
    once = co.integrate(other, start_of(system), (0, 1), 0.05, OwnKahan())
    assert np.array_equal(ready.run(start_of(system), (0, 1), linear=linear).x, once.x)
    several = ready.run(start_of(system), (0, 1), linear=np.stack([0 * linear, linear]))
    assert np.array_equal(several.x[:, 1], once.x) and not np.array_equal(several.x[:, 0], once.x)


def test_orders_and_compositions():
    system = SYSTEMS["so(4), cubic"]
    x0 = start_of(system)
    exact = co.integrate(system, x0, (0, 1), 0.02, co.GaussLegendre(4)).x[-1]
    own = co.Composition(OwnKahan(), JUMPS)
    assert (own.order, own.symmetric) == (4, True)
    body = SYSTEMS["so(3)"]
    truth = body.exact((1, 0.2, 0.5), 2.0)
    for scheme, order in ((OwnKahan(), 2), (own, 4), (Classical(), 4)):
        errors = [
            np.max(np.abs(co.integrate(body, (1, 0.2, 0.5), (0, 2), h, scheme).x[-1] - truth)) for h in (0.1, 0.05)
        ]
        assert 2.0 ** (order - 0.4) < errors[0] / errors[1] < 2.0 ** (order + 0.7)
    assert np.max(np.abs(co.integrate(system, x0, (0, 1), 0.02, Classical()).x[-1] - exact)) < 1e-7
    nested = co.Composition(co.Composition(OwnKahan(), (0.5, 0.5)), (0.25, 0.75))
    x = x0
    for fraction in (0.125, 0.125, 0.375, 0.375):
        x = OwnKahan().step(system, x, 0.0, 0.1 * fraction)
    assert np.max(np.abs(co.stepper(system, nested, 0.1)(x0) - x)) < 1e-14


def test_steppers_and_their_tangents():
    system = SYSTEMS["e(3), full"]
    x0 = start_of(system)
    step = co.stepper(system, OwnKahan(), 0.1)
    assert np.max(np.abs(step(x0) - OwnKahan().step(system, x0, 0.0, 0.1))) < 1e-14
    assert step.tangent_by(x0) == "complex step"
    known = co.stepper(system, co.ExplicitRungeKutta("rk4"), 0.1)
    own = co.stepper(system, Classical(), 0.1)
    assert known.tangent_by(x0) == "formula"
    assert np.max(np.abs(own.tangent(x0) - known.tangent(x0))) < 1e-14


def test_differences_where_nothing_else_is_to_be_had():
    @dataclasses.dataclass(frozen=True)
    class Rough(co.methods.StepMethod):
        order, explicit, symmetric = 1, True, False

        def properties(self, system):
            return NOTHING

        def step(self, system, x, t, h):
            return np.asarray(x, dtype=float) + h * np.abs(x) * x

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        step = co.stepper(SYSTEMS["so(3)"], Rough(), 0.1)
        x = np.array([1.0, -2.0, 0.5])
        assert step.tangent_by(x) == "differences"
        assert np.max(np.abs(step.tangent(x) - np.diag(1 + 0.2 * np.abs(x)))) < 1e-8


def test_choose_takes_it():
    found = co.choose(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 10), 1e-4, methods=[OwnKahan(), Classical()])
    assert isinstance(found.method, OwnKahan | Classical)
    sol = co.integrate(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 10), method=OwnKahan(), accuracy=1e-4)
    assert np.max(np.abs(sol.x[-1] - SYSTEMS["so(3)"].exact((1, 0.2, 0.5), 10.0))) < 1e-4


def test_what_numba_cannot_compile_runs_in_python_and_says_so_once(monkeypatch):
    monkeypatch.setattr(step_functions, "_warned_types", set())
    with pytest.warns(RuntimeWarning, match="the steps of Interpreted are Python calls") as said:
        sol = co.integrate(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 1), 0.1, Interpreted())
        again = co.integrate(SYSTEMS["so(3)"], np.ones((5, 3)) * 0.3, (0, 1), 0.1, Interpreted(), threads=2)
    assert sum(each.category is RuntimeWarning for each in said) == 1
    x = np.array([1, 0.2, 0.5])
    for k in range(10):
        x = Interpreted().step(SYSTEMS["so(3)"], x, 0.1 * k, 0.1)
    assert np.array_equal(sol.x[-1], x) and again.x.shape == (11, 5, 3)


class Scaled(co.methods.StepMethod):
    """Parameters of every kind that a compiled step reads, as attributes of the class."""

    order, explicit, symmetric = 1, True, False
    factor, shifts, kind, power, turned = 0.5, (0.25, -0.5, 0.125), "plain", 2, False
    _hidden = 3.0

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        f = system.vector_field(x, t)
        if self.kind == "plain":
            f = f**self.power
        if self.turned:
            f = -f
        return x + self.factor * h * (f + np.array(self.shifts))


class Faster(Scaled):
    factor = 2.0


class FasterAgain(Faster):
    power, kind = 3, "plain"


class Turned(Scaled):
    turned, shifts = True, (1.0, 2.0, 3.0)


class Both(FasterAgain, Turned):
    factor = 0.75


class Back(Both):
    """An attribute of the first class again, under those that were redefined."""

    factor, turned = Scaled.factor, Scaled.turned


@dataclasses.dataclass(frozen=True)
class Adjusted(Turned):
    """Fields, one of which was an attribute of a base class."""

    factor: float = 1.5
    other: str = "none"
    shifts: tuple[float, ...] = (0.0, 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class AdjustedAgain(Adjusted):
    factor: float = 4.0


INHERITED = [Scaled(), Faster(), FasterAgain(), Turned(), Both(), Back(), Adjusted(), Adjusted(0.25), AdjustedAgain()]
INHERITED += [Adjusted(2.0, shifts=(1.0, 0.0, 0.0)), AdjustedAgain(other="plain")]


@pytest.mark.parametrize("scheme", INHERITED, ids=lambda scheme: repr(scheme).partition(" object")[0])
def test_parameters_that_are_inherited_redefined_or_fields_are_those_of_the_scheme(scheme):
    names, values = step_functions._parameters(scheme)
    assert {"factor", "shifts", "kind", "power", "turned", "order", "explicit"} <= set(names)
    assert len(set(names)) == len(names) and not any(name.startswith("_") for name in names)
    for name, value in zip(names, values, strict=True):
        assert value == getattr(scheme, name) and type(value) is type(getattr(scheme, name)), name


@pytest.mark.long
@pytest.mark.parametrize("scheme", [Back(), AdjustedAgain()], ids=lambda scheme: type(scheme).__name__)
def test_a_compiled_step_has_the_parameters_of_a_derived_scheme(scheme):
    system = SYSTEMS["so(3)"]
    assert StepFunction(scheme, system).compiled
    x = start_of(system)
    found = co.integrate(system, x, (0.3, 0.6), 0.1, scheme).x[-1]
    for k in range(3):
        x = scheme.step(system, x, 0.3 + 0.1 * k, 0.1)
    assert np.max(np.abs(found - x)) < 1e-14


@dataclasses.dataclass(frozen=True)
class InPlace(co.methods.StepMethod):
    """A step in Python that changes the state that it was given, and keeps it."""

    given: list = dataclasses.field(default_factory=list)
    result: str = "same"
    compiles = False
    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        before = x.copy()
        self.given.append(x)
        x *= 0.5
        return {"same": x, "list": list(x), "float32": x.astype(np.float32), "whole": np.rint(before).astype(int)}[
            self.result
        ]


@pytest.mark.parametrize("result", ["same", "list", "float32", "whole"])
def test_a_step_in_python_owns_the_state_that_it_is_given(result):
    """It may be changed and kept; what is returned is converted, and a step from the same state is the same."""
    system, x0 = SYSTEMS["so(3)"], np.array([4.0, -2.0, 8.0])
    scheme = InPlace(result=result)
    sol = co.integrate(system, x0, (0, 0.3), 0.1, scheme, threads=1)
    factor = 1.0 if result == "whole" else 0.5
    np.testing.assert_array_equal(sol.x, np.outer(factor ** np.arange(4.0), x0))
    assert x0.tolist() == [4.0, -2.0, 8.0]
    # A trial step may come first; the last three are those of the run, each in memory of its own.
    np.testing.assert_array_equal(scheme.given[:3], 0.5 * sol.x[:3])


def test_steps_that_do_not_compile_are_reported_once_for_each_scheme(monkeypatch):
    class Another(Interpreted):
        pass

    monkeypatch.setattr(step_functions, "_warned_types", set())
    system = SYSTEMS["so(3)"]
    with pytest.warns(RuntimeWarning, match="the steps of") as said:
        for scheme in (Interpreted(), Another(), Interpreted(), Another()):
            StepFunction(scheme, system)
    assert [str(one.message).split()[3] for one in said] == ["Interpreted", "Another"]


@pytest.mark.filterwarnings("ignore:the steps of")
def test_an_exception_of_a_step_is_returned_once():
    function = StepFunction(Failing(), SYSTEMS["so(3)"])
    state, new = np.ones(3), np.full(3, 7.0)
    call = lambda t: function._callback(None, state.ctypes.data, t, 0.1, new.ctypes.data)  # noqa: E731
    assert call(0.0) == 0 and function.raised() is None and not np.any(new == 7.0)
    assert call(1.0) == 1 and isinstance(function.raised(), LookupError) and function.raised() is None


@pytest.mark.filterwarnings("ignore:the steps of")
@pytest.mark.parametrize("members", [1, 5])
def test_what_a_step_in_python_raises_comes_out_of_the_run(members):
    x0 = np.ones((members, 3)) * np.arange(1, 4) / 4 if members > 1 else (0.25, 0.5, 0.75)
    with pytest.raises(LookupError, match=r"nothing is known at t = 0\.6"):
        co.integrate(SYSTEMS["so(3)"], x0, (0, 2), 0.1, Failing(), threads=2)
    # The next run is as if nothing had been.
    assert co.integrate(SYSTEMS["so(3)"], x0, (0, 0.5), 0.1, Failing()).x.shape[0] == 6


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the steps of")
def test_a_step_that_is_no_state_is_refused_by_name():
    @dataclasses.dataclass(frozen=True)
    class Short(co.methods.StepMethod):
        order, explicit, symmetric = 1, True, False
        kind: str = "short"

        def properties(self, system):
            return NOTHING

        def step(self, system, x, t, h):
            return {"short": x[:2], "complex": x + 1j, "text": "no"}[self.kind]

    for kind, said in (("short", r"shape \(2,\)"), ("complex", "complex numbers"), ("text", "array of")):
        with pytest.raises(TypeError, match=f"the step of Short returned .*{said}.*it must return 3 real numbers"):
            co.integrate(SYSTEMS["so(3)"], (1, 0, 0), (0, 1), 0.1, Short(kind))


@pytest.mark.filterwarnings("ignore:the steps of")
def test_a_step_that_reads_what_matrices_do_not_have_is_refused_with_advice():
    system = co.systems.torus_euler(N=3)
    with pytest.raises(TypeError, match=r"OwnKahan reads system\.jacobian, which torus_euler .*in `properties`"):
        co.integrate(system, system.random(1, degrees=(1, 1)), (0, 1), 0.1, OwnKahan())

    @dataclasses.dataclass(frozen=True)
    class Mistaken(OwnKahan):
        def step(self, system, x, t, h):
            return self.no_field * x

    with pytest.raises(AttributeError, match="no_field"):
        co.integrate(SYSTEMS["so(3)"], (1, 0, 0), (0, 1), 0.1, Mistaken())


def test_a_step_that_leaves_the_numbers_fails_alone():
    """Forward steps of a growing member overflow; the others go on, with their bits."""
    system = SYSTEMS["so(4), cubic"]
    x0 = np.stack([start_of(system), 1e150 * start_of(system), 0.5 * start_of(system)])
    with pytest.raises(
        co.IntegrationError, match=r"in step 1, at t = 0, the step failed, or did not return one finite number.*1 of 3"
    ):
        co.integrate(system, x0, (0, 1), 0.1, Classical())
    try:
        co.integrate(system, x0, (0, 1), 0.1, Classical())
    except co.IntegrationError as error:
        assert error.partial.failed.tolist() == [False, True, False]
        assert np.array_equal(error.partial.x[:, 2], co.integrate(system, x0[2], (0, 1), 0.1, Classical()).x)


def test_the_registry_knows_it_while_it_is_registered():
    assert "OwnKahan" not in co.methods.names()
    assert co.methods.register(OwnKahan) is OwnKahan
    try:
        assert "OwnKahan" in co.methods.names() and co.methods.get("OwnKahan") == OwnKahan()
        co.methods.register(OwnKahan)  # once more is no other scheme
        with pytest.raises(ValueError, match="there is another scheme OwnKahan"):
            co.methods.register(dataclasses.make_dataclass("OwnKahan", [], bases=(OwnKahan,), frozen=True))
        sol = co.integrate(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 1), 0.1, co.Composition(OwnKahan(), JUMPS))
        assert co.methods.registry.from_description(co.methods.registry.description_of(sol.method)) == sol.method
    finally:
        co.methods.registry.forget("OwnKahan")
    with pytest.raises(ValueError, match="'OwnKahan'"):
        co.methods.get("OwnKahan")


def test_what_is_no_scheme_is_not_registered():
    class Plain(OwnKahan):
        pass

    with pytest.raises(TypeError, match="not a scheme"):
        co.methods.register(int)
    with pytest.raises(TypeError, match="StepMethod has no"):
        co.methods.register(co.methods.StepMethod)
    assert co.methods.registry  # nothing was left behind
    assert "StepMethod" not in co.methods.names()


@dataclasses.dataclass(frozen=True)
class RunningAnother(co.methods.StepMethod):
    """A step that is the end of another run: loops inside of loops."""

    inner: co.methods.Method
    compiles = False
    order, explicit, symmetric = 2, True, True

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        return co.stepper(system, self.inner, h)(x, t)


@pytest.mark.parametrize("inner", [co.Splitting(), co.GaussLegendre(2), co.Taylor(4)], ids=str)
def test_a_step_may_run_other_loops(inner):
    """Twenty steps make twenty tables: more than a thread remembers of the steps that it read last."""
    system, x0 = SYSTEMS["so(3)"], np.array([0.3, 1.0, 0.2])
    for depth, method in enumerate((RunningAnother(inner), RunningAnother(RunningAnother(inner)))):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = co.integrate(system, x0, (0, 2), 0.1, method, threads=1)
        state = x0
        for _ in range(20):
            state = co.stepper(system, inner, 0.1)(state)
        assert np.array_equal(found.x[-1], state), depth
