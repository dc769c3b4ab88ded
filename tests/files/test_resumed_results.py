"""`coadjoint resume` writes the results that the file of the run declares."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint import cli
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.configuration.loading import load

RUN = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.2, 0.1]
[run]
t_span = [0.0, 4.0]
step = 0.125
[output]
archive = "run.zarr"
"""
DECLARED = 'file = "run.nc"\nfigure = "run.png"\nmovie = "run.gif"\n'


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """Begin the run of a file, and stop it after 10 of 32 steps."""
    monkeypatch.chdir(tmp_path)

    def begin(output):
        (tmp_path / "run.toml").write_text(RUN + output)
        configuration = load("run.toml")
        about = configuration.dataset(configuration.integrate()).attrs["configuration"]
        from coadjoint.files.datasets.variables import ExtraMetadata

        archive_run(
            configuration.ready(),
            configuration.x0,
            configuration.t_span,
            1,
            "run.zarr",
            until=10,
            about=ExtraMetadata({}, {"configuration": about}),
        )
        (tmp_path / "run.toml").unlink()
        return tmp_path

    return begin


def test_declared_results_are_written(begun, capsys):
    folder = begun(DECLARED)
    assert cli.main(["resume", "run.zarr"]) == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr", "run.nc", "run.png", "run.gif"}
    written = [line for line in capsys.readouterr().out.splitlines() if line.startswith("written: ")]
    assert written == [f"written: run.{suffix}" for suffix in ("zarr", "nc", "png", "gif")]
    found = co.load("run.nc")
    whole = co.integrate(co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.2, 0.1), (0, 4), 0.125)
    np.testing.assert_array_equal(found.x, whole.x)
    assert found.incomplete is None and "inertia" in found.attributes["configuration"]


def test_options_take_precedence(begun):
    folder = begun(DECLARED)
    options = ["--out", "other.zarr", "--figure", "other.pdf", "--movie", "other.gif"]
    assert cli.main(["resume", "run.zarr", "--t-end", "6", "--quiet", *options]) == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr", "other.zarr", "other.pdf", "other.gif"}
    assert co.load("other.zarr").t[-1] == 6.0


def test_finished_runs_write_their_results_too(begun):
    folder = begun("")
    assert cli.main(["resume", "run.zarr"]) == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr"}, "nothing is declared"
    assert cli.main(["resume", "run.zarr", "--out", "late.nc"]) == 0
    assert len(co.load("late.nc").t) == 33


def test_unwritable_results_are_refused_before_the_run(begun, capsys):
    begun('file = "missing/run.nc"\n')
    assert cli.main(["resume", "run.zarr"]) == 2
    assert "output.file: missing/run.nc" in capsys.readouterr().err
    assert co.open_archive("run.zarr").reached == 10
    assert cli.main(["resume", "run.zarr", "--out", "run.csv"]) == 2
    assert cli.main(["resume", "run.zarr", "--out", "run.nc", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("declared", "option"),
    [
        ('file = "{above}/run.nc"', "--out"),
        ('figure = "../run.png"', "--figure"),
        ('movie = "linked/a.gif"', "--movie"),
    ],
)
def test_results_outside_of_the_folder_are_refused(begun, tmp_path_factory, capsys, declared, option):
    """An archive may come from others, who choose what it declares."""
    above = tmp_path_factory.mktemp("above")
    folder = begun(declared.format(above=above) + "\n")
    (folder / "linked").symlink_to(above)
    assert cli.main(["resume", "run.zarr"]) == 2
    assert f"is outside of the current folder; give {option}" in capsys.readouterr().err
    assert not list(above.iterdir()) and co.open_archive("run.zarr").reached == 10
    suffix = {"--out": "nc", "--figure": "png", "--movie": "gif"}[option]
    assert cli.main(["resume", "run.zarr", "--quiet", option, f"own.{suffix}"]) == 0
    assert (folder / f"own.{suffix}").exists()
