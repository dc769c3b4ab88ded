"""The law of two series: what it foretells, and that nothing near to the best goes untried."""

from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import accuracy, remembered
from coadjoint.choosing.law import AHEAD, NEARLY, Law, law_of
from random_runs.algebras import some_algebra

BODY = co.systems.rigid_body((1, 2, 2.5))


def fit_of(order, steps, error, method=None):
    return SimpleNamespace(candidate=SimpleNamespace(method=method or co.Taylor(order)), steps=steps, error=error)


def test_a_law_that_is_exact():
    """With c = 3 and T / r = 50 the error of N steps is 3 (50 / N)^p."""
    fits = [fit_of(p, 80.0 + p, 3.0 * (50.0 / (80.0 + p)) ** p) for p in (16, 8)]
    law = Law(*fits)
    for p, goal in ((6, 1e-3), (12, 1e-9), (24, 1e-12)):
        steps = law.steps(p, goal)
        assert 3.0 * (50.0 / steps) ** p == pytest.approx(goal, rel=1e-9)
        series, other = (SimpleNamespace(method=m) for m in (co.Taylor(p), co.GaussLegendre(p // 2)))
        assert law.guess(series, goal) == steps > law.guess(other, goal) > steps / AHEAD
        assert NEARLY < AHEAD


def test_two_series_far_enough_apart_make_it():
    near = [fit_of(16, 100, 1e-9), fit_of(14, 110, 1e-9)]
    assert law_of(near) is None and law_of(near[:1]) is None
    others = [fit_of(16, 100, 1e-9, co.GaussLegendre(8)), fit_of(8, 300, 1e-9, co.GaussLegendre(4))]
    assert law_of(others) is None
    assert law_of([*others, near[0], fit_of(8, 300, 0.0)]) is not None
    own = fit_of(8, 300, 1e-9, co.Taylor(8, tolerance=1e-6))
    assert law_of([near[0], own]) is None and law_of([near[0], own, fit_of(8, 300, 1e-9)]) is not None


def some_problems():
    rng = np.random.default_rng(7)
    yield BODY, (0.6, 0.0, 0.8), 100.0
    yield co.systems.toda(4), (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45), 5.0
    # A dense gradient on a solvable algebra in another basis: a Gauss method costs half of what a series does.
    other = np.random.default_rng(73)
    solvable = some_algebra(other)
    M = other.standard_normal((6, 6))
    yield co.LiePoissonSystem(solvable, co.Quadratic(M @ M.T / 6 + 0.3 * np.eye(6))), other.standard_normal(6), 5.0
    found = 0
    while found < 4:
        algebra = some_algebra(rng)
        if not 3 <= algebra.dim <= 8:
            continue
        found += 1
        M = np.diag(rng.uniform(0.5, 2.0, algebra.dim))
        x0 = rng.standard_normal(algebra.dim)
        system = co.LiePoissonSystem(algebra, co.Quadratic(M))
        speed = np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0)
        yield system, x0, (-1) ** found * 20.0 / max(float(speed), 0.1)


def test_what_goes_untried_is_no_cheaper(monkeypatch):
    """The steps of a scheme are found to a third or so from two starts of the search."""
    for system, x0, span in some_problems():
        for wanted in (1e-3, 1e-10):
            chosen = co.choose(system, x0, (0.0, span), wanted)
            with monkeypatch.context() as all_tried:
                all_tried.setattr(accuracy, "law_of", lambda found: None)
                thorough = co.choose(system, x0, (0.0, span), wanted)
            assert chosen.cost <= 1.35 * thorough.cost
            assert chosen.error <= wanted


def test_series_that_are_given_up_spare_the_trials_of_others(monkeypatch):
    """Particles fly apart: steps of its own are so much longer that hardly another scheme is worth a trial."""
    tried = []

    def counted(pilot, candidate, *rest):
        tried.append(candidate.method)
        return fit(pilot, candidate, *rest)

    fit = accuracy.fit
    monkeypatch.setattr(accuracy, "fit", counted)
    for wanted in (1e-6, 1e-9):
        tried.clear()
        chosen = co.choose(co.systems.toda(4), (-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45), (0.0, 80.0), wanted)
        assert chosen.method.own_steps
        # Two series make the law; of 20 candidates each other one could be tried.
        assert 2 <= len(tried) <= 6


def test_what_is_remembered_changes_nothing():
    first = co.choose(BODY, (0.6, 0.0, 0.8), (0, 50), 1e-7)
    co.choose(BODY, (0.1, 2.0, 0.3), (50, 0), 1e-4)
    again = co.choose(BODY, (0.6, 0.0, 0.8), (0, 50), 1e-7)
    new = co.choose(co.systems.rigid_body((1, 2, 2.5)), (0.6, 0.0, 0.8), (0, 50), 1e-7)
    assert first == again == new and first.others == again.others == new.others
    for method in (
        co.Taylor(6),
        co.Taylor(24),
        co.Taylor(24, projected=False),
        co.GaussLegendre(2),
        co.GaussLegendre(6),
    ):
        own, alone = (
            co.choose(system, (0.6, 0.0, 0.8), (0, 50), 1e-7, methods=method)
            for system in (BODY, co.systems.rigid_body((1, 2, 2.5)))
        )
        assert own == alone


def test_so_much_is_remembered(monkeypatch):
    made = []
    monkeypatch.setattr(remembered, "MOST", 3)
    for key in (1, 2, 3, 4, 4, 1):
        remembered.remembered(BODY, ("test", key), lambda key=key: made.append(key))
    assert made[-2:] == [4, 1]
    assert len(remembered._known_of(BODY)) <= 3
    made.clear()
    for _ in range(2):
        remembered.remembered(BODY, ("test", []), lambda: made.append(0))
    assert made == [0, 0]
