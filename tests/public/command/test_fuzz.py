"""Some random calls and configuration files, and files whose entries contradict each other; `make fuzz` tries more."""

import inspect
import statistics
import tomllib
from collections import Counter

import numpy as np
import pytest

import coadjoint as co
from command import command
from fuzz.configurations import draw
from fuzz.judging import wrong_error
from fuzz.run import in_processes
from long import long_beyond
from refusals import refused

COUNTS = [("configurations", 15), ("calls", 30), ("configurations", 1200), ("calls", 800)]


@pytest.mark.parametrize(("kind", "count"), long_beyond(2, COUNTS))
def test_outcome_is_a_result_or_one_sentence(kind, count):
    assert [f"{seed}: {found}" for seed, found in in_processes(kind, range(count))] == []


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
    assert "AttributeError" in wrong_error(raised(inspect.cleandoc, 1))
    assert "not of the library" in wrong_error(raised(statistics.mean, []))


BODY_FILE = """
system = {name = "rigid_body"}
initial = {x = [1.0, 0.1, 0.5]}
"""


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ('run = {t_span = [0, 1], step = 0.1, t_eval = [0.25]}\noutput.archive = "a.zarr"', ("t_eval", "archive")),
        (
            'run = {t_span = [1, 0], step = 0.1}\n[[forces]]\nname = "HeatBath"\nalpha = 1\ntemperature = 1\nseed = 3',
            ("run", "HeatBath"),
        ),
    ],
)
def test_contradictory_files_are_refused(capsys, tmp_path, more, named):
    file = tmp_path / "run.toml"
    file.write_text(BODY_FILE + more, encoding="utf-8")
    status, _, err = command(capsys, "check", file)
    assert status == 2 and all(name in err for name in named)


BODY, X, HUGE = co.systems.rigid_body(), (0.1, 1.0, 0.2), 10**400
TORUS = co.systems.torus_euler(N=5)
LINES = co.frequencies(np.arange(64.0), np.cos(np.arange(64.0)), 1)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: co.predicted_drift(BODY, X, gradient=lambda x: [1.0, 2.0]), ("gradient", "(2,)")),
        (lambda: co.predicted_drift(BODY, X, field=lambda x: 1.0), ("field", "()")),
        (lambda: LINES.combinations(largest=HUGE), ("largest",)),
        (lambda: co.Quadratic(X, linear=X)([HUGE, 1.0, 1.0]), ("float64",)),
        (lambda: co.Polynomial({(2,): 1.7e308}).gradient([1.0]), ("float64",)),
        (lambda: TORUS.random(1, spectrum=int), ("degrees",)),
        (lambda: TORUS.from_modes(np.broadcast_to(1j, 10**13)), ("modes", "shape")),
        (lambda: co.systems.spin_lattice(lattice=[], shape=10**30), ("shape",)),
        (lambda: co.systems.so_n_body((1e308, 1e308, 1e308)), ("inertia",)),
    ],
)
def test_found_calls_are_refused_without_warnings(call, named, recwarn):
    with refused((ValueError, TypeError, OverflowError), *named) as caught:
        call()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    assert not [noticed for noticed in recwarn if issubclass(noticed.category, RuntimeWarning)]
