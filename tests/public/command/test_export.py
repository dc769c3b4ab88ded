"""`coadjoint export`: headers on standard output and in files, and refusals."""

import errno
import os
from pathlib import Path

import pytest

import coadjoint as co
from command import command
from configuration_files import READY_MADE
from refusals import refused


def test_the_header_is_printed_or_written(tmp_path, monkeypatch, capsys):
    """It includes nothing of its own, and so may have any name."""
    monkeypatch.chdir(tmp_path)
    status, text, err = command(capsys, "export", "--free-body")
    assert (status, err) == (0, "") and text.startswith("/* coadjoint.h") and text.endswith("#endif\n")
    assert "MIT License" in text and max(map(len, text.splitlines())) <= 120
    assert command(capsys, "export", "--free-body", "-o", "coadjoint.h") == (0, "written: coadjoint.h\n", "")
    assert Path("coadjoint.h").read_text() == text
    Path("include").mkdir()
    assert command(capsys, "export", "--free-body", "--out", "include/body.hpp").status == 0
    assert Path("include/body.hpp").read_text() == text
    assert [line for line in text.splitlines() if "#include" in line] == ["#include <math.h>"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "--free-body, --library, a configuration FILE"),
        (["--free-bodies"], "'--free-body'"),
        (["--free-body", "-o", "body.txt"], "body.txt: the suffix sets the format; it must be .h or .hpp"),
        (["--free-body", "-o", "no/body.h"], "no/body.h: the folder no does not exist; create it first"),
        (["--free-body", "step.toml"], "--free-body and a configuration FILE"),
        (["--free-body", "--tangent"], "--tangent"),
        (["--free-body", "--name", "top"], "--name"),
        (["--free-body", "--library"], "--free-body and --library"),
        (["--library", "step.toml"], "--library and a configuration FILE"),
        (["--library"], "--out"),
        (["--library", "-o", "no"], "no: the folder does not exist; create it first"),
        (["step.toml", "-o", "a.json", "--tangent"], "a table"),
        (["step.toml"], "step.toml: cannot be read (No such file or directory"),
        (["step.toml", "-o", "step.c"], "step.c: the suffix sets the format; it must be .h or .hpp"),
    ],
)
def test_wrong_exports_are_refused(tmp_path, monkeypatch, capsys, arguments, reason):
    monkeypatch.chdir(tmp_path)
    status, out, err = command(capsys, "export", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1) and reason in err
    assert list(tmp_path.iterdir()) == []


def test_a_configuration_is_printed_or_written(tmp_path, monkeypatch, capsys):
    """As by the function, with the name of the header or of the configuration."""
    monkeypatch.chdir(tmp_path)
    Path("body.toml").write_text(READY_MADE)
    prepared = co.prepare(co.systems.rigid_body((1.0, 2.0, 2.5)), co.Splitting(order=4), step=0.1)
    text = co.export_c(prepared, "body.h").read_text()
    assert command(capsys, "export", "body.toml") == (0, text, "")
    assert command(capsys, "export", "body.toml", "-o", "own.h") == (0, "written: own.h\n", "")
    assert Path("own.h").read_text() == co.export_c(prepared, "again.h", name="own").read_text()
    assert command(capsys, "export", "body.toml", "-o", "own.h", "--name", "body", "--tangent").status == 0
    assert Path("own.h").read_text() == co.export_c(prepared, "body.h", tangent=True).read_text()
    assert command(capsys, "export", "body.toml", "-o", "own.json") == (0, "written: own.json\n", "")
    assert Path("own.json").read_text() == co.export_table(prepared, "body.json").read_text()


SYSTEM = READY_MADE.partition("[method]")[0]
TABLE = ["-o", "run.json"]
METHOD = '[method]\nname = "Splitting"\norder = 4'
BATH = '[[forces]]\nname = "HeatBath"\nalpha = 0.1\ntemperature = 0.1\nseed = 1\n'
UNEXPORTED = {
    (
        SYSTEM,
        f'[system]\nname = "satellite"\n[initial]\nx = {[0.1] * 9 + [1.0]}\n',
    ): "body.toml: export: the energy of satellite",
    ("[initial]", "[initial]\nattitude = true"): "body.toml: export: the ",
    (METHOD, BATH + METHOD.replace("4", "2")): "body.toml: export: ",
    ('"Splitting"\norder = 4', '"Taylor"\norder = 8'): "body.toml: export: Taylor(order=8) is n",
    ('"Splitting"\norder = 4', '"SphericalMidpoint"'): "body.toml: export: SphericalMidpoint() is n",
}
"""Changes of the configuration, and how the refusals begin, of C and of tables."""


@pytest.mark.parametrize(
    ("changed", "arguments", "reason"),
    [
        (('"Splitting"\norder = 4', '"GaussLegendre"'), [], "body.toml: export: GaussLegendre(stages=2) solves"),
        (("", ""), ["--name", "2b"], "body.toml: export: the functions cannot begin with '2b'"),
        (("", ""), ["-o", "mine.h"], "mine.h: is a header that coadjoint did not write, so it is not replaced"),
        (("[run]", "attitude = true\n[run]"), [], "body.toml: "),
        *((changed, arguments, reason) for changed, reason in UNEXPORTED.items() for arguments in ([], TABLE)),
    ],
)
def test_runs_that_cannot_be_exported_are_refused(tmp_path, monkeypatch, capsys, changed, arguments, reason):
    monkeypatch.chdir(tmp_path)
    Path("mine.h").write_text("int mine;\n")
    Path("body.toml").write_text(READY_MADE.replace(*changed) if changed[0] else READY_MADE)
    status, out, err = command(capsys, "export", "body.toml", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1) and reason in err
    assert Path("mine.h").read_text() == "int mine;\n" and len(list(tmp_path.iterdir())) == 2


def test_a_full_disk_is_reported_with_the_path(tmp_path, monkeypatch, capsys):
    """Of headers and tables by the functions, and at the shell."""
    monkeypatch.chdir(tmp_path)
    Path("body.toml").write_text(READY_MADE)
    prepared = co.prepare(co.systems.rigid_body((1.0, 2.0, 2.5)), co.Splitting(), step=0.1)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    for call, name in ((co.export_c, "run.h"), (co.export_table, "run.json")):
        with refused(ValueError, name, "No space left"):
            call(prepared, name)
    for arguments in (("body.toml",), ("--free-body",)):
        status, out, err = command(capsys, "export", *arguments, "-o", "body.h")
        assert (status, out, err.count("\n")) == (2, "", 1) and "body.h" in err and "No space left" in err
    assert [path.name for path in tmp_path.iterdir()] == ["body.toml"]
