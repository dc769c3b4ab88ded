"""Schemes of a user, written in Python: their runs are those of the step, compiled by Numba or called."""

import dataclasses
import math
import warnings

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from own_schemes import Failing, Interpreted, OwnKahan, Plain
from refusals import refused
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(3)


def cubic(n):
    exponents = [tuple(int(k == i) + 2 * int(k == (i + 1) % n) for k in range(n)) for i in range(n)]
    return co.Polynomial({e: 0.1 * (i + 1) for i, e in enumerate(exponents)})


SYSTEMS = {
    "so(3)": co.systems.rigid_body(inertia=(1, 2, 3)),
    "so(4), cubic": co.LiePoissonSystem(co.algebras.so(4), cubic(6)),
}


def start_of(system):
    return 0.4 * np.cos(np.arange(system.dim) + 1.0)


def stepped(scheme, system, x, t, h, count):
    """Return the state after steps in Python."""
    for k in range(count):
        x = scheme.step(system, x, t + k * h, h)
    return x


@dataclasses.dataclass(frozen=True)
class Given(Plain):
    """A step of given components."""

    components: tuple

    order, explicit, symmetric, compiles = 1, True, False, False

    def step(self, system, x, t, h):
        return np.array([component(x) for component in self.components])


def test_differences_are_taken_at_the_state_zero_too():
    """The functions of math reject complex numbers."""
    method = Given((lambda x: math.sin(x[0]) + 2.0 * x[1], lambda x: x[0] * x[1] - x[1]))
    plane = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Quadratic([1.0, 1.0]))
    step = co.stepper(plane, method, 0.1)
    assert step.tangent_by(np.zeros(2)) == "differences"
    # Central differences at the distance 2^-17: h^2/6 by the third derivative.
    assert np.abs(step.tangent(np.zeros(2)) - [[1.0, 2.0], [0.0, -1.0]]).max() <= 2.0**-34


def test_a_component_that_is_not_analytic_is_found_among_others():
    """Complex steps give 0, or half of the slope, for the components that depend on x.real or the conjugate."""
    x = np.array([0.6, -1.25, 1.75])
    analytic = [
        (lambda x: np.sin(x[0]) * x[1], [np.cos(x[0]) * x[1], np.sin(x[0]), 0.0]),
        (lambda x: x[0] * x[1] * x[2], [x[1] * x[2], x[0] * x[2], x[0] * x[1]]),
        (lambda x: x[2] ** 2 - x[1], [0.0, -1.0, 2.0 * x[2]]),
    ]
    others = [
        (lambda x: np.abs(x[1]) + x[2], [0.0, -1.0, 1.0]),
        (lambda x: np.real(x[0]) ** 2 * x[2], [2.0 * x[0] * x[2], 0.0, x[0] ** 2]),
        (lambda x: np.conj(x[2]) * x[2] + 0.0 * x[0], [0.0, 0.0, 2.0 * x[2]]),
        (lambda x: np.linalg.norm(x) * x[0], np.linalg.norm(x) * np.eye(3)[0] + x[0] * x / np.linalg.norm(x)),
    ]
    body = co.systems.rigid_body((1.0, 2.0, 3.0))

    def derivative(parts):
        step = co.stepper(body, Given(tuple(function for function, _ in parts)), 0.1)
        return step.tangent_by(x), np.abs(step.tangent(x) - [slope for _, slope in parts]).max()

    by, error = derivative(analytic)
    assert by == "complex step" and error <= 8 * UNIT_ROUNDOFF
    for place in range(3):
        for other in others:
            by, error = derivative([*analytic[:place], other, *analytic[place + 1 :]])
            # Central differences at the distance 2^-17: h^2/6 by the third derivative, and rounding by h.
            assert by == "differences" and error <= 2.0**-31, (place, others.index(other))


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


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "scheme",
    long_beyond(2, [Turned(), AdjustedAgain(other="plain"), Back(), Adjusted(0.25)]),
    ids=lambda scheme: type(scheme).__name__,
)
def test_parameters_of_a_compiled_step_are_those_of_the_scheme(scheme):
    """Also where they are inherited, redefined, or fields."""
    system = SYSTEMS["so(3)"]
    x = start_of(system)
    found = co.integrate(system, x, (0.3, 0.6), 0.1, scheme).x[-1]
    assert np.max(np.abs(found - stepped(scheme, system, x, 0.3, 0.1, 3))) < 1e-14


class Readings(Plain):
    """A step to what it reads of its system, at two times."""

    def step(self, system, x, t, h):
        H, found = system.hamiltonian, np.empty(6)
        found[:2] = system.energy(x, t), H.value(2 * x, t + h)
        found[2:4], found[4:] = H.gradient(x, t + h)[:2], system.vector_field(x, t)[:2]
        return found


def test_a_compiled_step_reads_a_driven_system_at_any_time():
    """By hand: e^t (cosh(x1) + x2^4) + x3 on the first of two so(3)."""
    pytest.importorskip("numba")
    H = co.Hamiltonian(
        lambda y, t: np.exp(t) * (np.cosh(y[0]) + y[1] ** 4) + y[2],
        lambda y, t: np.array([np.exp(t) * np.sinh(y[0]), 4 * np.exp(t) * y[1] ** 3, 1.0, 0.0, 0.0, 0.0]),
    )
    system, x = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), H), np.array([0.3, 1, 0.2, 0.5, 0.4, 0.7])
    f, after = np.exp(0.75), np.exp(1.0)
    values = f * (np.cosh(0.3) + 1) + 0.2, after * (np.cosh(0.6) + 16) + 0.4
    field = system.structure_matrix(x)[:2, :3] @ [f * np.sinh(0.3), 4 * f, 1.0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        found = co.stepper(system, Readings(), 0.25)(x, 0.75)
    np.testing.assert_allclose(found, [*values, after * np.sinh(0.3), 4 * after, *field], rtol=1e-13)


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


@pytest.mark.thinned(1)
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


@pytest.mark.thinned(1)
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


@dataclasses.dataclass(frozen=True)
class Connected(Plain):
    """A step that reads what no system has."""

    def step(self, system, x, t, h):
        return x + h * system.connection(x)


@pytest.mark.filterwarnings("ignore:the steps of")
def test_a_step_that_reads_what_matrices_do_not_have_is_refused():
    system = co.systems.torus_euler(N=3)
    with refused(TypeError, "Connected", "system.connection", "torus_euler"):
        co.integrate(system, system.random(1, degrees=(1, 1)), (0, 1), 0.1, Connected())


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
            warnings.simplefilter("default", co.LongWait)  # of a busy machine
            found = co.integrate(system, x0, (0, 2), 0.1, method, threads=1)
        state = x0
        for _ in range(20):
            state = co.stepper(system, inner, 0.1)(state)
        assert np.array_equal(found.x[-1], state), depth
