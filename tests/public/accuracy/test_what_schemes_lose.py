"""What a scheme does not declare to preserve is lost at a large step on a named system; what it declares is tested on
every system by the matrix."""

import numpy as np
import pytest

import coadjoint as co
from matrix.cases import supported, value_of
from matrix.references import largest_changes, preserved, rounding_of
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


def run(method, system):
    step = 0.1 if method.order <= 2 or "Composition" in str(method) else 0.4
    return co.integrate(system, STARTS[system_text(system)], (0.0, 40 * step), step, method)


def system_text(system):
    return next(text for text in STARTS if value_of(text) is system)


@pytest.mark.parametrize("text", CONSTANT)
def test_undeclared_invariants_are_lost(text):
    """The energy or the Casimirs of one of the systems, by a thousand times what rounding could do."""
    method, lost, undeclared = value_of(text), set(), set()
    for name in filter(lambda name: supported(text, name), STARTS):
        system = value_of(name)
        kept = preserved(system, method.properties(system))
        sol = run(method, system)
        changes, rounding = largest_changes(sol), rounding_of(sol)
        for key in changes.keys() - set(kept):
            kind = "energy" if key == "energy" else "Casimir"
            undeclared.add(kind)
            if changes[key] > 1000 * rounding[key]:
                lost.add(kind)
    assert lost == undeclared


@pytest.mark.parametrize("text", CONSTANT)
def test_schemes_not_declared_symmetric_are_not(text):
    """A step forward and back is off by O(h^(p+1)): far above rounding at a large step of a low order."""
    method = value_of(text)
    name = next((name for name in STARTS if supported(text, name)), None)
    if name is None or method.symmetric or method.order > 6:
        return
    system, x = value_of(name), STARTS[name]
    back = co.stepper(system, method, -0.4)(co.stepper(system, method, 0.4)(x), 0.4)
    assert np.abs(back - x).max() > 1e-11


@pytest.mark.parametrize("text", CONSTANT)
def test_group_elements_that_are_not_kept(text):
    """Those that are integrated leave the group; where there are none they are refused."""
    method = value_of(text)
    if not supported(text, BODY):
        return
    system = value_of(BODY)
    attitude = method.properties(system).attitude
    if attitude == "none":
        with refused(ValueError, "group element", type(method).__name__):
            co.integrate(system, SIX, (0.0, 1.0), 0.1, method, attitude="coadjoint")
    elif attitude == "integrated":
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
