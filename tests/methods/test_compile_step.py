"""A step in C++ that stands in a file of the user, compiled against the headers of the kernels."""

import dataclasses
import os
import pickle
import shutil
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from own_schemes import NOTHING, Relaxed

import coadjoint as co
from coadjoint.methods.compiled_steps import preprocessed_source, step_compiler

SOURCE = Path(__file__).with_name("own_step.cpp")

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler is installed")


@pytest.fixture(scope="module")
def step(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    yield co.methods.compile_step(SOURCE)
    patch.undo()


def scheme_of(own):
    @dataclasses.dataclass(frozen=True)
    class OwnEuler(co.methods.CompiledStepMethod):
        part: float = 1.0
        listening: bool = False

        order, explicit, symmetric = 1, True, False
        compiled_step = own

        def properties(self, system):
            return NOTHING

        def constants(self):
            return [int(self.listening)], [self.part]

        def step(self, system, x, t, h):
            return x + self.part * h * system.vector_field(x, t)

        def tangent(self, system, x, t, h):
            return self.step(system, x, t, h), np.eye(len(x)) + self.part * h * system.jacobian(x, t)

    return OwnEuler


@pytest.mark.long
def test_it_runs_as_its_reading_says(step):
    scheme = scheme_of(step)
    system = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, np.ones(6)))
    x0 = 0.3 * np.cos(np.arange(6.0))
    sol = co.integrate(system, x0, (0, 1), 0.1, scheme(0.5))
    python = co.integrate(system, x0, (0, 1), 0.1, Relaxed(0.5))
    assert np.max(np.abs(sol.x - python.x)) < 1e-14 and sol.stats.evaluations == 10
    ensemble = co.integrate(system, np.stack([x0, 2 * x0, -x0]), (0, 1), 0.1, scheme(0.5), threads=2)
    assert np.array_equal(ensemble.x[:, 0], sol.x)
    ready = co.prepare(system, scheme(0.5), 0.1, inputs=True)
    other = co.LiePoissonSystem(system.algebra, co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, x0))
    assert np.array_equal(ready.run(x0, (0, 1), linear=x0).x, co.integrate(other, x0, (0, 1), 0.1, scheme(0.5)).x)
    assert np.max(np.abs(co.stepper(system, scheme(), 0.1).tangent(x0) - np.eye(6) - 0.1 * system.jacobian(x0))) < 1e-15


