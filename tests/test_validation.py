"""Validation of numbers, names, flags and lists from the user."""

from decimal import Decimal
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import scipy.sparse

import coadjoint as co
from coadjoint.errors import unknown_name
from coadjoint.validation import (
    are_finite,
    check_finite,
    check_parameters,
    check_power,
    read_bool,
    read_choice,
    read_complex,
    read_finite,
    read_integer,
    read_list,
    read_number,
    read_numbers,
    read_positive,
    read_title,
    size_of_range,
    to_array,
    truncate_title,
)

BODY = co.systems.rigid_body()
X = (0.1, 1.0, 0.2)
HUGE = 10**400


@pytest.mark.parametrize(
    "value",
    [
        3,
        3.0,
        np.uint8(3),
        np.float16(3),
        np.float32(3),
        np.longdouble(3),
        Fraction(3),
        Decimal(3),
        mpmath.mpf(3),
        np.array(3),
    ],
)
def test_real_number_types_are_accepted(value):
    assert read_number(value, "step") == 3.0 and type(read_number(value, "step")) is float
    entry = value[()] if isinstance(value, np.ndarray) else value
    held = np.empty(2, dtype=object)
    held[:] = [entry, entry]
    assert read_numbers(held, "x").tolist() == [3.0, 3.0]


@pytest.mark.parametrize(
    "value",
    [None, True, np.True_, "3", b"3", 3j, [3], np.array([3]), np.ma.masked, np.datetime64(3, "D"), mpmath.mpc(3)],
)
def test_other_types_are_refused_as_numbers(value):
    with pytest.raises(TypeError, match=r"^step is .*; it must be a number"):
        read_number(value, "step")


@pytest.mark.parametrize(
    "value", [HUGE, -HUGE, Fraction(HUGE), Decimal(10) ** 400, np.longdouble("1e400"), mpmath.mpf(10) ** 400]
)
def test_numbers_beyond_float64_are_refused(value):
    with pytest.raises(ValueError, match=r"^step is .*(too large for float64|must be finite)$"):
        read_number(value, "step")
    held = np.empty(1, dtype=object)
    held[0] = value
    with pytest.raises(ValueError, match=r"too large for float64|give finite numbers"):
        read_finite(held, "x")


@pytest.mark.parametrize(
    "values",
    [
        np.array(["1", "2"], dtype=object),
        ["1", "2"],
        [1.0, "2"],
        [True, 2.0],
        [[1.0, 2.0], [True, 2.0]],
        np.array([True]),
        [1j, 2.0],
        np.array([1j]),
        [None],
        None,
        {1: 2},
        {1, 2},
        (i for i in range(3)),
        [[1.0], [1.0, 2.0]],
        [np.True_, 1.0],
        np.array([True, 1], dtype=object),
        b"12",
        np.zeros(2, dtype="datetime64[D]"),
    ],
)
def test_other_arrays_are_refused(values):
    with pytest.raises(TypeError, match=r"^M is .*; it must be (an array of real numbers|numbers in the units)"):
        read_numbers(values, "M")


def test_masked_entries_are_refused():
    masked = np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])
    for values in (masked, [masked, masked], [np.ma.masked, 1.0, 2.0]):
        with pytest.raises(ValueError, match="x0 has masked entries"):
            read_numbers(values, "x0")
    assert read_numbers(np.ma.masked_array([1.0, 2.0]), "x0").tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="masked entries"):
        co.integrate(BODY, masked, (0, 1), 0.1)
    with pytest.raises(ValueError, match="masked entries"):
        co.Quadratic(masked)
    with pytest.raises(ValueError, match="masked entries"):
        BODY.energy(masked)


def test_pandas_labels_are_refused():
    pd = pytest.importorskip("pandas")
    series = pd.Series([1.0, 2.0, 3.0])
    assert co.Quadratic(series).gradient([1.0, 1.0, 1.0]).tolist() == [1.0, 2.0, 3.0]
    for labelled in (
        pd.Series([1.0, 2.0, 3.0], index=[2, 0, 1]),
        pd.Series([1.0, 2.0, 3.0], index=list("abc")),
        pd.DataFrame(np.eye(3), index=[2, 0, 1]),
    ):
        with pytest.raises(TypeError, match=r"labels other than 0, 1, 2, .*to_numpy"):
            co.Quadratic(labelled)
        with pytest.raises(TypeError, match=r"labels other than 0, 1, 2, .*to_numpy"):
            co.integrate(BODY, labelled, (0, 1), 0.1)


