"""Formulas in configuration files, sweeps, datasets and archives."""

import json

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.configuration.loading import load
from coadjoint.files.records.records import record_of, system_of

HEAD = '[algebra]\nname = "e(3)"\n'
BRACKETS = '[algebra]\nbasis = ["m1", "m2", "m3"]\nbrackets = ["[m1, m2] = m3", "[m2, m3] = m1", "[m3, m1] = m2"]\n'
TAIL = "[initial]\nx = [0.1, 0.5, 0.3, 0.2, 0.7, -0.3]\n[run]\nt_span = [0, 1]\nstep = 0.05\n"
FORMULA = "a*x1^2/2 + (x2 + x3)^2/b + cos(x4) + 1/(2 + x5*x6)"


def written(path, hamiltonian, head=HEAD, tail=TAIL):
    path = path / "run.toml"
    path.write_text(f"{head}[hamiltonian]\n{hamiltonian}\n{tail}")
    return path


def of_python(x, a=1.5, b=4):
    return a * x[0] ** 2 / 2 + (x[1] + x[2]) ** 2 / b + np.cos(x[3]) + 1 / (2 + x[4] * x[5])


def test_a_formula_with_parameters(tmp_path):
    run = load(written(tmp_path, f'formula = "{FORMULA}"\nparameters = {{a = 1.5, b = 4}}'))
    assert run.method == co.Splitting()
    system = co.LiePoissonSystem(co.algebras.se(3), of_python)
    sol = run.integrate()
    assert np.abs(sol.x - co.integrate(system, sol.x[0], (0, 1), 0.05).x).max() < 2.0**-46


def test_a_polynomial_in_names_of_the_basis(tmp_path):
    tail = TAIL.replace(", 0.2, 0.7, -0.3", "")
    run = load(written(tmp_path, 'formula = "(m1 + m2)^2/2 + c*m3"\nparameters = {c = 2}', BRACKETS, tail))
    assert run.system.hamiltonian.to_polynomial() == co.Polynomial("1/2*x1^2 + x1*x2 + 1/2*x2^2 + 2*x3", dim=3)
    assert load(written(tmp_path, 'polynomial = "(m1 + m2)^2"', BRACKETS, tail)).system.dim == 3


def test_parameters_are_swept(tmp_path):
    tail = TAIL + '[sweep.over]\n"hamiltonian.parameters.a" = [1.0, 1.5, 2.0]\n'
    sol = load(written(tmp_path, f'formula = "{FORMULA}"\nparameters = {{a = 1.5, b = 4}}', tail=tail)).integrate()
    for member, a in enumerate((1.0, 1.5, 2.0)):
        system = co.LiePoissonSystem(co.algebras.se(3), lambda x, a=a: of_python(x, a))
        alone = co.integrate(system, sol.x[0, member], (0, 1), 0.05)
        assert np.abs(sol.x[:, member] - alone.x).max() < 2.0**-46


@pytest.mark.parametrize(
    ("hamiltonian", "message"),
    [
        ('formula = "x1 + d"', r"hamiltonian\.formula: 'x1 \+ d' has 'd', which is not a known name"),
        ('formula = "cos(x7)"', r"hamiltonian\.formula: .* has the coordinate x7; there are x1 to x6"),
        ('formula = "x1/0"', r"hamiltonian\.formula: 'x1/0' divides by zero"),
        ('formula = "__import__(1)*x1"', r"hamiltonian\.formula: .* has the function '__import__'"),
        ('formula = "x1"\nM = 1.0', r"hamiltonian\.M: is given with formula; include it there"),
        ('formula = "x1"\npolynomial = "x1"', r"hamiltonian\.polynomial: is given with formula"),
        ('polynomial = "cos(x1)"', r"hamiltonian\.polynomial: 'cos\(x1\)' has cos of a coordinate"),
        ("M = 1.0\nparameters = {a = 1}", r"hamiltonian\.parameters: belongs to a formula"),
        ('formula = "x1"\nparameters = {x1 = 1}', r"hamiltonian\.parameters\.x1: .*has the name of a coordinate"),
        ('formula = "a*x1"\nparameters = {a = [1]}', r"hamiltonian\.parameters\.a"),
        ("formula = 1", r"hamiltonian\.formula: must be text in quotes, not 1"),
    ],
)
def test_what_is_refused(hamiltonian, message, tmp_path):
    with pytest.raises(ConfigurationError, match=message) as refused:
        load(written(tmp_path, hamiltonian))
    assert "\n" not in str(refused.value)


SYSTEM = co.LiePoissonSystem(
    co.algebras.se(3), 2 * co.formula(FORMULA, 6, parameters={"a": 1.5, "b": 4}) + co.Quadratic(np.arange(1.0, 7.0))
)
PIECES = co.LiePoissonSystem(
    co.algebras.so(4),
    co.SplitHamiltonian([((0,), "x1^3 + sin(x1)"), ((1, 4), co.formula("cos(p*q)", basis=("p", "q")))]),
)


@pytest.mark.parametrize("system", [SYSTEM, PIECES], ids=["sum", "pieces"])
def test_formulas_are_stored_as_their_text(system, tmp_path):
    x = np.linspace(0.1, 0.6, 6)
    same = system_of(json.loads(json.dumps(record_of(system))))
    np.testing.assert_array_equal(same.vector_field(x), system.vector_field(x))
    assert "not_stored" not in record_of(system)
    sol = co.integrate(system, x, (0, 1), 0.05)
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    loaded = co.load(tmp_path / "run.nc")
    np.testing.assert_array_equal(co.integrate(loaded.system, x, (0, 1), 0.05, loaded.method).x, sol.x)


def test_an_archive_of_a_formula_is_resumed_without_functions(tmp_path):
    x = np.linspace(0.1, 0.6, 6)
    whole = co.integrate(SYSTEM, x, (0, 1), 0.05, archive=tmp_path / "run.zarr")
    again = co.resume(tmp_path / "run.zarr")
    np.testing.assert_array_equal(again.x, whole.x)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("text", "cos(x1"),
        ("text", "__import__('os')"),
        ("text", "x1+" * 100_000 + "x1"),
        ("text", 1),
        ("names", ["x1"]),
        ("parameters", {"a": "1/0"}),
        ("parameters", {"x1": 1.0}),
        ("factors", ["x"]),
        ("dim", 5),
    ],
)
def test_damaged_records_are_refused(key, value):
    record = record_of(co.LiePoissonSystem(co.algebras.se(3), co.formula("a*cos(x1)", 6, parameters={"a": 2})))
    record["hamiltonian"][key] = value
    with pytest.raises(ValueError, match="hamiltonian") as refused:
        system_of(record)
    assert len(str(refused.value)) < 500 and "\n" not in str(refused.value)
