"""Interrupts during preparation: the call ends, leaves nothing behind, and the next call works.

The child reports when it reaches a point of its work, and repeats the work until it is interrupted. It has imported
before what the work needs: Python itself ignores an interrupt in the callbacks that release the locks of imports.
"""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.functions import callbacks

# A child that receives no signal ends, so that the test fails.
REPORTING = """
import faulthandler, importlib
faulthandler.dump_traceback_later(120, exit=True)
def report(module, name, call):
    module, calls = importlib.import_module(module), []
    original = getattr(module, name)
    def counted(*given, **options):
        calls.append(None)
        if len(calls) == call:
            print("begun", flush=True)
        return original(*given, **options)
    setattr(module, name, counted)
"""
CHILD = (
    REPORTING
    + """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import numpy as np
import coadjoint as co
from coadjoint.long_operations import LongWait
import warnings
warnings.simplefilter("ignore")
{setting}
{again}
report(*{point})
try:
    while True:
        {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
{again}
print("again", flush=True)
"""
)
FULL = """
def system(g):
    A = np.random.default_rng(1).normal(size=(g.dim, g.dim))
    return co.LiePoissonSystem(g, co.Quadratic(A + A.T))
"""
FUNCTIONS = """
def energy(k):
    source = f"def value(x): return {k} * np.cosh(x)" + chr(10) + f"def slope(x): return {k} * np.sinh(x)"
    names = {"np": np}
    exec(source, names)
    return names["value"], names["slope"]
def spins(count):
    H = co.Separable({3 * k: energy(1.0 + k) for k in range(count)})
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), count), H)
def run(count):
    return co.integrate(spins(count), np.tile([0.3, 0.4, -0.2], count), (0, 1), 0.1, co.Splitting())
"""
CASES = {
    "a splitting": (
        FULL + "large, small = system(co.algebras.su(16)), system(co.algebras.su(3))",
        ("coadjoint.program.parts.decompose", "split", 1),
        "co.prepare(large, co.Splitting(), 0.1)",
        "assert co.integrate(small, np.ones(8) / 3, (0, 1), 0.1, co.Splitting()).drift()['energy'] < 1.0",
    ),
    "functions": (
        FUNCTIONS,
        ("coadjoint.kernels.functions.callbacks", "_compiled", 3),
        "run(200)",
        "assert run(3).x.shape == (11, 9)",
    ),
    "Casimirs": (
        "g = co.algebras.su(6)",
        ("coadjoint.algebra.invariants.casimirs", "_of_degree", 2),
        "g.casimirs(3)",
        "assert list(co.algebras.su(3).casimirs(3)) == ['C2', 'C3']",
    ),
}


def child(code, folder):
    environment = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1]), "TMPDIR": str(folder)}
    environment["NUMBA_CACHE_DIR"] = str(folder)
    return subprocess.Popen([sys.executable, "-c", code], stdout=-1, stderr=-1, text=True, env=environment, cwd=folder)


@pytest.mark.sensitive
@pytest.mark.parametrize("case", CASES)
def test_interrupt_ends_the_preparation(case, tmp_path):
    setting, point, work, again = CASES[case]
    with child(CHILD.format(setting=setting, point=point, work=work, again=again), tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
        rest, complaint = process.communicate(timeout=120)
    assert (process.returncode, rest, complaint) == (0, "again\n", "")
    assert os.listdir(tmp_path) == []


def cosh_system(factor):
    H = co.Separable({0: (lambda x: factor * np.cosh(x), lambda x: factor * np.sinh(x))})
    return co.LiePoissonSystem(co.algebras.so(3), H)


def test_interrupt_waits_for_the_compilation_of_a_function(monkeypatch):
    """An exception inside Numba would leave its registries incomplete for the rest of the process."""
    compile_function, completed = callbacks._compiled, []

    def interrupted(*given):
        if not completed:
            signal.raise_signal(signal.SIGINT)
        completed.append(compile_function(*given))
        return completed[-1]

    monkeypatch.setattr(callbacks, "_compiled", interrupted)
    system = cosh_system(1.0 + 2.0**-30)
    with pytest.raises(KeyboardInterrupt):
        co.integrate(system, [0.3, 0.4, -0.2], (0, 1), 0.1, co.Splitting())
    assert len(completed) == 1
    again = co.integrate(system, [0.3, 0.4, -0.2], (0, 1), 0.1, co.Splitting())
    assert len(completed) == 2 and again.x.shape == (11, 3)  # the gradient; the value was compiled before


def test_functions_are_compiled_in_any_thread():
    system, x0 = cosh_system(1.0 + 2.0**-31), [0.3, 0.4, -0.2]
    with ThreadPoolExecutor(1) as pool:
        there = pool.submit(co.integrate, system, x0, (0, 1), 0.1, co.Splitting()).result()
    assert np.array_equal(there.x, co.integrate(system, x0, (0, 1), 0.1, co.Splitting()).x)


FILE = """
[algebra]
name = "su(14)"

[hamiltonian]
M = {M}

[initial]
x = {x}

[method]
name = "Splitting"

[run]
t_span = [0.0, 1.0]
step = 0.1
"""


@pytest.mark.long
def test_command_interrupted_during_preparation(tmp_path):
    n = 14**2 - 1
    A = np.random.default_rng(1).normal(size=(n, n)).round(2)
    Path(tmp_path, "wide.toml").write_text(FILE.format(M=(A + A.T).tolist(), x=[0.05] * n), encoding="utf-8")
    code = "\n".join(
        [
            REPORTING,
            "import sys",
            "from coadjoint.program.parts import decompose",
            "split = decompose.split",
            "decompose.split = lambda *given: [split(*given) for _ in iter(int, 1)]",  # endless
            "report('coadjoint.program.parts.decompose', 'split', 1)",
            "from coadjoint.cli import run",
            "sys.argv = ['coadjoint', 'run', 'wide.toml', '--out', 'wide.zarr']",
            "run()",
        ]
    )
    with child(code, tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        rest, complaint = process.communicate(timeout=120)
    assert (process.returncode, rest, complaint) == (130, "", "coadjoint: interrupted\n")
    assert os.listdir(tmp_path) == ["wide.toml"]
