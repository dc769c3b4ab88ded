"""Arguments of everything public: wrong calls, hostile values, and both sides of each documented domain."""

import contextlib
import copy
import dataclasses
import datetime
import inspect
import pickle
import re
import signal
import warnings
from decimal import Decimal
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from domains.of_algebras import CATALOGUE
from fuzz.calls import BODY, CASES, ENTRIES, LONG, READY, TURNING, X, call
from fuzz.judging import TooLong, wrong_error
from fuzz.values import HOSTILE
from refusals import refused

TIME_LIMIT = 30  # seconds of the processor until a call counts as endless
ADDRESS_SPACE = 4 * 10**8  # bytes beyond those in use, which estimates of memory read


@pytest.fixture
def little_memory():
    """Bound the memory that estimates find free, so that nothing large is allocated."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as used:
        size = int(used.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ADDRESS_SPACE, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def time_limit():
    def give_up(*_):
        raise TooLong

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, TIME_LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def test_public_functions_are_called():
    assert {"co.integrate", "co.fit", "co.Splitting", "co.forces.LinearDamping", "co.systems.toda"} <= set(ENTRIES)
    assert {"co.LieAlgebra", "LieAlgebra.from_brackets", "Solution.at", "PreparedRun.run"} <= set(ENTRIES)
    assert len(ENTRIES) > 180


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ENTRIES)
def test_valid_arguments_are_accepted(name):
    """Without them nothing below says that a refusal is about the value that was replaced."""
    call(*ENTRIES[name])


SLOW = {("co.predicted_drift", "step"), ("co.certify", "step"), ("System.exact", "t")}
EVERY = [(name, parameter) for name, (_, known) in ENTRIES.items() for parameter in known]


@pytest.mark.thinned(24)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize(("name", "parameter"), [one for one in EVERY if one not in SLOW])
def test_hostile_values_give_a_result_or_a_refusal(name, parameter, little_memory, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function, arguments = ENTRIES[name]
    wrong = []
    for kind, value in HOSTILE.items():
        try:
            with time_limit(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call(function, {**arguments, parameter: value})
        except Exception as error:
            if found := wrong_error(error, parameter):
                wrong.append(f"{kind}: {found}")
        except TooLong:
            wrong.append(f"{kind}: not done after {TIME_LIMIT} s")
    assert not wrong, f"{name}, {parameter}:\n" + "\n".join(wrong)


@pytest.mark.thinned(1)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("name", CASES)
def test_domains_have_their_documented_ends(name):
    """Values inside are accepted, and those outside are refused by the name of the parameter."""
    case, wrong = CASES[name], []
    for parameter, domain in case.domains.items():
        for value in domain.inside:
            case(**{**case.arguments(), parameter: value})
        for k, value in enumerate(domain.outside):
            try:
                case(**{**case.arguments(), parameter: value})
            except (ValueError, TypeError) as refusal:
                if not re.search(domain.called or rf"\b{parameter}\b", str(refusal)):
                    wrong.append(f"the message about {parameter}, {k}, does not name it: {refusal}")
            except Exception as error:
                wrong.append(f"{parameter}, {k}: {type(error).__name__}: {error}")
            else:
                wrong.append(f"{parameter}, {k} is accepted")
    assert not wrong, "\n".join(wrong)


def test_every_algebra_with_parameters_has_domains():
    """Those of systems, forces and schemes are read from the registries and the signatures."""
    for name in {*co.algebras.names()} - {*CATALOGUE}:
        assert co.algebras.get(name).dim >= 1, "without parameters"


def wrong_call(function, /, *arguments, **keywords):
    with pytest.raises(TypeError) as caught:
        function(*arguments, **keywords)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 700
    assert not re.search(r"unexpected keyword|positional argument|multiple values|required argument|\(\) ", message)
    return message


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", [name for name in ENTRIES if " " not in name])
def test_wrong_calls_are_explained(name):
    """An unknown name, too many arguments, one that is given twice, and none of the required ones."""
    function = ENTRIES[name][0]
    parameters = inspect.signature(function).parameters
    kinds = {key: parameter.kind for key, parameter in parameters.items()}
    by_position = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    positional = [key for key, kind in kinds.items() if kind in by_position]
    if name.partition(".")[0] not in ("co", "Solution", "PreparedRun") or positional[:1] in (["name"], ["text"]):
        return  # plain methods of small classes
    if inspect.Parameter.VAR_KEYWORD not in kinds.values():
        assert "no_such_name" in wrong_call(function, no_such_name=1)
    if inspect.Parameter.VAR_POSITIONAL not in kinds.values():
        assert str(len(positional) + 1) in wrong_call(function, *[None] * (len(positional) + 1))
    if positional and kinds[positional[0]] is inspect.Parameter.POSITIONAL_OR_KEYWORD:
        assert f"{positional[0]} twice" in wrong_call(function, None, **{positional[0]: None})
    required = [
        key
        for key, parameter in parameters.items()
        if parameter.default is inspect.Parameter.empty
        and parameter.kind in (*by_position, inspect.Parameter.KEYWORD_ONLY)
    ]
    if required:
        assert f"needs {', '.join(required)};" in wrong_call(function)


class Counted(type):
    """A metaclass of a user."""

    made = 0

    def __call__(cls, *arguments, **keywords):
        Counted.made += 1
        return super().__call__(*arguments, **keywords)


@dataclasses.dataclass(frozen=True)
class Halved(co.methods.StepMethod, metaclass=Counted):
    share: float
    order, symmetric, explicit, compiles = 1, False, True, False

    def step(self, system, x, t, h):
        return x + h * self.share * system.vector_field(x, t)

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")


@dataclasses.dataclass(frozen=True)
class Spin(co.forces.Torque, metaclass=Counted):
    rate: float = 1.0


class Bath(co.forces.LinearDamping):
    def __init__(self, strength, *, seed):
        super().__init__(strength)


def test_classes_of_users_may_have_metaclasses():
    """Their constructors are their own; those of built-in classes are explained by the name of the class."""
    before = Counted.made
    halved, spin = Halved(0.5), Spin((0.0, 0.0, 1.0), rate=2.0)
    assert Counted.made == before + 2 and type(Halved) is type(Spin) is Counted
    run = co.integrate(BODY, X, (0, 1), 2.0**-5, halved)
    assert np.array_equal(run.x[1], X + 2.0**-5 * 0.5 * BODY.vector_field(X))
    assert np.array_equal(spin.field(BODY, np.zeros(3), 0.0), (0.0, 0.0, 1.0))
    for made in (halved, spin, Bath(0.1, seed=3), co.Composition(co.Kahan(), (0.5, 0.5))):
        assert copy.deepcopy(made) == pickle.loads(pickle.dumps(made)) == made
    assert "toward" in wrong_call(type("Mine", (co.forces.LinearDamping,), {}), 0.1, toward=0.0, towards=1.0)
    for wrong in ({"ratio": 2.0}, {}):
        with pytest.raises(TypeError, match=r"share|ratio"):
            Halved(**wrong)


@pytest.mark.parametrize("space", [co, co.methods, co.forces, co.systems, co.results, co.analysis])
def test_public_classes_have_no_metaclass(space):
    """Except protocols, which only types derive from."""
    classes = [one for name in dir(space) if isinstance(one := getattr(space, name), type)]
    assert [one for one in classes if type(one) is not type and not getattr(one, "_is_protocol", False)] == []


def test_abstract_methods_are_required():
    class Half(co.methods.StepMethod):
        order, symmetric, explicit = 1, False, True

    class Push(co.forces.Force):
        pass

    for kind in (Half, Push, co.methods.Method, co.forces.Force):
        with refused(TypeError, "abstract", kind.__name__):
            kind()


def test_errors_of_the_functions_themselves_pass_through():
    """A TypeError that a call raises with right arguments is not replaced."""

    def failing(x):
        raise TypeError("a message of the user")

    with pytest.raises(TypeError, match=r"^a message of the user$"):
        co.integrate(BODY, X, (0, 1), 0.1, events=co.Event(failing))

    @dataclasses.dataclass(frozen=True)
    class Refusing(co.forces.LinearDamping):
        def __post_init__(self):
            raise TypeError("a message of the force")

    with pytest.raises(TypeError, match=r"^a message of the force$"):
        Refusing(0.1)


DURATIONS = [
    (datetime.timedelta(seconds=2), "total_seconds"),
    (np.timedelta64(2, "s"), "np.timedelta64(1, 's')"),
    (datetime.datetime(2026, 1, 2), "seconds"),
    (HOSTILE["a quantity"], "magnitude"),
    (HOSTILE["a number with a unit"], "magnitude"),
]


@pytest.mark.parametrize(("value", "instead"), DURATIONS)
def test_durations_and_quantities_are_refused_with_what_to_give(value, instead):
    for wrong, *named in (
        (lambda: co.integrate(BODY, X, (0, 1), value), "step", instead),
        (lambda: co.integrate(BODY, X, (0, value), 0.1), "t_span"),
        (lambda: READY.run(X, (0, 1), t_eval=[value, value]), "t_eval"),
        (lambda: LONG.at(value), "t is"),
        (lambda: co.integrate(BODY, [1.0, value, 0.2], (0, 1), 0.1), "x0"),
        (lambda: co.systems.rigid_body((1, 2, value)), "inertia"),
    ):
        with refused(TypeError, *named, "units of the system"):
            wrong()


@pytest.mark.parametrize(
    "number",
    [3, 3.0, np.uint8(3), np.float16(3), np.longdouble(3), Fraction(3), Decimal(3), mpmath.mpf(3)],
)
def test_real_number_types_are_accepted(number):
    assert co.integrate(BODY, X, (0, number), number, save_every=1).t.tolist() == [0.0, 3.0]
    entries = np.empty(3, dtype=object)
    entries[:] = [number] * 3
    assert co.Quadratic(entries).gradient(np.ones(3)).tolist() == [3.0, 3.0, 3.0]


def test_small_integer_types_do_not_overflow():
    """200 + 200, 2 * 200 and -200 do not fit into eight bits without a sign."""
    two, many = np.uint8(2), np.uint8(200)
    assert co.algebras.get("sp(2n)", n=two) == co.algebras.sp(4) and co.algebras.so(two, np.uint8(2)).dim == 6
    assert co.algebras.A3_7(many) == co.algebras.A3_7(200) and co.GaussLegendre(many).order == 400
    p = co.Polynomial({(many, np.uint8(100)): many})
    assert p.degree == 300 and p.derivative(0).monomials == {(199, 100): 40_000}
    sol = co.integrate(BODY, np.array([200, 100, 50], dtype=np.uint8), (many, np.uint8(100)), many / np.uint8(200))
    assert sol.t[-1] == 100.0 and sol.x[0].tolist() == [200.0, 100.0, 50.0]
    assert len(co.integrate(BODY, X, (0, 256), 1, save_every=many).t) == 3


def test_masked_arrays_labels_and_foreign_objects_are_refused():
    pd = pytest.importorskip("pandas")
    masked = np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])
    assert co.Quadratic(pd.Series([1.0, 2.0, 3.0])).gradient(np.ones(3)).tolist() == [1.0, 2.0, 3.0]
    for read in (co.Quadratic, BODY.energy, lambda value: co.integrate(BODY, value, (0, 1), 0.1)):
        for value in (masked, [masked, masked]):
            with refused(ValueError, "masked"):
                read(value)
    columns = pd.DataFrame(np.eye(3), columns=["a", "b", "c"])
    labelled = (pd.Series([1.0, 2.0, 3.0], index=[2, 0, 1]), pd.Series([1.0, 2.0, 3.0], index=list("abc")), columns)
    for value in labelled:
        with refused(TypeError, "labels", "to_numpy"):
            co.Quadratic(value)


def test_polynomial_degrees_are_limited():
    assert co.Polynomial({(1024,): 1}).degree == 1024
    for make in (
        lambda: co.Polynomial({(1000, 25): 1}),
        lambda: co.Polynomial({(600,): 1}) ** 2,
        lambda: co.Polynomial({(600,): 1}) * co.Polynomial({(600,): 1}),
        lambda: co.Polynomial({(0,): 2}) ** 10**9,
    ):
        with refused(ValueError, "1024"):
            make()


def test_failed_ensemble_of_one_has_full_length():
    system = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(4, 0, 0): 1.0, (0, 4, 0): 2.0, (0, 0, 4): 3.0}))
    x0, partial = np.array([1e160, 1e160, 1e160]), {}
    for name, start in (("single", x0), ("one", x0[None]), ("two", np.array([x0, x0]))):
        with refused(co.IntegrationError) as failure:
            co.integrate(system, start, (0.5, 1.5), 0.1, co.GaussLegendre(2))
        partial[name] = failure.value.partial
        for again in (copy.copy, copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))):
            found = again(failure.value)
            assert type(found) is co.IntegrationError and str(found) == str(failure.value)
            assert (found.step, found.time) == (failure.value.step, failure.value.time) and found.time >= 0.5
            assert np.array_equal(found.partial.x, partial[name].x, equal_nan=True)
    assert partial["single"].x.shape == (1, 3) and np.isfinite(partial["single"].x).all()
    assert partial["one"].x.shape == (11, 1, 3) and partial["one"].failed.tolist() == [True]
    assert np.array_equal(partial["one"].x[:, 0], partial["two"].x[:, 0], equal_nan=True)
    assert np.isnan(partial["one"].x[1:]).all()


@pytest.mark.parametrize("x0", [(1e100, 2e100, 3e100), (1e200, 1e200, 1.0), [(0.1, 1, 0.2), (1e200, 1e200, 1)]])
def test_choices_near_a_blow_up_are_refused_without_warnings(x0):
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0]))
    with warnings.catch_warnings(), refused(ValueError):
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        co.choose(system, x0, (0, 1), 1e-6)


@pytest.mark.parametrize(("name", "size"), [("so(3)", 1e300), ("sl(2)", 1e155), ("so(4)", 1e3)])
def test_attitudes_near_a_blow_up_do_not_warn(name, size):
    """The exponential of a shift may overflow where the momentum does not."""
    g = co.algebras.get(name)
    system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(1.0, 2.0, g.dim)))
    x0 = size * np.cos(np.arange(3 * g.dim)).reshape(3, g.dim)
    with np.errstate(all="raise"):
        try:
            found = co.integrate(system, x0, (0, 0.3), 0.1, attitude="coadjoint")
        except co.IntegrationError as error:
            found = error.partial
    assert np.array_equal(found.attitude[0], np.broadcast_to(np.eye(g.dim), (3, g.dim, g.dim)))


def test_arrays_beyond_memory_are_refused_early():
    broad = np.broadcast_to(np.float32(1.0), (10**8, 10**8))
    for wrong, named in (
        (lambda: co.Quadratic(range(10**15)), ("M", "memory")),
        (lambda: co.Quadratic(broad), ("M", "100000000")),
        (lambda: co.integrate(BODY, broad, (0, 1), 0.1), ("x0", "100000000")),
    ):
        with refused(ValueError, *named):
            wrong()
    deep = 1.0
    for _ in range(1000):
        deep = [deep]
    with refused(TypeError, "x0"):
        co.integrate(BODY, deep, (0, 1), 0.1)
    with refused(ValueError):
        TURNING.spectrum(np.full((3, 3), np.inf))
