"""Extras: errors for missing packages, and consistency of declared and imported packages."""

import ast
import contextlib
import importlib.util
import re
import sys
import tomllib
import types
from pathlib import Path

import pytest

import coadjoint
from coadjoint import cli, commands
from coadjoint.optional_packages import EXTRAS, MissingPackageError, require_packages
from core_only import CORE

PACKAGE = Path(coadjoint.__file__).parent
ROOT = PACKAGE.parents[1]
BODY = """
system = {name = "rigid_body", parameters = {inertia = [1, 2, 3]}}
initial = {x = [1.0, 0.1, 0.5]}
run = {t_span = [0, 1], step = 0.1}
"""


@pytest.mark.parametrize(
    ("arguments", "missing", "message"),
    [
        (
            ["run", "body.toml"],
            "pydantic",
            'reading a configuration file needs the package pydantic, .*"coadjoint.io."',
        ),
        (["run", "body.toml", "--progress"], "tqdm", 'progress=True needs the package tqdm, .*"coadjoint.cli."'),
        (["run", "body.toml", "--out", "x.nc"], "h5py", 'x.nc: NetCDF needs the package h5py, .*"coadjoint.io."'),
        (["run", "body.toml", "--out", "x.zarr"], "zarr", 'x.zarr: Zarr needs the package zarr, .*"coadjoint.io."'),
        (["run", "body.toml", "--figure", "x.png"], "matplotlib", 'x.png: a figure needs .*"coadjoint.plot."'),
        (["reproduce"], "numba", 'repeating the experiments needs the package numba, .*"coadjoint.functions."'),
    ],
    ids=["configuration", "progress", "NetCDF", "Zarr", "figure", "reproduce"],
)
def test_command_names_missing_packages(tmp_path, monkeypatch, capsys, arguments, missing, message):
    """One line before the run; nothing is left behind."""
    (tmp_path / "body.toml").write_text(BODY)
    monkeypatch.chdir(tmp_path)
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *args: None if name == missing else find(name, *args))
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", None)
    assert cli.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(f"coadjoint: {message}\n", printed.err)
    assert [path.name for path in tmp_path.iterdir()] == ["body.toml"]


def test_broken_package_is_reported_in_one_line(monkeypatch, capsys):
    """A Numba older than NumPy, for instance, raises its own ImportError."""

    def load(path):
        raise ImportError("Numba needs NumPy 2.0 or less")

    monkeypatch.setattr("coadjoint.files.configuration.loading.load", load)
    assert cli.main(["run", "body.toml"]) == 2
    assert capsys.readouterr().err == "coadjoint: Numba needs NumPy 2.0 or less\n"
    assert commands.perform(["--version"]) == (0, "")


@pytest.mark.parametrize(("value", "refused"), [("1", True), ("yes", True), ("0", False), ("", False)])
def test_disabled_numba_is_refused(monkeypatch, value, refused):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", value)
    require_packages("a", "zarr")
    with pytest.raises(MissingPackageError, match="turns off; unset it") if refused else contextlib.nullcontext():
        require_packages("a", "numba")


def test_modules_without_a_specification_are_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "numcodecs", types.ModuleType("numcodecs"))
    require_packages("a", "numcodecs")


def imported_packages(parts=("",)):
    """Yield the packages of every import outside of TYPE_CHECKING, in files and folders of these names."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.relative_to(PACKAGE).as_posix().startswith(parts):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for checked in [node for node in ast.walk(tree) if isinstance(node, ast.If)]:
            if ast.unparse(checked.test) == "TYPE_CHECKING":
                checked.body = []
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            yield from (name.partition(".")[0] for name in names)


@pytest.mark.long
def test_imported_packages_are_declared():
    found = {*imported_packages()} - sys.stdlib_module_names
    assert found - CORE - {"mpl_toolkits", "dask", "llvmlite"} <= set(EXTRAS)  # of matplotlib, distributed and numba
    assert {"numba", "xarray", "matplotlib", "pydantic", "click", "tqdm", "zarr", "h5netcdf"} <= found


# Modules of packages that have other names on the index.
MODULES = {"python-flint": "flint", "pillow": "PIL", "google-crc32c": "google_crc32c"}


def declared_packages():
    """Return the table [project] of pyproject.toml, and the modules of each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return project, {
        extra: {MODULES.get(name := requirement.partition(">=")[0], name) for requirement in requirements}
        for extra, requirements in project["optional-dependencies"].items()
    }


@pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not a checkout")
def test_one_extra_is_enough_for_the_command():
    """Of packages that several extras need, `EXTRAS` names one extra; the others must have them too."""
    _, declared = declared_packages()
    parts = ("cli.py", "commands.py", "long_operations.py")
    used = {*imported_packages((*parts, "files/configuration/"))}
    assert used & set(EXTRAS) == {"click", "tqdm", "pydantic"} <= declared["cli"]


@pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not a checkout")
def test_extras_match_the_project():
    project, declared = declared_packages()
    assert all(package in declared[extra] for package, extra in EXTRAS.items())
    assert set().union(*(declared[extra] for extra in EXTRAS.values())) == set(EXTRAS)
    extras = "functions,io,plot,cli,precision,algebra,fluids,cluster,remote,bodies,parquet,orbits,spice,crystals"
    assert declared["all"] == {f"coadjoint[{extras}]"}
    assert "coadjoint[all]" in declared["dev"]
    needed = {requirement.partition(">=")[0] for requirement in project["dependencies"]}
    assert {MODULES.get(name, name) for name in needed} == CORE - {"coadjoint"}


@pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not a checkout")
def test_the_page_of_installation_lists_every_extra():
    _, declared = declared_packages()
    listed = re.findall(r"^\| `([\w-]+)` \|", (ROOT / "docs/installing.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(set(declared) - {"dev", "docs", "bench", "bench-fortran"})
