"""The C interface of the compiled library: the bits of runs and derivatives, failures, and hostile tables."""

import json
import random
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from c_compilers import compiled, compilers
from exported_run import assert_same
from exported_table import Failed, Interface, exported_library
from long import long_beyond
from random_runs.cases import REFUSALS, some_method, some_systems
from rounding import UNIT_ROUNDOFF

ROOT = Path(__file__).parents[3]
SOURCE = ROOT / "src" / "coadjoint" / "kernels" / "source"
TOP = co.systems.heavy_top()
FULL = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1, 0.2, 0.1], [0.2, 2, 0.3], [0.1, 0.3, 3]]))
QUARTIC = co.LiePoissonSystem(
    co.algebras.heisenberg(2), co.Polynomial({(2, 0, 0, 0, 0): 0.5, (4, 1, 0, 0, 0): 0.1, (0, 0, 0, 4, 0): 1.0})
)
CASES = {
    "free bodies": (TOP, co.Splitting(order=4, parts="free_body")),
    "bonds": (co.systems.spin_lattice("ring", 12), co.Splitting(parts="bonds")),
    "rotations of a lattice": (co.systems.spin_lattice("square", (20, 20)), co.Splitting()),
    "compensated sums": (TOP, co.Splitting(order=4, compensated=True)),
    "rational rotations": (TOP, co.Splitting(rotation="rational")),
    "cubic blocks": (FULL, co.Splitting(order=4)),
    "monomials": (QUARTIC, co.Splitting(order=4)),
    "series": (co.LiePoissonSystem(co.algebras.get("gl(n)", n=3), co.Quadratic(np.eye(9) + 0.1)), co.Splitting()),
    "growth": (co.systems.lorenz_1960(), co.Splitting()),
    "a state at rest": (co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.ones(6))), co.Splitting()),  # no parts
    "a composition": (TOP, co.Composition(co.Splitting(), (0.25, 0.5, 0.25))),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return exported_library(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module")
def interface(library):
    return Interface(library)


def table_of(prepared, folder):
    return co.export_table(prepared, folder / "run.json").read_text()


@contextmanager
def overflowing_as_the_library(call):
    """Where a derivative of the library overflows, so does that of the interface."""
    try:
        yield
    except co.IntegrationError:
        with pytest.raises(Failed, match="derivative is not finite"):
            call()
        raise


def check_interface(interface, prepared, folder, steps=12, sign=1.0):
    """Compare the bits of all states however the steps are divided, and of derivatives; and gradients."""
    table, h = table_of(prepared, folder), sign * prepared.step
    run = interface.run(table.replace(f'"step": {prepared.step!r}', f'"step": {h!r}'))
    x0 = np.random.default_rng(steps).standard_normal(prepared.system.dim)
    sol = prepared.run(x0, (0.0, steps * h))
    run.x = x0
    assert_same(run.x, x0)
    assert_same(run.save(steps), sol.x[1:])
    run.x = x0
    run.call("step")
    run.call("advance", 0)
    assert_same(run.save(2, 3), sol.x[[4, 7]])
    run.call("advance", steps - 7)
    assert_same(run.x, sol.x[-1])
    assert (run.call("steps"), run.call("size"), run.call("step_length")) == (steps, len(x0), h)
    v = np.random.default_rng(2).standard_normal((3, len(x0)))
    with overflowing_as_the_library(lambda: run.jvp(x0, steps, v)):
        _, tangents = prepared.jvp(x0, (0.0, steps * h), {"x0": v.T})
    end, moved = run.jvp(x0, steps, v)
    assert_same(end, sol.x[-1])
    assert_same(moved, tangents.x[-1].T)
    covector, weights = np.linspace(-1.0, 1.0, len(x0)), np.zeros(sol.x.shape)
    weights[-1] = covector
    with overflowing_as_the_library(lambda: run.vjp(x0, steps, covector)):
        gradient = prepared.vjp(x0, (0.0, steps * h))[1](x=weights)["x0"]
    assert_gradients_agree(prepared, run, sol, covector, gradient)


def assert_gradients_agree(prepared, run, sol, covector, gradient):
    """To rounding: the library finds those by the parameters in the same sweep, with other sums.

    Each step rounds some hundred times, relative to its gradient, and the steps before it carry this error.
    """
    _, tangents = prepared.jvp(sol.x[0], (sol.t[0], sol.t[-1]), {"x0": np.eye(sol.x.shape[1])})
    steps = len(sol.t) - 1
    later = [np.abs(run.vjp(sol.x[k], steps - k, covector)).sum() for k in range(steps)]
    size = max(a * b for a, b in zip(later, np.abs(tangents.x).max(axis=(1, 2)), strict=False))
    error = np.abs(run.vjp(sol.x[0], steps, covector) - gradient).max()
    assert error <= 128 * steps * UNIT_ROUNDOFF * size


@pytest.mark.parametrize("name", CASES)
@pytest.mark.thinned(4)
def test_runs_have_the_bits_of_the_library(name, interface, tmp_path):
    system, scheme = CASES[name]
    prepared = co.prepare(system, scheme, step=0.05)
    check_interface(interface, prepared, tmp_path)
    check_interface(interface, prepared, tmp_path, 8, sign=-1.0)


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning")
@pytest.mark.thinned(1)
@pytest.mark.parametrize("seed", long_beyond(5, range(200)))
def test_drawn_runs_have_the_bits_of_the_library(seed, interface, tmp_path):
    rng = np.random.default_rng(seed)
    while True:
        try:
            (system,), method = some_systems(rng, 1), some_method(rng)
            prepared = co.prepare(system, method, step=float(rng.choice([0.02, 0.1])))
            table_of(prepared, tmp_path)
            check_interface(interface, prepared, tmp_path)
            return
        except (*REFUSALS, co.IntegrationError):
            continue


def test_runs_in_threads_have_their_own_state(interface, tmp_path):
    prepared = co.prepare(TOP, co.Splitting(order=4), step=0.05)
    table, starts = table_of(prepared, tmp_path), np.random.default_rng(1).standard_normal((8, 6))

    def end(x0):
        run = interface.run(table)
        run.x = x0
        for _ in range(200):
            run.call("step")
        return run.x

    with ThreadPoolExecutor(4) as pool:
        for x0, found in zip(starts, pool.map(end, starts), strict=True):
            assert_same(found, prepared.end(x0, (0.0, 10.0)))


def test_numbers_of_tables_are_rounded_once(interface, tmp_path):
    """Of any size, subnormal, between two others, and with up to 19 digits."""
    table = table_of(co.prepare(TOP, co.Splitting(), step=0.05), tmp_path)
    drawn = random.Random(1)
    numbers = [f"{drawn.randint(1, 10**19 - 1)}e{drawn.randint(-340, 289)}" for _ in range(2000)]
    numbers += [repr(drawn.uniform(0, 1) * 10.0 ** drawn.randint(-307, 307)) for _ in range(1000)]
    numbers += ["5e-324", "2.4703282292062328e-324", "1.7976931348623157e308", "-9007199254740993", "0.1", "1E+2"]
    numbers += ["9007199254740993e0", "9007199254740995", "4503599627370497.5", "2.2250738585072011e-308"]
    for number in numbers:
        found = interface.run(table.replace('"step": 0.05', f'"step": {number}')).call("step_length")
        assert found == float(number), number


def test_failed_runs_wait_for_a_state(interface, tmp_path):
    prepared = co.prepare(QUARTIC, co.Splitting(), step=10.0)
    run = interface.run(table_of(prepared, tmp_path))
    run.x = np.full(5, 1e200)
    for name, arguments in {"advance": (20,), "step": (), "get_state": (np.zeros(5), 5)}.items():
        with pytest.raises(Failed, match="finite" if name == "advance" else "before") as failed:
            run.call(name, *arguments)
        assert failed.value.args[0] == 4
    run.x = np.zeros(5)
    run.call("step")
    assert np.all(run.x == 0.0) and run.call("steps") == 1


def test_wrong_arguments_are_refused(interface, tmp_path):
    run, x = interface.run(table_of(co.prepare(TOP, step=0.1), tmp_path)), np.zeros(6)
    for name, *arguments in (
        ("set_state", x, 5), ("set_state", None, 6), ("get_state", x, 7), ("get_state", None, 6),
        ("set_state", np.full(6, np.nan), 6), ("advance", -1), ("advance", 2**62), ("save", 2, 1, x, 11),
        ("save", -1, 1, x, 6), ("save", 1, 0, x, 6), ("save", 1, 1, None, 6), ("jvp", 0, x, x, 1),
        ("jvp", 1, x, None, 1), ("jvp", 1, x, x, 2**63), ("vjp", 1, None, x), ("vjp", 2**50, x, x),
    ):  # fmt: skip
        with pytest.raises(Failed) as failed:
            run.call(name, *arguments)
        assert failed.value.args[0] == 1 and failed.value.args[1], name
    with pytest.raises(Failed, match="null"):
        interface.call("step", None)
    assert (interface.call("size", None), interface.call("steps", None)) == (0, 0)
    interface.call("destroy", None)


def changed(**given):
    return lambda table: table | given


def without(name):
    return lambda table: {key: value for key, value in table.items() if key != name}


def inside(name, **given):
    return lambda table: table | {name: table[name] | given}


WRONG_TABLES = {
    "a later version": (changed(version=4), "version"),
    "functions of the user": (changed(functions=[0]), "functions"),
    "no name": (without("weight"), "weight"),
    "a text for numbers": (changed(weight="none"), "weight"),
    "no dimension": (changed(dim=0), "dim"),
    "a huge dimension": (changed(dim=2**40), "dim"),
    "a fraction of a column": (changed(column=[0.5, 1, 2]), "column"),
    "a column outside": (changed(column=[0, 1, 6]), "column"),
    "too few weights": (changed(weight=[1.0]), "weight"),
    "rows that descend": (changed(entry=[0, 2, 1, 3, 3, 3, 3, 3]), "entry"),
    "a part outside": (changed(part=[0, 1, 0, 1, 7]), "part"),
    "a section outside": (changed(section=[0, 2, 4, 9]), "section"),
    "a step of zero": (changed(step=0.0), "step"),
    "a body outside": (changed(bodies=[9]), "bodies"),
    "a body of one angle": (changed(bodies=[1]), "bodies"),
    "a coordinate outside": (inside("state_action", indices=[99] * 28), "state_action.indices"),
    "too few indices": (inside("dual_action", indices=[0]), "dual_action.indices"),
    "too few constants": (inside("state_action", constants=[1.0]), "state_action.constants"),
    "an unknown kind": (inside("state_action", kind=[6] * 7), "state_action.kind"),
    "an angle outside": (inside("state_action", angle=[0, 1, 2, 9, 0, 1, 2]), "state_action.angles"),
    "an infinite exponent": (changed(term_kind=[0, 1, 0, 0], exponent=[2**31]), "exponent"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_TABLES)
def test_wrong_tables_are_refused(name, interface, tmp_path):
    table = json.loads(table_of(co.prepare(TOP, co.Splitting(parts="free_body"), step=0.1), tmp_path))
    change, named = WRONG_TABLES[name]
    interface.run(json.dumps(table))
    with pytest.raises(Failed, match=named) as failed:
        interface.run(json.dumps(change(table)))
    assert failed.value.args[0] == 2


@pytest.mark.parametrize(
    "text",
    ["", "[1]", "{", '{"a": }', '{"a": 1', '{"a": NaN}', '{"a": 1e999}', '{"a": 12345678901234567890}', '{"a": 1} 2']
    + ['{"a": 1, "a": 2}', '{"a": ' + "[" * 5000, '{"a": "\\', '{"a" 1}', '{"a": [1, ]}', '{"a": -}', '{"a": 1e}'],
)  # fmt: skip
def test_texts_that_are_no_table_are_refused(text, interface):
    with pytest.raises(Failed, match="byte") as failed:
        interface.run(text)
    assert failed.value.args[0] == 2


@pytest.mark.long
@pytest.mark.skipif("gcc" not in compilers(), reason="needs GCC")
def test_mutated_tables_do_no_harm(tmp_path):
    """With the sanitizers of addresses and undefined behaviour, over every kind of flow."""
    tables = []
    for k, (system, scheme) in enumerate(CASES.values()):
        if system.dim < 100:
            tables.append(co.export_table(co.prepare(system, scheme, step=0.05), tmp_path / f"{k}.json"))
    names = ["interface/*", "flows/flow", "flows/compiled_rows", "flows/part_properties", "recording/watching"]
    names += ["boundary/interrupts", "tangents/flow_directions", "tangents/flow_cotangents", "tangents/flow_tangents"]
    names += ["field/field", "numbers/elementary", "recording/crossings"]
    sources = [source for name in names for source in SOURCE.glob(f"{name}.cpp")]
    command = ["g++", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O1", "-g1", "-w", "-std=c++17"]
    command += [
        "-ffp-contract=off",
        "-fno-math-errno",
        "-DCOADJOINT_UNROLLED=2",
        f"-I{SOURCE}",
        f"-I{SOURCE / 'interface'}",
    ]
    command += ["-o", str(tmp_path / "fuzz"), "-pthread"]
    subprocess.run([*command, ROOT / "tests" / "fuzz_tables.cpp", *sources], check=True)
    command = [tmp_path / "fuzz", "1", "20000", *tables]
    settings = {"ASAN_OPTIONS": "allocator_may_return_null=1"}
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    accepted, wrong, finished = map(int, done.stdout.split())
    assert min(accepted, wrong) > 4000 and finished > 2000


def example(folder, library):
    """Write the files of the page to a folder, and return its programs and the output."""
    page = (ROOT / "docs" / "other_languages.md").read_text(encoding="utf-8")
    texts = {kind: re.search(rf"```{kind}\n(.*?)```", page, re.DOTALL)[1] for kind in ("toml", "sh", "text")}
    (folder / "top.toml").write_text(texts["toml"])
    for line in texts["sh"].splitlines():
        subprocess.run([sys.executable, "-m", *line.split()], cwd=folder, check=True, capture_output=True)
    assert (folder / library.name).read_bytes() == library.read_bytes()
    return texts


@pytest.mark.parametrize("compiler", long_beyond(1, compilers()))
@pytest.mark.parametrize("language", ["c", "c++"])
def test_the_example_in_c(compiler, language, library, tmp_path):
    texts = example(tmp_path, library)
    (tmp_path / "spin.c").write_text((ROOT / "examples" / "spin.c").read_text())
    given = {"language": language, "libraries": (f"-L{tmp_path}", "-lcoadjoint", f"-Wl,-rpath,{tmp_path}")}
    program = compiled(compiler, tmp_path / "spin.c", tmp_path / "spin", "-O2", **given)
    done = subprocess.run([program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == texts["text"]


@pytest.mark.skipif(shutil.which("rustc") is None, reason="needs rustc")
def test_the_example_in_rust(library, tmp_path):
    texts = example(tmp_path, library)
    (tmp_path / "spin.rs").write_text((ROOT / "examples" / "spin.rs").read_text())
    command = ["rustc", "-O", "spin.rs", "-L", ".", "-C", f"link-arg=-Wl,-rpath,{tmp_path}"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "spin"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert list(map(float, done.stdout.split())) == list(map(float, texts["text"].split()[:2]))
