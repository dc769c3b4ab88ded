"""Dry runs: description and cost estimates, compared with the run."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from configuration_files import GROWING, OWN, READY_MADE

from coadjoint import cli
from coadjoint.files.configuration import dry_run as planning
from coadjoint.files.configuration.dry_run import plan
from coadjoint.files.configuration.loading import load
from coadjoint.systems.batch import Batch

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
SWEEP = '[sweep]\nsamples = 3\nseed = 7\n[sweep.over]\n"initial.x" = { sphere = 1.0 }\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def planned(folder, text):
    (folder / "run.toml").write_text(text, encoding="utf-8")
    return plan(load("run.toml"))


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    "text",
    [
        READY_MADE,
        READY_MADE.replace("step = 0.1", "step = 0.01\nsave_every = 7"),
        READY_MADE.replace("[0, 1]", "[1, -1]"),
        READY_MADE.replace("step = 0.1", "step = 0.1\nt_eval = [0.05, 0.3, 0.77]"),
        READY_MADE.replace("step = 0.1", "accuracy = 1e-8"),
        READY_MADE.replace("[0, 1]", "[0, 0]"),
        READY_MADE.replace("x = [1.0, 0.1, 0.5]", "x = [[1.0, 0.1, 0.5], [0.0, 1.0, 0.5]]\nattitude = true"),
        READY_MADE + '[observe]\nq = "x1*x2"\n',
        READY_MADE + SWEEP,
        READY_MADE + SWEEP + '"system.parameters.inertia[2]" = [2.25, 2.5]\n',
        OWN,
        'system = {name = "matrix_body"}\ninitial = {x = [[0.0, -1.0, 0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0], '
        "[-0.5, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.25], [0.0, 0.0, 0.0, -0.25, 0.0]]}\n"
        "run = {t_span = [0, 1], step = 0.125}\n",
    ],
)
def test_plan_matches_the_run(folder, text):
    found = planned(folder, text)
    before = {path.name for path in folder.iterdir()}
    sol = found.configuration.integrate()
    assert before == {"run.toml"} and not found.failed
    *_, written, taken = str(found).splitlines()
    assert written.startswith("output ") and "the trial failed" not in written
    assert taken.startswith("time          about ") and "from a trial of all its " in taken
    assert (found.steps, found.points) == (sol.stats.steps, len(sol.t))
    assert found.members == (sol.x.shape[1] if sol.failed is not None else 1)
    assert found.written == found.configuration.dataset(sol).nbytes
    assert found.memory >= sol.x.nbytes
    first = sol.system[0] if isinstance(sol.system, Batch) else sol.system
    assert found.properties == found.configuration.method.properties(first)


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
def test_plan_counts_output_times(folder, monkeypatch, kind, system, x0, end, method):
    """Saved points are output times; the steps from which they are reached are held in memory with them.

    A scheme with its own steps halves the step of the run until there are as many steps as output times.
    """
    times, tried = output_times(kind, end), []

    def short_run(*args, short=planning._trial_run):
        tried.append(short(*args))
        return tried[-1]

    monkeypatch.setattr(planning, "_trial_run", short_run)
    found = planned(
        folder,
        f"[system]\nname = {system!r}\n[initial]\nx = {x0 if len(x0) > 1 else x0[0]}\n[method]\n{method}\n"
        f"[run]\nt_span = [0, {end}]\nstep = {abs(end) / 10}\nt_eval = {times}\n",
    )
    sol = found.configuration.integrate()
    assert not found.failed and found.points == len(times) == len(sol.t)
    halvings = 0 if method is SPLITTING else max(0, math.ceil(math.log2(len(times) / 10)))
    assert found.steps == sol.stats.steps == 10 * 2**halvings
    # The trial takes the same steps; on a busy machine it may not reach the end.
    assert max(abs(trial.t[-1]) for trial in tried) == pytest.approx(found.tried * abs(end) / found.steps)
    assert found.written == found.configuration.dataset(sol).nbytes
    reached = len(np.union1d(np.floor(np.array(times) / end * found.steps + 1e-9), 0.0))
    invariants = 1 + len(sol.system.casimirs)
    row = 8 * len(x0) * (len(x0[0]) + invariants)
    # The working arrays of a run do not grow with the number of saved points.
    assert (len(times) + reached) * row <= found.memory <= (len(times) + reached) * (row + 24) + 8 * 400 * len(x0)
    lines = dict(line.split(maxsplit=1) for line in str(found).splitlines())
    of_members = f" of {len(x0)} members" if len(x0) > 1 else ""
    assert lines["saved"] == f"{len(times)} points{of_members}"
    assert lines["steps"] == f"{found.steps} of {abs(end) / found.steps:g}, from t = 0 to {end:g}"


@pytest.mark.thinned(6)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_check_command_on_every_example(folder, capsys, example):
    assert cli.main(["check", str(example)]) == 0
    output = capsys.readouterr().out
    for name in ("system", "members", "scheme", "keeps", "steps", "saved", "memory", "output", "time"):
        assert f"\n{name} " in f"\n{output}", name
    assert not [*folder.iterdir()]


def test_time_is_estimated_from_a_trial(folder, monkeypatch):
    """On a clock that counts steps: the overhead of a call is a small part of a sufficiently long trial."""
    clock, a_call, a_step = [0.0], 1e-3, 1e-4

    def short_run(configuration, ready, times, steps, every, short=planning._trial_run):
        clock[0] += a_call + a_step * steps
        return short(configuration, ready, times, steps, every)

    monkeypatch.setattr(planning, "_trial_run", short_run)
    monkeypatch.setattr(planning, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    text = READY_MADE.replace("[0, 1]", "[0, 1000000]").replace("step = 0.1", "step = 0.1\nsave_every = 1000")
    found = planned(folder, text)
    taken = a_step * found.steps
    assert taken < found.seconds <= taken * (1 + a_call / (planning.TRIAL_SECONDS - a_call)) * (1 + 1e-12)
    assert found.preparation_seconds == 0.0 and 0 < found.tried < found.steps


def test_check_command_output(folder, capsys):
    text = READY_MADE.replace("step = 0.1", "step = 0.1\nworkers = 2")
    text = text.replace("x = [1.0, 0.1, 0.5]", "x = [[1.0, 0.1, 0.5], [0.0, 1.0, 0.5]]") + '[output]\nfile = "a.nc"\n'
    (folder / "run.toml").write_text(text, encoding="utf-8")
    assert cli.main(["check", "run.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:4] == [
        "system        rigid_body, dimension 3",
        "members       2",
        "scheme        Splitting(order=4), of order 4",
        "keeps         Poisson bracket, all Casimirs; not the energy",
    ]
    assert lines[4] == "steps         10 of 0.1, from t = 0 to 1" and lines[5] == "saved         11 points of 2 members"
    assert lines[7].endswith("before compression; to a.nc")
    assert ", in one process; 2 workers share it; estimated from a trial of all its steps, " in lines[8]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (READY_MADE.replace("step", "stpe"), "run.toml: run.stpe: unknown key; did you mean 'step'?\n"),
        (READY_MADE + '[output]\nfile = "none/a.nc"\n', "run.toml: output.file: none/a.nc: "),
        (READY_MADE.replace("[0, 1]", "[0, 1e13]"), "run.toml: run.save_every: "),
        (
            READY_MADE.replace('"Splitting"\norder = 4', '"SphericalMidpoint"').replace("rigid_body", "heavy_top"),
            "run.toml: ",
        ),
    ],
)
def test_errors_are_one_line_each(folder, capsys, text, message):
    (folder / "run.toml").write_text(text, encoding="utf-8")
    assert cli.main(["check", "run.toml"]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.startswith(message)
    assert all(line.startswith("run.toml: ") for line in output.err.splitlines()) and output.err.endswith("\n")


def test_failed_trial_is_reported(folder, capsys):
    (folder / "run.toml").write_text(GROWING, encoding="utf-8")
    assert cli.main(["check", "run.toml"]) == 1
    output = capsys.readouterr()
    assert "time          not known: the trial failed (in step 710, " in output.out and output.err == ""
    assert "output        not known: the trial failed" in output.out and "xarray" not in output.out
