"""Interrupts during preparation: the call ends, leaves nothing behind, and the next call works.

The child repeats its work until it is interrupted. Python itself ignores an interrupt in callbacks, such as those that
release the locks of imports: the child has imported before what the work needs, and is interrupted again after others.
"""

import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from interrupting import interrupt_after

import coadjoint as co

# A child that receives no signal ends, so that the test fails. Between two works it must not be interrupted.
CHILD = """
import faulthandler, os, signal, sys, threading, warnings
faulthandler.dump_traceback_later(120, exit=True)
warnings.simplefilter("ignore")
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupt = os.getpid(), signal.SIGINT
sys.unraisablehook = lambda ignored: threading.Timer(0.01, os.kill, interrupt).start()
import numpy as np
import coadjoint as co
{setting}
{again}
try:
    print("begun", flush=True)
    while True:
        {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
{again}
print("again", flush=True)
"""
FULL = """
def system(g):
    A = np.random.default_rng(1).normal(size=(g.dim, g.dim))
    return co.LiePoissonSystem(g, co.Quadratic(A + A.T))
"""
FUNCTIONS = """
count = [0]
def energy(k):
    source = f"def value(x): return {k} * np.cosh(x)" + chr(10) + f"def slope(x): return {k} * np.sinh(x)"
    names = {"np": np}
    exec(source, names)
    return names["value"], names["slope"]
def spins(number):
    count[0] += 1
    H = co.Separable({3 * k: energy(count[0] + k / 4096) for k in range(number)})
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), number), H)
def run(number):
    return co.integrate(spins(number), np.tile([0.3, 0.4, -0.2], number), (0, 1), 0.1, co.Splitting())
"""
CASES = {
    "a splitting": (
        FULL + "large, small = system(co.algebras.su(8)), system(co.algebras.su(3))",
        "co.prepare(large, co.Splitting(), 0.1)",
        "assert co.integrate(small, np.ones(8) / 3, (0, 1), 0.1, co.Splitting()).drift()['energy'] < 1.0",
    ),
    "functions": (FUNCTIONS, "run(20)", "assert run(1).x.shape == (11, 3)"),
    "Casimirs": (
        "",
        "co.algebras.su(4).casimirs(3)",
        "assert list(co.algebras.su(3).casimirs(3)) == ['C2', 'C3']",
    ),
}


@pytest.mark.sensitive
@pytest.mark.parametrize("case", CASES)
def test_interrupt_ends_the_preparation(case, tmp_path):
    setting, work, again = CASES[case]
    environment = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1]), "TMPDIR": str(tmp_path)}
    environment["NUMBA_CACHE_DIR"] = str(tmp_path)
    command = [sys.executable, "-c", CHILD.format(setting=setting, work=work, again=again)]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True, env=environment, cwd=tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
        # `communicate` would lose what the pipe has read ahead of a line.
        rest, complaint = process.stdout.read(), process.stderr.read()
    assert (process.returncode, rest, complaint) == (0, "again\n", "")
    assert os.listdir(tmp_path) == []


def cosh_system(factor):
    H = co.Separable({0: (lambda x: factor * np.cosh(x), lambda x: factor * np.sinh(x))})
    return co.LiePoissonSystem(co.algebras.so(3), H)


def test_functions_are_compiled_again_after_an_interrupt():
    """An exception inside Numba would leave its registries incomplete for the rest of the process."""
    x0 = [0.3, 0.4, -0.2]
    co.integrate(cosh_system(1.0 + 2.0**-30), x0, (0, 1), 0.1, co.Splitting())
    for k in range(1, 4):
        system = cosh_system(1.0 + k * 2.0**-30)
        with pytest.raises(KeyboardInterrupt), interrupt_after(0.05 * k):
            for n in range(10**6):
                co.prepare(cosh_system(k + (1 + n) * 2.0**-20), co.Splitting(), 0.1)
        assert co.integrate(system, x0, (0, 1), 0.1, co.Splitting()).x.shape == (11, 3)


def test_functions_are_compiled_in_any_thread():
    system, x0 = cosh_system(1.0 + 2.0**-31), [0.3, 0.4, -0.2]
    with ThreadPoolExecutor(1) as pool:
        there = pool.submit(co.integrate, system, x0, (0, 1), 0.1, co.Splitting()).result()
    assert np.array_equal(there.x, co.integrate(system, x0, (0, 1), 0.1, co.Splitting()).x)