@pytest.mark.long
def test_what_it_asks_of_the_kernels_is_lent_to_it(step):
    """Long iterations hear an interrupt, also in a library of their own."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    scheme = scheme_of(step)
    assert np.array_equal(
        co.integrate(body, (1, 0.2, 0.1), (0, 1), 0.1, scheme(listening=True)).x,
        co.integrate(body, (1, 0.2, 0.1), (0, 1), 0.1, scheme()).x,
    )
    timer = threading.Timer(0.5, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            co.integrate(body, (1e-3, 2e-3, 1e-3), (0, 2e9), 1.0, scheme(0.0, True), save_every=10**9)
    finally:
        timer.cancel()


@pytest.mark.long
def test_another_process_finds_what_was_compiled(step, monkeypatch):
    def refused(*given):
        raise AssertionError("compiled again")

    for known in ("_LOADED", "_LIBRARIES", "_LAST_COMPILATIONS"):
        monkeypatch.setattr(step_compiler, known, {})
    monkeypatch.setattr(step_compiler, "_build", refused)
    assert co.methods.compile_step(SOURCE) == step and step.address != 0


def test_an_edited_file_is_compiled_again(step, tmp_path):
    """In the same process; a step that was compiled before the edit stays what it was."""
    path, body = tmp_path / "own_step.cpp", co.systems.rigid_body(inertia=(1, 2, 3))
    path.write_text(SOURCE.read_text())

    def last(compiled):
        return co.integrate(body, (1, 0.2, 0.1), (0, 1), 0.125, scheme_of(compiled)(0.5)).x[-1]

    first = co.methods.compile_step(path)
    assert first.digest == step.digest and np.array_equal(last(first), last(step))
    path.write_text(SOURCE.read_text().replace("tables.coefficients[0]", "2 * tables.coefficients[0]"))
    second = co.methods.compile_step(path)
    assert second != first and second.address != first.address
    assert np.array_equal(last(first), last(step))
    assert np.array_equal(last(second), co.integrate(body, (1, 0.2, 0.1), (0, 1), 0.125, scheme_of(step)(1.0)).x[-1])


class Project:
    """A source with headers of its own, of which only the preprocessing is tested."""

    def __init__(self, folder, step, patch):
        self.folder, self.patch, self.names = folder, patch, []
        for name in ("own", "first", "second"):
            (folder / name).mkdir()
        self.write("own/own.cpp", '#include "one.hpp"\n#include "steps/step_scheme.hpp"\nSTEP_SCHEME(own_step, Own)\n')
        self.write("own/one.hpp", '#include "deep/two.hpp"\n#include <three.hpp>\n#ifdef MACRO\nint MACRO;\n#endif\n')
        self.write("own/deep/two.hpp", 'int two;\n#include "three.hpp"\n')
        self.write("second/three.hpp", "int three;\n")
        self.write("compiler", '#!/bin/sh\nexec c++ "$@"\n')
        (folder / "compiler").chmod(0o755)
        self.options()
        patch.setattr(step_compiler, "_LAST_COMPILATIONS", {})
        patch.setattr(step_compiler, "_LOADED", {})
        self.library = step_compiler._LIBRARIES[step.path, step.digest]
        patch.setattr(step_compiler, "cached_library", self.loaded)

    def loaded(self, name, build):
        self.names.append(name)
        return self.library

    def write(self, name, text):
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    def options(self, more=""):
        search = f"-I{self.folder}/absent -I{self.folder}/first -I{self.folder}/second"
        self.patch.setenv("CXX", f"{self.folder}/compiler {search} {more}")

    def compile(self):
        """Return what identifies the step, and how many libraries were loaded."""
        return co.methods.compile_step(self.folder / "own" / "own.cpp"), len(self.names)


def same_size_and_time(project):
    path = project.folder / "own" / "deep" / "two.hpp"
    before = path.stat()
    path.write_text(path.read_text().replace("two", "owt"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def link_turned(project):
    (project.folder / "own" / "one.hpp").unlink()
    (project.folder / "own" / "one.hpp").symlink_to(project.folder / "other.hpp")


EDITS = {
    "source": lambda project: project.write("own/own.cpp", "int more;\nSTEP_SCHEME(own_step, Own)\n"),
    "header": lambda project: project.write("own/one.hpp", "int one;\n"),
    "header of a header": lambda project: project.write("own/deep/two.hpp", "int other;\n"),
    "same size and time": same_size_and_time,
    "header in a folder of an option": lambda project: project.write("second/three.hpp", "int other;\n"),
    "header found before another": lambda project: project.write("first/three.hpp", "int other;\n"),
    "folder found before another": lambda project: project.write("absent/three.hpp", "int other;\n"),
    "header beside the header": lambda project: project.write("own/deep/three.hpp", "int other;\n"),
    "header of the library shadowed": lambda project: project.write("own/steps/step_scheme.hpp", "int other;\n"),
    "macro": lambda project: project.options("-DMACRO=four"),
    "option that leaves the text alone": lambda project: project.options("-fwrapv"),
    "searched folders": lambda project: project.options(f"-isystem {project.folder}/first -DMACRO=five"),
    "compiler": lambda project: project.write("compiler", '#!/bin/sh\nexec c++ -DMACRO=six "$@"\n'),
    "link": link_turned,
}


@pytest.mark.thinned(10)
@pytest.mark.parametrize(
    ("edit", "trusting"), [*((edit, True) for edit in EDITS), ("header", False), ("header found before another", False)]
)
def test_an_edit_is_noticed_in_the_same_process(step, tmp_path, monkeypatch, edit, trusting):
    """From the stamps of files and folders alone, where all are old enough, and from the preprocessed text."""
    monkeypatch.setattr(preprocessed_source, "TIMESTAMP_GRANULARITY", -(10**18) if trusting else 10**18)
    project = Project(tmp_path, step, monkeypatch)
    project.write("other.hpp", "int other;\n")
    first, count = project.compile()
    assert count == 1
    with monkeypatch.context() as patch:
        if trusting:
            patch.setattr(step_compiler, "_run", None)
        assert project.compile() == (first, 1)
    EDITS[edit](project)
    second, count = project.compile()
    assert count == 2 and project.names[0] != project.names[1]
    assert (second.digest != first.digest) == (edit != "compiler"), "another machine may have another compiler"
    assert project.compile() == (second, 2)


def test_time_stamps_of_files_that_have_just_changed_are_not_trusted(tmp_path, monkeypatch):
    """A second edit within the resolution of the clock would leave the same ones."""
    (tmp_path / "file").touch()
    stamps = preprocessed_source.stamps_of([os.fsencode(tmp_path / name) for name in ("file", "none")])
    newest = max((tmp_path / "file").stat().st_mtime_ns, (tmp_path / "file").stat().st_ctime_ns)
    for later, trusted in ((0, False), (1, True), (-1, False), (-(10**18), False)):
        monkeypatch.setattr(
            time, "time_ns", lambda later=later: newest + preprocessed_source.TIMESTAMP_GRANULARITY + later
        )
        assert preprocessed_source.stamps_are_final(stamps) == trusted
    assert not preprocessed_source.stamps_are_final({})


def test_a_compiler_that_does_not_list_its_folders(step, tmp_path, monkeypatch):
    """Then a header may appear anywhere, and each call preprocesses."""
    monkeypatch.setattr(preprocessed_source, "TIMESTAMP_GRANULARITY", -(10**18))
    project = Project(tmp_path, step, monkeypatch)
    project.write("compiler", '#!/bin/sh\nexec c++ "$@" 2>/dev/null\n')
    first, _ = project.compile()
    project.write("first/three.hpp", "int other;\n")
    assert project.compile()[1] == 2 and project.compile()[0] != first


def test_a_step_in_another_process(step, tmp_path, monkeypatch):
    """It is compiled there from the same file, by any compiler, and an edited file is refused."""
    project = Project(tmp_path, step, monkeypatch)
    sent, address = pickle.loads(pickle.dumps(project.compile()[0])), step.address
    monkeypatch.setattr(step_compiler, "_LIBRARIES", {})
    project.write("compiler", '#!/bin/sh\nexec c++ -DMACRO=other "$@"\n')
    assert sent.address == address
    monkeypatch.setattr(step_compiler, "_LIBRARIES", {})
    project.write("own/deep/two.hpp", "int other;\n")
    with pytest.raises(ValueError, match=r"own\.cpp: is not what the step own_step was compiled from"):
        sent.address  # noqa: B018


def failing(folder, text):
    path = folder / "compiler"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (lambda folder: "/no/such/compiler", r"the compiler /no/such/compiler cannot be run \(No such file"),
        (str, "cannot be run .*; name another one by CXX="),
        (lambda folder: str(SOURCE), "cannot be run"),
        (lambda folder: "c++ '", r"CXX is .*cannot be read as a command \(No closing quotation\)"),
        (lambda folder: failing(folder, "exit 3"), r"failed \(exit status 3\); name another one by CXX="),
        (lambda folder: failing(folder, "kill -9 $$"), r"failed \(exit status -9\)"),
        (lambda folder: failing(folder, "exit 0"), "has written nothing; name another one"),
        (lambda folder: failing(folder, "cat >/dev/null; sleep 60"), "did not end within 0 s"),
        (lambda folder: failing(folder, "printf '\\377 no licence' >&2; exit 1"), "rejects it: . no licence"),
    ],
)
def test_compilers_that_do_not_work(tmp_path, monkeypatch, command, said):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("CXX", command(tmp_path))
    if "did not end" in said:
        monkeypatch.setattr(step_compiler, "COMPILER_TIMEOUT", 0.1)
    with pytest.raises((RuntimeError, ValueError), match=said) as refused:
        co.methods.compile_step(SOURCE)
    assert "\n" not in str(refused.value) and refused.value.__suppress_context__ | (refused.value.__context__ is None)
    assert list(tmp_path.rglob("*.so")) == []


def test_messages_of_the_compiler_are_in_english(tmp_path, monkeypatch):
    """In any language of the user: they are searched for errors and for the folders of headers."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    monkeypatch.setenv("CXX", failing(tmp_path, 'echo "own.cpp:1: error: in $LC_ALL" >&2; exit 1'))
    with pytest.raises(ValueError, match=r"rejects it: own\.cpp:1: error: in C$"):
        co.methods.compile_step(SOURCE)


