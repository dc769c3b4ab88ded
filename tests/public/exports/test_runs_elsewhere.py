"""Prepared runs in C on other machines: in WebAssembly and on a microcontroller, with the bits of the library."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from c_compilers import STRICT
from exported_run import assert_same
from long import long_beyond
from random_runs.cases import REFUSALS, some_method, some_systems

HERE = Path(__file__).parent
ZIG = [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined", *STRICT["c"]]
NODE = """
const { WASI } = require("node:wasi"), wasi = new WASI({ version: "preview1" });
WebAssembly.instantiate(require("node:fs").readFileSync(process.argv[2]), wasi.getImportObject())
    .then((found) => wasi.start(found.instance));
"""
SHOW = """
void put_sign(char sign);
static void show(const double *x, int count) {
    for (int i = 0; i < count; ++i) {
        union { double number; uint64_t bits; } both;
        both.number = x[i];
        for (int shift = 60; shift >= 0; shift -= 4) put_sign("0123456789abcdef"[(both.bits >> shift) & 15]);
        put_sign('\\n');
    }
}
"""
TOP = co.systems.heavy_top()
RUNS = (
    (co.systems.rigid_body((1, 2, 2.5)), co.Splitting()),
    (TOP, co.Splitting(order=4, parts="free_body")),
    (TOP, co.ExplicitRungeKutta()),
    (co.systems.lorenz_1960(), co.Splitting()),
    (co.systems.spin_lattice("ring", 12), co.Splitting(parts="bonds")),
)
needs_zig = pytest.mark.skipif(find_spec("ziglang") is None, reason="needs the package ziglang")


def drawn(count, first, folder):
    """Return random runs that can be exported."""
    found, seed = [], first
    while len(found) < count:
        rng, seed = np.random.default_rng(seed), seed + 1
        try:
            (system,), method = some_systems(rng, 1), some_method(rng)
            prepared = co.prepare(system, method, step=float(rng.choice([0.02, 0.1])))
            co.export_c(prepared, folder / "tried.h")
            prepared.end(state_of(prepared), (0.0, 5 * prepared.step))
        except (*REFUSALS, co.IntegrationError):
            continue
        found.append(prepared)
    return found


def state_of(prepared):
    return np.random.default_rng(prepared.system.dim).standard_normal(prepared.system.dim)


def program(seed, folder):
    """Write a program that prints the bits of the ends of fixed and drawn runs of five steps; return both."""
    heads, calls, ends = [], [], []
    fixed = [co.prepare(system, scheme, step=0.05) for system, scheme in RUNS]
    for k, prepared in enumerate([*fixed, *drawn(10, 1000 * seed, folder)]):
        co.export_c(prepared, folder / f"r{k}.h")
        x0 = state_of(prepared)
        ends.append(prepared.end(x0, (0.0, 5 * prepared.step)))
        heads.append(f'#include "r{k}.h"')
        numbers = ", ".join(float(one).hex() for one in x0)
        calls.append(f"{{ double x[] = {{{numbers}}}; r{k}_run(x, R{k}_STEP, 5); show(x, {len(x0)}); }}")
    source = folder / "main.c"
    source.write_text("\n".join([*heads, SHOW, "int main(void) {", *calls, "return 0;", "}", ""]))
    return source, ends


def compiled(command, target):
    done = subprocess.run([*command, "-o", str(target)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return target


def check_output(command, ends):
    """Compare the bits that a program prints; the debugger of a microcontroller prints to the output of errors."""
    given = os.environ | {"NODE_NO_WARNINGS": "1"}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(command, **streams, text=True, check=False, timeout=300, env=given)
    assert re.fullmatch(r"([0-9a-f]{16}\n)+", done.stdout), done.stdout[-1000:]
    found = np.array([int(line, 16) for line in done.stdout.split()], dtype=np.uint64).view(np.float64)
    assert_same(found, np.concatenate(ends))


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning")
@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.parametrize("tool", [pytest.param("zig", marks=[needs_zig, pytest.mark.long]), "emcc"])
@pytest.mark.parametrize("seed", long_beyond(1, range(20)))
def test_webassembly_has_the_bits_of_the_library(tool, seed, tmp_path):
    """Of fixed runs and of drawn ones, ten for each seed."""
    source, ends = program(seed, tmp_path)
    with source.open("a") as file:
        file.write("#include <stdio.h>\nvoid put_sign(char sign) { putchar(sign); }\n")
    command = [*ZIG, "-target", "wasm32-wasi"] if tool == "zig" else ["emcc", *STRICT["c"]]
    if shutil.which(command[0]) is None:
        pytest.skip(f"needs {tool}")
    (tmp_path / "start.js").write_text(NODE)
    module = compiled([*command, "-O2", str(source)], tmp_path / "main.wasm")
    check_output(["node", tmp_path / "start.js", module], ends)


@needs_zig
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning")
@pytest.mark.skipif(shutil.which("qemu-system-arm") is None, reason="needs qemu-system-arm")
@pytest.mark.parametrize("seed", long_beyond(1, range(20)))
def test_a_microcontroller_has_the_bits_of_the_library(seed, tmp_path):
    """A Cortex-M4 without operating system, by qemu."""
    source, ends = program(seed, tmp_path)
    command = [*ZIG, "-Os", "-ffreestanding", "-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4"]
    command += [f"-Wl,-T,{HERE / 'microcontroller.ld'}", str(source), str(HERE / "microcontroller.c")]
    image = compiled(command, tmp_path / "main.elf")
    options = ["-M", "mps2-an386", "-nographic", "-semihosting-config", "enable=on,target=native", "-kernel"]
    check_output(["qemu-system-arm", *options, image], ends)
