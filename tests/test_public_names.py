"""What `dir` lists, what type checkers and editors know, and what is said of a name that is not there."""

import importlib.util
import os
import subprocess
import sys
import types
from pathlib import Path

import pytest

import coadjoint as co

ROOT = Path(__file__).parents[1]
SPACES = {"co.systems": co.systems, "co.algebras": co.algebras, "co.methods": co.methods, "co.forces": co.forces}


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_namespaces_show_what_is_public_and_nothing_else(space):
    shown = dir(space)
    assert sorted(space.__all__) == sorted(shown)
    for name in shown:
        assert not name.startswith("_")
        assert not isinstance(getattr(space, name), types.ModuleType), name
    assert {"get", "names"} <= set(shown)


def test_everything_of_a_solution_is_listed_from_the_start():
    sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (1, 0.2, 0.1), (0, 1), 0.1)
    parts = {"t", "x", "energy", "casimirs", "attitude", "observed", "stats", "failed", "events", "system", "method"}
    assert parts | {"drift", "at", "plot", "movie", "to_xarray"} <= set(dir(sol))


@pytest.mark.parametrize(
    ("space", "name", "message"),
    [
        (
            "co.systems",
            "heavi_top",
            r"co.systems has no attribute 'heavi_top'; did you mean 'heavy_top'\? It has: cleb",
        ),
        ("co.systems", "frisbee", r"has no attribute 'frisbee'. It has: clebsch_body, .*vlasov_moments"),
        ("co.algebras", "so3", r"did you mean 'so'\? It has: A3_7"),
        ("co.forces", "Damping", r"did you mean 'LinearDamping'\?"),
        ("co.methods", "Splitting", r"has no attribute 'Splitting'; it is co.Splitting$"),
        ("co", "integrat", r"did you mean 'integrate'\? dir\(coadjoint\) lists what it has"),
    ],
)
def test_a_name_that_is_not_there(space, name, message):
    with pytest.raises(AttributeError, match=message):
        getattr({**SPACES, "co": co}[space], name)
    assert not hasattr(co.systems, "__wrapped__")


USER = """
import coadjoint as co

body = co.systems.rigid_body(inertia=(1, 2, 3))
reveal_type(body)
reveal_type(co.systems.toda(5))
reveal_type(co.algebras.so(3))
reveal_type(co.forces.Torque((0, 0, 1)))
sol = co.integrate(body, (1, 0.2, 0.1), (0, 1), 0.1, co.Splitting(order=4))
reveal_type(sol.energy)
co.systems.frisbee
co.integrat
co.algebras.so3
co.methods.Spliting
"""


@pytest.mark.long
@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
def test_a_type_checker_knows_every_name_and_no_other(tmp_path):
    file = tmp_path / "user.py"
    file.write_text(USER, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", str(file)]
    paths = {**os.environ, "MYPYPATH": str(ROOT / "src")}
    message = subprocess.run(command, capture_output=True, text=True, env=paths, cwd=ROOT).stdout
    for line, kind in [(5, "LiePoissonSystem"), (6, "LiePoissonSystem"), (7, "LieAlgebra"), (8, "Torque")]:
        assert any(f":{line}: note: Revealed" in row and f".{kind}" in row for row in message.splitlines()), message
    assert ":10: note: Revealed type is" in message and "ndarray" in message
    for line, name in [(11, "frisbee"), (12, "integrat"), (13, "so3"), (14, "Spliting")]:
        assert f'user.py:{line}: error: Module has no attribute "{name}"' in message, message
