"""Paths in configuration files: nothing is executed, and files are read and written where the user names them."""

import os
import pickle

import numpy as np
import pytest
from configuration_files import READY_MADE

from coadjoint import cli

STATES = READY_MADE.replace("x = [1.0, 0.1, 0.5]", 'x = "{}"')
SWEPT = READY_MADE + '[sweep.over]\n"initial.x" = {{ file = "{}" }}\n'


class Touching:
    def __reduce__(self):
        return (open, ("executed", "w"))


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Return the working folder and another one with the configuration."""
    work, other = tmp_path / "work", tmp_path / "other"
    work.mkdir()
    other.mkdir()
    monkeypatch.chdir(work)
    return work, other


@pytest.mark.parametrize("text", [STATES, SWEPT], ids=["states", "sweep"])
@pytest.mark.parametrize("kind", ["pickle", "objects"])
def test_pickles_are_refused(folders, capsys, text, kind):
    _, other = folders
    if kind == "pickle":
        (other / "states.npy").write_bytes(pickle.dumps(Touching()))
    else:
        np.save(other / "states.npy", np.array([Touching(), 1.0, 2.0], dtype=object), allow_pickle=True)
    (other / "run.toml").write_text(text.format("states.npy"))
    assert cli.main(["run", "../other/run.toml"]) == 2
    assert "states.npy" in capsys.readouterr().err
    assert not any((folder / "executed").exists() for folder in folders)


@pytest.mark.parametrize(
    "path", ["system.parameters.inertia", "initial.x", "run.step", "method.name", "method.order", "system.name"]
)
def test_code_in_text_is_not_executed(folders, capsys, path):
    work, _ = folders
    lines, table, key = READY_MADE.splitlines(), "", path.rpartition(".")[2]
    for number, line in enumerate(lines):
        table = line.strip("[]") if line.startswith("[") else table
        if f"{table}.{line.partition(' =')[0]}" == path:
            lines[number] = f"{key} = \"__import__('pathlib').Path('executed').touch()\""
    assert lines != READY_MADE.splitlines()
    (work / "run.toml").write_text("\n".join(lines))
    assert cli.main(["run", "run.toml"]) == 2
    assert capsys.readouterr().err.startswith(f"run.toml: {path.partition('.')[0]}")
    assert [file.name for file in work.iterdir()] == ["run.toml"]


def test_states_are_read_beside_the_file(folders, capsys):
    work, other = folders
    np.save(other / "states.npy", [1.0, 0.1, 0.5])
    (other / "run.toml").write_text(STATES.format("states.npy") + '[output]\nfile = "run.nc"\n')
    assert cli.main(["run", "../other/run.toml", "--quiet"]) == 0
    assert [path.name for path in work.iterdir()] == ["run.nc"]
    assert sorted(path.name for path in other.iterdir()) == ["run.toml", "states.npy"]


def test_relative_paths_with_two_dots(folders, capsys):
    work, other = folders
    np.save(work / "states.npy", [1.0, 0.1, 0.5])
    (other / "run.toml").write_text(STATES.format("../work/states.npy") + '[output]\nfile = "../other/run.nc"\n')
    assert cli.main(["run", "../other/run.toml", "--quiet"]) == 0
    assert sorted(path.name for path in other.iterdir()) == ["run.nc", "run.toml"]


@pytest.mark.parametrize("name", ["~/run.nc", "$HOME/run.nc", "`pwd`/run.nc", "missing/../run.nc/x.nc"])
def test_names_are_not_expanded(folders, capsys, monkeypatch, name):
    work, _ = folders
    monkeypatch.setenv("HOME", str(work))
    (work / "run.toml").write_text(READY_MADE + f"[output]\nfile = '{name}'\n")
    assert cli.main(["run", "run.toml"]) == 2
    assert "does not exist; create it first" in capsys.readouterr().err
    assert [path.name for path in work.iterdir()] == ["run.toml"]


def test_output_replaces_a_link(folders, capsys):
    work, other = folders
    (other / "precious").write_text("precious")
    os.symlink(other / "precious", work / "run.nc")
    (work / "run.toml").write_text(READY_MADE + '[output]\nfile = "run.nc"\n')
    assert cli.main(["run", "run.toml", "--quiet"]) == 0
    assert (other / "precious").read_text() == "precious"
    assert not (work / "run.nc").is_symlink()


def test_circular_links_are_refused(folders, capsys):
    work, _ = folders
    os.symlink("loop.npy", work / "loop.npy")
    (work / "run.toml").write_text(STATES.format("loop.npy"))
    assert cli.main(["run", "run.toml"]) == 2
    assert "loop.npy' cannot be read" in capsys.readouterr().err


def test_array_header_beyond_the_file_is_refused(folders, capsys):
    work, _ = folders
    np.save(work / "states.npy", np.ones((2, 3)))
    expected = (work / "states.npy").read_bytes()
    (work / "states.npy").write_bytes(
        expected.replace(b"(2, 3)", b"(9" + b"0" * 12 + b", 3)").replace(b" " * 12, b"", 1)
    )
    (work / "run.toml").write_text(STATES.format("states.npy"))
    assert cli.main(["run", "run.toml"]) == 2
    assert "holds no array of numbers" in capsys.readouterr().err
