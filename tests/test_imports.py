"""Importing the package is light, and every public name arrives when it is used."""

import subprocess
import sys

import pytest

import coadjoint as co

HEAVY = ("scipy", "numba", "llvmlite", "xarray", "matplotlib", "pydantic", "click", "tqdm", "zarr", "flint", "h5netcdf")


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
    ],
    ids=["package", "names", "system"],
)
def test_importing_loads_numpy_and_nothing_heavy(statement):
    loaded = loaded_after(statement)
    assert "coadjoint" in loaded
    assert sorted(name for name in HEAVY if name in loaded) == []


def test_every_public_name_exists():
    for name in co.__all__:
        assert getattr(co, name) is not None
    assert set(co.__all__) <= set(dir(co))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Spliting'"):
        _ = co.Spliting
