"""Options of the command reach the library; `check` refuses as `run` does; errors determine the exit status."""

import inspect
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint import cli, commands, library_commands, run_commands
from coadjoint.files.archives.resume import resume
from coadjoint.files.output import output_files as output
from test_cli import BODY

ENSEMBLE = BODY.replace("[1.0, 0.1, 0.5]", "[[1.0, 0.1, 0.5], [0.1, 1.0, 0.5]]")
FLUID = """
system = {name = "torus_euler", parameters = {N = 3}}
initial = {kind = "random", seed = 1}
run = {t_span = [0, 1], step = 0.5}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.toml").write_text(BODY)
    return tmp_path


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (BODY, 'file = "a.csv"', "output.file: a.csv: the suffix sets the format; it must be .nc or .zarr"),
        (BODY, 'file = "none/a.nc"', "output.file: none/a.nc: the folder none does not exist; create it first"),
        (BODY, 'figure = "a.gif"', "output.figure: a.gif: the suffix sets the format"),
        (BODY, 'figure = "none/a.png"', "output.figure: none/a.png: the folder none does not exist"),
        (BODY, 'archive = "held.zarr"', "output.archive: held.zarr: exists"),
        (BODY, 'archive = "none/a.zarr"', "output.archive: none/a.zarr: the folder none does not exist"),
        (FLUID, 'movie = "a.png"', "output.movie: a.png: the suffix sets the format"),
        (FLUID, 'movie = "none/a.gif"', "output.movie: none/a.gif: the folder none does not exist"),
    ],
)
def test_check_refuses_as_run_does(folder, capsys, monkeypatch, text, line, message):
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", lambda *args, **kwargs: pytest.fail("it ran"))
    (folder / "held.zarr").mkdir()
    (folder / "run.toml").write_text(f"{text}[output]\n{line}\n")
    for command in ("run", "check"):
        assert cli.main([command, "run.toml"]) == 2
        found = capsys.readouterr()
        assert (found.out, found.err.count("\n")) == ("", 1) and found.err.startswith(f"run.toml: {message}"), found.err


def test_options_are_checked_early_and_override_the_file(folder, capsys, monkeypatch):
    (folder / "held").mkdir()
    (folder / "run.toml").write_text(BODY + '[output]\nfile = "a.csv"\narchive = "none/a"\nfigure = "a.txt"\n')
    arguments = ["run", "run.toml", "--out", "b.nc", "--figure", "b.svg", "--archive"]
    with monkeypatch.context() as patched:
        patched.setattr("coadjoint.runs.run.Run.advance", lambda *arguments, **kwargs: pytest.fail("it ran"))
        assert cli.main([*arguments, "held"]) == 2
    assert "held: exists" in capsys.readouterr().err
    monkeypatch.setattr(co.Solution, "plot", lambda run: None)
    monkeypatch.setattr(output, "write_figure", lambda figure, target: None)
    assert cli.main([*arguments, "b.zarr"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == ["written: b.zarr", "written: b.nc", "written: b.svg"]


def test_movies_of_forced_systems(folder, monkeypatch, capsys):
    """The movie is that of the unforced system."""
    made = []
    monkeypatch.setattr(co.Solution, "movie", lambda run, path: made.append(path.name))
    forces = '[[forces]]\nname = "Viscosity"\nnu = 0.1\n'
    (folder / "fluid.toml").write_text(FLUID + forces)
    assert cli.main(["run", "fluid.toml", "--movie", "a.gif"]) == 0
    assert made == ["a.gif"] and capsys.readouterr().out.endswith("written: a.gif\n")


@pytest.mark.parametrize("end", [None, 2.0, 0.0])
def test_resume_options_are_passed(folder, capsys, monkeypatch, end):
    """An end at time zero is a valid end."""
    times = [] if end is None else ["--t-end", str(end)]
    (folder / "many.toml").write_text(ENSEMBLE.replace("[0.0, 1.0]", "[-1.0, -0.5]"))
    assert cli.main(["run", "many.toml", "--archive", "a.zarr", "--quiet"]) == 0
    calls, own = [], resume

    def spy(*args, **kwargs):
        bound = inspect.signature(own).bind(*args, **kwargs)
        bound.apply_defaults()
        calls.append(bound.arguments)
        return own(args[0], *args[1:], **{**kwargs, "workers": None})

    monkeypatch.setattr("coadjoint.files.archives.resume.resume", spy)
    assert cli.main(["resume", "a.zarr", *times, "--threads", "3", "--workers", "2", "--progress"]) == 0
    assert {key: calls[0][key] for key in ("t_end", "threads", "workers", "progress")} == {
        "t_end": end, "threads": 3, "workers": 2, "progress": True
    }  # fmt: skip
    assert calls[0]["system"] is None, "rebuilt from the record"
    assert capsys.readouterr().out.endswith("written: a.zarr\n")
    assert co.open_archive("a.zarr").t[-1] == (-0.5 if end is None else end)
    assert cli.main(["resume", "a.zarr", "--quiet"]) == 0
    assert {key: calls[1][key] for key in ("t_end", "threads", "workers", "progress")} == {
        "t_end": None, "threads": None, "workers": None, "progress": False
    }  # fmt: skip
    assert capsys.readouterr().out == ""


@pytest.mark.thinned(8)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "run.toml", "--out", ""], ": the suffix sets the format; it must be .nc or .zarr"),
        (["run", "run.toml", "--archive", ""], "archive is ''; it must be the path of a folder"),
        (["run", "run.toml", "--figure", ""], ": the suffix sets the format; it must be .png, .pdf or .svg"),
        (["run", "run.toml", "--movie", ""], ": the suffix sets the format; it must be .mp4 or .gif"),
        (["certify", "run.toml", "--json", ""], ": the suffix sets the format; it must be .json"),
        (["certify", "run.toml", "--plot", ""], ": the suffix sets the format; it must be .png, .pdf or .svg"),
        (["certify", "run.toml", "--steps", "0"], "steps must be a whole number from 1 to 10000000, not 0"),
        (["resume", "held.zarr", "--t-end", "0"], "t_end is 0, but the run has reached t = 1 on its way to 1"),
        (["resume", "held.zarr", "--t-end", "2", "--threads", "0"], "must be a whole number from 1 up, not 0"),
        (["resume", "held.zarr", "--workers", "0"], "is the archive of one run; client and workers are for ensembles"),
        (["systems", "toda", "--json", ""], ": the suffix sets the format; it must be .json"),
        (["systems", ""], "unknown system ''"),
        (["methods", ""], "unknown method ''"),
        (["algebras", ""], "unknown algebra ''"),
        (["gallery", "", "--out", "out"], "unknown system ''"),
    ],
)
def test_zero_and_empty_options_are_used(folder, capsys, monkeypatch, arguments, message):
    """They are refused instead of replaced by the default or the file."""
    text = BODY + '[output]\nfile = "a.nc"\nfigure = "a.png"\n'
    (folder / "run.toml").write_text(text)
    co.integrate(co.systems.rigid_body(), (1.0, 0.1, 0.5), (0, 1), 0.1, archive="held.zarr")
    if arguments[0] != "resume":  # resume repeats the first step
        monkeypatch.setattr("coadjoint.runs.run.Run.advance", lambda *args, **kwargs: pytest.fail("it ran"))
    assert cli.main(arguments) == 2
    found = capsys.readouterr()
    assert found.out == "" and message in found.err and found.err.count("\n") == 1, found.err
    assert sorted(path.name for path in folder.iterdir()) == ["body.toml", "held.zarr", "run.toml"]


@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (3.0, 2.0), (-1.0, -2.0)])
def test_certify_uses_the_whole_file(folder, monkeypatch, capsys, span):
    text = BODY.replace("[0.0, 1.0]", str(list(span))) + '[method]\nname = "Splitting"\norder = 4\n'
    (folder / "run.toml").write_text(text)
    arguments = {}

    def spy(system, method, x0, step, **kwargs):
        arguments.update(kwargs, system=system.name, method=method, x0=x0, step=step)
        return SimpleNamespace(passed=True, to_json=lambda: "{}", __str__=lambda self: "")

    monkeypatch.setattr("coadjoint.analysis.certificates.certify.certify", spy)
    assert cli.main(["certify", "run.toml", "--steps", "7"]) == 0
    assert arguments == {
        "system": "rigid_body",
        "method": co.Splitting(order=4),
        "x0": [1.0, 0.1, 0.5],
        "step": math.copysign(0.1, span[1] - span[0]),
        "steps": 7,
    }


def test_certify_targets_are_checked_first(folder, monkeypatch, capsys):
    monkeypatch.setattr(
        "coadjoint.analysis.certificates.certify.certify", lambda *args, **kwargs: pytest.fail("it ran")
    )
    for option, name in (
        ("--json", "none/a.json"),
        ("--plot", "none/a.png"),
        ("--json", "a.png"),
        ("--plot", "a.json"),
    ):
        assert cli.main(["certify", "body.toml", option, name]) == 2
        assert capsys.readouterr().err.startswith(f"{name}: ")


@pytest.mark.parametrize("reason", [OSError(28, "No space left on device"), MemoryError(), output.OutputError("full")])
@pytest.mark.parametrize(
    ("writer", "arguments"),
    [
        ("write_dataset", ["run", "body.toml", "--out", "a.nc"]),
        ("write_figure", ["run", "body.toml", "--figure", "a.png"]),
        ("write_text", ["certify", "body.toml", "--steps", "8", "--json", "a.json"]),
        ("write_figure", ["certify", "body.toml", "--steps", "8", "--plot", "a.png"]),
        ("movie", ["run", "fluid.toml", "--movie", "a.gif"]),
    ],
)
def test_unwritable_results_are_one_line(folder, monkeypatch, capsys, writer, arguments, reason):
    def fail(*args):
        raise reason

    monkeypatch.setattr(co.Solution, "plot", lambda run: None)
    found = SimpleNamespace(passed=True, to_json=lambda: "{}", plot=lambda: None)
    monkeypatch.setattr("coadjoint.analysis.certificates.certify.certify", lambda *args, **kwargs: found)
    (folder / "fluid.toml").write_text(FLUID)
    monkeypatch.setattr(*((co.Solution, "movie") if writer == "movie" else (output, writer)), fail)
    assert cli.main(arguments) == 1
    message = {OSError: "No space left on device", MemoryError: "it does not fit into memory"}.get(type(reason), "full")
    line = f"{arguments[1]}: {arguments[-1]} could not be written ({message}); nothing was replaced\n"
    assert capsys.readouterr().err == line


def finding(name, passed, skipped=""):
    class Found(SimpleNamespace):
        def __str__(self):
            return f"{self.name}: {self.skipped or self.passed}"

    return Found(name=name, passed=passed, skipped=skipped)


def test_selftest_counts_and_prints(monkeypatch, capsys):
    found = [finding("a", True), finding("b", True, "no zarr"), finding("c", False), finding("d", True, "no numba")]
    monkeypatch.setattr("coadjoint.experiments.selftest.run.selftest", lambda: iter(found))
    assert cli.main(["selftest"]) == 1
    *lines, last = capsys.readouterr().out.splitlines()
    assert lines == ["a: True", "b: no zarr", "c: False", "d: no numba"]
    assert last.startswith(f"coadjoint {co.__version__}: 4 checks, 1 failed, 2 skipped, ")
    assert cli.main(["selftest", "--quiet"]) == 1
    assert capsys.readouterr().out == "c: False\n"
    found.pop(2)
    assert cli.main(["selftest", "--quiet"]) == 0 and capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (ValueError("a is\nwrong"), 2, "coadjoint: ValueError: a is wrong"),
        (TypeError("a"), 2, "coadjoint: TypeError: a"),
        (ZeroDivisionError("a"), 2, "coadjoint: ZeroDivisionError: a"),
        (OverflowError("a"), 2, "coadjoint: OverflowError: a"),
        (RecursionError("a"), 2, "coadjoint: RecursionError: a"),
        (MemoryError("a"), 2, "coadjoint: MemoryError: a"),
        (ImportError("a"), 2, "coadjoint: a"),
        (BrokenPipeError(32, "a"), 141, ""),
        (OSError(28, "No space left"), 1, "coadjoint: the standard output cannot be written (No space left)"),
        (OSError(28, "No space left", "a.nc"), 1, "coadjoint: [Errno 28] No space left: 'a.nc'"),
        (PermissionError(13, "Denied", "a.nc"), 1, "coadjoint: [Errno 13] Denied: 'a.nc'"),
        (output.OutputError("a.nc: is a folder"), 2, "a.nc: is a folder"),
    ],
)
def test_exit_status_of_errors(monkeypatch, error, status, message):
    def fail(*args):
        raise error

    monkeypatch.setattr(library_commands, "_describe", fail)
    assert commands.perform(["methods"]) == (status, message)


def test_warnings_are_printed_after_success(monkeypatch):
    import warnings

    def warned(*args):
        for text in ("b", "a", "b"):
            warnings.warn(text, UserWarning, stacklevel=1)
        if failing:
            raise ValueError("wrong")

    monkeypatch.setattr(library_commands, "_describe", warned)
    failing = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert commands.perform(["methods"]) == (0, "coadjoint: warning: b\ncoadjoint: warning: a")
        failing.append(True)
        assert commands.perform(["methods"]) == (2, "coadjoint: ValueError: wrong")


def test_long_wait_warning_with_closed_stderr(monkeypatch):
    from coadjoint.long_operations import warn_if_long

    class Closed:
        def write(self, text):
            raise OSError("closed")

        def flush(self):
            raise OSError("closed")

    monkeypatch.setattr(library_commands, "_describe", lambda *args: warn_if_long("a run", 60.0))
    for stream in (Closed(), None):
        monkeypatch.setattr("sys.stderr", stream)
        assert commands.perform(["methods"]) == (0, "")


def test_exit_status_of_interrupts_and_missing_packages(monkeypatch, capsys):
    for error, status, message in (
        (KeyboardInterrupt(), 130, "coadjoint: interrupted\n"),
        (ImportError("a is missing"), 2, "coadjoint: a is missing\n"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(commands, "perform", lambda *arguments, error=error: (_ for _ in ()).throw(error))
            assert cli.main(["methods"]) == status
        assert capsys.readouterr() == ("", message)


def test_summary_shows_changes_and_balances(folder, capsys):
    forced = '[[forces]]\nname = "LinearDamping"\nrate = 0.1\n'
    for text, heading in (
        (BODY, "largest deviation from the start, over every step:"),
        (
            BODY.replace("step = 0.1", "step = 0.1\nwatch = false"),
            "largest deviation from the start, over the saved po",
        ),
        (BODY + forced, "change, and change minus the work of the forces (balance), over every step:"),
    ):
        (folder / "run.toml").write_text(text)
        assert cli.main(["run", "run.toml"]) == 0
        _, second, *rows = capsys.readouterr().out.splitlines()
        assert second.startswith(heading) and [row.split()[0] for row in rows] == ["energy", "|x|^2"]
        found = co.integrate(
            co.systems.rigid_body().with_forces(co.forces.LinearDamping(0.1)) if "forces" in text else
            co.systems.rigid_body(), (1.0, 0.1, 0.5), (0, 1), 0.1, watch="watch" not in text,
        )  # fmt: skip
        for row in rows:
            name, *numbers = row.split()
            wanted = [found.change()[name], *([found.balance()[name]] if "forces" in text else [])]
            assert numbers == [f"{number:.3g}" for number in wanted]


def test_missing_balance_is_printed_as_nan(capsys):
    stats = SimpleNamespace(steps=1, seconds=0.5, elapsed=0.75)
    sol = SimpleNamespace(
        system=co.systems.rigid_body(), method="Splitting", stats=stats, step=0.1, watched=True, work={"a": {}},
        change=lambda: {"energy": 0.25, "own": 0.5}, balance=lambda: {"energy": 0.125},
    )  # fmt: skip
    run_commands._summarize(sol, [])
    assert [line.split() for line in capsys.readouterr().out.splitlines()[2:]] == [
        ["energy", "0.25", "0.125"], ["own", "0.5", "nan"]
    ]  # fmt: skip


def test_driven_energy_is_marked(capsys):
    H = co.Hamiltonian(lambda x, t: np.cos(t) * x[2], lambda x, t: np.array([0.0, 0.0, np.cos(t)]))
    driven = co.LiePoissonSystem(co.algebras.so(3), H, name="a" * 199)
    stats = SimpleNamespace(steps=1, seconds=0.5, elapsed=0.75)
    for system, shown in ((driven, "energy (driven, so that it changes)"), (co.systems.rigid_body(), "energy")):
        sol = SimpleNamespace(
            system=system, method="Splitting", stats=stats, step=0.1, watched=False, work=None,
            change=lambda: {"energy": 0.25, "C" * 500: 0.5},
        )  # fmt: skip
        run_commands._summarize(sol, [])
        lines = capsys.readouterr().out.splitlines()
        assert lines[2].split("  ")[1].strip() == shown and max(map(len, lines[2:])) < 80


@pytest.mark.parametrize(
    ("text", "value"), [("b=0.5", 0.5), ("b=1/4", 0.25), ("b=5e-1", 0.5), ("b=25E-2", 0.25), ("b=-1/2", -0.5)]
)
def test_parameter_numbers_are_parsed(text, value):
    assert library_commands._read_parameter(text) == ("b", value)


@pytest.mark.parametrize(
    "text",
    ["b", "b=", "b=x", "b=1/0", "b=1e400", "b=1E400", "b=-1E+400", "b=1e1/2", "b=nan", f"b={'1' * 60}", "b=0x10",
     "b=1e-x"],
)  # fmt: skip
def test_invalid_parameters_are_refused(text):
    with pytest.raises(ValueError, match="is not a parameter; give name and number"):
        library_commands._read_parameter(text)


def test_schema_is_readable_text(capsys):
    assert cli.main(["schema"]) == 0
    shown = capsys.readouterr().out
    assert "\\u" not in shown.replace("\\u0000", "") and json.loads(shown)


def test_misspelled_options_are_suggested(capsys):
    for arguments, near in ((["certify", "--stepps", "3"], "--steps"), (["resume", "--tend", "3"], "--t-end"),
                            (["gallery", "--uot", "a"], "--out"), (["systems", "--jsn", "a"], "--json")):  # fmt: skip
        assert cli.main(arguments) == 2
        line = f"coadjoint: unknown option '{arguments[1]}'; did you mean '{near}'?\n"
        assert capsys.readouterr().err == line
