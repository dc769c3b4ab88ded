"""`coadjoint export`: the header of free bodies on standard output and in files, and refusals."""

from pathlib import Path

import pytest

from command import command


def test_the_header_is_printed_or_written(tmp_path, monkeypatch, capsys):
    """A file of another name includes itself by that name."""
    monkeypatch.chdir(tmp_path)
    status, text, err = command(capsys, "export", "--free-body")
    assert (status, err) == (0, "") and text.startswith("/* coadjoint.h") and text.endswith("#endif\n")
    assert "MIT License" in text and max(map(len, text.splitlines())) <= 120
    assert command(capsys, "export", "--free-body", "-o", "coadjoint.h") == (0, "written: coadjoint.h\n", "")
    assert Path("coadjoint.h").read_text() == text
    Path("include").mkdir()
    assert command(capsys, "export", "--free-body", "--out", "include/body.hpp").status == 0
    assert Path("include/body.hpp").read_text() == text.replace('#include "coadjoint.h"', '#include "body.hpp"')
    assert text.count('#include "coadjoint.h"') == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "coadjoint: export has nothing to write; give --free-body"),
        (["--free-bodies"], "coadjoint: unknown option '--free-bodies'; did you mean '--free-body'?"),
        (["--free-body", "-o", "body.txt"], "body.txt: the suffix sets the format; it must be .h or .hpp"),
        (["--free-body", "-o", "no/body.h"], "no/body.h: the folder no does not exist; create it first"),
        (["--free-body", "-o", 'a"b.h'], "coadjoint: --out: 'a\"b.h' cannot be included; give a name without"),
        (["--free-body", "step.toml"], "coadjoint: got unexpected extra argument (step.toml)"),
    ],
)
def test_wrong_exports_are_refused(tmp_path, monkeypatch, capsys, arguments, reason):
    monkeypatch.chdir(tmp_path)
    status, out, err = command(capsys, "export", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1) and err.startswith(reason)
    assert list(tmp_path.iterdir()) == []
