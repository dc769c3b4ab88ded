"""The level of kernels: from all features that compilers use, and the registers that the system saves."""

import ctypes
import platform
import subprocess
from pathlib import Path

import pytest
from test_build import COMPILER, needs_levels, needs_tools

from coadjoint.kernels.library import SOURCE, processor_level

pytestmark = [needs_tools, needs_levels]

# Leaf, register and bit of each feature: Intel SDM, volume 2A, CPUID; AMD APM, volume 3, appendix D.
LEVEL_3 = {
    "pni": (1, 2, 0), "ssse3": (1, 2, 9), "fma": (1, 2, 12), "cx16": (1, 2, 13), "sse4_1": (1, 2, 19),
    "sse4_2": (1, 2, 20), "movbe": (1, 2, 22), "popcnt": (1, 2, 23), "osxsave": (1, 2, 27), "avx": (1, 2, 28),
    "f16c": (1, 2, 29), "lahf_lm": (0x80000001, 2, 0), "abm": (0x80000001, 2, 5), "bmi1": (7, 1, 3),
    "avx2": (7, 1, 5), "bmi2": (7, 1, 8),
}  # fmt: skip
LEVEL_4 = {
    "avx512f": (7, 1, 16), "avx512dq": (7, 1, 17), "avx512cd": (7, 1, 28), "avx512bw": (7, 1, 30),
    "avx512vl": (7, 1, 31),
}  # fmt: skip
# Bits of XCR0, volume 1, XSAVE: SSE, AVX; mask registers, and the upper parts and the rest of the vectors of AVX-512.
SAVED_3, SAVED_4 = {1, 2}, {5, 6, 7}
# A processor whose registers are those that a test has written, by leaf and register, and a system that saves some.
CPUID = """
#include <map>
extern "C" std::map<unsigned, unsigned>* written() { static std::map<unsigned, unsigned> all; return &all; }
extern "C" void write_register(unsigned leaf, unsigned k, unsigned value) { (*written())[leaf ^ (k << 8)] = value; }
static int __get_cpuid(unsigned leaf, unsigned* a, unsigned* b, unsigned* c, unsigned* d) {
    unsigned* registers[] = {a, b, c, d};
    for (unsigned k = 0; k < 4; ++k) *registers[k] = (*written())[leaf ^ (k << 8)];
    return 1;
}
static int __get_cpuid_count(unsigned leaf, unsigned, unsigned* a, unsigned* b, unsigned* c, unsigned* d) {
    return __get_cpuid(leaf, a, b, c, d);
}
static unsigned saved = 0;
extern "C" void write_saved(unsigned bits) { saved = bits; }
// In place of the instruction xgetbv.
#define __asm__
#define volatile(...) low = saved, high = 0
"""


@pytest.fixture(scope="module")
def level_with(tmp_path_factory):
    """Return the function that tells the level of a processor with these features, and with these saved registers."""
    folder = tmp_path_factory.mktemp("processor")
    (folder / "cpuid.h").write_text(CPUID)
    library = folder / "processor.so"
    options = ["-std=c++17", "-O1", "-shared", "-fPIC", f"-I{folder}"]
    subprocess.run([str(COMPILER), *options, str(SOURCE / "boundary/processor.cpp"), "-o", str(library)], check=True)
    functions = ctypes.CDLL(str(library))

    def level(features, saved=SAVED_3 | SAVED_4):
        functions.write_saved(ctypes.c_uint(sum(1 << bit for bit in saved)))
        registers = {}
        for leaf, register, bit in features.values():
            registers[leaf, register] = registers.get((leaf, register), 0) | 1 << bit
        for leaf, register, _ in (LEVEL_3 | LEVEL_4).values():
            functions.write_register(
                ctypes.c_uint(leaf), ctypes.c_uint(register), ctypes.c_uint(registers.get((leaf, register), 0))
            )
        return functions.processor_level()

    return level


@pytest.mark.skipif(platform.system() != "Linux", reason="/proc is of Linux")
def test_it_is_what_the_system_says_of_this_machine():
    line = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags"))
    flags = {*line.split()} | {"osxsave"}  # not among the flags; AVX is, if the system saves its registers
    expected = 1 if not flags >= set(LEVEL_3) else 4 if flags >= set(LEVEL_4) else 3
    assert processor_level() == expected


EVERY, SAVED = LEVEL_3 | LEVEL_4, SAVED_3 | SAVED_4


@pytest.mark.parametrize(
    ("features", "saved", "level"),
    [(EVERY, SAVED, 4), (LEVEL_3, SAVED, 3), ({}, SAVED, 1), (EVERY, SAVED_3, 3), (EVERY, set(), 1)]
    + [({k: v for k, v in EVERY.items() if k != name}, SAVED, 1 if name in LEVEL_3 else 3) for name in sorted(EVERY)]
    + [(EVERY, SAVED - {bit}, 1 if bit in SAVED_3 else 3) for bit in sorted(SAVED)],
)
def test_a_level_needs_its_features_and_registers_that_the_system_saves(level_with, features, saved, level):
    """Without such a register, the first instruction that uses it ends the process."""
    assert level_with(features, saved) == level
