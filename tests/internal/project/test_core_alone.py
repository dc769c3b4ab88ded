"""The package without its extras: core functions work, and others name the package to install."""

import re
import textwrap

import pytest

from coadjoint.optional_packages import EXTRAS
from core_only import run_with_the_core

BODY = """
system = {name = "rigid_body", parameters = {inertia = [1, 2, 3]}}
initial = {x = [1.0, 0.1, 0.5]}
run = {t_span = [0, 1], step = 0.1}
"""
START = """
import numpy as np
import coadjoint as co
body = co.systems.rigid_body(inertia=(1, 2, 3))
x0 = np.array([1.0, 0.2, 0.1])
"""


def printed(code, folder=None):
    """Return the lines that code prints without the extras."""
    done = run_with_the_core(START + textwrap.dedent(code), folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_names_choices_and_exact_algebra():
    code = """
    import importlib.util
    print([name for name in NAMES if importlib.util.find_spec(name)])
    print(sum(getattr(co, name) is not None for name in dir(co)) == len(dir(co)))
    sol = co.integrate(body, x0, (0.0, 10.0), accuracy=1e-9)
    print(np.abs(sol.x[-1] - body.exact(x0, 10.0)).max() < 1e-9, co.choose(body, x0, (0.0, 10.0), 1e-9).step > 0)
    g = co.algebras.so(5)
    print(*g.casimirs(max_degree=4), g.generic_rank(), co.algebras.get("A5,7", a=-0.5, b=-0.25, c=0.5).generic_rank())
    """
    lines = printed(code.replace("NAMES", repr([*EXTRAS, "mpmath", "pytest", "setuptools"])))
    assert lines == ["[]", "True", "True True", "C2 C4 8 2"]


def test_runs_and_steps_of_polynomial_systems():
    code = """
    for method in (co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(12), co.ModifiedGaussLegendre(1),
                   co.ModifiedGaussLegendre(1, freeze="gradient"), co.IteratedGaussLegendre(2),
                   co.ExplicitRungeKutta("rk4"), co.RadauEnergy(2)):
        sol = co.integrate(body, x0, (0.0, 1.0), 0.01, method, observe={"x1": co.Polynomial({(1, 0, 0): 1.0})})
        ready = co.prepare(body, method, 0.01).run(x0, (0.0, 1.0))
        step, x = co.stepper(body, method, 0.01), x0
        for _ in range(100):
            x = step(x)
        near = np.abs(sol.x[-1] - body.exact(x0, 1.0)).max() < 1e-3
        print(near, (sol.x == ready.x).all(), np.abs(x - sol.x[-1]).max() < 1e-12, sol.observed["x1"].shape)
    quartic = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(4, 0, 0): 0.25, (0, 2, 0): 0.5, (0, 0, 2): 1.0}))
    sol = co.integrate([quartic, co.batch([body, co.systems.rigid_body(inertia=(2, 3, 4))])][1],
                       np.array([x0, x0]), (0.0, 1.0), 0.01, attitude=True, threads=2)
    print(sol.attitude.shape, max(co.integrate(quartic, x0, (0.0, 1.0), 0.01).drift().values()) < 1e-2)
    """
    lines = printed(code)
    assert lines[:-1] == ["True True True (101,)"] * 8
    assert lines[-1] == "(101, 2, 3, 3) True"


@pytest.mark.long
def test_ready_made_systems_and_algebras_run():
    """Also with non-polynomial Casimirs, whose formulas are compiled with the kernels."""
    code = """
    for name in co.systems.names():
        system = co.systems.get(name, **({"inertia": (1.0, 2.0, 3.0)} if name == "rigid_body" else {}))
        try:
            coupled = ("double_spherical_pendulum", "point_vortices")
            splits = isinstance(system, co.LiePoissonSystem) and name not in coupled
            method = co.Splitting() if splits else co.GaussLegendre(2)
            x0 = np.linspace(0.5, 1.5, system.dim)
            if "z" in system.casimirs:
                x0[np.argmax(abs(system.casimirs["z"].gradient(x0)))] = 1.0
            if hasattr(system, "from_vector"):
                x0, method = system.algebra.projected(system.from_vector(0.1 * x0)), None
            sol = co.integrate(system, x0, (0.0, 0.1), 0.01, method)
        except ImportError as error:
            # Python functions need an extra to be compiled.
            called = ("bodies", "double_spherical_pendulum", "gravitating_bodies", "rigid_molecules", "satellite")
            called += ("point_vortices", "sklyanin")
            assert name in called and "coadjoint[functions]" in str(error), name
            continue
        assert all(np.isfinite(values).all() for values in sol.casimirs.values()), name
    kinds = set()
    for name, parameters in (("A3,2", {}), ("A3,3", {}), ("A3,7", {"a": 2.0}), ("A5,18", {"p": 1.0})):
        g = co.algebras.get(name, **parameters)
        system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(1.0, 2.0, g.dim)))
        sol = co.integrate(system, np.linspace(0.5, 1.5, g.dim), (0.0, 0.5), 0.01, co.Splitting(order=4))
        kinds |= {type(casimir).__name__ for casimir in system.casimirs.values()}
        worst = max(drift for key, drift in sol.drift().items() if key != "energy")
        print(name, worst < 1e-12)
    print(*sorted(kinds))
    """
    lines = printed(code)
    assert lines == ["A3,2 True", "A3,3 True", "A3,7 True", "A5,18 True", "LogarithmicInvariant"]


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "H = co.Hamiltonian(lambda x: x[0] ** 4, lambda x: np.array([4 * x[0] ** 3, 0.0, 0.0]))\n"
            "s = co.LiePoissonSystem(co.algebras.so(3), H)\n"
            "print(s.energy(x0) == x0[0] ** 4, s.vector_field(x0).shape)\n"
            "co.integrate(s, x0, (0.0, 1.0), 0.1, co.GaussLegendre(1))",
            r'the gradient of the Hamiltonian, a Python function, needs the package numba, .*coadjoint\[functions\]"',
        ),
        (
            "J = lambda x: np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])\n"
            "s = co.PoissonSystem(J, co.Quadratic([1.0, 2.0, 3.0]))\n"
            "co.prepare(s, co.GaussLegendre(1), 0.1).run(x0, (0.0, 1.0))",
            r'the structure matrix, a Python function, needs the package numba, .*coadjoint\[functions\]"',
        ),
        (
            "co.integrate(body, x0, (0.0, 1.0), 0.1, observe={'square': lambda x: x[0] ** 2})",
            r'the value of square, a Python function, needs the package numba, .*coadjoint\[functions\]"',
        ),
        (
            "co.integrate(body, x0, (0.0, 1.0), 0.1).plot()",
            r'drawing a solution needs the package matplotlib, .*coadjoint\[plot\]"',
        ),
        (
            "co.integrate(body, x0, (0.0, 1.0), 0.1).to_xarray()",
            r'a dataset of a solution needs the package xarray, .*coadjoint\[io\]"',
        ),
        (
            "co.integrate(body, x0, (0.0, 1.0), 0.1, progress=True)",
            r'progress=True needs the package tqdm, .*coadjoint\[cli\]"',
        ),
        (
            "from coadjoint.choosing import accuracy\n"
            "accuracy.choose = None\n"
            "co.integrate(body, x0, (0.0, 1.0), accuracy=1e-9, progress=True)",
            r'progress=True needs the package tqdm, .*coadjoint\[cli\]"',
        ),
    ],
    ids=lambda value: value.partition(" needs")[0] if "needs" in value else "",
)  # fmt: skip
def test_missing_package_is_named_with_its_extra(tmp_path, code, message):
    """Nothing has run or been written."""
    watched = (
        "from coadjoint.runs.run import Run\n"
        "from coadjoint.optional_packages import MissingPackageError\n"
        "runs, advance = [], Run.advance\n"
        "Run.advance = lambda self, *given: (runs.append(self), advance(self, *given))[1]\n"
        f"try:\n    exec({code!r})\nexcept MissingPackageError as error:\n    print(error)\n    print(error.name)\n"
        "print(len(runs))"
    )
    (tmp_path / "body.toml").write_text(BODY)
    lines = printed(watched, folder=tmp_path)
    if code.startswith("H = co.Hamiltonian"):
        assert lines.pop(0) == "True (3,)"
    assert re.fullmatch(message, lines[0])
    assert EXTRAS[lines[1]] in message
    assert lines[2] == "0"  # beside the short run of the solution that is plotted
    assert [path.name for path in tmp_path.iterdir()] == ["body.toml"]


