"""A typical session emits no warning, also none of deprecated functions of other packages."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from core_only import ENVIRONMENT

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "rigid_body.toml"
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
"""
CHECKOUT = """
import doctest, sys
from importlib.metadata import entry_points
(script,) = entry_points(group="console_scripts", name="coadjoint")
readme, example = {files}
flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
assert not doctest.testfile(readme, module_relative=False, optionflags=flags).failed
for arguments in (
    ["check", example],
    ["run", example, "--out", "body.nc", "--figure", "body.png"],
    ["run", example, "--archive", "body.zarr", "--quiet"],
    ["resume", "body.zarr", "--t-end", "1001"],
    ["systems"],
    ["schema"],
):
    sys.argv = ["coadjoint", *arguments]
    try:
        status = script.load()()
    except SystemExit as ended:
        status = ended.code
    assert not status, arguments
"""


def test_session_without_warnings(tmp_path):
    """A run, its archive, files, a picture, an ensemble, a chosen scheme and a Python function.

    In a checkout also the README, and a configuration file that is checked, and run with a dataset, an archive and a
    picture.
    """
    checkout = CHECKOUT.format(files=(str(ROOT / "README.md"), str(EXAMPLE))) if EXAMPLE.is_file() else ""
    if checkout:  # the README reads a log of the examples, from the folder of the sources
        shutil.copytree(EXAMPLE.parent, tmp_path / "examples", ignore=shutil.ignore_patterns("*.py"))
    process = [sys.executable, "-W", "error", "-c", SESSION + checkout]
    environment = ENVIRONMENT | {"MPLBACKEND": "agg"}
    done = subprocess.run(process, capture_output=True, text=True, timeout=300, cwd=tmp_path, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    written = {"run.zarr", "run.nc", "copy.zarr", "run.png"} | (
        {"body.nc", "body.png", "body.zarr"} if checkout else set()
    )
    assert written <= set(os.listdir(tmp_path))
