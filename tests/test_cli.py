"""The command `coadjoint`: runs, output, refusals and exit status."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import xarray

import coadjoint
import coadjoint as co
from coadjoint import cli
from coadjoint.algebra.families.low_dimensional import entries, parameters_of
from coadjoint.experiments.statement import judge

SOURCE = Path(coadjoint.__file__).parents[1]
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.toml"))

BODY = """
[system]
name = "rigid_body"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.1
"""

# [e1, e2] = e2 with H = x1 gives x2' = x2, which overflows at t = 709.78, in step 710.
GROWING = """
sign = -1
[algebra]
dim = 2
brackets = ["[e1, e2] = e2"]
[hamiltonian]
linear = [1.0, 0.0]
[initial]
x = [1.0, 1.0]
[run]
t_span = [0.0, 1000.0]
step = 1.0
save_every = 100
"""
OVERFLOW = (
    "in step 710, at t = 709, a number overflowed; take a smaller step than 1; if that fails near the same time, the "
    "motion itself grows without bound there: end t_span before"
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.toml").write_text(BODY)
    (tmp_path / "growing.toml").write_text(GROWING)
    return tmp_path


def refused(capsys, *arguments):
    """Return the single line with which the command refuses."""
    assert cli.main(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.endswith("\n") and output.err.count("\n") == 1
    return output.err[:-1]


@pytest.mark.thinned(6)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example, folder, capsys):
    target = folder / "run.zarr"
    assert cli.main(["run", str(example), "--out", str(target)]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    assert output.out.endswith(f"written: {target}\n")
    with xarray.open_zarr(target) as dataset:
        assert dataset["x"].notnull().all()
        assert dataset.attrs["configuration"] == example.read_text()


def test_examples_exist():
    wanted = {"rigid_body", "attitude", "a37", "own_algebra", "polynomial", "heavy_top", "ensemble"}
    assert wanted <= {path.stem for path in EXAMPLES}


def test_run_prints_the_drift_unless_quiet(folder, capsys):
    assert cli.main(["run", "body.toml"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("rigid_body, Splitting(order=2")
    assert "10 steps of 0.1" in output and "over every step" in output
    assert [line.split()[0] for line in output.splitlines()[2:]] == ["energy", "|x|^2"]
    assert cli.main(["run", "body.toml", "--quiet", "--out", "run.nc"]) == 0
    assert capsys.readouterr().out == ""
    assert (folder / "run.nc").is_file()


@pytest.mark.long
def test_outputs_named_in_the_file(folder, capsys):
    (folder / "body.toml").write_text(BODY + '[output]\nfile = "named.zarr"\nfigure = "named.png"\n')
    assert cli.main(["run", "body.toml"]) == 0
    assert (folder / "named.zarr").is_dir()
    assert (folder / "named.png").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["run", "body.toml", "--out", "other.nc", "--figure", "other.svg"]) == 0
    assert (folder / "other.nc").is_file() and (folder / "other.svg").is_file()
    assert sorted(p.name for p in folder.iterdir()) == [
        "body.toml", "growing.toml", "named.png", "named.zarr", "other.nc", "other.svg"
    ]  # fmt: skip


def test_progress_is_written_to_stderr(folder, capsys):
    assert cli.main(["run", "body.toml", "--progress", "--quiet"]) == 0
    output = capsys.readouterr()
    assert output.out == "" and "10 of 10 steps (100 %)" in output.err


@pytest.mark.parametrize("name", ["part.nc", "part.zarr"])
def test_failed_run_writes_the_partial_solution(folder, capsys, name):
    assert cli.main(["run", "growing.toml", "--out", name]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err == (f"growing.toml: the run failed: {OVERFLOW}; the solution so far is in {name}\n")
    engine = {"part.nc": "h5netcdf", "part.zarr": "zarr"}[name]
    with xarray.open_dataset(name, engine=engine) as dataset:
        assert dataset["time"].values.tolist() == [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0]
        assert dataset["x"].notnull().all()
        assert dataset.attrs["run_failed"] == 1
        assert dataset.attrs["failed_step"] == 710
        assert dataset.attrs["failed_time"] == 709.0
        assert "overflowed" in dataset.attrs["failed_reason"]


def test_failed_run_without_output(folder, capsys):
    assert cli.main(["run", "growing.toml"]) == 1
    assert capsys.readouterr().err == f"growing.toml: the run failed: {OVERFLOW}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "coadjoint: unknown command 'rnu'; did you mean 'run'?"),
        (
            ["zzzzz"],
            "coadjoint: unknown command 'zzzzz'; there are: algebras, certify, check, gallery, methods, reproduce, "
            "resume, run, schema, selftest, systems",
        ),
        (["run"], "coadjoint: missing argument 'FILE' (see 'coadjoint run --help')"),
        (["run", "body.toml", "--ot", "x"], "coadjoint: unknown option '--ot'; did you mean '--out'?"),
        (["--verzion"], "coadjoint: unknown option '--verzion'; did you mean '--version'?"),
        (["run", "body.toml", "--out"], "coadjoint: option '--out' requires an argument"),
        (
            ["systems", "rigid_body", "more"],
            "coadjoint: got unexpected extra argument (more) (see 'coadjoint systems --help')",
        ),
        (["systems", "rigidbody"], "coadjoint: unknown system 'rigidbody'; did you mean 'rigid_body'?"),
        (["gallery", "lagrangetop"], "coadjoint: unknown system 'lagrangetop'; did you mean 'lagrange_top'?"),
        (["systems", "--json", "x.json"], "coadjoint: --json writes the description of one system; give its name"),
        (["systems", "toda", "--json", "x.txt"], "x.txt: the suffix sets the format; it must be .json"),
        (["run", "none.toml"], "none.toml: cannot be read (No such file or directory)"),
        (["run", "."], ".: cannot be read (Is a directory)"),
        (["run", "body.toml", "--out", "run.csv"], "run.csv: the suffix sets the format; it must be .nc or .zarr"),
        (
            ["run", "body.toml", "--figure", "run.bmp"],
            "run.bmp: the suffix sets the format; it must be .png, .pdf or .svg",
        ),
        (["run", "body.toml", "--out", "no/run.nc"], "no/run.nc: the folder no does not exist; create it first"),
        (
            ["gallery", "toda", "--out", "body.toml"],
            "coadjoint: --out body.toml: cannot be made a folder (File exists); give another",
        ),
        (
            ["reproduce", "--out", "body.toml"],
            "coadjoint: --out body.toml: cannot be made a folder (File exists); give another",
        ),
    ],
)
def test_invalid_arguments_are_refused_in_one_line(folder, capsys, monkeypatch, arguments, message):
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", lambda *args, **kwargs: pytest.fail("the run started"))
    assert refused(capsys, *arguments) == message


def test_other_targets_are_not_replaced(folder, capsys):
    (folder / "other.nc").mkdir()
    (folder / "other.zarr").mkdir()
    (folder / "other.zarr" / "thesis.tex").write_text("precious")
    assert refused(capsys, "run", "body.toml", "--out", "other.nc") == "other.nc: is a folder; give the name of a file"
    message = "other.zarr: exists and is not a Zarr store, so it is not replaced; give another name"
    assert refused(capsys, "run", "body.toml", "--out", "other.zarr") == message
    assert (folder / "other.zarr" / "thesis.tex").read_text() == "precious"


def test_unwritable_folder_is_refused(folder, capsys):
    # Nobody can create files in /proc.
    message = refused(capsys, "run", "body.toml", "--out", "/proc/run.zarr")
    assert message.startswith("/proc/run.zarr: cannot be written (") and message.endswith("); give another folder")


@pytest.mark.long
def test_certify_prints_writes_and_plots(folder, capsys):
    arguments = ["certify", "body.toml", "--steps", "40", "--json", "found.json", "--plot", "found.png"]
    assert cli.main(arguments) == 0
    output = capsys.readouterr()
    assert output.err == ""
    assert "passed: every declared property holds\nwritten: found.json\nwritten: found.png\n" in output.out
    read = json.loads((folder / "found.json").read_text())
    assert read["passed"] is True and read["subject"]["steps"] == 40 and read["subject"]["step"] == 0.1
    assert (folder / "found.png").read_bytes().startswith(b"\x89PNG")


def test_failed_certificate_has_status_1(folder, capsys):
    @co.methods.register
    @dataclasses.dataclass(frozen=True)
    class DeclaredSymmetric(co.ModifiedGaussLegendre):
        symmetric = True

    try:
        (folder / "false.toml").write_text(BODY + '[method]\nname = "DeclaredSymmetric"\n')
        assert cli.main(["certify", "false.toml", "--steps", "10"]) == 1
    finally:
        co.methods.registry.forget("DeclaredSymmetric")
    output = capsys.readouterr()
    assert output.err == "" and output.out.endswith("not passed: a step back undoes a step (fails)\n")


def test_certify_at_rest_is_undecidable(folder, capsys):
    (folder / "rest.toml").write_text(BODY.replace("[1.0, 0.1, 0.5]", "[1.0, 0.0, 0.0]"))
    assert cli.main(["certify", "rest.toml", "--steps", "10"]) == 1
    assert "order (not decidable here)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            '[system.parameters]\ninertia = [1, 2, 3]\n[sweep.over]\n"system.parameters.inertia[2]" = [2, 3]\n',
            "sweep.over: a certificate is of one system",
        ),
        ('[[forces]]\nname = "LinearDamping"\nrate = 0.1\n', "forces: a certificate is of a system without forces"),
    ],
)
def test_certify_names_the_table_that_it_does_not_take(table, message, folder, capsys):
    Path("more.toml").write_text(f"{Path('body.toml').read_text()}\n{table}")
    assert refused(capsys, "certify", "more.toml").startswith(f"more.toml: {message}; ")


def test_systems_and_methods_are_listed(capsys):
    assert cli.main(["systems"]) == 0
    systems = capsys.readouterr().out
    for name in coadjoint.systems.names():
        assert f"{name}(" in systems
    assert "rigid_body(inertia=(1.0, 2.0, 3.0))\n    Return the free rigid body" in systems
    assert cli.main(["methods"]) == 0
    methods = capsys.readouterr().out
    assert "GaussLegendre(stages=2)\n    The Gauss-Legendre method" in methods
    assert "Composition(base, coefficients)\n" in methods
    assert cli.main(["methods", "GaussLegendre"]) == 0
    one = capsys.readouterr().out
    assert one.startswith("GaussLegendre(stages=2)\n    The Gauss-Legendre method") and "\n    stages : int" in one
    assert "Examples" not in one and "Splitting(order=2" not in one and one.endswith("\n")
    assert refused(capsys, "methods", "Spliting").startswith(
        "coadjoint: unknown method 'Spliting'; did you mean 'Splitting'?"
    )


def test_reproduce_prints_the_table_and_the_figures(folder, capsys, monkeypatch):
    row = judge("k", "Lemma 1", "sum", paper="4", criterion="exact", measured="2 + 2 = 4", holds=True)

    def experiments(out, echo):
        echo("running")
        (out / "sum.png").write_text("")
        return SimpleNamespace(table=[row], figures=[out / "sum.png"])

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


def test_help_and_version(capsys):
    assert cli.main([]) == 0
    empty = capsys.readouterr().out
    assert cli.main(["--help"]) == 0
    assert capsys.readouterr().out == empty
    assert "reproduce" in empty and "Run the configuration FILE" in empty
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"coadjoint {coadjoint.__version__}\n"


@pytest.mark.parametrize("arguments", [["--help"], ["systems"]])
def test_light_commands_load_no_heavy_packages(arguments):
    code = (
        "import sys; from coadjoint.cli import main; status = main(sys.argv[1:]); "
        "heavy = [m for m in ('numba', 'matplotlib', 'xarray', 'pydantic') if m in sys.modules]; "
        "sys.exit(status or ' '.join(heavy) or None)"
    )
    environment = {**os.environ, "PYTHONPATH": str(SOURCE)}
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")


def test_module_runs_the_command(folder):
    environment = {**os.environ, "PYTHONPATH": str(SOURCE)}
    command = [sys.executable, "-m", "coadjoint", "run", "none.toml"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "none.toml: cannot be read (No such file or directory)\n"


def test_systems_describes_one_system(folder, capsys):
    assert cli.main(["systems", "gyrostat", "--json", "described.json"]) == 0
    output = capsys.readouterr()
    assert output.err == "" and output.out.startswith("gyrostat(inertia=(1.0, 2.0, 3.0), rotors=(0.25, 0.5, 0.75))")
    assert "so(3); dimension 3, rank 2" in output.out and "mass times length squared over time" in output.out
    assert output.out.endswith("written: described.json\n")
    assert json.loads((folder / "described.json").read_text())["casimirs"] == {"|x|^2": "x1^2 + x2^2 + x3^2"}


def test_gallery_writes_plots_and_a_page(folder, capsys):
    assert cli.main(["gallery", "so_n_body", "so_n_body", "--out", "out/here"]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    assert output.out.splitlines() == ["1 of 1: so_n_body", f"written: {Path('out/here/index.html')}"]
    assert sorted(p.name for p in (folder / "out/here").iterdir()) == ["index.html", "so_n_body.png"]
    assert (folder / "out/here/so_n_body.png").read_bytes().startswith(b"\x89PNG")


WITH_PARAMETERS = {name for name in entries() if parameters_of(name)}


def test_algebras_are_listed(capsys):
    assert cli.main(["algebras"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(co.algebras.names())
    assert "A4_9(b)         dimension 4, -1 < b <= 1" in lines
    assert "so(p,q)         a family; give the numbers, such as so(3,1)" in lines


def test_algebra_is_described(capsys):
    assert cli.main(["algebras", "A5,23", "b=1/2"]) == 0
    found = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[1:] if line[0] != " ")
    assert found["dimension"] == "5" and found["brackets"] == "[e1, e5] = 2 e1"
    assert "2*log|x4| - b*log|x1|" in found["casimirs"]
    for name in co.algebras.names():
        # Families without numbers and algebras without parameters are refused.
        incomplete = name.endswith(("n)", "q)")) or name in WITH_PARAMETERS
        assert cli.main(["algebras", name]) == (2 if incomplete else 0)
        assert ("dimension " in capsys.readouterr().out) is not incomplete


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("so(n)",), "so(n) is a family; give its numbers, such as so(3)"),
        (("so(x)",), "unknown algebra 'so(x)'; did you mean 'so(n)'?"),
        (("A5,23", "b"), "'b' is not a parameter; give name and number, such as b=0.5 or b=1/3"),
        (("A5,23", "b=1/0"), "'b=1/0' is not a parameter; give name and number, such as b=0.5 or b=1/3"),
        (("A5,23", "b=1e999999999"), "'b=1e999999999' is not a parameter"),
        (("A5,23",), "algebra 'A5_23' needs the parameter 'b'"),
        (("A5,23", "b=0"), "b"),
    ],
)
def test_invalid_algebras_are_refused(capsys, arguments, message):
    assert cli.main(["algebras", *arguments]) == 2
    given = capsys.readouterr()
    assert given.out == "" and given.err.startswith("coadjoint: ") and message in given.err
    assert given.err.count("\n") == 1
