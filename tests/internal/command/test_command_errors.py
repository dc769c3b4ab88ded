"""Exit status of errors, and summaries of what runs of files do not have."""

import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint import cli, commands
from coadjoint.experiments.reich1993.statements import judge
from coadjoint.files.output import output_files as output
from configuration_files import BODY

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


@pytest.mark.thinned(1)
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
    monkeypatch.setattr("coadjoint.experiments.selftest.selftest", lambda: iter(found))
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
        (ValueError("a is\nwrong"), 2, "coadjoint: a is wrong"),
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

    monkeypatch.setattr(commands, "_describe", fail)
    assert commands.perform(["methods"]) == (status, message)


def test_warnings_are_printed_after_success(monkeypatch):
    def warned(*args):
        for text in ("b", "a", "b"):
            warnings.warn(text, UserWarning, stacklevel=1)
        if failing:
            raise ValueError("wrong")

    monkeypatch.setattr(commands, "_describe", warned)
    failing = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert commands.perform(["methods"]) == (0, "coadjoint: warning: b\ncoadjoint: warning: a")
        failing.append(True)
        assert commands.perform(["methods"]) == (2, "coadjoint: wrong")


def test_long_wait_warning_with_closed_stderr(monkeypatch):
    from coadjoint.long_operations import warn_if_long

    class Closed:
        def write(self, text):
            raise OSError("closed")

        def flush(self):
            raise OSError("closed")

    monkeypatch.setattr(commands, "_describe", lambda *args: warn_if_long("a run", 60.0))
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


@pytest.mark.parametrize("driven", [True, False])
def test_summaries_have_every_balance_and_mark_driven_energies(capsys, driven):
    H = co.Hamiltonian(lambda x, t: np.cos(t) * x[2], lambda x, t: np.array([0.0, 0.0, np.cos(t)]))
    system = co.LiePoissonSystem(co.algebras.so(3), H, name="a" * 199) if driven else co.systems.rigid_body()
    sol = SimpleNamespace(
        system=system, method="Splitting", step=0.1, watched=True, work=None if driven else {"a": {}},
        stats=SimpleNamespace(steps=1, seconds=0.5, elapsed=0.75),
        change=lambda: {"energy": 0.25, "C" * 500: 0.5}, balance=lambda: {"energy": 0.125},
    )  # fmt: skip
    commands._summarize(sol, [])
    first, second = capsys.readouterr().out.splitlines()[2:]
    assert max(len(first), len(second)) < 80 and ("energy (driven, so that it changes)" in first) == driven
    if not driven:
        assert first.split() == ["energy", "0.25", "0.125"] and second.split()[-2:] == ["0.5", "nan"]


def test_reproduce_prints_the_table_and_the_figures(folder, capsys, monkeypatch):
    row = judge("k", "Lemma 1", "sum", paper="4", criterion="exact", measured="2 + 2 = 4", holds=True)

    def experiments(out, echo):
        echo("running")
        (out / "sum.png").write_text("")
        return [row], [out / "sum.png"]

    monkeypatch.setitem(
        sys.modules,
        "coadjoint.experiments.reich1993",
        SimpleNamespace(reproduce=experiments, check_packages=lambda: None),
    )
    assert cli.main(["reproduce", "--out", "a/b"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "running",
        "holds               Lemma 1: sum",
        "                    2 + 2 = 4",
        "written: a/b/sum.png",
    ]
