"""The bits of a run do not depend on the vector instructions of the processor, nor on fused products in hardware."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import coadjoint
from coadjoint.kernels import library


def usable_levels() -> list[str]:
    """Return the levels that are built and that this processor has, the highest first; none where it has no levels."""
    highest = library.processor_level()
    return [f"v{level}" for level in library.built_levels() if highest is not None and level <= highest]


@cache
def digests(level: str | None) -> dict[str, str]:
    """Return the digests of the runs that a process of this level makes."""
    environment = {name: value for name, value in os.environ.items() if name != "COADJOINT_LEVEL"}
    environment["PYTHONPATH"] = str(Path(coadjoint.__file__).parents[1])
    if level is not None:
        environment["COADJOINT_LEVEL"] = level
    command = [sys.executable, "-m", "verification.digests_of_runs"]
    folder = Path(__file__).parents[1]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.long  # `make variants` compares levels too
@pytest.mark.parametrize("level", [None, *usable_levels()[1:]])
def test_every_level_gives_the_same_bits(level):
    """Also twice the same level, in two processes: nothing of a process, such as an address, is in the bits."""
    expected = digests(next(iter(usable_levels()), None)) if level else digests.__wrapped__(None)
    found = digests(level)
    assert len(found) > 90
    assert {name for name in expected if expected[name] != found[name]} == set()
    assert len(set(found.values())) == len(found)
