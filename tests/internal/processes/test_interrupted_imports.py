"""Interrupts during imports: the import completes, the interrupt is raised, and the next call works."""

import json
import subprocess
import sys

import pytest

# A package whose modules use each other through their package, as those of Numba and PyYAML do; `tick` is called
# between all statements.
PACKAGE = {
    "__init__": ["from fragile import first", "import fragile.second", "value = fragile.first.a + fragile.second.b"],
    "first": ["import fragile", "a = 1", "import fragile.third"],
    "second": ["import fragile.first", "b = fragile.first.a + fragile.third.c"],
    "third": ["c = 3"],
    "replaced": ["import sys", "import types", "sys.modules[__name__] = types.SimpleNamespace(d=4)"],
}
CALLS = "import fragile; import fragile.replaced as r; found = (fragile.value, fragile.first.a, fragile.third.c, r.d)"
EACH_STATEMENT = f"""
import importlib, json, signal, sys
import coadjoint

CALLS = {CALLS!r}
signal.signal(signal.SIGINT, signal.default_int_handler)

class Ticks:
    count, at, executed = 0, None, []
    def tick(self, name):
        self.executed.append(name)
        self.count += 1
        if self.count == self.at:
            signal.raise_signal(signal.SIGINT)

def outcome(at):
    for name in [name for name in sys.modules if name.startswith("fragile")]:
        del sys.modules[name]
    ticks = sys.modules["ticks"] = Ticks()
    ticks.at, ticks.executed, names = at, [], {{"__name__": "coadjoint.of_a_test"}}
    try:
        exec(CALLS, names)
        interrupted = False
    except KeyboardInterrupt:
        interrupted = True
    again = {{"__name__": "elsewhere"}}
    exec(CALLS, again)
    restored = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return interrupted, again["found"], sorted(ticks.executed), restored

ticks = outcome(None)[2]
print(json.dumps([outcome(at) for at in range(1, len(ticks) + 1)]))
"""


def printed(code, *arguments, cwd=None):
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=cwd)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


@pytest.mark.sensitive
def test_interrupted_imports_leave_complete_modules(tmp_path):
    (tmp_path / "fragile").mkdir()
    for name, statements in PACKAGE.items():
        lines = ["import ticks"]
        for statement in statements:
            lines += ["ticks.tick(__name__)", statement]
        lines.append("" if name == "replaced" else "ticks.tick(__name__)")
        (tmp_path / "fragile" / f"{name}.py").write_text("\n".join(lines))
    count = sum(len(statements) + (name != "replaced") for name, statements in PACKAGE.items())
    found = printed(EACH_STATEMENT, cwd=tmp_path)
    assert len(found) == count
    executed = found[0][2]
    assert len(executed) == count
    # Nothing is executed twice: modules imported before the interrupt stay the same.
    assert found == [[True, [5, 1, 3, 4], executed, True]] * count


OTHER_HANDLERS = """
import json, signal, sys, threading
import coadjoint
from coadjoint.interruption import deferred

heard = []
signal.signal(signal.SIGTERM, lambda number, frame: heard.append((number, frame is not None)))
signal.signal(signal.SIGHUP, signal.SIG_IGN)
with deferred():
    signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGTERM)
    during = list(heard)
ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
signal.raise_signal(signal.SIGTERM)

failed = []
signal.signal(signal.SIGINT, signal.default_int_handler)
code = "import broken"
open("broken.py", "w").write("import signal; signal.raise_signal(signal.SIGINT); import no_such_module")
def load():
    try:
        exec(code, {"__name__": "coadjoint.of_a_test"})
    except BaseException as error:
        failed.append(type(error).__name__)
load()
open("broken.py", "w").write("import no_such_module")
load()
thread = threading.Thread(target=load)
thread.start(), thread.join()
print(json.dumps([during, heard, ignored, failed]))
"""


def test_handlers_are_called_once_after_the_import(tmp_path):
    during, heard, ignored, failed = printed(OTHER_HANDLERS, cwd=tmp_path)
    assert during == [] and ignored
    assert len(heard) == 2 and all(with_frame for _, with_frame in heard)
    assert failed == ["KeyboardInterrupt", "ModuleNotFoundError", "ModuleNotFoundError"]
