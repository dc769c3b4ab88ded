"""Examples of `docs/own_schemes.md` beside its doctests: a scheme in C++, and a package of schemes."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co

PAGE = (Path(__file__).parents[3] / "docs" / "own_schemes.md").read_text(encoding="utf-8")
EXAMPLES = Path(__file__).parents[3] / "examples"
SOURCE = Path(co.__file__).parents[1]
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (1.0, 0.2, 0.5)
SCHEME = '''
import dataclasses

import coadjoint as co


@dataclasses.dataclass(frozen=True)
class {name}(co.methods.StepMethod):
    """A scheme of another package."""

    part: float = 1.0

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + self.part * h * system.vector_field(x, t)
'''
RUN = """
[system]
name = "rigid_body"

[initial]
x = [1.0, 0.2, 0.5]

[method]
name = "Kutta3"
part = 0.5

[run]
t_span = [0, 1]
step = 0.1

[output]
file = "out.nc"
"""


def module_of(scheme, monkeypatch):
    """Return the module of a scheme in C++ of `examples/`."""
    name = scheme.lower()
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, name, module)
    specification.loader.exec_module(module)
    return module


DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Hamiltonian(lambda x, t: x[0] * np.cos(t), lambda x, t: np.array([np.cos(t), 0.0, 0.0])),
)


def in_python(method, system):
    """Return 40 steps of the version of a scheme in Python."""
    x = np.array(X0)
    for k in range(40):
        x = method.step(system, x, 0.05 * k, 0.05)
    return x


@pytest.mark.long
@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler is installed")
def test_schemes_in_cpp_are_those_in_python(tmp_path, monkeypatch):
    """The implicit one is a Gauss method; the explicit one has the order 2."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    Gauss, Heun = (getattr(module_of(name, monkeypatch), name) for name in ("Gauss", "Heun"))
    for method in (Gauss(1), Gauss(2), Heun(1.0), Heun(0.5), Heun(2 / 3)):
        for system in (BODY, DRIVEN):
            sol, fine = (co.integrate(system, X0, (0, 2), h, method) for h in (0.05, 0.025))
            assert np.max(np.abs(sol.x[-1] - in_python(method, system))) < 40 * 40 * 2.0**-53
            if isinstance(method, Gauss):
                reference = co.integrate(system, X0, (0, 2), 0.05, co.GaussLegendre(method.stages))
                assert np.max(np.abs(sol.x - reference.x)) < 40 * 8 * 2.0**-53 and sol.drift()["|x|^2"] < 1e-14
            elif system is BODY:
                errors = [np.max(np.abs(run.x[-1] - BODY.exact(X0, 2.0))) for run in (sol, fine)]
                assert 1.7 < np.log2(errors[0] / errors[1]) < 2.3 and sol.stats.evaluations == 80
    stepper = co.stepper(BODY, Heun(0.75), 0.1)
    assert stepper.tangent_by(X0) == "complex step" and stepper.tangent(X0).shape == (3, 3)
    with pytest.raises(co.IntegrationError):
        co.integrate(BODY, X0, (0, 100), 50.0, Gauss())


@pytest.fixture
def installed(tmp_path):
    """Return a folder with the installed package of the page, and a broken package."""
    project = tomllib.loads(re.search(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1])["project"]
    (point,) = project["entry-points"]["coadjoint.methods"].items()
    broken = "Missing = no_such_module_anywhere:Missing\n"
    for name, points in ((project["name"], f"{point[0]} = {point[1]}\n"), ("broken", broken)):
        metadata = tmp_path / f"{name.replace('-', '_')}-0.1.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n")
        (metadata / "entry_points.txt").write_text(f"[coadjoint.methods]\n{points}")
    module, name = point[1].split(":")
    (tmp_path / f"{module}.py").write_text(SCHEME.format(name=name))
    (tmp_path / "run.toml").write_text(RUN)
    return tmp_path


def run_python(folder, *command):
    paths = os.pathsep.join([str(folder), str(SOURCE)])
    env = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, cwd=folder, env=env, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.mark.long
def test_installed_package_registers_schemes(installed):
    listed, warned = run_python(installed, "-m", "coadjoint", "methods")
    assert "Kutta3(part=1.0)\n    A scheme of another package." in listed
    assert "the scheme Missing (no_such_module_anywhere:Missing) is skipped" in warned
    run_python(installed, "-m", "coadjoint", "run", "run.toml")
    again = (
        "import json, xarray, coadjoint as co; "
        "dataset = xarray.open_dataset('out.nc', engine='h5netcdf'); sol = co.results.rebuild(dataset); "
        "print(json.dumps([repr(sol.method), bool((sol.x == dataset['x'].values).all())]))"
    )
    assert json.loads(run_python(installed, "-W", "ignore", "-c", again)[0]) == ["Kutta3(part=0.5)", True]
