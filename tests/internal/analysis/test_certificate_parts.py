"""Rows of certificates: group elements that are wrong anywhere, and expensive steps, along directions."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.certificates import attitude, step_map, subject
from coadjoint.analysis.certificates.certify import scheme_and_claims
from coadjoint.analysis.certificates.reference import natural_time
from coadjoint.analysis.certificates.subject import Subject
from rounding import UNIT_ROUNDOFF as U

Properties = co.methods.Properties
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = np.array([0.3, 1.0, 0.2])
RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("speed", "rests"), [(32 * U, True), (128 * U, False)])
def test_a_state_rests_up_to_its_threshold(speed, rests):
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros(3), linear=(0.0, 0.0, speed)))
    assert (natural_time(system, np.array([1.0, 0.0, 0.0])) == 0.0) is rests


def subject_of(system, method, states, h, steps=32, **said):
    scheme, claims = scheme_and_claims(system, method, said.get("order"), said.get("properties"), said.get("symmetric"))
    states = np.atleast_2d(np.asarray(states, dtype=float))
    return Subject(system, scheme, h, states, steps, **claims)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.1, -0.1])
@pytest.mark.parametrize("place", [None, (1, 0), (9, 3), (-1, 1)])
def test_a_wrong_group_element_is_seen_at_any_time_of_any_member(place, h, monkeypatch):
    run_of = attitude._run

    def off(subject, kind, steps):
        run, elements, condition = run_of(subject, kind, steps)
        if place is not None and not (kind == "coadjoint" and untouched):
            elements = elements.copy()
            elements[place] += 1e-8 * np.outer([1.0, -2.0, 0.5], [0.3, 1.0, 2.0])
        return run, elements, condition

    monkeypatch.setattr(attitude, "_run", off)
    for untouched in (False, True):
        rows = {row.key: row for row in attitude.attitude_rows(subject_of(BODY, co.Splitting(), X0, h), None, 32)}
        assert list(rows) == ["spatial momentum", "group", "element"]
        for key, row in rows.items():
            fails = place is not None and not (key == "spatial momentum" and untouched)
            assert row.verdict == ("fails" if fails else "holds"), str(row)
            assert row.claimed and (row.value > row.bound) == fails


def coupled(algebra):
    A = RNG.normal(size=(algebra.dim, algebra.dim))
    return co.LiePoissonSystem(algebra, co.Quadratic(A @ A.T / algebra.dim + np.eye(algebra.dim)))


class SaidToBePoisson(co.GaussLegendre):
    """A symmetric scheme that is no Poisson map."""

    def properties(self, system):
        return Properties(poisson=True, energy=False, casimirs="quadratic", attitude="none")


SYSTEMS = {name: coupled(co.algebras.get(name)) for name in ("sl(2)", "A5,3", "su(3)")}


@pytest.fixture
def dear(monkeypatch):
    """Every step is taken for one that takes long."""
    monkeypatch.setattr(subject, "EXPENSIVE_SECONDS", 0.0)


@pytest.mark.parametrize("name, h", [("sl(2)", 0.05), ("A5,3", -0.05)])
def test_dear_steps_have_the_verdicts_of_cheap_ones(name, h, dear, monkeypatch):
    system = SYSTEMS[name]
    x0 = RNG.normal(size=system.dim)
    for scheme in (co.Splitting(), co.GaussLegendre(2)):
        few = co.certify(system, scheme, x0, h, steps=64)
        along = few["poisson"].measured.endswith("by tangents along 4 directions there and back")
        assert along == bool(few["poisson"].value is not None)
        assert len(few.subject["states"]) == 2
        with monkeypatch.context() as patch:
            patch.setattr(subject, "EXPENSIVE_SECONDS", np.inf)
            all_of_it = co.certify(system, scheme, x0, h, steps=64)
        assert len(all_of_it.subject["states"]) == 4
        told = {row.key: row.verdict for row in few.table if row.claimed}
        assert told == {row.key: row.verdict for row in all_of_it.table if row.claimed} and few.passed


@pytest.mark.parametrize("name", ["sl(2)", "su(3)"])
def test_what_is_no_poisson_map_is_found_along_directions(name, dear):
    system = SYSTEMS[name]
    x0 = RNG.normal(size=system.dim)
    row = co.certify(system, SaidToBePoisson(1), x0, 0.1, steps=8)["poisson"]
    assert row.verdict == "fails" and row.value > 1e6 * row.bound


def test_the_defect_along_directions_is_about_that_of_the_matrices(dear):
    """P J - J(y) Q^T has 15^2 entries, whose mean square is estimated by 16 numbers: to a factor of 2, by 4 sigma."""
    system, scheme, h = coupled(co.algebras.su(4)), co.GaussLegendre(1), 0.2
    x = RNG.normal(size=system.dim)
    row = co.certify(system, SaidToBePoisson(1), x[None], h, steps=1)["poisson"]
    there, back = co.stepper(system, scheme, row.evidence.get("step", h)), co.stepper(system, scheme, -h)
    y = there(x)
    P, Q = there.tangent(x), back.tangent(y)
    defect = np.linalg.norm(P @ system.structure_matrix(x) - system.structure_matrix(y) @ Q.T)
    assert row.measured.startswith("defect")
    found, bound, _ = step_map._directional_defect(subject_of(system, scheme, x, h, 1), x, h)
    assert 0.5 * defect < found < 2.0 * defect and bound < 1e-6 * defect


@pytest.mark.long
def test_the_long_run_has_as_many_steps_as_take_seconds(monkeypatch):
    monkeypatch.setattr(subject, "SECONDS_PER_COST", 2e-5)  # a step of su(3) then counts as some milliseconds
    system = SYSTEMS["su(3)"]
    x0 = RNG.normal(size=system.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05)
    steps = found.subject["steps"]
    assert 32 <= steps < 2000 and f"{steps} steps of 0.05 from 2 states" in found["run"].measured
    assert "steps=2000 would take about" in found["run"].reason
    with pytest.warns(co.LongWait, match="the long run of 5000 steps from 2 states takes about"):
        asked = co.certify(system, co.Splitting(), x0, 0.05, steps=5000)
    assert asked.subject["steps"] == 5000 and asked["run"].reason == ""


@pytest.mark.long
def test_matrices_that_would_be_too_large_are_not_needed_for_dear_steps(dear, monkeypatch):
    """Neither J nor P is made as a matrix; a lattice of more coordinates is not read flow by flow."""
    monkeypatch.setattr(step_map, "MAX_DENSE_DIM", 16)
    g = co.algebras.so(7)
    system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(1.0, 2.0, g.dim)))
    monkeypatch.setattr(type(system), "structure_matrix", None)
    x0 = RNG.normal(size=g.dim) / np.sqrt(g.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05, steps=4)
    assert [found[key].verdict for key in ("symmetry", "poisson")] == ["holds", "holds"]
    monkeypatch.setattr(step_map, "MAX_DIRECTIONAL_DIM", 20)
    assert co.certify(system, co.Splitting(), x0, 0.05, steps=4)["poisson"].verdict == "not decidable here"


def test_matrix_systems_are_seen_along_directions(dear):
    """Their J is a matrix of the system, not of an algebra with structure constants."""
    ball = co.systems.sphere_euler(4)
    found = co.certify(ball, co.IsospectralGauss(2), ball.random(seed=1), 0.02, steps=16)
    assert found["poisson"].measured.endswith("by tangents along 4 directions there and back")
    assert found["poisson"].verdict == "holds" and found.passed
