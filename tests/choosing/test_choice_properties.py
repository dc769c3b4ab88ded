"""Properties that every choice of a scheme has."""

import re
from dataclasses import fields
from functools import lru_cache

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import accuracy as choosing
from coadjoint.choosing import system_cache
from coadjoint.choosing.accuracy import Choice
from coadjoint.choosing.pilot import Growth
from coadjoint.choosing.system_cache import loops_of
from coadjoint.choosing.unreached import rounded_up
from coadjoint.methods.suggested_scheme import candidate_schemes

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 3.0))
SO4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.3, 0.2, 0.7, 0.9]), sign=-1)
CASES = {"so(3)": (BODY, (1.0, 0.2, 0.5)), "so(4)": (SO4, (0.5, -0.3, 0.8, 0.1, 0.6, -0.2))}
METHODS = {
    "splitting": co.Splitting(order=6),
    "gauss": co.GaussLegendre(4),
    "taylor": co.Taylor(order=14),
    "own steps": co.Taylor(tolerance=1e-9),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("span", [(0.0, 50.0), (3.0, -997.0), (0.0, 1e4)])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-9, 2e-12])
def test_error_includes_roundoff(case, span, accuracy):
    system, x0 = CASES[case]
    try:
        choice = co.choose(system, x0, span, accuracy)
    except ValueError as refusal:
        assert "accuracy" in str(refusal)
        return
    for each in (choice, *choice.others):
        assert 0.0 < each.roundoff <= each.error
    assert choice.error <= accuracy


@pytest.mark.thinned(4)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("time", [100.0, 1e3, 1e4, 1e5])
def test_single_scheme_is_never_replaced_by_a_variant(case, method, time):
    system, x0 = CASES[case]
    for accuracy in (1e-6, 1e-11, 3e-12):
        try:
            choice = co.choose(system, x0, (0.0, time), accuracy, methods=METHODS[method])
        except ValueError as refusal:
            assert "accuracy" in str(refusal) or "reach" in str(refusal)
            continue
        assert type(choice.method) is type(METHODS[method])
        if method != "own steps":  # of which the tolerance is chosen
            assert choice.method == METHODS[method]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(
    ("method", "copies"),
    # From four members on, lanes change the costs of schemes, and so the choice among them.
    [(None, 2), *((method, copies) for method in METHODS for copies in (2, 4, 7))],
)
def test_copies_of_a_state_get_its_choice(case, method, copies):
    system, x0 = CASES[case]
    given = {} if method is None else {"methods": METHODS[method]}
    one = co.choose(system, x0, (1.0, 101.0), 1e-8, **given)
    many = co.choose(system, [x0] * copies, (1.0, 101.0), 1e-8, **given)
    if method == "own steps":  # trials of several members need not stop at one tolerance
        assert many.step == pytest.approx(one.step, rel=0.25) and many.cost == pytest.approx(one.cost, rel=0.25)
    else:
        assert (many.method, many.step, many.cost) == (one.method, one.step, pytest.approx(one.cost))


@pytest.mark.parametrize("accuracy", [None, 1e-6])
def test_prepared_run_reads_changed_arguments_again(accuracy):
    x0, span = np.array([1.0, 0.2, 0.5]), [0.0, 10.0]
    given = {"accuracy": accuracy, "x0": [x0.copy()], "t_span": (0.0, 10.0)} if accuracy else {"step": 0.125}
    run = co.prepare(BODY, **given)
    first = run.run(x0, span)
    end, start = first.x[-1].copy(), first.x[0].copy()
    x0 *= 1.0625
    np.testing.assert_array_equal(first.x[0], start)
    moved = run.run(x0, span)
    np.testing.assert_array_equal(moved.x[0], x0)
    assert np.abs(moved.x[-1] - end).max() > 1e-3
    span[1] = 1000.0
    if accuracy:
        with pytest.raises(ValueError, match="1000"):
            run.run(x0, span)
    else:
        assert run.run(x0, span).t[-1] == 1000.0
    span[:] = [0.0, -10.0]
    if accuracy:
        with pytest.raises(ValueError, match=r"direction|prepared"):
            run.run(x0, span)


def test_choice_text_contains_every_number():
    other = Choice(co.GaussLegendre(3), 0.5, 1e-5, 1e-6, 1e-9, 700.0)
    choice = Choice(co.Splitting(order=4), 0.0123456789, 2.5e-5, 3.75e-6, 4.25e-9, 200.0, (other, choice_of(900.0)))
    numbers = (
        r"with step (\S+): expected error (\S+) for the wanted (\S+) \((\S+) of it rounding\), at the cost of (\S+)"
    )
    wanted = ("0.0123457", "3.8e-06", "2.5e-05", "4.2e-09", "2e+02")
    for one, rest in ((choice, f"; next {other.method} at 3.5 times that"), (Choice(*values(choice)[:-1]), "")):
        text = str(one)
        found = re.search(numbers, text).groups()
        assert text.startswith(f"{choice.method} with") and text.endswith(f" rotations{rest}")
        assert [float(a) for a in found] == pytest.approx([float(b) for b in wanted], rel=0.03)
    free = Choice(co.Splitting(order=4), 1.0, 1e-6, 0.0, 0.0, 0.0, (other,))
    assert "; next " in str(free)


def choice_of(cost):
    return Choice(co.Taylor(12), 0.25, 1e-5, 1e-6, 1e-9, cost)


def values(choice):
    return [getattr(choice, field.name) for field in fields(choice)]


