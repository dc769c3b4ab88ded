"""What is said of a system is what it is."""

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
def test_what_is_said_is_what_the_system_is(name):
    told, system = summarize_system(name), co.systems.get(name)
    assert json.loads(json.dumps(told)) == told
    assert (told["dimension"], told["sign"]) == (system.dim, system.sign)
    J = system.structure_matrix(np.random.default_rng(8).normal(size=system.dim))
    assert told["rank"] == np.linalg.matrix_rank(J)
    for key, parameter in told["parameters"].items():
        assert parameter["kind"] and parameter["meaning"], f"the docstring of {name} says nothing of {key}"
    assert list(told["casimirs"]) == list(system.casimirs)
    x = np.cos(np.arange(system.dim))
    for key, formula in told["casimirs"].items():
        if formula is not None and not formula.endswith("..."):
            # the coordinates by their names, put back by their numbers, are the Casimir again
            for i in sorted(range(system.dim), key=lambda i: -len(told["coordinates"][i])):
                formula = formula.replace(told["coordinates"][i], f"@{i + 1}@")
            assert parse_polynomial(_numbered(formula), system.dim)(x) == pytest.approx(
                value_of(system.casimirs[key], x), abs=1e-12
            )
    method = suggested_scheme(system)
    assert told["scheme"] == str(method)
    assert method.properties(system).poisson or system.algebra is None
    text = system_text(told)
    assert max(map(len, text.splitlines())) <= 100
    for word in ("algebra", "rank", "casimirs", "begin with", *told["parameters"]):
        assert word in text


def value_of(casimir, x):
    return float(casimir.value(x) if isinstance(casimir, co.Quadratic) else casimir(x))


def _numbered(formula):
    parts = formula.split("@")
    return "".join(f"x{part}" if place % 2 else part for place, part in enumerate(parts))


def test_a_system_without_exact_flows_has_another_scheme():
    def value(x):
        return np.cosh(x[0] + x[1] * x[2])

    def slope(x):
        return np.sinh(x[0] + x[1] * x[2]) * np.array([1.0, x[2], x[1]])

    cosh = co.Hamiltonian(value, slope)
    system = co.LiePoissonSystem(co.algebras.so(3), cosh)
    assert isinstance(suggested_scheme(system), co.GaussLegendre)
    with pytest.raises(TypeError, match="one system"):
        suggested_scheme(co.batch([system]))