def foreign_objects():
    pd = pytest.importorskip("pandas")
    return [pd.Series([1.0, 2.0, 3.0]), pd.DataFrame(np.eye(3)), scipy.sparse.eye(3), np.eye(3), pd.NA]


@pytest.mark.parametrize(
    "call",
    [
        lambda v: co.integrate(BODY, X, (0, 1), 0.1, progress=v),
        lambda v: co.integrate(BODY, X, (0, 1), 0.1, observe=v),
        lambda v: co.integrate(BODY, X, (0, 1), 0.1, watch=v),
        lambda v: co.integrate(BODY, X, (0, 1), v),
        lambda v: co.integrate(BODY, X, (0, 1), accuracy=v),
        lambda v: co.integrate(BODY, X, v, 0.1),
        lambda v: co.choose(BODY, X, (0, 1), 1e-3, processed=v),
        lambda v: co.Splitting(order=v),
        lambda v: co.Splitting(rotation=v),
        lambda v: co.Splitting(scheme=v),
        lambda v: co.Splitting(compensated=v),
        lambda v: co.Taylor(v),
        lambda v: co.GaussLegendre(v),
        lambda v: co.ModifiedGaussLegendre(1, freeze=v),
        lambda v: co.ExplicitRungeKutta(v),
        lambda v: co.LiePoissonSystem(BODY.algebra, co.Quadratic(1.0), sign=v),
        lambda v: co.LiePoissonSystem(BODY.algebra, co.Quadratic(1.0), casimirs=v),
        lambda v: co.LiePoissonSystem(BODY.algebra, co.Quadratic(1.0), name=v),
        lambda v: co.algebras.get(v),
        lambda v: co.algebras.so(v),
        lambda v: co.systems.get(v),
    ],
)
def test_unexpected_arrays_are_refused(call):
    for value in foreign_objects():
        with pytest.raises((TypeError, ValueError), match=r"(must|give|needs)") as refusal:
            call(value)
        assert "ambiguous" not in str(refusal.value) and len(str(refusal.value)) < 1000


@pytest.mark.parametrize(
    "call",
    [
        lambda: co.stepper(BODY, co.Splitting(), 0.1)(X, t=HUGE),
        lambda: co.Composition(co.Splitting(), (HUGE, -HUGE, 1)),
        lambda: co.algebras.change_of_basis(co.algebras.so(3), [[1e200, 0, 0], [0, 1e200, 0], [0, 0, 1e-200]]),
        lambda: BODY.exact(X, HUGE),
        lambda: co.Separable({2**64: (np.sin, np.cos)}),
    ],
)
def test_huge_arguments_raise_value_error(call):
    with pytest.raises(ValueError):
        call()


def test_small_integer_types_do_not_overflow():
    """200 + 200, 2 * 200 and -200 do not fit into eight bits without a sign."""
    two, many = np.uint8(2), np.uint8(200)
    assert co.algebras.get("sp(2n)", n=two) == co.algebras.sp(4)
    assert co.algebras.so(two, np.uint8(2)).dim == 6
    assert co.algebras.A3_7(many) == co.algebras.A3_7(200)
    assert co.GaussLegendre(many).order == 400
    p = co.Polynomial({(many, np.uint8(100)): many})
    assert p.degree == 300 and p.derivative(0).monomials == {(199, 100): 40_000}
    assert (co.Polynomial({(1,): 1}) ** many).degree == 200
    exact = np.empty(2, dtype=object)
    exact[:] = [many, Fraction(1, 2)]
    assert co.Quadratic(exact).gradient(np.array([Fraction(200), Fraction(1)], dtype=object)).tolist() == [40_000, 0.5]
    sol = co.integrate(
        BODY, np.array([200, 100, 50], dtype=np.uint8), (np.uint8(200), np.uint8(100)), many / np.uint8(200)
    )
    assert sol.t[-1] == 100.0 and sol.x[0].tolist() == [200.0, 100.0, 50.0]
    assert len(co.integrate(BODY, X, (0, 256), 1, save_every=many).t) == 3


