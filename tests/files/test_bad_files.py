"""Errors in configuration files: one short line with file and key, in bounded time, before the run."""

import warnings

import pytest
import xarray
from configuration_files import OWN, READY_MADE

from coadjoint import cli
from guards import bounded_work

NINES = "9" * 5000
HEXADECIMAL = "0x" + "f" * 5000
BRACKETS = 'brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]'
CASIMIRS = '[casimirs]\n"|x|^2" = "x1^2 + x2^2 + x3^2"\n'
NAMED = OWN.replace(f"dim = 3\n{BRACKETS}", 'name = "A3,7"\nparameters = {a = 2.0}').replace(CASIMIRS, "")


def own(old, new):
    assert old in OWN
    return OWN.replace(old, new)


def hamiltonian(polynomial):
    return own("M = [1.0, 0.5, 0.25]", f"polynomial = {polynomial}")


def body(old, new):
    assert old in READY_MADE
    return READY_MADE.replace(old, new)


def scheme(text):
    return body('name = "Splitting"\norder = 4', text)


def parameter(value):
    return NAMED.replace("2.0}", f"{value}}}")


CASES = {
    "lists in lists": (own("x = [1.0, 0.1, 0.5]", "x = " + "[" * 2000 + "]" * 2000), "line 12, column 69: x: "),
    "tables in tables": (body("order = 4", "order = " + "{a=" * 2000 + "1" + "}" * 2000), "line 10, column 201: order"),
    "some lists": (own("x = [1.0, 0.1, 0.5]", "x = " + "[" * 200 + "]" * 200), "initial.x: must be a list"),
    "lists that do not end": (own("x = [1.0", "x = " + "[" * 50000 + "1.0"), "line 12, column 69: x: "),
    "a key of many parts": (OWN + ".".join("a" * 10**5) + " = 1", "line 16, column 1: a key has more than 64"),
    "brackets in text": ('a = "' + "[" * 500 + '"\nb = ' + "[" * 2000 + "\n" + "]" * 2000, "line 2, column 69: b: "),
    "digits": (own("step = 0.1", f"step = {NINES}"), "line 15, column 8: step: a whole number has too many digits"),
    "digits of dim": (own("dim = 3", f"dim = {NINES}"), "line 5, column 7: dim: a whole number has too many digits"),
    "hexadecimal dim": (own("dim = 3", f"dim = {HEXADECIMAL}"), "algebra.dim: "),
    "hexadecimal step": (own("step = 0.1", f"step = {HEXADECIMAL}"), "run.step: must be a number"),
    "hexadecimal x": (own("x = [1.0", f"x = [{HEXADECIMAL}"), "initial.x: <int of about 6021 digits> is too large"),
    "hexadecimal sign": (own("sign = -1", f"sign = {HEXADECIMAL}"), "sign: must be 1 or -1"),
    "hexadecimal order": (body("order = 4", f"order = {HEXADECIMAL}"), "method: "),
    "hexadecimal parameter": (parameter(HEXADECIMAL), "algebra: "),
    "large parameter": (parameter("1e308"), "algebra: "),
    "date": (parameter("1979-05-27"), "algebra: "),
    "inertia": (body("[1.0, 2.0, 2.5]", HEXADECIMAL), "system: "),
    "inertia that cannot be inverted": (body("[1.0, 2.0, 2.5]", "[1.0, 1.0, 5e-324]"), "system: "),
    "algebra beyond memory": (NAMED.replace("A3,7", "so(n)").replace("a = 2.0", "n = 100000"), "algebra: so(100000)"),
    "long inertia": (body("[1.0, 2.0, 2.5]", f"[{'1.0,' * 10000}]"), "system: inertia has shape (10000,)"),
    "dimension": (own("dim = 3", "dim = 1000000000000"), "algebra.dim: an algebra of dimension 1000000000000 needs "),
    "dimension of another state": (own("dim = 3", "dim = 1000"), "initial.x: x0 has the shape (3,); it must be (1000"),
    "degree": (hamiltonian('"x1^4000000000"'), "hamiltonian.polynomial: 'x1^4000000000' has the degree 4000000000"),
    "digits of a degree": (hamiltonian(f'"x1^{NINES}"'), "hamiltonian.polynomial: a number of 5000 digits"),
    "degree of a product": (hamiltonian('"x1^1000*x2^1000"'), "hamiltonian.polynomial: 'x1^1000*x2^1000' has the degr"),
    "degree in a list": (hamiltonian("[[1, [4000000000, 0, 0]]]"), "hamiltonian.polynomial: the term [1, [4000000000"),
    "degree of a Casimir": (own("x1^2 + x2^2", "x1^5000000 + x2^2"), "casimirs.|x|^2: "),
    "degree of what is observed": (OWN + '[observe]\na = "x1^5000000"', "observe.a: "),
    "coordinate": (hamiltonian(f'"x{NINES}"'), "hamiltonian.polynomial: 'x999"),
    "coefficient": (hamiltonian(f'"{NINES}*x1"'), "hamiltonian.polynomial: a number of 5000 digits is too large"),
    "coefficient in a list": (hamiltonian(f"[[{HEXADECIMAL}, [1, 0, 0]]]"), "hamiltonian.polynomial: a coefficient "),
    "product of coefficients": (hamiltonian(f'"{"*".join(["9" * 300] * 800)}"'), "hamiltonian.polynomial: a number is"),
    "denominators": (hamiltonian(f'"{"*".join(["1/" + "9" * 300] * 450)}"'), "hamiltonian.polynomial: a number is"),
    "quotient": (hamiltonian('"1e300/1e-300*x1"'), "hamiltonian.polynomial: a number is too large"),
    "sum": (hamiltonian('"1e308*x1 + 1e308*x1"'), "hamiltonian.polynomial: a number is too large"),
    "many terms": (hamiltonian(f'"{"x1 + " * 20000}y"'), "hamiltonian.polynomial: 'x1 + x1"),
    "long blank": (hamiltonian(f'"{" " * 10**5}"'), "hamiltonian.polynomial: "),
    "long term": (hamiltonian(f"[[1, [{'0,' * 10**4}]]]"), "hamiltonian.polynomial: the term [1, [0, 0, 0"),
    "constant": (own("= e3", f"= {NINES} e3"), "algebra.brackets: a number of 5000 digits"),
    "sum of constants": (own("= e3", "= 1e308 e3 + 1e308 e3"), "algebra.brackets: '[e1, e2] = 1e308 e3 + 1e308 e3'"),
    "infinite constant": (own("= e3", "= 1e999 e3"), "algebra.brackets: a number is too large"),
    "long bracket": (own("= e3", "= " + "e3 " * 50000), "algebra.brackets: '[e1, e2] = e3 e3"),
    "no bracket": (own("[e1, e2]", "[" * 50000), "algebra.brackets: '[[["),
    "long key": (OWN + "a" * 10**5 + " = 1", "run.aaaaa"),
    "long names": (OWN + f'[observe]\n"{"a" * 10**5}" = "x9"', "observe.aaaaa"),
    "long value": (own('x = [1.0, 0.1, 0.5]', f'x = "{"a" * 10**5}"'), "initial.x: must be a list of numbers"),
    "key in two lines": (OWN + '"a\\nb\\u001b[31m" = 1', "run.a b?[31m: unknown key"),
    "name with NUL": (own('"mine"', '"a\\u0000"'), "name: must be printable characters in one line, not 'a\\x00'"),
    "Casimir with NUL": (own('"|x|^2"', '"a\\u0000"'), "casimirs.a?: must be printable characters"),
    "basis with NUL": (own("dim = 3", 'basis = ["a\\u0000", "b", "c"]'), "algebra.basis[0]: must be printable"),
    "schemes in schemes": (
        scheme("name = 'Composition'\ncoefficients = [0.5, 0.25, 0.25]\nbase = "
        + "{name = 'Composition', coefficients = [0.5, 0.25, 0.25], base = " * 60 + "{name = 'Splitting'}" + "}" * 60),
        "method: ",
    ),
    "compositions of compositions": (
        scheme("name = 'Composition'\ncoefficients = [0.25, 0.5, 0.25]\nbase = "
        + "{name = 'Composition', coefficients = [0.25, 0.5, 0.25], base = " * 40 + "{name = 'Splitting'}" + "}" * 40),
        "method: ",
    ),
    "coordinate of a part": (body("order = 4", "parts = [[0, 100000000000000000000], [1], [2]]"), "method: "),
    "saved states": (own("step = 0.1", "step = 1e-14"), "run.save_every: the saved states do not fit into memory: "),
    "long file name": (OWN + f'[output]\nfile = "{"a" * 300}.nc"', "output.file: aaaaa"),
    "long folder": (OWN + f'[output]\nfigure = "{"a/" * 10**5}.png"', "output.figure: a/a"),
    "file name with NUL": (OWN + '[output]\nfile = "a\\u0000.nc"', "output.file: a?.nc: cannot be written"),
    "nested exponents": (hamiltonian("[[1, [[2], 0, 0]]]"), "hamiltonian.polynomial: the term [1, [[2]"),
    "a parameter called name": (NAMED.replace("a = 2.0", "a = 2.0, name = 1"), "algebra.parameters.name: no "),
    "a parameter of no system": (body("rigid_body", "body").replace("inertia", "name"), "system: unknown "),
    "a size beyond float64": (
        READY_MADE + f'[sweep]\nsamples = 2\nseed = 1\n[sweep.over]\n"initial.x" = {{sphere = {HEXADECIMAL}}}',
        "sweep.over.initial.x.sphere: must be a positive number",
    ),
    "suffix": (OWN + '[output]\nfile = "a.csv"', "output.file: a.csv: the suffix sets the format"),
    "long line": ("a" * 10**5, "line 1, column 100001: expected '=' after a key"),
    "text that does not end": ('a = """' + "b" * 10**5, "line 1, column 100008: unterminated string"),
}  # fmt: skip


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", CASES)
def test_error_is_one_line_with_file_and_key(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", lambda *args, **kwargs: pytest.fail("it ran"))
    text, message = CASES[name]
    (tmp_path / "run.toml").write_text(text)
    with bounded_work():
        status = cli.main(["run", "run.toml"])
    shown = capsys.readouterr()
    assert (status, shown.out) == (2, "")
    assert shown.err.startswith(f"run.toml: {message}")
    assert shown.err.endswith("\n") and shown.err[:-1].isprintable() and len(shown.err) < 420
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


def test_long_file_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("coadjoint.files.configuration.parsing.MAX_BYTES", 1000)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.toml").write_text("#" * 1001)
    assert cli.main(["run", "run.toml"]) == 2
    assert capsys.readouterr().err == "run.toml: is longer than 1000 bytes; give long ensembles in Python\n"


def test_unusual_names_are_preserved(tmp_path, monkeypatch, capsys):
    # The longest exceeds the length of file names in a Zarr store.
    monkeypatch.chdir(tmp_path)
    names = ["é|x|²", "", "C" * 3000, "C" * 2999 + "D", "a.b/c"]
    casimirs = "\n".join(f'"{name}" = "x1^2 + x2^2 + x3^2"' for name in names)
    text = OWN.replace('"|x|^2" = "x1^2 + x2^2 + x3^2"', casimirs)
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    for target, engine in (("run.nc", "h5netcdf"), ("run.zarr", "zarr")):
        assert cli.main(["run", "run.toml", "--out", target]) == 0
        assert all(len(line) < 200 for line in capsys.readouterr().out.splitlines())
        with xarray.open_dataset(target, engine=engine) as dataset:
            stored = {dataset[name].attrs["long_name"] for name in dataset if name.startswith("casimir")}
            assert stored == set(names)


def test_warnings_are_one_line_each(monkeypatch, capsys):
    def warned(*args):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            for _ in range(2):
                warnings.warn("the scale\nis odd", RuntimeWarning, stacklevel=1)

    monkeypatch.setattr("coadjoint.library_commands._describe", warned)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert cli.main(["methods"]) == 0
    assert capsys.readouterr().err == "coadjoint: warning: the scale is odd\n"
