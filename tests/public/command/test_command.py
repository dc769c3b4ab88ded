"""The command `coadjoint`: its options against the library, output, refusals and exit status."""

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

import coadjoint as co
from command import command
from configuration_files import BODY, GROWING

ROOT = Path(co.__file__).parents[1]
EXAMPLES = sorted((Path(__file__).parents[3] / "examples").glob("*.toml"))


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """Run the command in a folder with the files above."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.toml").write_text(BODY)
    (tmp_path / "growing.toml").write_text(GROWING)
    return lambda *arguments: command(capsys, *arguments)


def python(*arguments):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=False)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example, call):
    found = call("run", example, "--out", "run.zarr")
    assert (found.status, found.err) == (0, "") and found.out.endswith("written: run.zarr\n")
    with xarray.open_zarr("run.zarr") as dataset:
        assert dataset["x"].notnull().all() and dataset.attrs["configuration"] == example.read_text()


def test_a_run_is_summarized_unless_quiet(call):
    """Deviations, or changes and balances, as the solution has them."""
    forced = '[[forces]]\nname = "LinearDamping"\nrate = 0.1\n'
    for text in (BODY, BODY.replace("step = 0.1", "step = 0.1\nwatch = false"), BODY + forced):
        Path("run.toml").write_text(text)
        found = call("run", "run.toml")
        first, second, *rows = found.out.splitlines()
        assert found.status == 0 and first.startswith("rigid_body") and "10 steps of 0.1" in first
        assert ("every step" in second) == ("watch" not in text) and ("balance" in second) == ("forces" in text)
        body = co.systems.rigid_body()
        body = body.with_forces(co.forces.LinearDamping(0.1)) if "forces" in text else body
        sol = co.integrate(body, (1.0, 0.1, 0.5), (0, 1), 0.1, watch="watch" not in text)
        assert [row.split()[0] for row in rows] == ["energy", "|x|^2"]
        for name, *numbers in map(str.split, rows):
            wanted = [sol.change()[name], *([sol.balance()[name]] if "forces" in text else [])]
            assert numbers == [f"{number:.3g}" for number in wanted]
    assert call("run", "body.toml", "--quiet", "--out", "run.nc") == (0, "", "")
    found = call("run", "body.toml", "--progress", "--quiet")
    assert found.out == "" and "10 of 10 steps (100 %)" in found.err


def test_names_of_invariants_are_shown_in_one_line(call):
    Path("long.toml").write_text(
        'algebra = {name = "so(3)"}\nhamiltonian = {M = 1.0}\ninitial = {x = [1.0, 0.1, 0.5]}\n'
        f'run = {{t_span = [0.0, 1.0], step = 0.1}}\n[casimirs]\n"{"C" * 200}" = "x1^2 + x2^2 + x3^2"\n'
    )
    assert max(map(len, call("run", "long.toml").out.splitlines()[2:])) < 80


@pytest.mark.long
def test_outputs_of_the_file_are_replaced_by_options(call):
    Path("body.toml").write_text(BODY + '[output]\nfile = "named.zarr"\nfigure = "named.png"\n')
    assert call("run", "body.toml").status == 0
    assert Path("named.zarr").is_dir() and Path("named.png").read_bytes().startswith(b"\x89PNG")
    options = ["--out", "other.nc", "--figure", "other.svg", "--archive", "other.zarr"]
    lines = call("run", "body.toml", *options).out.splitlines()
    assert lines[-3:] == ["written: other.zarr", "written: other.nc", "written: other.svg"]
    written = {"named.png", "named.zarr", "other.nc", "other.svg", "other.zarr"}
    assert {path.name for path in Path().iterdir()} == {"body.toml", "growing.toml", *written}


@pytest.mark.parametrize("name", ["part.nc", "part.zarr", None])
def test_a_failed_run_writes_what_it_computed(call, name):
    found = call("run", "growing.toml", *(["--out", name] if name else []))
    assert (found.status, found.out) == (1, "") and found.err.count("\n") == 1
    for said in ("growing.toml: the run failed: in step 710, at t = 709,", "overflowed", name or ""):
        assert said in found.err
    if name:
        with xarray.open_dataset(name, engine={"part.nc": "h5netcdf", "part.zarr": "zarr"}[name]) as dataset:
            assert dataset["time"].values.tolist() == [100.0 * k for k in range(8)] and dataset["x"].notnull().all()
            attributes = dataset.attrs
        assert (attributes["run_failed"], attributes["failed_step"], attributes["failed_time"]) == (1, 710, 709.0)
        assert "overflowed" in attributes["failed_reason"]


REFUSED = {
    "an unknown command": (["rnu"], ("rnu",)),
    "no command like it": (["zzzzz"], ("'zzzzz'", "--help")),
    "no file": (["run"], ("FILE", "--help")),
    "a misspelled option": (["run", "body.toml", "--ot", "x"], ("--ot", "--out")),
    "options of other commands": (["certify", "--stepps", "3"], ("--stepps", "--steps")),
    "an end": (["resume", "--tend", "3"], ("--tend", "--t-end")),
    "a folder of pictures": (["gallery", "--uot", "a"], ("--uot", "--out")),
    "a description": (["systems", "--jsn", "a"], ("--jsn", "--json")),
    "a misspelled flag": (["--verzion"], ("--verzion", "--version")),
    "an option without its value": (["run", "body.toml", "--out"], ("--out",)),
    "one argument more": (["systems", "rigid_body", "more"], ("more", "--help")),
    "an unknown system": (["systems", "rigidbody"], ("'rigidbody'", "'rigid_body'")),
    "an unknown scheme": (["methods", "Spliting"], ("'Spliting'", "'Splitting'")),
    "a description of all": (["systems", "--json", "x.json"], ("--json", "name")),
    "the format of a description": (["systems", "toda", "--json", "x.txt"], ("x.txt: ", ".json")),
    "a file that is not there": (["run", "none.toml"], ("none.toml: ", "No such file")),
    "a folder": (["run", "."], (".: ", "directory")),
    "pictures in a file": (["gallery", "toda", "--out", "body.toml"], ("body.toml", "is a file")),
    "experiments in a file": (["reproduce", "--out", "body.toml"], ("body.toml", "is a file")),
    "certificate of no name": (["certify", "body.toml", "--json", ""], (".json",)),
    "picture of no name": (["certify", "body.toml", "--plot", ""], (".png, .pdf or .svg",)),
    "certificate in no folder": (["certify", "body.toml", "--json", "none/a.json"], ("none/a.json: ",)),
    "certificate as a picture": (["certify", "body.toml", "--json", "a.png"], ("a.png: ",)),
    "no steps": (["certify", "body.toml", "--steps", "0"], ("steps", "not 0")),
    "a sweep": (["certify", "sweep.toml"], ("sweep.toml: sweep.over: ",)),
    "an end before": (["resume", "held.zarr", "--t-end", "0"], ("t_end is 0",)),
    "no threads": (["resume", "held.zarr", "--t-end", "2", "--threads", "0"], ("not 0",)),
    "workers of one run": (["resume", "held.zarr", "--workers", "0"], ("workers",)),
    "no archive": (["resume", "none.zarr"], ("none.zarr",)),
    "a description of no name": (["systems", "toda", "--json", ""], (".json",)),
    "no name of a system": (["systems", ""], ("''",)),
    "a family": (["algebras", "so(n)"], ("so(n) is a family", "so(3)")),
    "no parameter": (["algebras", "A5,23"], ("'b'",)),
    "a parameter out of range": (["algebras", "A4,9", "b=2"], ("b = 2",)),
    "a family without brackets": (["algebras", "so4"], ("'so(4)'",)),
    "a parameter of zero": (["algebras", "A5,23", "b=0"], ("b",)),
}
REFUSED |= {
    f"the parameter {text[:20]}": (["algebras", "A5,23", text], (f"'{text[:20]}", "name and number"))
    for text in ("b", "b=", "b=x", "b=1/0", "b=1e400", "b=-1E+400", "b=1e1/2", "b=nan", "b=0x10", "b=1e-x",
                 "b=1e999999999", f"b={'1' * 60}", "b=" + "1" * 5000)
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_wrong_arguments_are_refused_in_one_line(call, name):
    arguments, said = REFUSED[name]
    more = '[system.parameters]\ninertia = [1, 2, 3]\n[sweep.over]\n"system.parameters.inertia[2]" = [2, 3]\n'
    Path("sweep.toml").write_text(f"{BODY}\n{more}")
    if "held.zarr" in arguments:
        co.integrate(co.systems.rigid_body(), (1.0, 0.1, 0.5), (0, 1), 0.1, archive="held.zarr")
    before = sorted(path.name for path in Path().iterdir())
    found = call(*arguments)
    assert (found.status, found.out) == (2, "") and found.err.count("\n") == 1, found
    assert [part for part in said if part.casefold() not in found.err.casefold()] == [], found.err
    assert sorted(path.name for path in Path().iterdir()) == before


@pytest.mark.parametrize("end", [None, 2.0, 0.0])
def test_resume_has_the_options_of_the_library(call, end):
    """An end at time zero is a valid end; threads and progress change no number."""
    ensemble = BODY.replace("[1.0, 0.1, 0.5]", "[[1.0, 0.1, 0.5], [0.1, 1.0, 0.5]]").replace("0.0, 1.0", "-1.0, -0.5")
    Path("many.toml").write_text(ensemble)
    assert call("run", "many.toml", "--archive", "a.zarr", "--quiet") == (0, "", "")
    times = [] if end is None else ["--t-end", str(end)]
    found = call("resume", "a.zarr", *times, "--threads", "3", "--progress", "--out", "b.nc")
    assert found.status == 0 and found.out.endswith("written: b.nc\n")
    assert end is None or "100 %" in found.err
    last = -0.5 if end is None else end
    wanted = co.integrate(co.systems.rigid_body(), [(1.0, 0.1, 0.5), (0.1, 1.0, 0.5)], (-1, last), 0.1)
    for path in ("a.zarr", "b.nc"):
        assert co.load(path).t[-1] == last and np.array_equal(co.load(path).x, wanted.x)
    assert call("resume", "a.zarr", "--quiet") == (0, "", "")


@pytest.mark.parametrize("span", [(0.0, 1.0), (-1.0, -2.0)])
def test_certify_is_the_certificate_of_the_library(call, span):
    text = BODY.replace("[0.0, 1.0]", str(list(span))) + '[method]\nname = "Splitting"\norder = 4\n'
    Path("run.toml").write_text(text)
    found = call("certify", "run.toml", "--steps", "7", "--json", "found.json")
    body, step = co.systems.rigid_body(), math.copysign(0.1, span[1] - span[0])
    wanted = co.certify(body, co.Splitting(order=4), (1.0, 0.1, 0.5), step, steps=7)
    assert found.status == int(not wanted.passed) and str(wanted) in found.out
    written = json.loads(Path("found.json").read_text())
    assert written["subject"]["steps"] == 7 and written["subject"]["step"] == step
    assert [row["verdict"] for row in written["rows"]] == [row.verdict for row in wanted.rows]


@pytest.mark.long
def test_certificates_are_plotted(call):
    found = call("certify", "body.toml", "--steps", "40", "--plot", "found.png")
    assert found.status == 0 and found.out.endswith("written: found.png\n")
    assert Path("found.png").read_bytes().startswith(b"\x89PNG")


def test_certificates_of_states_at_rest_and_of_false_schemes_have_status_1(call):
    Path("rest.toml").write_text(BODY.replace("[1.0, 0.1, 0.5]", "[1.0, 0.0, 0.0]"))
    found = call("certify", "rest.toml", "--steps", "10")
    assert found.status == 1 and "order (not decidable here)" in found.out
    Path("false.toml").write_text(BODY + '[method]\nname = "DeclaredSymmetric"\n')
    code = """
