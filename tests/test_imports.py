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


@pytest.mark.parametrize("space", ["algebras", "analysis", "forces", "methods", "plotting", "results", "systems"])
def test_namespaces_are_lazy_and_name_what_is_near(space):
    module = getattr(co, space)
    assert all(getattr(module, name) is not None for name in module.__all__)
    assert set(module.__all__) <= set(dir(module))
    name = sorted(module.__all__, key=len)[-1]
    with pytest.raises(AttributeError, match=f"'{name[:-1]}'; did you mean '{name}'"):
        getattr(module, name[:-1])
    assert f"coadjoint.{space}" not in loaded_after("import coadjoint")


def test_a_function_is_not_shadowed_by_its_module():
    """Importing the module `line_drift` leaves the function of that name in `co.analysis`."""
    import coadjoint.analysis.line_drift  # noqa: F401

    assert callable(co.analysis.line_drift) and callable(co.analysis.round_off)


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("Events", "RecordedEvents"),
        ("section", "poincare_section"),
        ("corrector", "make_corrector"),
        ("ensemble", "integrate_ensemble"),
    ],
)
def test_former_names_remain(former, name):
    assert getattr(co, former) is getattr(co, name)
