"""At a large step, what a scheme declares is preserved on each of some systems, and the rest is lost on one of them."""

from functools import partial

import numpy as np
import pytest

import coadjoint as co
from matrix.cases import supported, value_of
from matrix.references import largest_changes, poisson_defect, preserved, rounding_of
from matrix.schemes import SLOW, schemes
from refusals import refused

pytestmark = pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore:the steps of")
BODY = "co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([2.0, 0.4, 0.7, 0.3, 0.5, 1.0]), sign=-1)"
PAIRS = "co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([2.0, 0.4, 0.7, 0.3, 0.5, 1.0]) + "
PAIRS += "co.Polynomial({(1, 0, 0, 0, 0, 1): 0.6}))"
CUBIC = "co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(np.linspace(0.3, 1.6, 8)))"
TOP = "co.LiePoissonSystem(co.algebras.e(3), co.Polynomial({(2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.25, "
TOP += "(0, 0, 2, 0, 0, 0): 0.2, (0, 0, 0, 1, 0, 0): 0.75, (0, 0, 0, 0, 3, 0): 0.3, (0, 0, 0, 1, 0, 1): 0.4}), sign=-1)"
SIX = np.array([1.0, 0.5, -0.4, 0.7, -1.0, 0.3])
STARTS = {BODY: SIX, PAIRS: SIX, TOP: SIX, CUBIC: np.array([1.0, 0.5, -0.4, 0.7, -1.0, 0.3, 0.8, -0.6])}
CONSTANT = [text for text in schemes() if text not in SLOW and not value_of(text).own_steps]


def step_of(method):
    return 0.1 if method.order <= 2 else 0.4


@pytest.mark.thinned(1)
@pytest.mark.parametrize("text", CONSTANT)
def test_declared_is_kept_and_the_rest_is_lost(text):
    """Lost are the energy, the Casimirs or the bracket by a thousand times what rounding could do."""
    method, lost, undeclared = value_of(text), set(), set()
    for name in filter(partial(supported, text), STARTS):
        system, x = value_of(name), STARTS[name]
        declared = method.properties(system)
        kept = preserved(system, declared)
        step = step_of(method)
        sol = co.integrate(system, x, (0.0, 40 * step), step, method)
        changes, rounding = largest_changes(sol), rounding_of(sol)
        work = sol.stats.evaluations / sol.stats.steps
        changes["bracket"], rounding["bracket"] = poisson_defect(co.stepper(system, method, step), x, work)
        for key, change in changes.items():
            if key in kept or (key == "bracket" and declared.poisson):
                assert change <= rounding[key], key
                continue
            kind = key if key in ("energy", "bracket") else "Casimir"
            undeclared.add(kind)
            if change > 1000 * rounding[key]:
                lost.add(kind)
    assert lost == undeclared


@pytest.mark.parametrize("text", [text for text in schemes() if text not in (*SLOW, *CONSTANT)])
def test_steps_of_varying_length_are_no_poisson_map(text):
    """The derivative of the end of a run, by differences of order 4, in which errors of 1e-9 are less than 1e-6."""
    method, largest = value_of(text), 0.0
    for name in filter(partial(supported, text), STARTS):
        system, x, e = value_of(name), STARTS[name], 2.0**-7

        def end(k, d, system=system, x=x, e=e):
            return co.integrate(system, x + k * e * d, (0.0, 2.0), 0.5, method, watch=False).x[-1]

        P = np.stack([(8 * (end(1, d) - end(-1, d)) - end(2, d) + end(-2, d)) / (12 * e) for d in np.eye(len(x))], 1)
        defect = P @ system.structure_matrix(x) @ P.T - system.structure_matrix(end(0, x))
        largest = max(largest, np.abs(defect).max())
        if np.abs(defect).max() > 1e-6:
            assert not method.properties(system).poisson
    assert largest > 0 or not any(supported(text, name) for name in STARTS)


