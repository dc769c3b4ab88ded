"""A hundred random calls and half as many configurations; `make fuzz` tries many more."""

import inspect
import statistics
import tomllib
from collections import Counter

import pytest

import coadjoint as co
from long import long_beyond

from .configurations import draw
from .judging import wrong_error
from .run import in_processes

FEW, LONG = 50, 20_000
COUNTS = [("configurations", FEW), ("calls", 2 * FEW), ("configurations", 1200), ("calls", 800)]


@pytest.mark.parametrize(("kind", "count"), long_beyond(2, COUNTS))
def test_outcome_is_a_result_or_one_sentence(kind, count):
    assert [f"{seed}: {found}" for seed, found in in_processes(kind, range(count))] == []


@pytest.mark.long
@pytest.mark.parametrize("kind", ["configurations", "calls"])
def test_many_more_outcomes(kind):
    seeds = range(10**6, 10**6 + LONG)
    assert [f"{seed}: {found}" for seed, found in in_processes(kind, seeds)] == []


def test_seeds_are_reproducible_and_varied():
    assert draw(7) == draw(7) != draw(8)
    read = Counter()
    for seed in range(400):
        try:
            read["TOML"] += 1
            table = tomllib.loads(draw(seed).decode())
        except (ValueError, RecursionError):
            read["no TOML"] += 1
            continue
        read.update(key for key in ("sweep", "forces", "events", "output", "observe") if key in table)
    assert all(read[key] > 5 for key in ("TOML", "no TOML", "sweep", "forces", "events", "output", "observe"))


def test_crashes_are_reported(monkeypatch, tmp_path):
    """A program that crashes or fails at two seeds replaces the workers."""
    worker = tmp_path / "worker"
    worker.write_text(
        "#!/bin/sh\n"
        'for seed in $(seq $4 $(($4 + $5 - 1))); do echo "[$seed]"; '
        'if [ $seed = 3 ]; then kill -SEGV $$; fi; if [ $seed = 5 ]; then echo "[5, \\"wrong\\"]"; fi; done\n'
    )
    worker.chmod(0o755)
    monkeypatch.setattr("fuzz.run.sys.executable", str(worker))
    found = [*in_processes("configurations", range(1, 8))]
    assert [seed for seed, _ in found] == [3, 5]
    assert found[0][1].startswith("ended by -11")


def test_acceptable_errors():
    def raised(function, *args):
        try:
            function(*args)
        except Exception as error:
            return error

    assert wrong_error(raised(co.algebras.so, -1), "so") is None
    assert "AttributeError" in wrong_error(raised(inspect.cleandoc, 1), "")
    assert "not of the library" in wrong_error(raised(statistics.mean, []), "")
