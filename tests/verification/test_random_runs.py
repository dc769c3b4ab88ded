"""Random systems, schemes and crowds: every run has the bits that it has alone, and ends.

`make long` tries three times as many, `make soak` thousands.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import coadjoint as co
from long import long_beyond
from random_runs.cases import case_of

SEEDS, EACH = 300, 25
# The limit of a single seed ends a process earlier.
GUARD = 600.0


@pytest.mark.parametrize("first", long_beyond(3, range(0, SEEDS, EACH)))
def test_random_runs_have_the_same_bits_in_any_company(first):
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


def test_cases_have_all_that_a_run_may_be_given():
    """Steps of the scheme's own, events, batches, group elements, runs backward: each in some of the cases."""
    cases = [case_of(seed)[0] for seed in range(60)]
    own = {type(case.method).__name__ for case in cases if case.method.own_steps}
    assert own == {"Taylor", "ReversibleSteps"}
    events = [event for case in cases for event in case.events]
    assert len(events) > 15 and {event.direction for event in events} == {-1, 0, 1}
    assert {case.batch for case in cases} == {True, False} == {case.attitude is False for case in cases}
    assert any(case.t_span[1] < case.t_span[0] for case in cases)
    assert any(case.events and case.method.own_steps for case in cases)