import dataclasses, json, sys
import coadjoint as co
from importlib.metadata import entry_points
main = next(iter(entry_points(group='console_scripts', name='coadjoint'))).load()
@co.methods.register
@dataclasses.dataclass(frozen=True)
class DeclaredSymmetric(co.ModifiedGaussLegendre):
    '''A scheme of a test.'''
    symmetric = True
sys.exit(main())
"""
    found = python("-c", code, "certify", "false.toml", "--steps", "10")
    assert found.returncode == 1 and "a step back undoes a step (fails)" in found.stdout
    schema = json.loads(python("-c", code, "schema").stdout)
    tables = {table["description"]: table for table in schema["$defs"]["MethodTable"]["anyOf"]}
    assert tables["A scheme of a test."]["properties"]["freeze"]


def test_systems_and_schemes_are_described(call):
    systems, schemes = call("systems").out, call("methods").out
    for name in co.systems.names():
        assert f"{name}(" in systems
    for name in co.methods.names():
        assert re.search(rf"^{name}\b", schemes, re.MULTILINE)
    assert "rigid_body(inertia=(1.0, 2.0, 3.0))\n    Return the free rigid body" in systems
    one = call("methods", "GaussLegendre").out
    assert one.startswith("GaussLegendre(stages=2)\n    The Gauss-Legendre method") and "\n    stages : int" in one
    assert "Examples" not in one and "Splitting(order=2" not in one and one.endswith("\n")
    found = call("systems", "gyrostat", "--json", "described.json")
    assert found.out.startswith("gyrostat(inertia=(1.0, 2.0, 3.0), rotors=(0.25, 0.5, 0.75))")
    assert re.search("^rank +2$", found.out, re.MULTILINE) and "mass times length squared over time" in found.out
    assert found.out.endswith("written: described.json\n")
    assert json.loads(Path("described.json").read_text())["casimirs"] == {"|x|^2": "x1^2 + x2^2 + x3^2"}
    assert "so(5)" in call("systems", "matrix_body").out


def test_algebras_are_described_for_numbers_in_any_notation(call):
    for text, b in (("b=1/2", 0.5), ("b=0.5", 0.5), ("b=5e-1", 0.5), ("b=25E-2", 0.25), ("b=-1/2", -0.5)):
        shown = call("algebras", "A5,23", text).out
        found = dict(line.split(maxsplit=1) for line in shown.splitlines()[1:] if line[0] != " ")
        assert found["dimension"] == "5" and found["brackets"] == "[e1, e5] = 2 e1"
        assert co.algebras.get("A5,23", b=b).bracket([0, 1, 0, 0, 0], [0, 0, 0, 0, 1]) is not None
    assert "2*log|x4| - b*log|x1|" in call("algebras", "A5,23", "b=1/2").out


def test_the_gallery_writes_pictures_and_a_page(call):
    found = call("gallery", "so_n_body", "so_n_body", "--out", "out/here")
    assert (found.status, found.err) == (0, "")
    assert found.out.splitlines() == ["1 of 1: so_n_body", f"written: {Path('out/here/index.html')}"]
    assert {path.name for path in Path("out/here").iterdir()} == {"index.html", "so_n_body.png"}
    assert Path("out/here/so_n_body.png").read_bytes().startswith(b"\x89PNG")


def test_help_and_version(call):
    empty = call().out
    assert call("--help").out == empty and "reproduce" in empty and "Run the configuration FILE" in empty
    assert call("--version").out == f"coadjoint {co.__version__}\n"


def test_light_commands_load_no_heavy_packages_and_the_module_is_the_command():
    code = """
import sys
from importlib.metadata import entry_points
main = next(iter(entry_points(group="console_scripts", name="coadjoint"))).load()
statuses = []
for argument in ("--help", "systems"):
    sys.argv = ["coadjoint", argument]
    try:
        statuses.append(main())
    except SystemExit as ended:
        statuses.append(ended.code)
heavy = [name for name in ("numba", "matplotlib", "xarray", "pydantic") if name in sys.modules]
sys.exit(" ".join(heavy) or any(statuses))
"""
    done = python("-c", code)
    assert (done.returncode, done.stderr) == (0, "")
    done = python("-m", "coadjoint", "run", "none.toml")
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.startswith("none.toml: cannot be read (")
