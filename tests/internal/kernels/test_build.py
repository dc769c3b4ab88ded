"""The build of the compiled kernels: what it refuses, what it compiles again, and what its libraries export."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from coadjoint.kernels.library import compiler_options, level_options, levels, processor_level
from long import long_beyond

ROOT = Path(__file__).parents[3]
SOURCES = "src/coadjoint/kernels/source"
# The packages cmake and ninja stand beside the interpreter.
PLACES = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
CMAKE, NINJA, COMPILER = (shutil.which(tool, path=PLACES) for tool in ("cmake", "ninja", "c++"))
needs_tools = pytest.mark.skipif(None in (CMAKE, NINJA, COMPILER), reason="cmake, ninja or a compiler is missing")
needs_levels = pytest.mark.skipif(processor_level() is None, reason="only x86-64 has levels")


def copied(folder):
    """Return a copy of what the build reads."""
    shutil.copy(ROOT / "CMakeLists.txt", folder)
    for path in (ROOT / "src").rglob("*"):
        if path.suffix in (".cpp", ".hpp", ".json", ".map"):
            place = folder / path.relative_to(ROOT)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, place)
    return folder


def configured(tree, *options):
    """Configure a build of a copy; return its exit status and what it says."""
    command = [str(CMAKE), "-S", str(tree), "-B", str(tree / "build"), "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={NINJA}"]
    command += ["-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    return done.returncode, " ".join((done.stdout + done.stderr).split())


def commands(tree):
    """Return how each source of each library is compiled."""
    entries = json.loads((tree / "build/compile_commands.json").read_text())
    sources = [entry for entry in entries if not entry["file"].endswith(".hxx.cxx")]  # without precompiled headers
    named = [(re.search(r"/(\w+)\.dir/", entry["command"])[1], entry) for entry in sources]
    return {(library, Path(entry["file"]).name): entry["command"] for library, entry in named}


def compiled(tree):
    """Build; return the libraries and sources that were compiled."""
    command = [str(CMAKE), "--build", str(tree / "build")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    return sorted(re.findall(r"Building CXX object \S*?(\w+)\.dir/\S*?(\w+\.cpp)\.o", done.stdout))


@pytest.mark.long
@needs_tools
@needs_levels
def test_levels_are_chosen_by_name(tmp_path):
    tree = copied(tmp_path)
    sources = {path.name for path in tree.rglob("*.cpp")} - {"processor.cpp"}
    for chosen, names in {
        "v1;v3": ["v1", "v3"],
        "all": [f"v{level}" for level in levels()],
        "": [f"v{processor_level()}"],
    }.items():
        assert configured(tree, f"-DCOADJOINT_LEVELS={chosen}")[0] == 0
        libraries = {(f"_kernels_{name}", source) for name in names for source in sources}
        assert set(commands(tree)) == {("_processor", "processor.cpp"), *libraries}


@needs_tools
@needs_levels
@pytest.mark.parametrize("state", ["wheel", "editable"])
def test_installations_compile_the_level_of_the_machine_alone(tmp_path, state):
    tree = copied(tmp_path)
    assert configured(tree, "-DSKBUILD=2", f"-DSKBUILD_STATE={state}")[0] == 0
    assert {library for library, _ in commands(tree)} == {"_processor", f"_kernels_v{processor_level()}"}


@needs_tools
def test_another_compiler_is_not_left_out_in_silence(tmp_path, monkeypatch):
    tree = copied(tmp_path)
    assert configured(tree)[0] == 0
    other = tmp_path / "other++"
    other.symlink_to(str(COMPILER))
    monkeypatch.setenv("CXX", f"{other} -g")
    status, said = configured(tree)
    assert status != 0
    assert f"CXX is {other}, but {tree / 'build'} was made for" in said


@pytest.mark.long
@needs_tools
@pytest.mark.parametrize("levels", long_beyond(1, ["v3", "v1;v3"]))
def test_what_has_changed_is_compiled_and_nothing_else(tmp_path, levels):
    """On sources that are made as short as can be: which are compiled does not depend on what they hold."""
    tree = copied(tmp_path)
    for path in tree.rglob("*.cpp"):
        if path.name != "processor.cpp":
            path.write_text('#include "boundary/interrupts.hpp"\n')
    names = [f"_kernels_{level}" for level in levels.split(";")] if processor_level() else ["_kernels"]
    options = [f"-DCOADJOINT_LEVELS={levels}"] if processor_level() else []
    assert configured(tree, *options)[0] == 0
    assert {name for name, _ in compiled(tree)} == {*names, *(["_processor"] if processor_level() else [])}
    assert compiled(tree) == []
    changed = tree / SOURCES / "boundary/probes.cpp"
    changed.write_text(changed.read_text() + "// more\n")
    assert compiled(tree) == [(name, "probes.cpp") for name in names]
    assert compiled(tree) == []
    (tree / SOURCES / "boundary/added.cpp").write_text("\n")
    assert compiled(tree) == [(name, "added.cpp") for name in names]
    header = tree / SOURCES / "boundary/interrupts.hpp"
    header.write_text(header.read_text() + "// more\n")
    including = {path.name for path in (tree / "src").rglob("*.cpp")} - {"processor.cpp", "added.cpp"}
    assert compiled(tree) == sorted((name, source) for name in names for source in including)


@needs_tools
@needs_levels
def test_options_of_the_build_are_those_of_the_tests(tmp_path):
    """The build reads options.json by CMake, the tests by Python: the compiler is told the same."""
    tree = copied(tmp_path)
    assert configured(tree, "-DCOADJOINT_LEVELS=all")[0] == 0
    told = commands(tree)
    for level in levels():
        expected = compiler_options(level_options(level), tree / SOURCES)
        command = told[f"_kernels_v{level}", "flow.cpp"].partition(" -o ")[0].split()[1:]
        # The precompiled header of the build, which tells the compiler nothing else.
        at = next((k for k, option in enumerate(command) if option == "-Winvalid-pch"), None)
        if at is not None:
            assert command[at + 1] == "-include" and Path(command[at + 2]).name == "cmake_pch.hxx"
            del command[at : at + 3]
        kept = [option for option in command if not option.startswith("-D_kernels")]
        assert sorted(kept) == sorted(expected)
        # In the same order but for the last three, which add nothing to what others say.
        assert [option for option in kept if option in expected[:-3]] == expected[:-3]


STATIC = "-DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY"
BOTH = "-DCMAKE_OSX_ARCHITECTURES=x86_64;arm64"
REFUSED = {
    # GCC does not align the stack of Windows for vectors, and programs crash at the first.
    "windows": (["-DCMAKE_SYSTEM_NAME=Windows", STATIC], "set CXX=clang++"),
    # Kernels of two processors have different names: one library cannot hold both.
    "macos": ([BOTH], "are not the same files: build for each of x86_64;arm64 alone"),
    "fast": (["-DCMAKE_CXX_FLAGS=-g -ffast-math"], "CXXFLAGS has -ffast-math, which changes the bits of a run"),
    "Ofast": (["-DCMAKE_CXX_FLAGS=-g -Ofast"], "CXXFLAGS has -Ofast, which changes the bits of a run"),
}
OF_LEVELS = {"32 bits": (["-DCMAKE_CXX_FLAGS=-m32", STATIC], "build with a 64-bit compiler, for a 64-bit Python")}
OF_LEVELS |= {
    levels: ([f"-DCOADJOINT_LEVELS={levels}"], f"COADJOINT_LEVELS has {wrong}, which is none of v1;v3;v4")
    for levels, wrong in [("v2", "v2"), ("v1;fast", "fast"), ("v3;all", "all"), ("4", "4")]
}


@pytest.mark.thinned(4)
@needs_tools
@pytest.mark.parametrize("name", [*REFUSED, *(pytest.param(name, marks=needs_levels) for name in OF_LEVELS)])
def test_builds_are_refused(tmp_path, name):
    options, expected = (REFUSED | OF_LEVELS)[name]
    status, said = configured(copied(tmp_path), *options)
    if name == "windows" and "compiler identification is GNU" not in said:
        pytest.skip("the compiler is not GCC")
    assert status != 0 and expected in said
