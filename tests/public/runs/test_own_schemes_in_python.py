"""Schemes of a user, written in Python: their runs are those of the step, compiled by Numba or called."""

import dataclasses
import warnings

import numpy as np
import pytest

import coadjoint as co
from methods.own_schemes import Classical, Failing, Interpreted, OwnKahan, Plain, Relaxed
from refusals import refused

pytestmark = pytest.mark.thinned(3)

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


def stepped(scheme, system, x, t, h, count):
    """Return the state after steps in Python."""
    for k in range(count):
        x = scheme.step(system, x, t + k * h, h)
    return x


# Derivatives of functions are not given here, so that Kahan's method has none.
CASES = [
    (name, scheme)
    for name in SYSTEMS
    for scheme in (Classical(), Relaxed(0.5), OwnKahan())
    if not (scheme == OwnKahan() and name in ("driven", "J(x)"))
]


@pytest.mark.thinned(10)
@pytest.mark.parametrize(("name", "scheme"), CASES, ids=str)
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_a_run_takes_the_steps_of_the_function(name, scheme, h):
    """Compiled: calls of Python would be warned of, which is an error here."""
    system = SYSTEMS[name]
    x0, t0 = start_of(system), 0.3
    sol = co.integrate(system, x0, (t0, t0 + 4 * h), abs(h), scheme)
    x = stepped(scheme, system, x0, t0, h, 4)
    assert np.max(np.abs(sol.x[-1] - x)) < 200 * system.dim * 2.0**-53 * max(1.0, np.max(np.abs(x)))
    assert (sol.x[1] - x0) @ system.vector_field(x0, t0) * h > 0


@dataclasses.dataclass(frozen=True)
class Unsmooth(Plain):
    """Steps of which a complex step gives no derivative: the imaginary part is dropped, or has no meaning."""

    kind: str

    def step(self, system, x, t, h):
        return x * (1 + h * np.real(x)) if self.kind == "real" else np.asarray(x, dtype=float) + h * np.abs(x) * x


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["real", "float"])
def test_tangents_are_differences_where_a_complex_step_is_wrong(kind):
    step, x = co.stepper(SYSTEMS["so(3)"], Unsmooth(kind), 0.1), np.array([1.0, -2.0, 0.5])
    assert step.tangent_by(x) == "differences"
    expected = np.diag(1 + 0.2 * (x if kind == "real" else np.abs(x)))
    assert np.max(np.abs(step.tangent(x) - expected)) < 1e-8


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


def test_choose_takes_it():
    found = co.choose(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 10), 1e-4, methods=[OwnKahan(), Classical()])
    assert isinstance(found.method, OwnKahan | Classical)
    sol = co.integrate(SYSTEMS["so(3)"], (1, 0.2, 0.5), (0, 10), method=OwnKahan(), accuracy=1e-4)
    assert np.max(np.abs(sol.x[-1] - SYSTEMS["so(3)"].exact((1, 0.2, 0.5), 10.0))) < 1e-4


class Scaled(Plain):
    """Parameters of every kind that a compiled step reads, as attributes of the class."""

    factor, shifts, kind, power, turned = 0.5, (0.25, -0.5, 0.125), "plain", 2, False
    _hidden = 3.0

    def step(self, system, x, t, h):
        f = system.vector_field(x, t)
        if self.kind == "plain":
            f = f**self.power
        if self.turned:
            f = -f
        return x + self.factor * h * (f + np.array(self.shifts))


class Turned(Scaled):
    turned, shifts = True, (1.0, 2.0, 3.0)


class Back(Turned):
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


@pytest.mark.long
@pytest.mark.parametrize(
    "scheme", [Turned(), Back(), Adjusted(0.25), AdjustedAgain(other="plain")], ids=lambda scheme: type(scheme).__name__
)
def test_parameters_of_a_compiled_step_are_those_of_the_scheme(scheme):
    """Also where they are inherited, redefined, or fields."""
    system = SYSTEMS["so(3)"]
    x = start_of(system)
    found = co.integrate(system, x, (0.3, 0.6), 0.1, scheme).x[-1]
    assert np.max(np.abs(found - stepped(scheme, system, x, 0.3, 0.1, 3))) < 1e-14


