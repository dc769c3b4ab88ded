"""Every registered scheme on registered and drawn systems, with drawn options.

Compared are: the bits of members alone, of any number of threads, of saved, watched, archived and prepared runs; the
order of the error; what is declared to be preserved; and tangents, gradients and differences. `tests/matrix/` draws
the cases and writes the lines that are executed, and a failure shows them.
"""

import os

import pytest

import coadjoint as co
from matrix.cases import drawn, option_sets
from matrix.options import every_pair, pairs_in
from matrix.running import check_scheme
from matrix.schemes import schemes
from matrix.systems import systems

EACH = 2


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.mark.thinned(1)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("method", schemes())
def test_scheme_on_drawn_systems(method):
    assert check_scheme(method, seed=1, each=EACH)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("seed", range(2, 6))
@pytest.mark.parametrize("method", schemes())
def test_scheme_on_other_systems(method, seed):
    assert check_scheme(method, seed, each=6, catalogue=3)


def test_every_registered_scheme_and_system_is_drawn():
    cases = [case for method in schemes() for case in drawn(method, 1, EACH)]
    for name in co.methods.names():
        assert sum(f"co.{name}(" in method for method, *_ in cases) > 1, name
    for system in systems():
        assert sum(system == other for _, other, *_ in cases) > 1, system


def test_every_pair_of_options_is_drawn():
    assert set().union(*map(pairs_in, option_sets(1))) == every_pair()