@pytest.mark.parametrize("t0", [0.0, -3.5])
def test_empty_span_gets_first_scheme_without_error(t0):
    for first, second in ((co.GaussLegendre(4), co.Splitting(order=4)), (co.Splitting(order=4), co.Taylor(12))):
        choice = co.choose(BODY, (1.0, 0.2, 0.5), (t0, t0), 1e-7, methods=[first, second])
        assert values(choice) == [first, 1.0, 1e-7, 0.0, 0.0, 0.0, ()]


ROUND_NUMBERS = [1.0, 9.99e-7, 1.0000001e-9, 2.5e-9, 2.51e-13, 9.91e-3, 1e-16]


@pytest.mark.parametrize("value", [*ROUND_NUMBERS, *10.0 ** np.linspace(-17, -1, 40)])
def test_least_accuracy_is_rounded_up_to_two_digits(value):
    assert value <= float(rounded_up(value)) * (1.0 + 2.0**-50) <= 1.1 * value * (1.0 + 2.0**-48)
    assert re.fullmatch(r"\d\.\de[+-]\d\d", rounded_up(value))


@pytest.mark.parametrize(
    ("written", "schemes"),
    [
        ("GaussLegendre", co.GaussLegendre()),
        ({"name": "Splitting", "order": 6}, co.Splitting(order=6)),
        (["Splitting", {"name": "GaussLegendre", "stages": 4}], [co.Splitting(), co.GaussLegendre(4)]),
        ((co.Taylor(14), {"name": "Taylor", "order": 8}), [co.Taylor(14), co.Taylor(8)]),
    ],
    ids=str,
)
def test_methods_accept_names_mappings_and_schemes(written, schemes):
    expected = co.choose(BODY, (1.0, 0.2, 0.5), (0.0, 10.0), 1e-6, methods=schemes)
    found = co.choose(BODY, (1.0, 0.2, 0.5), (0.0, 10.0), 1e-6, methods=written)
    assert found == expected and found.others == expected.others


@pytest.mark.parametrize("processed", [False, True])
def test_default_schemes_depend_on_dimension(processed):
    known = candidate_schemes(processed)
    limits = {each.largest for each in known if np.isfinite(each.largest)}
    for dim in (3, 64, *(int(limit) + more for limit in limits for more in (-1, 0, 1))):
        found = choosing._schemes(None, processed, dim)
        assert list(found) == [each for each in known if not each.largest < dim]
    assert choosing._schemes(co.Splitting(), processed, 10**6) == (co.Splitting(),)


@pytest.mark.parametrize("span", [(0.0, 40.0), (100.0, 60.0), (-3.0, -43.0)])
def test_refusals_name_scheme_accuracy_and_span_length(span, monkeypatch):
    x0, splitting = (1.0, 0.2, 0.5), co.Splitting(order=4)
    with monkeypatch.context() as none, pytest.raises(ValueError) as refused:
        none.setattr(choosing, "fit", lambda *given: None)
        co.choose(BODY, x0, span, 1e-6, methods=splitting)
    assert all(part in str(refused.value) for part in (str(splitting), "accuracy 1e-06", "time 40"))
    for methods, name in ((splitting, str(splitting)), (None, "any scheme")):
        with monkeypatch.context() as lost, pytest.raises(ValueError) as refused:
            lost.setattr(choosing, "least_roundoff", lambda pilot: 0.5)
            co.choose(BODY, x0, span, 1e-6, methods=methods)
        assert all(part in str(refused.value) for part in ("float64", name, "time 40"))


@pytest.mark.parametrize("quarter", [0.0, 1e-12, 1.0, 5.0, 40.0])
@pytest.mark.parametrize("half", [0.0, 1e-12, 1.0, 6.0, 50.0])
@pytest.mark.parametrize("whole", [0.0, 1e-12, 1.0, 35.0, 400.0])
def test_growth_factor_is_monotone_and_scale_invariant(quarter, half, whole):
    growth, small = Growth(quarter, half, whole), Growth(*(2.0**-60 * value for value in (quarter, half, whole)))
    windows = (1.0, 1.5, 2.0, 10.0, 1e3, 1e9)
    for least in (1.0, 2.0):
        factors = [growth.factor(count, least) for count in windows]
        assert factors == sorted(factors) == [small.factor(count, least) for count in windows] and factors[0] == 1.0
        if whole > 0.0:
            assert all(found >= count**least * (1 - 1e-12) for found, count in zip(factors, windows, strict=True))
            # An error that appears only now is no growth, unless it grows much in the last half.
            if half == 0.0 or (quarter == 0.0 and whole <= 16.0 * half):
                assert factors == [count**least for count in windows]
        else:
            assert set(factors) == {1.0}


def test_loops_are_cached_only_for_step_independent_tables(monkeypatch):
    monkeypatch.setattr(system_cache, "SystemLoops", lambda *given, **options: [given])
    monkeypatch.setattr(system_cache, "_cache_of", lru_cache(lambda system: {}))
    called = co.LiePoissonSystem(
        co.algebras.so(3), co.Hamiltonian(lambda x: 0.5 * (x @ x), lambda x: 1.0 * x), name="called"
    )
    free = co.PoissonSystem(lambda x: np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 2.0]))
    gauss, splitting = co.GaussLegendre(2), co.Splitting(order=2)
    # Neither where tables depend on the step, nor with functions of the user, which may change.
    cases = [(BODY, gauss, True), (BODY, splitting, False), (called, gauss, False), (free, gauss, False)]
    for system, method, cached in cases:
        assert method.tables_of_any_step is (method is gauss)
        assert (loops_of(system, method, 0.1) is loops_of(system, method, 0.2)) is cached
    assert loops_of(BODY, gauss, 0.1) is not loops_of(BODY, co.GaussLegendre(3), 0.1)
    assert loops_of(BODY, gauss, 0.1) is not loops_of(SO4, gauss, 0.1)