def test_no_compiler_is_installed(monkeypatch):
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(step_compiler, "_LAST_COMPILATIONS", {})
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(RuntimeError, match="no C\\+\\+ compiler is installed"):
        co.methods.compile_step(SOURCE)


def test_on_windows_only_clang_compiles(tmp_path, monkeypatch):
    """Paths in CXX may have backslashes."""
    monkeypatch.setattr(step_compiler, "_LAST_COMPILATIONS", {})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    failing(tmp_path, "echo g++ 14.2")
    monkeypatch.setenv("CXX", f"{tmp_path}\\compiler -DONE")
    with monkeypatch.context() as windows:
        windows.setattr(sys, "platform", "win32")
        with pytest.raises(RuntimeError, match=r"compiled by Clang on Windows, and .*/compiler is another compiler"):
            co.methods.compile_step(SOURCE)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("int main() {}", "has no STEP_SCHEME"),
        ("STEP_SCHEME(one, One)\nSTEP_SCHEME(two, Two)", "has the steps one, two; select one by name"),
        ('#include "steps/step_scheme.hpp"\nSTEP_SCHEME(one, Unknown)', "the compiler c.. rejects it: .*Unknown"),
        ("STEP_SCHEME(one, One)\n#include <no_such_header>", "the compiler c.. rejects it: .*no_such_header"),
    ],
)
def test_what_cannot_be_compiled_is_refused_in_one_line(tmp_path, monkeypatch, text, said):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "own.cpp"
    path.write_text(text)
    with pytest.raises(ValueError, match=said) as refused:
        co.methods.compile_step(path)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there():
    with pytest.raises(ValueError, match=r"none\.cpp: cannot be read"):
        co.methods.compile_step("none.cpp")
    with pytest.raises(ValueError, match="has no step 'other'; it has own_step"):
        co.methods.compile_step(SOURCE, name="other")