def test_command_without_click_has_status_2(tmp_path):
    done = run_with_the_core("from coadjoint.cli import run\nrun()", "systems", folder=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r'coadjoint: .* needs the package click, .*\[cli\]"\n', done.stderr)


def test_own_steps_are_python_calls():
    code = """
    import dataclasses, warnings
    @dataclasses.dataclass(frozen=True)
    class Euler(co.methods.StepMethod):
        order, explicit, symmetric = 1, True, False
        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
        def step(self, system, x, t, h):
            return x + h * system.vector_field(x, t)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        sol = co.integrate(body, np.array([x0, 2 * x0]), (0.0, 10.0), 0.1, Euler())
    print(sol.x.shape, [each.category.__name__ for each in warned])
    print(warned[0].message)
    """
    first, second = printed(code)
    assert first == "(101, 2, 3) ['RuntimeWarning', 'LargeStepWarning']"
    assert "steps of Euler are Python calls" in second and 'pip install "coadjoint[functions]"' in second


def test_runs_of_small_systems_do_not_load_scipy():
    """It takes longer to import than all the rest, and only some systems and analyses need it."""
    code = """
    import sys
    for method in (co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(12)):
        co.integrate(body, np.array([x0, x0]), (0, 1), 0.1, method, attitude=True, threads=2).drift()
    top = co.systems.heavy_top()
    co.integrate(top, np.full(top.dim, 0.3), (0, 1), accuracy=1e-9)
    print(any(name.partition(".")[0] == "scipy" for name in sys.modules))
    co.certify(body, co.Splitting(order=4), x0, step=0.1)
    print("scipy" in sys.modules)
    """
    assert printed(code) == ["False", "True"]
