"""Every registered scheme on registered and drawn systems, with drawn options.

Compared are: the bits of members alone, of any number of threads, of saved, watched, archived and prepared runs; the
order of the error; what is declared to be preserved; and tangents, gradients and differences. `tests/matrix/` draws
the cases and writes the lines that are executed, and a failure shows them.
"""

import os
from functools import cache, partial

import numpy as np
import pytest

from long import long_beyond
from matrix.cases import accepted, drawn, drawn_on, option_sets, supported, value_of
from matrix.options import NEUTRAL, every_pair, pairs_in
from matrix.references import convergence
from matrix.running import Disagreement, check_case, check_drawn, is_refused
from matrix.schemes import SLOW, schemes
from matrix.soak import check_wild
from matrix.systems import systems

pytestmark = [
    pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning"),
    pytest.mark.filterwarnings("ignore:the steps of Heun"),
]


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@cache
def cases_of(method):
    """Every second scheme on a system on an algebra of the catalogue, if it supports it; else on a registered one."""
    new = schemes().index(method) % 2 == 1 and list(drawn(method, seed=1, each=0, catalogue=1))
    return new or list(drawn(method, seed=1, each=1, catalogue=0))


@pytest.mark.thinned(8)
@pytest.mark.parametrize("method", schemes())
def test_schemes_on_drawn_systems(method):
    assert check_drawn(cases_of(method))


@pytest.mark.long
def test_systems_that_no_scheme_draws():
    taken = {system for method in schemes() for _, system, *_ in cases_of(method)}
    for system in sorted(set(systems()) - taken):
        assert check_drawn(drawn_on(system, seed=1, each=1))


@pytest.mark.long
@pytest.mark.parametrize("system", systems())
def test_systems_by_drawn_schemes(system):
    assert check_drawn(drawn_on(system, seed=1, each=2))


def test_members_on_workers():
    """One case of those that start processes; the long ones have more."""
    chosen = {"members": "batch", "blocks": "workers", "direction": "backward", "attitude": "coadjoint"}
    assert check_drawn([("co.GaussLegendre(2)", "co.systems.rigid_body()", NEUTRAL | chosen, 1)])


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3])  # other ones, and as many as one likes, by `make soak`
@pytest.mark.parametrize("method", schemes())
def test_schemes_on_other_systems(method, seed):
    assert check_drawn(drawn(method, seed, each=4, catalogue=2, workers=0.1))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("first", long_beyond(1, range(0, 300, 12)))
def test_wild_cases_have_the_same_bits(first):
    """Random algebras, members that are far away, at rest or failing, and events."""
    for seed in range(first, first + 12):
        check_wild(seed, threads=seed % 5 == 0)


@pytest.mark.parametrize("method", [text for text in schemes() if text not in SLOW])
def test_unsupported_systems_are_refused_by_name(method):
    """The declaration and the run agree: what is refused is refused before a step, with a line that says why."""
    assert not all(is_refused(method, system) for system in systems())


SHOWING = (
    "co.systems.rigid_body()",
    "co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.4]) + co.Polynomial({(1, 1, 0): 0.3}))",
    "co.systems.sphere_euler(N=5)",
    "co.systems.torus_euler(N=5)",
    "co.systems.heavy_top()",
)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("method", [text for text in schemes() if text not in SLOW and not value_of(text).own_steps])
def test_every_scheme_shows_its_order(method):
    """On one of some systems the slope of the error is conclusive: the check of the order does not pass unused.

    From order 6 on, errors may be too small for a slope, which the check sees as well.
    """
    scheme = value_of(method)
    for system in filter(partial(supported, method), SHOWING):
        for seed in (1, 2):
            _, space, _ = accepted(method, system, NEUTRAL, seed)
            states = np.stack([space["x0"], 0.95 * space["x0"], 1.05 * space["x0"]])
            power = 2 if scheme.symmetric else 1
            shown, order, allowed = convergence(space["system"], scheme, states, space["span"], scheme.order, power)
            assert abs(shown - order) <= allowed
            if np.isfinite(allowed):
                return
    assert scheme.order >= 6, "no error is large enough, or none falls regularly"


def test_every_pair_of_options_is_drawn():
    assert set().union(*map(pairs_in, option_sets(1))) == every_pair()


def test_failures_show_lines_that_repeat_them():
    case, space, _ = accepted("co.GaussLegendre(2)", "co.systems.rigid_body()", NEUTRAL | {"members": "many"}, 5)

    def false_check(case, space):
        yield "found, expected, allowed = sol.x[-1, 0], 1.001 * sol.x[-1, 0], 1e-12\n"

    with pytest.raises(Disagreement, match="false_check of co") as failure:
        check_case(case, space, [false_check])
    text = str(failure.value)
    lines = text[text.index("import numpy") :]
    assert "co.integrate(" in lines and len(lines.splitlines()) < 25
    with pytest.raises(AssertionError, match=r"they differ by 0\.000\d+, allowed 1e-12"):
        exec(lines, {})
