"""`coadjoint check`: the description of a run and estimates of its cost, compared with the run."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from command import command
from configuration_files import OWN, READY_MADE

EXAMPLES = sorted((Path(__file__).parents[3] / "examples").glob("*.toml"))
SWEEP = '[sweep]\nsamples = 3\nseed = 7\n[sweep.over]\n"initial.x" = { sphere = 1.0 }\n'
TWO = "x = [[1.0, 0.1, 0.5], [0.0, 1.0, 0.5]]"
BYTES = {"bytes": 1.0, "B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def checked(capsys, folder, text):
    """Return the lines of a check by their first words."""
    (folder / "run.toml").write_text(text, encoding="utf-8")
    done = command(capsys, "check", "run.toml")
    assert (done.status, done.err) == (0, "")
    return dict(line.split(maxsplit=1) for line in done.out.splitlines())


def written(capsys):
    assert command(capsys, "run", "run.toml", "--out", "run.nc", "--quiet").status == 0
    return co.load("run.nc")


def size_of(text):
    """Return the first size in a text, and its rounding."""
    digits, unit = re.search(r"([\d.]+) (bytes|B|kB|MB|GB)", text).groups()
    return float(digits) * BYTES[unit], BYTES[unit] * 10.0 ** -len(digits.partition(".")[2])


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    "text",
    [
        READY_MADE,
        READY_MADE.replace("step = 0.1", "step = 0.01\nsave_every = 7"),
        READY_MADE.replace("[0, 1]", "[1, -1]"),
        READY_MADE.replace("step = 0.1", "accuracy = 1e-8"),
        READY_MADE.replace("[0, 1]", "[0, 0]"),
        READY_MADE.replace("x = [1.0, 0.1, 0.5]", f"{TWO}\nattitude = true"),
        READY_MADE + '[observe]\nq = "x1*x2"\n',
        READY_MADE + SWEEP,
        READY_MADE + SWEEP + '"system.parameters.inertia[2]" = [2.25, 2.5]\n',
        OWN,
    ],
)
def test_check_matches_the_run(folder, capsys, text):
    lines = checked(capsys, folder, text)
    assert {path.name for path in folder.iterdir()} == {"run.toml"}
    sol = written(capsys)
    members = sol.x.shape[1] if sol.failed is not None else 1
    of_members = f" of {members} members" if members > 1 else ""
    assert lines["saved"].startswith(f"{len(sol.t)} points{of_members}") and lines["members"] == str(members)
    assert lines["steps"].startswith(f"{sol.stats.steps} of ")
    assert str(sol.method) in lines["scheme"] and "from a trial of all its " in lines["time"]
    size, rounding = size_of(lines["output"])
    # The dataset has some text of the file itself.
    assert abs(size - sol.to_xarray().nbytes) <= rounding + 64
    assert size_of(lines["memory"])[0] * 1.1 >= sol.x.nbytes


def output_times(kind, end):
    """Return times from 0 to an end after ten steps, in the order of the run."""
    between = np.sort(np.random.default_rng(int(8 * abs(end))).uniform(0.02, 0.98, 60))
    of_steps = np.arange(11) / 10
    times = {
        "between steps": between[::20],
        "several in a step": between,
        "repeated": np.repeat(between[::15], 3),
        "of steps": of_steps[1::3],
        "of the end": of_steps[-1:],
        "of and between steps": np.union1d(of_steps, between[::7]),
    }[kind]
    return [float(time) for time in end * times]


SPLITTING, OWN_STEPS = 'name = "Splitting"', 'name = "Taylor"\norder = 12\ntolerance = 1e-9'


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("kind", "system", "x0", "end", "method"),
    [
        ("between steps", "heavy_top", [[0.5, 0.2, 1.0, 0.6, 0.0, 0.8]], 2.0, SPLITTING),
        ("several in a step", "paper_a37", [[1.0, 0.5, 0.7]], -1.0, SPLITTING),
        ("repeated", "rigid_body", [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3]], 1.0, SPLITTING),
        ("of steps", "heavy_top", [[0.5, 0.2, 1.0, 0.6, 0.0, 0.8], [0.1, 1.0, 0.3, 0.0, 0.6, 0.8]], -2.0, SPLITTING),
        ("of the end", "paper_a37", [[1.0, 0.5, 0.7]], 1.0, OWN_STEPS),
        ("several in a step", "heavy_top", [[0.5, 0.2, 1.0, 0.6, 0.0, 0.8]], 1.0, OWN_STEPS),
        ("of and between steps", "rigid_body", [[1.0, 0.1, 0.5]], -1.0, OWN_STEPS),
    ],
)
def test_output_times_are_counted(folder, capsys, kind, system, x0, end, method):
    """A scheme with its own steps halves the step of the run until there are as many steps as output times."""
    times = output_times(kind, end)
    lines = checked(
        capsys,
        folder,
        f"[system]\nname = {system!r}\n[initial]\nx = {x0 if len(x0) > 1 else x0[0]}\n[method]\n{method}\n"
        f"[run]\nt_span = [0, {end}]\nstep = {abs(end) / 10}\nt_eval = {times}\n",
    )
    sol = written(capsys)
    steps = 10 * 2 ** (0 if method is SPLITTING else max(0, math.ceil(math.log2(len(times) / 10))))
    of_members = f" of {len(x0)} members" if len(x0) > 1 else ""
    assert lines["saved"] == f"{len(times)} points{of_members}" and len(sol.t) == len(times)
    assert lines["steps"] == f"{steps} of {abs(end) / steps:g}, from t = 0 to {end:g}" and sol.stats.steps == steps
    size, rounding = size_of(lines["output"])
    assert abs(size - sol.to_xarray().nbytes) <= rounding + 64
    # The steps from which the times are reached are held in memory with them; beside them some working arrays.
    reached = len(np.union1d(np.floor(np.array(times) / end * steps + 1e-9), 0.0))
    row, (memory, rounding) = 8 * len(x0) * (len(x0[0]) + 1 + len(sol.casimirs)), size_of(lines["memory"])
    assert (len(times) + reached) * row - rounding <= memory
    assert memory <= (len(times) + reached) * (row + 24) + 8 * 400 * len(x0) + rounding


@pytest.mark.thinned(6)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_check_of_every_example(folder, capsys, example):
    done = command(capsys, "check", example)
    assert done.status == 0
    for name in ("system", "members", "scheme", "keeps", "steps", "saved", "memory", "output", "time"):
        assert f"\n{name} " in f"\n{done.out}", name
    assert not [*folder.iterdir()]


def test_what_is_printed(folder, capsys):
    text = READY_MADE.replace("step = 0.1", "step = 0.1\nworkers = 2").replace("x = [1.0, 0.1, 0.5]", TWO)
    lines = checked(capsys, folder, text + '[output]\nfile = "a.nc"\n')
    assert {name: lines[name] for name in ("system", "members", "scheme", "keeps", "steps", "saved")} == {
        "system": "rigid_body, dimension 3",
        "members": "2",
        "scheme": "Splitting(order=4), of order 4",
        "keeps": "Poisson bracket, all Casimirs; not the energy",
        "steps": "10 of 0.1, from t = 0 to 1",
        "saved": "11 points of 2 members",
    }
    assert lines["output"].endswith("before compression; to a.nc")
    assert "in one process; 2 workers share it; estimated from a trial of all its steps" in lines["time"]


def test_a_long_run_is_not_computed(folder, capsys):
    """Its time is estimated from a trial of a part of its steps."""
    text = READY_MADE.replace("[0, 1]", "[0, 1000000000]").replace("step = 0.1", "step = 0.1\nsave_every = 1000000")
    lines = checked(capsys, folder, text)
    assert "from a trial of " in lines["time"] and "all its" not in lines["time"]


def test_failed_trial_is_reported(folder, capsys):
    """[e1, e2] = e2 with H = x1 gives x2' = x2, which overflows at t = 709.78."""
    (folder / "run.toml").write_text(
        'sign = -1\n[algebra]\ndim = 2\nbrackets = ["[e1, e2] = e2"]\n[hamiltonian]\nlinear = [1.0, 0.0]\n'
        "[initial]\nx = [1.0, 1.0]\n[run]\nt_span = [0.0, 1000.0]\nstep = 1.0\nsave_every = 100\n"
    )
    done = command(capsys, "check", "run.toml")
    assert (done.status, done.err) == (1, "") and "xarray" not in done.out
    assert "time          not known: the trial failed (in step 710, " in done.out
    assert "output        not known: the trial failed" in done.out
