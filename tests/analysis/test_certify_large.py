"""Certificates where a step takes long: fewer states and steps, derivatives along directions, the same verdicts."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.checks import poisson, subject, symmetry
from coadjoint.long_operations import LongWait
from coadjoint.methods import Properties

RNG = np.random.default_rng(7)


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
    found, bound, _ = poisson._directional_defect(subject_of(system, scheme, x, h), x, h)
    assert 0.5 * defect < found < 2.0 * defect and bound < 1e-6 * defect


def subject_of(system, scheme, x, h):
    from coadjoint.analysis.certificates.claims import scheme_and_claims
    from coadjoint.analysis.checks.subject import Subject

    method, claims = scheme_and_claims(system, scheme, None, None, None)
    return Subject(system, method, claims, h, x[None], 1)


@pytest.mark.long
def test_the_long_run_has_as_many_steps_as_take_seconds(monkeypatch):
    monkeypatch.setattr(subject, "SECONDS_PER_COST", 2e-5)  # a step of su(3) then counts as some milliseconds
    system = SYSTEMS["su(3)"]
    x0 = RNG.normal(size=system.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05)
    steps = found.subject["steps"]
    assert 32 <= steps < 2000 and f"{steps} steps of 0.05 from 2 states" in found["run"].measured
    assert "steps=2000 would take about" in found["run"].reason
    with pytest.warns(LongWait, match="the long run of 5000 steps from 2 states takes about"):
        asked = co.certify(system, co.Splitting(), x0, 0.05, steps=5000)
    assert asked.subject["steps"] == 5000 and asked["run"].reason == ""


def test_the_norm_of_a_tangent_by_directions():
    """To a factor of 1.5: the norms of 4 columns of a matrix near the unit matrix, of 24 rows, are near each other."""
    system = coupled(co.algebras.su(5))
    x = RNG.normal(size=system.dim)
    given = subject_of(system, co.Splitting(), x, 0.05)
    P = co.stepper(system, co.Splitting(), 0.05).tangent(x)
    size = np.linalg.norm(P)
    assert size / 1.5 < given.tangent_norm(x, 0.05) < 1.5 * size
    exact = size * np.linalg.norm(np.linalg.inv(P))
    assert exact / 2.25 < given._estimated_condition(x, 0.05) < 2.25 * exact
    assert given.condition(x, 0.05) == given._condition(x, 0.05)


@pytest.mark.long
def test_matrices_that_would_be_too_large_are_not_needed_for_dear_steps(dear, monkeypatch):
    """Neither J nor P is made as a matrix; a lattice of more coordinates is not read flow by flow."""
    for module in (poisson, symmetry):
        monkeypatch.setattr(module, "MAX_DENSE_DIM", 16)
    g = co.algebras.so(7)
    system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(1.0, 2.0, g.dim)))
    monkeypatch.setattr(type(system), "structure_matrix", None)
    x0 = RNG.normal(size=g.dim) / np.sqrt(g.dim)
    found = co.certify(system, co.Splitting(), x0, 0.05, steps=4)
    assert [found[key].verdict for key in ("symmetry", "poisson")] == ["holds", "holds"]
    monkeypatch.setattr(poisson, "MAX_DIRECTIONAL_DIM", 20)
    assert co.certify(system, co.Splitting(), x0, 0.05, steps=4)["poisson"].verdict == "not decidable here"


def test_matrix_systems_are_seen_along_directions(dear):
    """Their J is a matrix of the system, not of an algebra with structure constants."""
    ball = co.systems.sphere_euler(4)
    found = co.certify(ball, co.IsospectralGauss(2), ball.random(seed=1), 0.02, steps=16)
    assert found["poisson"].measured.endswith("by tangents along 4 directions there and back")
    assert found["poisson"].verdict == "holds" and found.passed
