"""Properties of every choice: the schemes that were given, the parts of its error, copies of a state, arguments."""

import numpy as np
import pytest

import coadjoint as co

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
def test_the_error_contains_the_rounding(case, span, accuracy):
    system, x0 = CASES[case]
    try:
        choice = co.choose(system, x0, span, accuracy)
    except ValueError as refused:
        assert "accuracy" in str(refused)
        return
    for one in (choice, *choice.others):
        assert 0.0 < one.roundoff <= one.error
    assert choice.error <= accuracy


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("time", [100.0, 1e3, 1e4, 1e5])
def test_a_single_scheme_keeps_its_settings(case, method, time):
    """It is refused where it does not reach the accuracy, and never replaced by a more accurate variant."""
    system, x0 = CASES[case]
    for accuracy in (1e-6, 1e-11, 3e-12):
        try:
            choice = co.choose(system, x0, (0.0, time), accuracy, methods=METHODS[method])
        except ValueError as refused:
            assert "accuracy" in str(refused) or "reach" in str(refused)
            continue
        assert type(choice.method) is type(METHODS[method])
        if method != "own steps":  # whose tolerance is what is chosen
            assert choice.method == METHODS[method]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(
    ("method", "copies"),
    # From four on, members go side by side, which changes the costs of schemes and so the choice among them.
    [(None, 2), *((method, copies) for method in METHODS for copies in (2, 4, 7))],
)
def test_copies_of_a_state_have_the_choice_of_one(case, method, copies):
    system, x0 = CASES[case]
    given = {} if method is None else {"methods": METHODS[method]}
    one = co.choose(system, x0, (1.0, 101.0), 1e-8, **given)
    many = co.choose(system, [x0] * copies, (1.0, 101.0), 1e-8, **given)
    if method == "own steps":  # trials of several members need not stop at one tolerance
        assert many.step == pytest.approx(one.step, rel=0.25) and many.cost == pytest.approx(one.cost, rel=0.25)
    else:
        assert (many.method, many.step, many.cost) == (one.method, one.step, pytest.approx(one.cost))


@pytest.mark.parametrize("accuracy", [None, 1e-6])
def test_arguments_that_are_changed_in_place(accuracy):
    """What a prepared run reads of its arguments it reads in every call."""
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