@pytest.mark.parametrize("value", [3, None, [], {}, 10**5000, np.eye(3), "x" * 10**6], ids=list("abcdefg"))
def test_unknown_names_of_any_type(value):
    assert len(str(unknown_name("algebra", value, ["so(3)", "sl(2)"]))) < 200
    with pytest.raises(ValueError, match="unknown rotation"):
        read_choice(value, "rotation", ("exact", "rational"))
    with pytest.raises((TypeError, ValueError)) as refusal:
        co.algebras.get(value)
    assert len(str(refusal.value)) < 1000


def test_bounds_of_numbers():
    assert read_integer(1e6, "save_every", floats=True) == 10**6
    for value in (1e6, 0, 1.5, "1", None, True, np.nan):
        with pytest.raises(ValueError, match="n must be a whole number from 1 to 5, not"):
            read_integer(value, "n", 1, 5)
    with pytest.raises(ValueError, match="n must be at most 5, not 6; it is enough"):
        read_integer(6, "n", 1, 5, reason="it is enough")
    assert read_positive(Fraction(1, 2), "h") == 0.5
    with pytest.raises(ValueError, match=r"h is -0\.0; it must be positive"):
        read_positive(-0.0, "h")
    assert read_bool(np.True_, "watch") is True
    for name in ("a\nb", "x" * 201):
        with pytest.raises(ValueError, match="one line of at most 200 characters"):
            read_title(name, "name")


def test_arrays_are_copied_only_if_needed():
    arguments = np.ones(3)
    assert to_array(arguments, "x") is arguments
    assert not np.shares_memory(read_numbers(arguments, "x"), arguments)


def test_polynomial_degrees_are_limited():
    assert co.Polynomial({(1024,): 1}).degree == 1024
    for call in (
        lambda: co.Polynomial({(1000, 25): 1}),
        lambda: co.Polynomial({(600,): 1}) ** 2,
        lambda: co.Polynomial({(600,): 1}) * co.Polynomial({(600,): 1}),
        lambda: co.Polynomial({(0,): 2}) ** 10**9,
    ):
        with pytest.raises(ValueError, match="1024"):
            call()


def test_batches_are_refused_where_one_system_is_needed():
    batch = co.batch([BODY, BODY])
    calls = [
        lambda: co.choose(batch, X, (0, 1), 1e-3),
        lambda: co.integrate(batch, X, (0, 1), accuracy=1e-3),
        lambda: co.stepper(batch, co.Splitting(), 0.1),
        lambda: co.Splitting.tuned(batch, X),
        lambda: co.Splitting().describe(batch),
        *(
            lambda m=m: m.properties(batch)
            for m in (
                co.Splitting(), co.Taylor(), co.GaussLegendre(), co.ModifiedGaussLegendre(), co.RadauEnergy(),
                co.IteratedGaussLegendre(), co.ExplicitRungeKutta(), co.Composition(co.Splitting(), (1.0,)),
            )
        ),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(TypeError, match=r"batch"):
            call()
    with pytest.raises(TypeError, match="system is None"):
        co.Taylor().properties(None)


def test_round_off_of_a_batch():
    from coadjoint.analysis.round_off import round_off

    bodies = [co.systems.rigid_body((1, 2, third)) for third in (2.5, 3.0)]
    sol = co.integrate(co.batch(bodies), X, (0, 100), 0.1, save_every=100)
    alone = [co.integrate(body, [X], (0, 100), 0.1, save_every=100) for body in bodies]
    found = round_off(sol)
    worst = max(round_off(one)["energy"].worst for one in alone)
    assert found["energy"].worst == worst


def test_failed_ensemble_of_one_has_full_length():
    g = co.algebras.so(3)
    system = co.LiePoissonSystem(g, co.Polynomial({(4, 0, 0): 1.0, (0, 4, 0): 2.0, (0, 0, 4): 3.0}))
    x0 = np.array([1e160, 1e160, 1e160])
    partial = {}
    for name, start in (("single", x0), ("one", x0[None]), ("two", np.array([x0, x0]))):
        with pytest.raises(co.IntegrationError) as failure:
            co.integrate(system, start, (0, 1), 0.1, co.GaussLegendre(2))
        partial[name] = failure.value.partial
    assert partial["single"].x.shape == (1, 3) and np.isfinite(partial["single"].x).all()
    assert partial["one"].x.shape == (11, 1, 3) and partial["one"].failed.tolist() == [True]
    assert np.array_equal(partial["one"].x[:, 0], partial["two"].x[:, 0], equal_nan=True)
    assert np.isnan(partial["one"].x[1:]).all()


@pytest.mark.parametrize(
    "x0", [(1e100, 2e100, 3e100), (1e200, 1e200, 1.0), [(0.1, 1, 0.2), (1e200, 1e200, 1)], [(1e160,) * 3] * 9]
)
def test_choice_near_a_blow_up_is_refused_without_warnings(x0):
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0]))
    with pytest.raises(ValueError, match=r"not finite|blows up|no step|too irregular|rounding|no accuracy"):
        co.choose(system, x0, (0, 1), 1e-6)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("size", [1e3, 1e20, 1e155, 1e300])
