"""Files of check-cases and of samples: what is written is read, and files of strangers are refused in one line."""

import json
import os

import numpy as np
import pytest

import coadjoint as co
from command import command
from refusals import refused

NAMES = ("wx", "wy", "wz", "qw", "qx", "qy", "qz")
CHEAP = [name for name in co.checkcases.names() if name not in ("two_asteroids", "water_dimer", "eccentric_libration")]


@pytest.fixture(scope="module")
def case():
    return co.checkcases.get("free_body")


def columns_of(case):
    return {name: values[::20] for name, values in case.reference().items()}


def csv(columns, delimiter=",", header=True, comment="# made by a test\n"):
    rows = [delimiter.join(columns)] * header
    rows += [delimiter.join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True)]
    return comment + "\n".join(rows) + "\n"


@pytest.mark.parametrize("name", CHEAP)
def test_written_files_have_the_certain_digits(name, tmp_path):
    """The CSV passes within the accuracy, and the JSON has the same numbers and the whole statement."""
    case = co.checkcases.get(name)
    case.write(tmp_path / "case.csv")
    case.write(str(tmp_path / "case.json"))
    assert case.compare(tmp_path / "case.csv", tolerance=2 * case.accuracy).passed
    text = (tmp_path / "case.csv").read_text()
    stored = json.loads((tmp_path / "case.json").read_text())
    table = co.checkcases.read_table(tmp_path / "case.csv")
    assert {key: values.tolist() for key, values in table.items()} == stored["samples"]
    assert tuple(table) == case.columns and stored["statement"] == case.statement and "CC0" in stored["license"]
    assert case.statement in text and case.source in text and "license: CC0" in text
    assert {key: entry["unit"] for key, entry in stored["parameters"].items()} == {
        key: unit for key, (_, unit) in case.parameters.items()
    }


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", ", "])
@pytest.mark.parametrize("header", [True, False])
def test_text_tables_are_read(case, tmp_path, delimiter, header):
    columns = columns_of(case)
    file = tmp_path / "mine.csv"
    file.write_text(csv(columns, delimiter, header, "% another comment\n\n# and\n"), encoding="utf-8-sig")
    given = None if header else ",".join(columns)
    assert case.compare(file, columns=given, tolerance=1e-11).passed
    if not header:
        with refused(ValueError, str(file), "t=NAME"):
            case.compare(file)
        assert case.compare(file, columns="t,wx,wy,wz,-,-,-,-").errors[0].name == "rates"


def test_quoted_names_with_units_are_read(case, tmp_path):
    columns = columns_of(case)
    named = {'"time, s"': columns["t"], '"p [deg/s]"': np.degrees(columns["wx"])}
    named |= {'"q [deg/s]"': np.degrees(columns["wy"]), '"r [deg/s]"': np.degrees(columns["wz"])}
    (tmp_path / "mine.csv").write_text(csv(named))
    found = case.compare(tmp_path / "mine.csv", columns={"t": "time, s"})
    assert found.passed and sum("converted from deg/s" in note for note in found.notes) == 3


def test_netcdf_is_read_with_its_units(case, tmp_path):
    import xarray

    columns = columns_of(case)
    dataset = xarray.Dataset({name: ("time", columns[name]) for name in NAMES}, {"time": columns["t"]})
    dataset["wx"] = np.degrees(dataset["wx"])
    dataset["wx"].attrs["units"] = "deg/s"
    dataset["time"].attrs["units"] = "s"
    dataset["name"] = "text"
    dataset.to_netcdf(tmp_path / "mine.nc", engine="h5netcdf")
    assert case.compare(tmp_path / "mine.nc").passed
    (tmp_path / "broken.nc").write_bytes((tmp_path / "mine.nc").read_bytes()[:600])
    with refused(ValueError, "broken.nc", "NetCDF"):
        case.compare(tmp_path / "broken.nc")


def test_tables_of_other_libraries_are_compared(case):
    """A frame of pandas, a dataset of xarray with the time as a coordinate, and plain lists."""
    import pandas
    import xarray

    columns = columns_of(case)
    dataset = xarray.Dataset({name: ("t", columns[name]) for name in NAMES}, {"t": columns["t"]})
    dataset["wy"] = np.degrees(dataset["wy"])
    dataset["wy"].attrs["units"] = "deg/s"
    for samples in (pandas.DataFrame(columns), dataset, {name: list(values) for name, values in columns.items()}):
        found = case.compare(samples)
        assert found.passed and len(found.errors) == 4


