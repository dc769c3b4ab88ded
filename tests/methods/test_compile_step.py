"""A step in C++ that stands in a file of the user, compiled against the headers of the kernels."""

import dataclasses
import shutil
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
from own_schemes import NOTHING, Relaxed

import coadjoint as co
from coadjoint.methods import step_compiler

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


def test_it_runs_as_its_reading_says(step):
    scheme = scheme_of(step)
    system = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, np.ones(6)))
    x0 = 0.3 * np.cos(np.arange(6.0))
    sol = co.integrate(system, x0, (0, 1), 0.1, scheme(0.5))
    python = co.integrate(system, x0, (0, 1), 0.1, Relaxed(0.5))
    assert np.max(np.abs(sol.x - python.x)) < 1e-14 and sol.stats.evaluations == 10
    crowd = co.integrate(system, np.stack([x0, 2 * x0, -x0]), (0, 1), 0.1, scheme(0.5), threads=2)
    assert np.array_equal(crowd.x[:, 0], sol.x)
    ready = co.prepare(system, scheme(0.5), 0.1, inputs=True)
    other = co.LiePoissonSystem(system.algebra, co.Quadratic(np.diag(np.arange(1.0, 7)) + 0.1, x0))
    assert np.array_equal(ready.run(x0, (0, 1), linear=x0).x, co.integrate(other, x0, (0, 1), 0.1, scheme(0.5)).x)
    assert np.max(np.abs(co.stepper(system, scheme(), 0.1).tangent(x0) - np.eye(6) - 0.1 * system.jacobian(x0))) < 1e-15


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


def test_it_is_compiled_once(step, monkeypatch):
    """Another process finds what was compiled, and a file that has changed is compiled again."""

    def refused(*given):
        raise AssertionError("compiled again")

    step_compiler._library.cache_clear()
    step_compiler._address.cache_clear()
    monkeypatch.setattr(step_compiler, "_build", refused)
    assert co.methods.compile_step(SOURCE) == step and step.address != 0


def test_a_file_that_has_changed_is_compiled_again(step, tmp_path, monkeypatch):
    other = tmp_path / "own_step.cpp"
    other.write_text(SOURCE.read_text() + "\n// changed\n")
    built = []
    monkeypatch.setattr(step_compiler, "_build", lambda command, source, target: built.append(source) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        co.methods.compile_step(other)
    assert built == [other]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("int main() {}", "has no STEP_SCHEME"),
        ("STEP_SCHEME(one, One)\nSTEP_SCHEME(two, Two)", "has the steps one, two; say which"),
        ('#include "steps/step_scheme.hpp"\nSTEP_SCHEME(one, Unknown)', "the compiler c.. refuses it: .*Unknown"),
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
    crowd = np.array([[0.6, 0.3, 0.8], [1.2, -0.6, 0.1], [0.1, 0.2, 0.3]])
    for end in (2.0, -2.0):
        every = co.integrate(body, crowd, (0, end), 0.125, method, threads=1)
        for m, x0 in enumerate(crowd):
            alone = co.integrate(body, x0, (0, end), 0.125, method)
            assert np.array_equal(alone.x, every.x[:, m])
            read = np.array([method.step(body, x0, 0.0, t) for t in alone.t[1:]])
            assert np.max(np.abs(alone.x[1:] - read)) < 1e-12
            assert 2 < alone.stats.evaluations < 2000
            for step, save_every, watch in ((0.125, 5, True), (0.125, 16, False), (2.0, 1, True), (2.0**-9, 64, False)):
                sol = co.integrate(body, x0, (0, end), step, method, save_every=save_every, watch=watch)
                assert np.array_equal(sol.x[-1], alone.x[-1]) and sol.stats.evaluations == alone.stats.evaluations
        assert np.array_equal(co.integrate(body, crowd, (0, end), 0.125, method, threads=2).x, every.x)