@pytest.mark.parametrize("text", CONSTANT)
def test_schemes_not_declared_symmetric_are_not(text):
    """A step forward and back is off by O(h^(p+1)): far above rounding at a large step of a low order."""
    method = value_of(text)
    if method.symmetric or method.order > 6:
        return
    largest, h = 0.0, step_of(method)
    for name in filter(partial(supported, text), STARTS):
        system, x = value_of(name), STARTS[name]
        back = co.stepper(system, method, -h)(co.stepper(system, method, h)(x), h)
        largest = max(largest, np.abs(back - x).max())
    assert largest > 1e-11 or not any(supported(text, name) for name in STARTS)


@pytest.mark.parametrize("text", CONSTANT)
def test_group_elements_that_are_not_kept(text):
    """Those that are integrated leave the group."""
    method = value_of(text)
    if not supported(text, BODY):
        return
    system = value_of(BODY)
    if method.properties(system).attitude == "integrated":
        g = co.integrate(system, SIX, (0.0, 20.0), 0.1, method, attitude=True).attitude[-1]
        assert np.abs(g @ g.T - np.eye(4)).max() > 1e-9


def growing_element():
    """Return a system and a state at rest, of which the group element grows as exp(t)."""
    g = co.algebras.get("so(2,1)") if "so(2,1)" in co.algebras.names() else co.algebras.so(2, 1)
    boost = np.eye(3)[int(np.argmax([np.abs(np.linalg.eigvals(g.coadjoint(e)).real).max() for e in np.eye(3)]))]
    system = co.LiePoissonSystem(g, co.Quadratic(0.0, linear=boost))
    return system, next(e for e in np.eye(3) if not np.any(system.vector_field(e)))


@pytest.mark.parametrize(
    "method", [co.Splitting(order=2, parts="coordinates"), co.GaussLegendre(3), co.Taylor(12)], ids=str
)
def test_overflow_of_a_group_element_names_its_step(method):
    """Whatever is saved or watched, in members and alone; nothing after it is given."""
    system, still = growing_element()
    steps = set()
    for every, watch, members in ((1, True, 1), (1, False, 5), (7, True, 5), (50, False, 1)):
        x = still * np.linspace(1.0, 2.0, members)[:, None]
        given = {"attitude": "coadjoint", "save_every": every, "watch": watch}
        with refused(co.IntegrationError, "overflowed") as caught:
            co.integrate(system, x, (0, 800), 1.0, method, **given)
        steps.add(caught.value.step)
        partial = caught.value.partial
        before = partial.t < caught.value.step
        assert np.isfinite(partial.attitude[before]).all() and np.isfinite(partial.x[before]).all()
        assert np.isnan(partial.attitude[~before]).all() and np.isnan(partial.x[~before]).all()
    assert len(steps) == 1 and 700 < steps.pop() < 720  # the logarithm of the largest float64 is 709.8


@pytest.mark.parametrize("span", [(7.25, 107.25), (7.25, -92.75)], ids=str)
def test_failure_names_its_time(span):
    """The motion of one of two signs grows without bound in the direction of the run."""
    way, failures = np.sign(span[1] - span[0]), []
    for sign in (1, -1):
        system = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Polynomial({(1, 1): 4.0}), sign=sign)
        try:
            co.integrate(system, (0.5, 0.5), span, 0.25, co.ExplicitRungeKutta("rk4"), save_every=2)
        except co.IntegrationError as failure:
            failures.append(failure)
    for failure in failures:
        assert failure.time == 7.25 + way * (failure.step - 1) * 0.25 and f"at t = {failure.time:g}" in str(failure)
        t = failure.partial.t
        assert t[0] == 7.25 and np.all(np.diff(t) * way > 0) and np.isfinite(failure.partial.x).all()
        assert np.all(np.abs(t - 7.25) <= (failure.step - 1) * 0.25)
    assert failures
