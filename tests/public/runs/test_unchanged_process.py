"""The library changes nothing in the process that imports it; what a call changes it puts back, however it ends."""

import json
import platform
import sys

import pytest

from core_only import run_python

UPWARD = {"x86_64": 0x800, "aarch64": 0x400000, "arm64": 0x400000}
# Other packages are imported before, since they may change the process themselves.
CHILD = """
import ctypes, decimal, faulthandler, json, locale, os, random, signal, sys, threading, warnings
import flint, numba, numpy as np, scipy.linalg.blas, scipy.sparse.linalg, threadpoolctl

libc, upward, one, tiny = ctypes.CDLL(None), {upward}, 1.0, 2.0**-60
faulthandler.dump_traceback_later(150, exit=True)
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, lambda number, frame: None)
signal.signal(signal.SIGPROF, signal.default_int_handler)
warnings.filterwarnings("ignore", "a message of the user")
warnings.simplefilter("ignore", UserWarning)
locale.setlocale(locale.LC_NUMERIC, "C")
limits = threadpoolctl.threadpool_limits(2)
libc.fesetround(upward)

def state():
    mode, rounded = libc.fegetround(), (one + tiny > one, one - tiny < one)
    libc.fesetround(0)  # what follows is other code
    handlers = [(int(number), signal.getsignal(number)) for number in sorted(signal.valid_signals())]
    found = {{
        "import hooks": [*sys.meta_path, *sys.path_hooks],
        "signal handlers": handlers,
        "signal mask": [*signal.pthread_sigmask(signal.SIG_BLOCK, [])],
        "affinity": sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "rounding mode": (mode, rounded),
        "floating-point errors": np.geterr(),
        "decimals": str(decimal.getcontext()),
        "locale": locale.setlocale(locale.LC_ALL),
        "warnings": [*warnings.filters, warnings.showwarning, warnings.formatwarning],
        "thread pools": sorted((pool["filepath"], pool["num_threads"]) for pool in threadpoolctl.threadpool_info()),
        "hooks": [sys.excepthook, sys.unraisablehook, threading.excepthook, sys.displayhook, sys.gettrace()],
        "random numbers": [hash(random.getstate()), np.random.get_state()[1].sum(), np.random.get_state()[2]],
        "environment": dict(os.environ),
        "folder": os.getcwd(),
    }}
    libc.fesetround(mode)
    return {{name: repr(value) for name, value in found.items()}}

before, found = state(), {{}}

def after(what):
    found[what] = [name for name, value in state().items() if value != before[name]]

import coadjoint as co
for name in dir(co):
    getattr(co, name)
after("the import")
body, x0 = co.systems.rigid_body((1, 2, 3)), (1.0, 0.2, 0.1)
co.integrate(body, np.tile(x0, (64, 1)), (0, 10), 0.01, co.Splitting(), threads=2)
after("an ensemble in threads")
co.integrate(body, x0, (0, 10), accuracy=1e-6)
after("the choice of a scheme")
fluid = co.systems.sphere_euler(N=64)
co.integrate(fluid, fluid.random(seed=1), (0, 0.02), 0.01, threads=2)
after("products of matrices")
H = co.Separable({{0: (lambda x: np.cosh(x), lambda x: np.sinh(x))}})
co.integrate(co.LiePoissonSystem(co.algebras.so(3), H), x0, (0, 1), 0.1, co.Splitting())
after("functions compiled by Numba")
try:
    co.integrate(body, "x0", (0, 1), 0.1)
except (TypeError, ValueError):
    after("a refusal")
try:
    co.integrate(body, (10.0, 20.0, 10.0), (0, 1000), 10.0, co.ExplicitRungeKutta())
except co.IntegrationError:
    after("a failed run")
try:
    signal.setitimer(signal.ITIMER_PROF, 0.5)
    co.integrate(body, x0, (0, 1e8), 0.01, co.Splitting(), save_every=10**4, watch=False)
except KeyboardInterrupt as interrupt:
    points = len(interrupt.partial.t)
    after("an interrupted run")
print(json.dumps([found, points]))
"""


@pytest.mark.sensitive
@pytest.mark.skipif(platform.machine() not in UPWARD or sys.platform == "win32", reason="modes are set through libm")
def test_the_process_is_unchanged():
    done = run_python(CHILD.format(upward=UPWARD[platform.machine()]))
    assert done.returncode == 0, done.stderr
    found, points = json.loads(done.stdout)
    assert {what: changed for what, changed in found.items() if changed} == {} and len(found) == 8
    assert points > 1, "the states until the interrupt are kept"