def test_parquet_is_read(case, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = pyarrow.table({**columns_of(case), "label": ["a"] * len(columns_of(case)["t"])})
    parquet.write_table(table, tmp_path / "mine.parquet")
    assert case.compare(tmp_path / "mine.parquet", tolerance=1e-11).passed
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 nothing PAR1")
    with refused(ValueError, "broken.parquet", "Parquet"):
        case.compare(tmp_path / "broken.parquet")


WRONG = {
    "no numbers": ("# nothing\n", "no line"),
    "nothing": ("", "empty"),
    "names alone": ("t,wx,wy,wz\n", "no line of numbers"),
    "a word": ("t,wx,wy,wz\n0,1,2,3\n1,1,two,3\n", "line 3: 'two'"),
    "decimal commas": ("t;wx;wy;wz\n0;1,5;2;3\n", "decimal points"),
    "a short line": ("t,wx,wy,wz\n0,1,2,3\n1,1,2\n", "line 3"),
    "a name twice": ("t,wx,wx,wz\n0,1,2,3\n", "'wx'"),
    "an empty field": ("t,wx,wy,wz\n0,1,,3\n1,1,2,3\n", "wy"),
    "an unknown order": ("t,wx,wy,wz,q1,q2,q3,q4\n0,1,2,3,1,0,0,0\n1,1,2,3,1,0,0,0\n", "unknown order"),
    "no attitude": ("t,wx,wy,wz,roll\n0,1,2,.5,0\n1,1,2,3,0\n", "attitude (qw, qx, qy, qz)"),
    "an infinity": ("t,wx,wy,wz\n0,1,2,3\n1,inf,2,3\n", "wx is inf in sample 2"),
    "a unit of another kind": ("t,wx [kg],wy,wz\n0,1,2,3\n1,1,2,3\n", "'kg'"),
    "digits in groups": ("t,wx,wy,wz\n0,1,2,3\n1,1_0,2,3\n", "'1_0'"),
    "a long name": ("t,wx,wy," + "z" * 201 + "\n0,1,2,3\n", "200 characters"),
    "a formula": ("t,wx,wy,wz\n0,=1+1,2,3\n", "'=1+1'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_files_that_are_no_tables_are_refused_in_one_line(case, tmp_path, capsys, what):
    text, words = WRONG[what]
    file = tmp_path / "mine.csv"
    file.write_text(text)
    with refused(ValueError, str(file), words):
        case.compare(file)
    printed = command(capsys, "checkcase", "free_body", "--compare", file)
    assert printed.status == 2 and printed.out == "" and printed.err.count("\n") == 1 and words in printed.err


def test_other_files_are_refused(case, tmp_path):
    (tmp_path / "mine.csv").write_bytes(b"t,wx\n\xff\xfe")
    with refused(ValueError, "UTF-8"):
        case.compare(tmp_path / "mine.csv")
    with refused(ValueError, "cannot be read"):
        case.compare(tmp_path / "missing.csv")
    with refused(ValueError, "suffix"):
        case.compare(tmp_path / "mine.pickle")
    with refused(ValueError, "cannot be read"):
        (tmp_path / "folder.csv").mkdir()
        case.compare(tmp_path / "folder.csv")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.csv")
        with refused(ValueError, "pipe"):
            case.compare(tmp_path / "pipe.csv")
    with refused(Exception, ".csv", ".json"):
        case.write(tmp_path / "case.txt")


@pytest.fixture
def check(capsys):
    """The command ``coadjoint checkcase``."""
    return lambda *arguments: command(capsys, "checkcase", *arguments)


def test_command_writes_compares_and_draws(case, tmp_path, check):
    reference, errors, figure = tmp_path / "case.csv", tmp_path / "errors.csv", tmp_path / "errors.png"
    assert check("free_body", "--out", reference).status == 0
    printed = check("free_body", "--compare", reference, "--tolerance", 1e-11, "--out", errors, "--plot", figure)
    assert printed.status == 0
    assert "within the tolerance of 1e-11" in printed.out and f"written: {figure}" in printed.out
    assert figure.read_bytes().startswith(b"\x89PNG")
    table = co.checkcases.read_table(errors)
    assert set(table) == {"t", "rates", "attitude", "energy", "momentum in space"} and table["rates"].max() < 1e-11


def test_command_ends_with_one_beyond_the_tolerance(case, tmp_path, check):
    columns = columns_of(case)
    columns["qx"] = -columns["qx"]
    columns |= {name: -columns[name] for name in ("qy", "qz")}
    (tmp_path / "mine.csv").write_text(csv(columns))
    status, printed, _ = check("free_body", "--compare", tmp_path / "mine.csv")
    assert status == 1 and "BEYOND" in printed and "it looks like this: the quaternion is conjugated" in printed
    assert check("free_body", "--compare", tmp_path / "mine.csv", "--tolerance", 4).status == 0  # at most pi


def test_command_reads_parameters(tmp_path, check):
    given = ["inertia=3,0,0;0,2,0.1;0,0.1,2.5", "rates=0.1,200,0.1", "end=1", "samples=5"]
    assert check("free_body", *given, "--out", tmp_path / "a.json").status == 0
    stored = json.loads((tmp_path / "a.json").read_text())
    assert stored["parameters"]["inertia"]["value"] == [[3, 0, 0], [0, 2, 0.1], [0, 0.1, 2.5]]
    assert stored["samples"]["t"] == [0, 0.25, 0.5, 0.75, 1] and stored["samples"]["wy"][0] == 200
    for wrong in ("rates=1,2", "rates", "rates=a,b,c", "speed=1", "rates=" + "1," * 400, "samples=2.5", "end=-1"):
        printed = check("free_body", wrong, "--out", tmp_path / "b.json")
        assert printed.status == 2 and printed.err.count("\n") == 1, wrong
    assert not (tmp_path / "b.json").exists()


def test_command_lists_and_describes(check):
    printed = check("--list").out
    assert all(f"{name}(" in printed for name in co.checkcases.names())
    printed = check("brick").out
    assert "slug ft^2" in printed and "published, simulator 06: rates 0.00012" in printed


def euler(case, h):
    """Samples of explicit Euler steps of a free body, rates alone."""
    moments, w, rows = np.diag(case.body.inertia), case.body.rates, []
    for k in range(round(case.end / h) + 1):
        rows.append([k * h, *w])
        w = w + h * np.cross(moments * w, w) / moments
    return dict(zip(("t", "wx", "wy", "wz"), np.array(rows).T, strict=True))


def test_command_measures_the_order_from_several_steps(tmp_path, check):
    case = co.checkcases.get("free_body", end=2.0)
    arguments = ["free_body", "end=2"]
    for h in (0.02, 0.01, 0.005):
        (tmp_path / f"{h}.csv").write_text(csv(euler(case, h)))
        arguments += ["--compare", tmp_path / f"{h}.csv", "--step", h]
    status, printed, _ = check(*arguments)
    assert status == 1
    order = float(printed.partition("observed order of the rates: ")[2].split()[0])
    assert abs(order - 1.0) < 0.2
    assert "the scheme is of order 1: the samples agree with explicit Euler steps" in printed


USAGES = [
    (["free_body", "--tolerance", "1e-3"], "--compare"),
    (["free_body", "--plot", "a.png"], "--compare"),
    (["free_body", "--compare", "a.csv", "--step", "1", "--step", "2"], "--step"),
    (["free_body", "--compare", "a.csv", "--compare", "b.csv", "--plot", "a.png"], "one comparison"),
    (["free_body", "--compare", "a.csv", "--tolerance", "0"], "tolerance"),
    (["free_body", "--compare", "a.csv", "--out", "a.json"], ".csv"),
    (["free_bod"], "free_body"),
    (["free_body", "--out", "a.txt"], ".csv"),
]


@pytest.mark.parametrize(("arguments", "words"), USAGES, ids=[words for _, words in USAGES])
def test_wrong_usage_is_refused_in_one_line(arguments, words, check, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    printed = check(*arguments)
    assert (
        printed.status == 2 and words in printed.err and printed.err.count("\n") == 1 and not list(tmp_path.iterdir())
    )


def test_the_published_files_are_compared_by_the_command(tmp_path, check):
    """Five simulators, in the units and under the names of their files: two pass at 1e-10, the others do not."""
    case = co.checkcases.get("brick")
    names = [f"bodyAngularRateWrtEi_deg_s_{axis}" for axis in ("Roll", "Pitch", "Yaw")]
    given = ",".join(f"{column}={name}" for column, name in zip(NAMES, names, strict=False))
    passed = {}
    for simulator, samples in case.published.items():
        columns = {
            "time": samples["t"],
            **{name: np.degrees(samples[w]) for name, w in zip(names, NAMES, strict=False)},
        }
        (tmp_path / "theirs.csv").write_text(csv(columns))
        printed = check("brick", "--compare", tmp_path / "theirs.csv", "--columns", given, "--tolerance", "1e-10")
        passed[simulator[-2:]] = printed.status == 0
        assert printed.err == "" and "converted from deg/s" in printed.out
    assert passed == {"01": True, "02": False, "04": True, "05": False, "06": False}
