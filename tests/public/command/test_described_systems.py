"""`coadjoint systems NAME`: what it says of each ready-made system."""

import json

import numpy as np
import pytest

import coadjoint as co
from command import command
from long import long_between


@pytest.mark.thinned(5)
@pytest.mark.parametrize("name", long_between(2, co.systems.names()))
def test_summary_matches_the_system(name, capsys, tmp_path):
    done, system = command(capsys, "systems", name, "--json", tmp_path / "system.json"), co.systems.get(name)
    assert (done.status, done.err) == (0, "")
    summary = json.loads((tmp_path / "system.json").read_text())
    assert (summary["dimension"], summary["sign"]) == (system.dim, system.sign)
    J = system.structure_matrix(np.random.default_rng(8).normal(size=system.dim))
    assert summary["rank"] == np.linalg.matrix_rank(J)
    for key, parameter in summary["parameters"].items():
        assert parameter["kind"] and parameter["meaning"], f"the docstring of {name} does not describe {key}"
    assert list(summary["casimirs"]) == list(system.casimirs)
    x = np.cos(np.arange(system.dim))
    for key, formula in summary["casimirs"].items():
        if formula is not None and not formula.endswith("..."):
            # The formula is parsed back to the Casimir.
            read = co.formula(formula, basis=summary["coordinates"])
            assert read(x) == pytest.approx(value_of(system.casimirs[key], x), abs=1e-12)
    assert summary["scheme"].partition("(")[0] == type(co.prepare(system, step=0.01).method).__name__
    text = command(capsys, "systems", name).out
    assert max(map(len, text.splitlines())) <= 100
    for word in ("algebra", "rank", "casimirs", "begin with", *summary["parameters"]):
        assert word in text


def value_of(casimir, x):
    return float(casimir.value(x) if isinstance(casimir, co.Quadratic) else casimir(x))
