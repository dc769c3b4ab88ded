"""Which cases of thinned tests stay in `make test`."""

import subprocess
import sys

import pytest


@pytest.mark.thinned(3)
@pytest.mark.parametrize("second", ["x", "y", "z"])
@pytest.mark.parametrize("first", ["a", "b", "c", "d"])
def test_pairs(first, second):
    assert first < second


def test_a_third_of_the_pairs_stays_with_every_value():
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--collect-only", "-m", "not long", __file__]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    pairs = {line.partition("[")[2].rstrip("]") for line in lines if "test_pairs[" in line}
    assert len(pairs) == 4
    assert {pair[0] for pair in pairs} | {pair[-1] for pair in pairs} == set("abcdxyz")