@pytest.mark.long
def test_steps_of_its_own(tmp_path, monkeypatch):
    """The kernels see that a step from another library takes steps of its own: no look changes them."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    own = co.methods.compile_step(SOURCE.with_name("own_lengths.cpp"))

    @dataclasses.dataclass(frozen=True)
    class OwnLengths(co.methods.CompiledStepMethod):
        length: float = 2.0**-8

        order, explicit, symmetric, own_steps = 1, True, False, True
        compiled_step = own

        def properties(self, system):
            return NOTHING

        def constants(self):
            return [], [self.length]

        def step(self, system, x, t, h):
            x, since = np.array(x), 0.0
            while True:
                slope = system.vector_field(x, t + since)
                length = np.copysign(self.length / np.linalg.norm(slope), h)
                if abs(h - since) <= abs(length):
                    return x + (h - since) * slope
                x, since = x + length * slope, since + length

    body, method = co.systems.rigid_body(inertia=(2, 3, 4)), OwnLengths()
    ensemble = np.array([[0.6, 0.3, 0.8], [1.2, -0.6, 0.1], [0.1, 0.2, 0.3]])
    for end in (2.0, -2.0):
        every = co.integrate(body, ensemble, (0, end), 0.125, method, threads=1)
        for m, x0 in enumerate(ensemble):
            alone = co.integrate(body, x0, (0, end), 0.125, method)
            assert np.array_equal(alone.x, every.x[:, m])
            read = np.array([method.step(body, x0, 0.0, t) for t in alone.t[1:]])
            assert np.max(np.abs(alone.x[1:] - read)) < 1e-12
            assert 2 < alone.stats.evaluations < 2000
            for step, save_every, watch in ((0.125, 5, True), (0.125, 16, False), (2.0, 1, True), (2.0**-9, 64, False)):
                sol = co.integrate(body, x0, (0, end), step, method, save_every=save_every, watch=watch)
                assert np.array_equal(sol.x[-1], alone.x[-1]) and sol.stats.evaluations == alone.stats.evaluations
        assert np.array_equal(co.integrate(body, ensemble, (0, end), 0.125, method, threads=2).x, every.x)
