"""Summaries of ready-made systems."""

import json

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.formulas import parse_polynomial
from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.runs.system_summary import summarize_system, system_text
from long import long_between


@pytest.mark.thinned(5)
@pytest.mark.parametrize("name", long_between(2, co.systems.names()))
def test_summary_matches_the_system(name):
    summary, system = summarize_system(name), co.systems.get(name)
    assert json.loads(json.dumps(summary)) == summary
    assert (summary["dimension"], summary["sign"]) == (system.dim, system.sign)
    J = system.structure_matrix(np.random.default_rng(8).normal(size=system.dim))
    assert summary["rank"] == np.linalg.matrix_rank(J)
    for key, parameter in summary["parameters"].items():
        assert parameter["kind"] and parameter["meaning"], f"the docstring of {name} does not describe {key}"
    assert list(summary["casimirs"]) == list(system.casimirs)
    x = np.cos(np.arange(system.dim))
    for key, formula in summary["casimirs"].items():
        if formula is not None and not formula.endswith("..."):
            # With numbers in place of the names of the coordinates, the formula is parsed back to the Casimir.
            for i in sorted(range(system.dim), key=lambda i: -len(summary["coordinates"][i])):
                formula = formula.replace(summary["coordinates"][i], f"@{i + 1}@")
            assert parse_polynomial(_numbered(formula), system.dim)(x) == pytest.approx(
                value_of(system.casimirs[key], x), abs=1e-12
            )
    method = suggested_scheme(system)
    assert summary["scheme"] == str(method)
    assert method.properties(system).poisson or system.algebra is None
    text = system_text(summary)
    assert max(map(len, text.splitlines())) <= 100
    for word in ("algebra", "rank", "casimirs", "begin with", *summary["parameters"]):
        assert word in text


def value_of(casimir, x):
    return float(casimir.value(x) if isinstance(casimir, co.Quadratic) else casimir(x))


def _numbered(formula):
    parts = formula.split("@")
    return "".join(f"x{part}" if k % 2 else part for k, part in enumerate(parts))


def test_suggested_scheme_without_exact_flows():
    def value(x):
        return np.cosh(x[0] + x[1] * x[2])

    def slope(x):
        return np.sinh(x[0] + x[1] * x[2]) * np.array([1.0, x[2], x[1]])

    cosh = co.Hamiltonian(value, slope)
    system = co.LiePoissonSystem(co.algebras.so(3), cosh)
    assert isinstance(suggested_scheme(system), co.GaussLegendre)
    with pytest.raises(TypeError, match="one system"):
        suggested_scheme(co.batch([system]))
