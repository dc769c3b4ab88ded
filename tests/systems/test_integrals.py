"""Known integrals of a system: kept by name, checked to be constant along its field, and written into its record."""

import json

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.records import record_of, system_of

SO3, E3 = co.algebras.so(3), co.algebras.e(3)
THIRD = co.Polynomial({(0, 0, 1): 1})
SYMMETRIC = co.Quadratic([0.3, 0.3, 0.7])


def body(**given):
    return co.LiePoissonSystem(SO3, SYMMETRIC, sign=-1, name="own", **given)


def test_they_are_read_only_and_may_be_observed():
    system = body(integrals={"x3": THIRD, "x3^2": co.Quadratic([0, 0, 2]), "cos": co.Invariant(lambda x: np.cos(x[2]))})
    assert list(system.integrals) == ["x3", "x3^2", "cos"] and system.integrals["x3"] == THIRD
    system.integrals.clear()
    assert len(system.integrals) == 3
    kept = {name: F for name, F in system.integrals.items() if name != "cos"}
    sol = co.integrate(system, (1.0, 0.5, 0.25), (0, 5), 0.5, co.Splitting(2), observe=kept)
    assert np.ptp(sol.observed["x3"]) == 0.0 and sol.observed["x3^2"][0] == 0.0625
    assert body().integrals == {}


def test_a_record_keeps_those_that_are_polynomials():
    cube = co.Polynomial({(0, 0, 3): 1})
    forms = {"x3": THIRD, "cube": cube, "x3^2": co.Quadratic([0, 0, 2])}
    record = json.loads(json.dumps(record_of(body(integrals={**forms, "f": lambda x: x[2]}))))
    assert record["not_stored"] == ["integral: f"]
    again = system_of(record)
    assert list(again.integrals) == list(forms) and again.integrals["cube"] == cube
    assert again.integrals["x3^2"].value([0, 0, 2.0]) == 4.0
    assert "integrals" not in record_of(body())


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"x2": co.Polynomial({(0, 1, 0): 1})}, ValueError, "'x2' is not an integral: it changes at the rate"),
        ({"q": co.Quadratic([1, 2, 0])}, ValueError, "'q' is not an integral"),
        (
            {"v": co.Invariant(lambda x: x[1], lambda x: np.array([0.0, 1.0, 0.0]))},
            ValueError,
            "'v' is not an integral",
        ),
        ({"x": co.Polynomial({(0, 1): 1})}, ValueError, "the integral 'x' has 2 variables"),
        ({"energy": THIRD}, ValueError, "an integral is called 'energy'"),
        ({"x": 3}, TypeError, "the integral 'x' is 3"),
        ([THIRD], TypeError, "integrals is a list"),
    ],
)
def test_what_is_none_is_refused(given, kind, message):
    with pytest.raises(kind, match=message):
        body(integrals=given)


@pytest.mark.parametrize("H", [SYMMETRIC, co.Polynomial("0.15*x1^2 + 0.15*x2^2 + 0.5*x3^3", dim=3)], ids=str)
@pytest.mark.parametrize("off", [1e-10, 1e-12])
def test_one_that_changes_by_more_than_rounding_is_refused(H, off):
    """For polynomials the tolerance is some hundred round-offs."""
    nearly = {"linear": co.Polynomial({(0, 0, 1): 1, (1, 0, 0): off}), "square": co.Quadratic([1.0, 1.0 + off, 1.0])}
    for name, F in nearly.items():
        with pytest.raises(ValueError, match=f"'{name}' is not an integral: it changes at the rate"):
            co.LiePoissonSystem(SO3, H, sign=-1, integrals={name: F})
    exact = {"linear": THIRD, "square": co.Quadratic([1.0, 1.0, 1.0])}
    assert list(co.LiePoissonSystem(SO3, H, sign=-1, integrals=exact).integrals) == list(exact)


def test_energies_that_are_functions():
    value, slope = (
        (lambda x: np.cosh(x[2]) + x[0] ** 2 + x[1] ** 2),
        (lambda x: np.array([2 * x[0], 2 * x[1], np.sinh(x[2])])),
    )
    assert co.LiePoissonSystem(SO3, co.Hamiltonian(value, slope), integrals={"x3": THIRD}).integrals
    with pytest.raises(ValueError, match="'x1' is not an integral"):
        co.LiePoissonSystem(SO3, co.Hamiltonian(value, slope), integrals={"x1": co.Polynomial({(1, 0, 0): 1})})
    cubic = co.Polynomial({(2, 0, 1): 1, (0, 2, 1): 1, (0, 0, 3): 0.1})
    assert co.LiePoissonSystem(SO3, cubic, integrals={"x3": THIRD}).integrals


def test_a_field_that_rests_at_time_zero_is_looked_at_later():
    turning = co.Hamiltonian(lambda x, t: t * x[0], lambda x, t: np.array([t, 0 * t, 0 * t]))
    with pytest.raises(ValueError, match="'x3' is not an integral"):
        co.LiePoissonSystem(SO3, turning, integrals={"x3": THIRD})
    assert co.LiePoissonSystem(SO3, turning, integrals={"x1": co.Polynomial({(1, 0, 0): 1})}).integrals


def test_a_top_on_e3_with_a_rounded_mass():
    H = co.Quadratic([1 / 3, 1 / 3, 1 / 7, 0, 0, 0], linear=[0, 0, 0, 0, 0, 0.3])
    system = co.LiePoissonSystem(E3, H, sign=-1, integrals={"m3": co.Polynomial({(0, 0, 1, 0, 0, 0): 1})})
    assert list(system.integrals) == ["m3"]
    with pytest.raises(ValueError, match="not an integral"):
        co.LiePoissonSystem(E3, H, sign=-1, integrals={"p3": co.Polynomial({(0, 0, 0, 0, 0, 1): 1})})
