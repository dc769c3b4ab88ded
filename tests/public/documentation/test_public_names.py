"""Public names: imports, `dir`, docstrings, type checkers, and errors for unknown names."""

import importlib.util
import os
import pydoc
import re
import subprocess
import sys
import types
from functools import cache
from pathlib import Path

import pytest

import coadjoint as co

ROOT = Path(__file__).parents[3]
SPACES = {"co.systems": co.systems, "co.algebras": co.algebras, "co.methods": co.methods, "co.forces": co.forces}


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_namespaces_list_exactly_the_public_names(space):
    shown = dir(space)
    assert sorted(space.__all__) == sorted(shown)
    for name in shown:
        assert not name.startswith("_")
        assert not isinstance(getattr(space, name), types.ModuleType), name
    assert {"get", "names"} <= set(shown)


def test_solution_attributes_are_listed():
    sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (1, 0.2, 0.1), (0, 1), 0.1)
    parts = {"t", "x", "energy", "casimirs", "attitude", "observed", "stats", "failed", "events", "system", "method"}
    assert parts | {"drift", "at", "plot", "movie", "to_xarray"} <= set(dir(sol))


@pytest.mark.parametrize(
    ("space", "name", "message"),
    [
        ("co.systems", "heavi_top", r"no attribute 'heavi_top'; did you mean 'heavy_top'\?"),
        ("co.systems", "frisbee", r"has no attribute 'frisbee'. It has: .*clebsch_body, .*vlasov_moments"),
        ("co.algebras", "so3", r"did you mean 'so'\? It has: A3_7"),
        ("co.forces", "Damping", r"did you mean 'LinearDamping'\?"),
        ("co.methods", "Splitting", r"has no attribute 'Splitting'; it is co.Splitting$"),
        ("co", "integrat", r"did you mean 'integrate'\? dir\(coadjoint\) lists what it has"),
    ],
)
def test_unknown_names_are_suggested(space, name, message):
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
def test_type_checker_knows_the_public_names(tmp_path):
    file = tmp_path / "user.py"
    file.write_text(USER, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", str(file)]
    paths = {**os.environ, "MYPYPATH": str(ROOT / "src")}
    output = subprocess.run(command, capture_output=True, text=True, env=paths, cwd=ROOT).stdout
    for line, kind in [(5, "ClassicalBody"), (6, "LiePoissonSystem"), (7, "LieAlgebra"), (8, "Torque")]:
        assert any(f":{line}: note: Revealed" in row and f".{kind}" in row for row in output.splitlines()), output
    assert ":10: note: Revealed type is" in output and "ndarray" in output
    for line, name in [(11, "frisbee"), (12, "integrat"), (13, "so3"), (14, "Spliting")]:
        assert f'user.py:{line}: error: Module has no attribute "{name}"' in output, output


# Imports.

HEAVY = (
    *("scipy", "numba", "llvmlite", "xarray", "matplotlib", "pydantic", "click", "tqdm", "zarr", "flint", "h5netcdf"),
    *("jax", "torch"),
)


@cache
def loaded_after(statement):
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import coadjoint",
        "import coadjoint; coadjoint.Splitting(order=4), coadjoint.LieAlgebra, coadjoint.IntegrationError",
        "import coadjoint; coadjoint.LiePoissonSystem(coadjoint.algebras.so(3), coadjoint.Quadratic([1, 2, 3]))",
        "import coadjoint; coadjoint.systems.rigid_body(); coadjoint.algebras.so(4).representation",
    ],
    ids=["package", "names", "system", "ready-made"],
)
def test_import_loads_no_heavy_packages(statement):
    loaded = loaded_after(statement)
    assert "coadjoint" in loaded
    assert sorted(name for name in HEAVY if name in loaded) == []


def test_help_of_the_package_is_two_screens():
    text = pydoc.render_doc(co)
    assert len(text.splitlines()) < 100
    assert set(re.findall(r"`(\w+)`", co.__doc__)) <= set(dir(co))


@pytest.mark.parametrize(
    "space",
    "algebras analysis attitudes bodies forces jax methods orbits plotting results spectra systems torch".split(),
)
def test_namespaces_are_lazy_and_name_what_is_near(space):
    module = getattr(co, space)
    assert all(getattr(module, name) is not None for name in module.__all__)
    assert set(module.__all__) <= set(dir(module))
    name = sorted(module.__all__, key=len)[-1]
    with pytest.raises(AttributeError, match=f"'{name[:-1]}'; did you mean '{name}'"):
        getattr(module, name[:-1])
    assert f"coadjoint.{space}" not in loaded_after("import coadjoint")


def test_a_function_is_not_shadowed_by_its_module():
    """Loading the module `phase_error` leaves the function of that name in `co.analysis`."""
    assert "coadjoint.analysis.phase_error" in loaded_after("import coadjoint; coadjoint.analysis.phase_error")
    assert callable(co.analysis.phase_error) and callable(co.analysis.round_off)
