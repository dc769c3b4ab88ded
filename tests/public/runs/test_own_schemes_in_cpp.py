"""Steps in C++ in a file of the user: runs, edits, and errors of files and compilers."""

import dataclasses
import shutil
import signal
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from own_schemes import NOTHING
from refusals import refused

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
def test_long_steps_can_be_interrupted(step):
    """Also in a library of its own."""
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


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A copy of the source that this process has not compiled, and an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "copy.cpp"
    path.write_text(SOURCE.read_text())
    return path


def compiler(folder, text):
    path = folder / "compiler"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("command", "named"),
    [
        (lambda folder: "/no/such/compiler", ("/no/such/compiler", "No such file")),
        (str, ("cannot be run", "CXX=")),
        (lambda folder: str(SOURCE), ("cannot be run", "own_step.cpp")),
        (lambda folder: "c++ '", ("CXX", "No closing quotation")),
        (lambda folder: compiler(folder, "exit 3"), ("exit status 3", "CXX=")),
        (lambda folder: compiler(folder, "kill -9 $$"), ("exit status -9",)),
        (lambda folder: compiler(folder, "exit 0"), ("nothing", "CXX=")),
        (lambda folder: compiler(folder, "printf '\\377 no licence' >&2; exit 1"), ("no licence",)),
        # Messages are searched for errors and headers: in English, in any language of the user.
        (lambda folder: compiler(folder, 'echo "copy.cpp:1: error: in $LC_ALL" >&2; exit 1'), ("error: in C",)),
    ],
)
def test_compilers_that_do_not_work(own, monkeypatch, command, named):
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    monkeypatch.setenv("CXX", command(own.parent))
    with refused((RuntimeError, ValueError), *named) as failure:
        co.methods.compile_step(own)
    assert "\n" not in str(failure.value)
    assert list(own.parent.rglob("*.so")) == []


def test_no_compiler_is_installed(own, monkeypatch):
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with refused(RuntimeError, "no C++ compiler"):
        co.methods.compile_step(own)


def test_on_windows_only_clang_compiles(own, monkeypatch):
    """Paths in CXX may have backslashes."""
    compiler(own.parent, "echo g++ 14.2")
    monkeypatch.setenv("CXX", f"{own.parent}\\compiler -DONE")
    with monkeypatch.context() as windows:
        windows.setattr(sys, "platform", "win32")
        with refused(RuntimeError, "Clang", "Windows", "/compiler"):
            co.methods.compile_step(own)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("int main() {}", ("STEP_SCHEME",)),
        ("STEP_SCHEME(one, One)\nSTEP_SCHEME(two, Two)", ("one, two",)),
        ('#include "steps/step_scheme.hpp"\nSTEP_SCHEME(one, Unknown)', ("c++", "Unknown")),
        ("STEP_SCHEME(one, One)\n#include <no_such_header>", ("c++", "no_such_header")),
    ],
)
def test_sources_that_cannot_be_compiled(own, text, named):
    own.write_text(text)
    with refused(ValueError, *named) as failure:
        co.methods.compile_step(own)
    assert "\n" not in str(failure.value)


def test_files_and_names_that_are_not_there():
    with refused(ValueError, "none.cpp"):
        co.methods.compile_step("none.cpp")
    with refused(ValueError, "'other'", "own_step"):
        co.methods.compile_step(SOURCE, name="other")


@pytest.mark.long
def test_steps_of_its_own_length(tmp_path, monkeypatch):
    """Output points do not affect them."""
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
        every = co.integrate(body, ensemble, (0, end), 0.125, method, threads=2)
        for m, x0 in enumerate(ensemble):
            alone = co.integrate(body, x0, (0, end), 0.125, method)
            assert np.array_equal(alone.x, every.x[:, m])
            read = np.array([method.step(body, x0, 0.0, t) for t in alone.t[1:]])
            assert np.max(np.abs(alone.x[1:] - read)) < 1e-12
            assert 2 < alone.stats.evaluations < 2000
            for step, save_every in ((0.125, 5), (2.0, 1), (2.0**-9, 64)):
                sol = co.integrate(body, x0, (0, end), step, method, save_every=save_every, watch=False)
                assert np.array_equal(sol.x[-1], alone.x[-1]) and sol.stats.evaluations == alone.stats.evaluations
