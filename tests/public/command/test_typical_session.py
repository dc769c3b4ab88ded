"""A typical session emits no warning, also none of deprecated functions of other packages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from core_only import ENVIRONMENT

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "rigid_body.toml"
README = """
import doctest, sys, warnings
import coadjoint as co
warnings.filterwarnings("ignore", category=co.LongWait)  # of a busy machine
flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
print(doctest.testfile(sys.argv[1], module_relative=False, optionflags=flags).failed)
"""

SESSION = """
import warnings
import numpy as np
import coadjoint as co
warnings.filterwarnings("ignore", category=co.LongWait)  # of a busy machine
body = co.systems.rigid_body(inertia=(1, 2, 3))
x0 = (0.01, 1.0, 0.01)
sol = co.integrate(body, x0, (0, 90), 0.05, co.Splitting(order=4), attitude=True)
assert sol.drift()["energy"] < 1e-8
co.integrate(body, x0, (0, 20), 0.05, co.Splitting(order=4), archive="run.zarr")
assert co.resume("run.zarr", t_end=40).t[-1] == 40
assert (co.load("run.zarr").x == sol.x[:801]).all()
sol.to_xarray().to_netcdf("run.nc", engine="h5netcdf")
sol.to_xarray().to_zarr("copy.zarr", zarr_format=2)
assert (co.load("run.nc").x == sol.x).all() and (co.load("copy.zarr").x == sol.x).all()
sol.plot().savefig("run.png")
members = co.integrate(body, np.outer(np.linspace(0.5, 1.0, 8), x0), (0, 1), 0.05, co.Taylor(12), threads=2)
co.integrate(body, x0, (0, 10), accuracy=1e-9)
co.integrate(co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda x: x[0] ** 4 + x[1] ** 2)), x0, (0, 1), 0.1,
    co.GaussLegendre(2))
assert co.certify(body, co.GaussLegendre(2), (0.3, 1.0, 0.2), step=0.1).passed
print("done")
"""


def strictly(folder, *arguments):
    """Run Python with warnings as errors; return what it printed."""
    command = [sys.executable, "-W", "error", *map(str, arguments)]
    environment = ENVIRONMENT | {"MPLBACKEND": "agg"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=folder, env=environment)
    assert (done.returncode, done.stderr) == (0, ""), arguments
    return done.stdout


def test_session_without_warnings(tmp_path):
    """A run, its archive, files, a picture, an ensemble, a chosen scheme, a Python function and a certificate."""
    assert strictly(tmp_path, "-c", SESSION) == "done\n"
    assert {"run.zarr", "run.nc", "copy.zarr", "run.png"} <= set(os.listdir(tmp_path))


@pytest.mark.skipif(not EXAMPLE.is_file(), reason="not a checkout")
def test_readme_without_warnings(tmp_path):
    assert strictly(tmp_path, "-c", README, ROOT / "README.md") == "0\n"


@pytest.mark.skipif(not EXAMPLE.is_file(), reason="not a checkout")
def test_commands_without_warnings(tmp_path):
    """A configuration file that is checked, run with a dataset, an archive and a picture, and certified."""
    for arguments in (
        ("check", EXAMPLE),
        ("run", EXAMPLE, "--out", "run.nc", "--figure", "run.png"),
        ("run", EXAMPLE, "--archive", "run.zarr", "--quiet"),
        ("resume", "run.zarr", "--t-end", "1001"),
        ("certify", EXAMPLE),
        ("systems",),
        ("schema",),
    ):
        strictly(tmp_path, "-m", "coadjoint", *arguments)
    assert {"run.nc", "run.png", "run.zarr"} <= set(os.listdir(tmp_path))