@pytest.mark.parametrize("name", ["so(3)", "so(2,1)", "sl(2)", "so(4)", "su(3)"])
def test_attitude_near_a_blow_up_does_not_warn(name, size):
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


@pytest.mark.parametrize(
    "call",
    [
        lambda name: co.LieAlgebra([], dim=1, name=name),
        lambda name: co.LieAlgebra([], dim=1, basis=[name]),
        lambda name: co.LiePoissonSystem(BODY.algebra, co.Quadratic(1.0), name=name),
    ],
)
def test_names_are_one_short_line(call):
    for name in ("x" * 10**6, "a\nb", "\x1b[31m"):
        with pytest.raises(ValueError, match="one line of at most 200 characters") as refusal:
            call(name)
        assert len(str(refusal.value)) < 1000


def test_composed_names_stay_short():
    g = co.algebras.direct_sum(*[co.algebras.so(3)] * 100)
    for _ in range(10):
        g = co.algebras.subalgebra(g, np.eye(g.dim, dtype=int)[:3].tolist())
    assert len(g.name) <= 200


@pytest.mark.parametrize("start", [-3, 0, 5])
@pytest.mark.parametrize("stop", [-4, 0, 1, 7])
@pytest.mark.parametrize("step", [-3, -1, 1, 2, 5])
def test_length_of_ranges(start, stop, step):
    values = range(start, stop, step)
    assert size_of_range(values) == len(values) and size_of_range(range(0, 10**30, 3)) == (10**30 + 2) // 3
    assert read_numbers(values, "x").tolist() == list(values)


def test_arrays_beyond_memory_are_refused_early(monkeypatch):
    with pytest.raises(ValueError, match=r"^x, range\(0, 1000000000000000\), needs about"):
        read_numbers(range(10**15), "x")
    broad = np.broadcast_to(np.float32(1.0), (10**8, 10**8))
    with pytest.raises(ValueError, match=r"^a copy of x, of shape \(100000000, 100000000\), needs about"):
        read_numbers(broad, "x")
    with pytest.raises(ValueError, match=r"^events, of 10000000000000000 entries, needs about"):
        read_list(broad.reshape(-1), "events", "give a list")


