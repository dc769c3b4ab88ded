"""Certificates in other units of momentum and time: the same verdicts, and bounds that scale as their rows."""

import functools

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.analysis.certificates.claims import scheme_and_claims
from coadjoint.analysis.checks import convergence
from coadjoint.analysis.checks.reference import CLOSED_FORM_TOLERANCE, motion, natural_time
from coadjoint.analysis.checks.study import study
from coadjoint.analysis.checks.subject import Subject

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "e(2)": co.algebras.e(2),
    "so(4)": co.algebras.so(4),
    "Heisenberg": co.algebras.heisenberg(1),
}
UNITS = [(2.0**30, 2.0**-10), (2.0**-30, 2.0**10)]
"""Units of momentum and time; powers of two round nothing."""
U = 2.0**-53
KEPT = co.methods.Properties(poisson=True, energy=True, casimirs="all", attitude="none")


@functools.cache
def drawn(name):
    """Return M, linear and four states."""
    rng, n = np.random.default_rng(len(name)), ALGEBRAS[name].dim
    M = rng.normal(size=(n, n))
    return M @ M.T / n, rng.normal(size=n) / 4, rng.normal(size=(4, n)) / 2


def in_units(name, momentum, time):
    """Return the system of the energy (momentum/time) H(x/momentum)."""
    M, linear, _ = drawn(name)
    return co.LiePoissonSystem(ALGEBRAS[name], co.Quadratic(M / (momentum * time), linear=linear / time))


def noisy(system):
    """Return the midpoint rule with relative errors of 1e-8 by the last bits of each coordinate."""

    def step(x, h):
        after = x + h * system.vector_field(x + h / 2 * system.vector_field(x))
        return after * (1.0 + 1e-8 * (np.frexp(after)[0] * 2.0**45 % 1.0))

    return step


METHODS = {
    "Splitting": lambda system: co.Splitting(parts="coordinates"),
    "GaussLegendre": lambda system: co.GaussLegendre(2),
    "noisy": noisy,
}


def rows_of(name, method, momentum, time):
    system = in_units(name, momentum, time)
    said = {"order": 2, "properties": KEPT, "symmetric": False} if method == "noisy" else {}
    found = co.certify(system, METHODS[method](system), momentum * drawn(name)[2], time / 8, steps=4, **said)
    return {row.key: row for row in found.rows}


@functools.cache
def plain_rows(name, method):
    return rows_of(name, method, 1.0, 1.0)


@pytest.mark.thinned(45)
@pytest.mark.parametrize("units", UNITS, ids=["large", "small"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ALGEBRAS)
def test_units_change_no_verdict_and_scale_every_bound(name, method, units):
    """Elements and relative errors have no unit, invariants neither."""
    momentum = units[0]
    scaled, plain = rows_of(name, method, *units), plain_rows(name, method)
    unit = dict.fromkeys(("symmetry", "reversibility", "poisson", "spatial momentum"), momentum)
    assert scaled.keys() == plain.keys() and {*unit} - {"spatial momentum"} <= plain.keys()
    for key, row in plain.items():
        assert scaled[key].verdict == row.verdict, f"{row}\n{scaled[key]}"
        if row.bound:
            # Another step or state may be the worst after rounding; a power of a unit too many is at least 2^10.
            assert 2.0**-5 < scaled[key].bound / (unit.get(key, 1.0) * row.bound) < 2.0**5, key


@pytest.mark.thinned(4)
@pytest.mark.parametrize("units", UNITS, ids=["large", "small"])
@pytest.mark.parametrize("name", ["so(3)", "e(2)"])
def test_single_steps_have_the_same_errors_in_other_units(name, units):
    found = []
    for momentum, time in ((1.0, 1.0), units):
        system = in_units(name, momentum, time)
        scheme, claims = scheme_and_claims(system, co.GaussLegendre(1), None, None, None)
        subject = Subject(system, scheme, claims, time / 8, momentum * drawn(name)[2], 4)
        found.append(convergence._single_steps(subject, study(subject)))
    plain, scaled = found
    assert len(plain.steps) == len(scaled.steps) and scaled.value == pytest.approx(plain.value, abs=1e-3)
    np.testing.assert_allclose(scaled.steps / units[1], plain.steps, rtol=1e-6)
    # Errors are above 16 times their round-off.
    np.testing.assert_allclose(scaled.errors, plain.errors, rtol=1 / 8)


@pytest.mark.thinned(8)
@pytest.mark.parametrize("units", UNITS, ids=["large", "small"])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_references_in_other_units_are_the_same_motion(name, units):
    momentum, time = units
    states = drawn(name)[2]
    plain = motion(in_units(name, 1.0, 1.0), states, 2.0)
    scaled = motion(in_units(name, *units), momentum * states, 2.0 * time)
    assert plain.by == scaled.by == "DOP853 on the vector field"
    size = np.linalg.norm(plain.states)
    assert np.linalg.norm(scaled.states / momentum - plain.states) <= (plain.error + scaled.error) * size
    # Both errors are those of few steps, whose first lengths may differ.
    assert scaled.error < 64 * plain.error < 64e-11
    for x in states:
        expected = time * natural_time(in_units(name, 1.0, 1.0), x)
        assert natural_time(in_units(name, *units), momentum * x) == pytest.approx(expected, rel=1e-9)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("units", [(1.0, 1.0), *UNITS], ids=["plain", "large", "small"])
@pytest.mark.parametrize("off", [1e-11, 1e-9, 1e-7])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_the_error_of_a_closed_form_is_relative(name, off, units):
    """Of a linear motion x' = A x, too large by one factor at any time: two half steps are off once more."""
    momentum, time = units
    _, linear, states = drawn(name)
    algebra, n = ALGEBRAS[name], len(linear)
    A = co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=linear)).vector_field(np.eye(n)).T
    system = co.LiePoissonSystem(
        algebra,
        co.Quadratic(0.0, linear=linear / time),
        exact=lambda x0, t, attitude: (1.0 + off) * expm(t / time * A) @ x0,
    )
    found = motion(system, momentum * states, 2.0 * time)
    true = states @ expm(2.0 * A).T
    distance = np.linalg.norm(found.states / momentum - true) / np.linalg.norm(true)
    if off > CLOSED_FORM_TOLERANCE:
        assert found.by == "DOP853 on the vector field" and "is off the vector field by 1e-07" in found.contradiction
        assert distance <= found.error < 1e-11
    else:
        assert found.by == "the closed form" and found.contradiction == ""
        # The exponentials of a norm below 2 |A| are rounded to some n u of that.
        rounding = 64 * n * U * (1.0 + np.linalg.norm(A))
        assert distance == pytest.approx(off, abs=rounding)
        assert found.error == pytest.approx(2.0 * off, abs=2.0 * rounding)
