"""Random systems, schemes and ensembles: the same bits in every way to run them, and no run hangs.

`make long` runs twelve times as many, `make soak` thousands.
"""

import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest

import coadjoint as co
from long import long_beyond, long_where
from random_runs import soak
from random_runs.cases import case_of
from random_runs.comparisons import differences, run

SEEDS, EACH = 300, 25
# The limit of a single seed ends a process earlier.
GUARD = 600.0


@pytest.mark.parametrize("first", long_beyond(1, range(0, SEEDS, EACH)))
def test_random_runs_have_the_same_bits(first):
    command = [sys.executable, "-m", "random_runs.soak", str(first), str(EACH)]
    done = subprocess.run(
        command,
        cwd=Path(__file__).parents[1],
        env=os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=GUARD,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert done.stdout.splitlines()[-1] == f"{EACH} seeds, 0 wrong"


@pytest.mark.parametrize("seed", [8200055, 8200449, 8202363])
def test_seeds_of_earlier_differences(seed):
    """An energy that overflowed and was subtracted from itself; a pair of crossings in the last step."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", co.LargeStepWarning)
        assert list(differences(seed)) == []


@pytest.mark.parametrize("seed", [2000018, 770000244])
def test_states_that_overflow_are_drawn(seed):
    case, _ = case_of(seed)
    with pytest.raises(OverflowError):
        for x in case.x0:
            case.systems[0].vector_field(x)


def test_soak_continues_after_a_failed_draw(monkeypatch, capsys):
    def fail(seed):
        raise RuntimeError("no such case")

    limit = SimpleNamespace(dump_traceback_later=lambda *given, **options: None, cancel_dump_traceback_later=int)
    monkeypatch.setattr(soak, "faulthandler", limit)  # needs a file, which captured output is not
    monkeypatch.setattr(soak, "case_of", fail)
    monkeypatch.setattr(soak, "differences", lambda seed: [] if seed % 2 else fail(seed))
    assert soak.tried(range(4), 60.0) == 2
    assert capsys.readouterr().out.count("its case cannot be drawn: no such case") == 2


@pytest.mark.parametrize("seed", long_where([770000343], [770000343, 770002335]))
def test_failures_have_the_same_step(seed):
    """A group element overflows where the momentum does not; a variable step overflows."""
    assert not list(differences(seed))
    assert run(case_of(seed)[0]).failed.any()


def test_cases_cover_all_options_of_runs():
    cases = [case_of(seed)[0] for seed in range(60)]
    own = {type(case.method).__name__ for case in cases if case.method.own_steps}
    assert own == {"Taylor", "ReversibleSteps"}
    events = [event for case in cases for event in case.events]
    assert len(events) > 15 and {event.direction for event in events} == {-1, 0, 1}
    assert {case.batch for case in cases} == {True, False} == {case.attitude is False for case in cases}
    assert any(case.t_span[1] < case.t_span[0] for case in cases)
    assert any(case.events and case.method.own_steps for case in cases)