@dataclasses.dataclass(frozen=True)
class InPlace(Plain):
    """A step in Python that changes the state that it was given, and keeps it."""

    given: list = dataclasses.field(default_factory=list)
    result: str = "same"
    compiles = False

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


def test_what_numba_cannot_compile_runs_in_python_and_is_warned_of_once_for_each_scheme():
    class First(Interpreted):
        pass

    class Second(Interpreted):
        pass

    system, x0 = SYSTEMS["so(3)"], np.array([1, 0.2, 0.5])
    with pytest.warns(RuntimeWarning, match="Python calls") as warned:
        for scheme in (First(), Second(), First(), Second()):
            sol = co.integrate(system, x0, (0, 1), 0.1, scheme)
        several = co.integrate(system, np.stack([x0, 2 * x0]), (0, 1), 0.1, First(), threads=2)
    messages = [str(each.message) for each in warned if each.category is RuntimeWarning]
    assert [name for name in ("First", "Second") for text in messages if name in text] == ["First", "Second"]
    assert len(messages) == 2
    assert np.array_equal(sol.x[-1], stepped(Interpreted(), system, x0, 0.0, 0.1, 10))
    assert np.array_equal(several.x[:, 0], sol.x)


@pytest.mark.filterwarnings("ignore:the steps of")
@pytest.mark.parametrize("members", [1, 5])
def test_what_a_step_in_python_raises_comes_out_of_the_run(members):
    x0 = np.ones((members, 3)) * np.arange(1, 4) / 4 if members > 1 else (0.25, 0.5, 0.75)
    with refused(LookupError, "t = 0.6"):
        co.integrate(SYSTEMS["so(3)"], x0, (0, 2), 0.1, Failing(), threads=2)
    # The next run is as if nothing had been.
    assert co.integrate(SYSTEMS["so(3)"], x0, (0, 0.5), 0.1, Failing()).x.shape[0] == 6


@dataclasses.dataclass(frozen=True)
class Returning(OwnKahan):
    """A step with a wrong result."""

    kind: str = "short"
    compiles = False

    def step(self, system, x, t, h):
        if self.kind == "attribute":
            return self.no_field * x
        return {"short": x[:2], "complex": x + 1j, "text": "no"}[self.kind]


@pytest.mark.filterwarnings("ignore:the steps of")
@pytest.mark.parametrize(
    ("kind", "error", "named"),
    [
        ("short", TypeError, ("Returning", "(2,)", "3 real numbers")),
        ("complex", TypeError, ("Returning", "complex", "3 real numbers")),
        ("text", TypeError, ("Returning", "3 real numbers")),
        ("attribute", AttributeError, ("no_field",)),
    ],
)
def test_a_step_that_returns_no_state_is_refused(kind, error, named):
    with refused(error, *named):
        co.integrate(SYSTEMS["so(3)"], (1, 0, 0), (0, 1), 0.1, Returning(kind))


@pytest.mark.filterwarnings("ignore:the steps of")
def test_a_step_that_reads_what_matrices_do_not_have_is_refused():
    system = co.systems.torus_euler(N=3)
    with refused(TypeError, "OwnKahan", "system.jacobian", "torus_euler"):
        co.integrate(system, system.random(1, degrees=(1, 1)), (0, 1), 0.1, OwnKahan())


def test_a_member_that_overflows_fails_alone():
    system = SYSTEMS["so(4), cubic"]
    x0 = np.stack([start_of(system), 1e150 * start_of(system), 0.5 * start_of(system)])
    with refused(co.IntegrationError, "step 1", "1 of 3") as failure:
        co.integrate(system, x0, (0, 1), 0.1, Classical())
    partial = failure.value.partial
    assert partial.failed.tolist() == [False, True, False]
    assert np.array_equal(partial.x[:, 2], co.integrate(system, x0[2], (0, 1), 0.1, Classical()).x)


@dataclasses.dataclass(frozen=True)
class RunningAnother(Plain):
    """A step that is the end of another run: loops inside of loops."""

    inner: co.methods.Method
    compiles = False
    order, explicit, symmetric = 2, True, True

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