def test_infinite_numbers_are_found():
    """Below and above the size up to which plain Python sums; finite numbers with an overflowing sum are finite."""
    for size in (1, 2, 63, 64, 65, 200):
        assert are_finite(np.zeros(size)) and are_finite(np.full(size, 1e308)) and are_finite(-np.full(size, 1e308))
        for index in {0, size // 2, size - 1}:
            for wrong in (np.nan, np.inf, -np.inf):
                numbers = np.full(size, 1e308)
                numbers[index] = wrong
                assert not are_finite(numbers)
                with pytest.raises(ValueError, match=rf"^x0\[{index}\] is -?(nan|inf); give finite numbers$"):
                    check_finite(numbers, "x0")
    assert not are_finite(np.array([np.inf, -np.inf])) and are_finite(np.zeros((0, 3)))
    with pytest.raises(ValueError, match=r"^x0\[0, 1\] is inf"):
        check_finite(np.array([[1.0, np.inf], [np.nan, 1.0]]), "x0")
    with pytest.raises(ValueError, match=r"^step is nan"):
        check_finite(np.array(np.nan), "step")


def test_powers_stay_within_float64():
    for number in (2.0, -2.0):
        check_power(number, 1023, "x")
        with pytest.raises(ValueError, match=r"^x is -?2.0, and its power 1024 leaves the range"):
            check_power(number, 1024, "x")
    check_power(1e-300, 10**6, "x")
    check_power(-1.0, 10**6, "x")


def test_results_have_plain_types():
    for value in (np.int8(5), 5, np.uint64(5)):
        assert type(read_integer(value, "n")) is int
    for value in (5.0, np.float16(5), np.float32(5)):
        assert type(read_integer(value, "n", floats=True)) is int
        with pytest.raises(ValueError, match="n must be a whole number from 1 up"):
            read_integer(value, "n")
    assert read_integer(np.float16(2048), "n", maximum=10**9, floats=True) == 2048
    for value in (True, np.True_):
        with pytest.raises(ValueError, match="n must be a whole number from 1 up"):
            read_integer(value, "n")
    assert type(read_bool(np.False_, "flag")) is bool
    assert type(read_positive(np.float32(0.5), "h")) is float
    with pytest.raises(ValueError, match="must be positive"):
        read_positive(0, "h")
    assert read_complex([1, 2j], "W").dtype == np.complex128
    for wrong in ([True, 1j], np.array([True]), "1j", [[1j], [1, 2]]):
        with pytest.raises(TypeError, match=r"^W is "):
            read_complex(wrong, "W")
    with pytest.raises(ValueError, match="too large for float64"):
        read_complex([HUGE], "W")


def test_titles_and_lists():
    assert read_title("x" * 200, "name") == "x" * 200
    for size in (199, 200, 201, 1000):
        assert len(truncate_title("x" * size)) == min(size, 200)
        assert read_title(truncate_title("x" * size), "name").startswith("x" * min(size, 197))
    for name in ("a\tb", "a\u2028b", "a\0"):
        with pytest.raises(ValueError, match="one line of at most 200 characters"):
            read_title(name, "name")
    with pytest.raises(TypeError, match="nonempty"):
        read_title("", "name")
    assert read_list((k for k in range(3)), "a", "rule") == (0, 1, 2) and read_list(np.arange(2), "a", "rule") == (0, 1)
    for wrong in ("ab", b"ab", {"a": 1}, 3, None, np.array(3)):
        with pytest.raises(TypeError, match=r"^a is .*; rule$"):
            read_list(wrong, "a", "rule")


def test_unknown_and_missing_parameters():
    check_parameters("F", ["b", "a"], ["a", "b", "c"], ["a"])
    for arguments, known, required, message in (
        (["d"], ["delta"], [], "unknown parameter of F 'd'"),
        (["a"], [], [], "unknown parameter of F 'a'; there are: (none)"),
        (["b"], ["a", "b", "c"], ["b", "c", "a"], "F needs the parameter 'c'"),
        ([], ["a"], ["a"], "F needs the parameter 'a'"),
    ):
        with pytest.raises(ValueError) as refused:
            check_parameters("F", iter(arguments), iter(known), required)
        assert str(refused.value).startswith(message)


def test_nested_lists_are_checked():
    deep = masked = 1.0
    for _ in range(30):
        deep, masked = [deep], [masked]
    assert read_numbers(deep, "x").shape == (1,) * 30
    inner = [True]
    for _ in range(20):
        inner = [inner]
    with pytest.raises(TypeError, match=r"^x is "):
        read_numbers(inner, "x")
    for _ in range(1000):
        inner = [inner]
    with pytest.raises(TypeError, match=r"^x is "):
        read_numbers(inner, "x")


def test_pandas_labels_along_any_axis_are_refused():
    pd = pytest.importorskip("pandas")
    for labelled in (pd.DataFrame(np.eye(2), columns=["a", "b"]), pd.DataFrame(np.eye(2), columns=[1, 0])):
        for values in (labelled, [labelled]):
            with pytest.raises(TypeError, match="labels other than 0, 1, 2"):
                read_numbers(values, "M")
    assert read_numbers(pd.DataFrame(np.eye(2)), "M").tolist() == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.skipif(int(np.__version__.partition(".")[0]) < 2, reason="arrays have 32 dimensions at most")
def test_object_arrays_of_many_dimensions_are_refused():
    for dimensions in (33, 64):
        with pytest.raises(TypeError, match=r"^x is .*; it must be an array of real numbers"):
            to_array(np.full((1,) * dimensions, Fraction(1, 3), dtype=object), "x")
    assert read_numbers(np.full((1,) * 32, Fraction(1, 2), dtype=object), "x").ravel().tolist() == [0.5]
