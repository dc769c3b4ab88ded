"""Runs, and what prepares them, have the bits of the standard floating-point mode, and leave that of their caller."""

import os
import subprocess
import sys

import numpy as np
import pytest

import coadjoint as co
from exported_table import Interface, exported_library
from float_modes import MODES, float_mode
from long import long_beyond

STARTS = np.random.default_rng(0).standard_normal((40, 3))
X0 = (0.1, 1.0, 0.3)
SUBNORMAL = 1e-310 * np.array(X0)


def body():
    return co.systems.rigid_body((0.7, 1.1, 1.3))


def prepared(**options):
    return co.prepare(body(), co.Splitting(order=4), step=0.1, **options)


def ensemble(threads):
    sol = co.integrate(body(), STARTS, (0.0, 5.0), 0.1, co.Splitting(order=4), threads=threads, attitude=True)
    return sol.x, sol.attitude, sol.t, sol.energy, sol.drift()["energy"]


def spins(threads):
    lattice = co.systems.spin_lattice("ring", 1500, exchange=0.1)
    return co.integrate(lattice, np.tile(STARTS[:30].ravel(), 50), (0.0, 6.4), 0.1, "Splitting", threads=threads).x


def steps():
    step = co.stepper(body(), co.GaussLegendre(2), 0.1)
    return step(X0), *step.both(X0), step.group(X0), step.tangent(X0)


def derivatives():
    ready, directions = prepared(), {"x0": np.eye(3), "inertia": np.eye(3)}
    _, pullback = ready.vjp(X0, (0.0, 3.0))
    found = pullback(x=np.ones((31, 3)))
    return ready.jvp(X0, (0.0, 3.0), directions)[1].x, found["x0"], found["inertia"]


def subnormal():
    return prepared().run(SUBNORMAL, (0.0, 10.0)).x


def exported(folder):
    def text():
        return co.export_c(prepared(), folder / "run.h").read_text(), co.export_table(prepared(), folder / "run.json")

    return text


def values_of_systems():
    top = co.systems.heavy_top((0.7, 1.1, 1.3), (0.1, 0.2, 0.3))
    x = np.array((0.3, 0.2, 1.0, 0.6, 0.1, 0.8))
    forced = top.with_forces(co.forces.LinearDamping((0.1, 0.1, 0.1, 0, 0, 0)))
    run = co.integrate(forced, x, (0.0, 1.0), 0.1)
    return top.energy(x), top.vector_field(x), body().exact(X0, [1.0, 2.0]), run.x, run.at([0.33, 0.5]).x


CALLS = {
    "one thread": lambda: ensemble(1),
    "two threads": lambda: ensemble(2),
    "one member on one thread": lambda: spins(1),
    "one member on two threads": lambda: spins(2),
    "steppers": steps,
    "derivatives": derivatives,
    "subnormal states": subnormal,
    "functions of Python": lambda: (
        co.integrate(
            co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda x: 0.3 * x[0] ** 2 + x[1] ** 4)),
            X0,
            (0, 1),
            0.1,
        ).x
    ),
    "values and other runs": values_of_systems,
    "Taylor series": lambda: co.integrate(body(), X0, (0.0, 2.0), 0.1, co.Taylor(order=12)).x,
    "choices": lambda: co.integrate(body(), X0, (0.0, 20.0), accuracy=1e-8).x,
}


def bits_of(value):
    if isinstance(value, tuple | list):
        return [bits_of(entry) for entry in value]
    return np.asarray(value).tobytes() if isinstance(value, np.ndarray | float) else value


def test_subnormal_states_move():
    x = subnormal()
    assert np.abs(np.linalg.norm(x / 1e-310, axis=1) / np.linalg.norm(X0) - 1).max() < 1e-10  # 2^-45, 100 roundings


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("call", CALLS)
def test_bits_do_not_depend_on_the_mode_of_the_caller(call, mode):
    wanted = bits_of(CALLS[call]())
    with float_mode(mode):
        assert bits_of(CALLS[call]()) == wanted


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("options", [{}, {"save_every": 7}])
def test_what_a_solution_computes_later_has_the_same_bits(options, mode):
    """A prepared run warns once, so that later ones have not computed their times when they return."""
    ready = prepared(attitude=True)

    def later():
        sol = ready.run(X0, (0.7, 3.7), **options)
        return sol.t, sol.x, sol.attitude, sol.energy, sol.drift()["energy"]

    wanted = bits_of(later())
    with float_mode(mode):
        assert bits_of(later()) == wanted


@pytest.mark.parametrize("mode", MODES)
def test_exported_digits(tmp_path, mode):
    export = exported(tmp_path)
    wanted, table = export()[0], (tmp_path / "run.json").read_text()
    with float_mode(mode):
        assert export()[0] == wanted
    assert (tmp_path / "run.json").read_text() == table


@pytest.mark.parametrize("mode", long_beyond(1, MODES))
def test_a_package_that_is_imported_in_a_mode(mode):
    """Constants of its modules are those of any other process."""
    source = (
        "import hashlib, sys\nfrom float_modes import float_mode\nfrom contextlib import nullcontext\n"
        "with float_mode(sys.argv[1]) if sys.argv[1] else nullcontext():\n"
        "    import coadjoint as co\n"
        "    x = co.integrate(co.systems.heavy_top(), (.3, .2, 1, .6, 0, .8), (0, 3), .1, co.GaussLegendre(3)).x\n"
        "print(hashlib.sha256(x.tobytes()).hexdigest())\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    found = {
        subprocess.run(
            [sys.executable, "-B", "-c", source, name], env=environment, capture_output=True, text=True, check=True
        ).stdout
        for name in ("", mode)
    }
    assert len(found) == 1


def test_the_c_interface(tmp_path):
    interface, ready = Interface(exported_library(tmp_path)), prepared()
    table = co.export_table(ready, tmp_path / "run.json").read_text()
    wanted = ready.run(X0, (0.0, 1.0)).x[1:].tobytes()

    def states():
        run = interface.run(table)
        run.x = np.array(X0)
        return run.save(10)

    for mode in MODES:
        with float_mode(mode):
            found = states()
        assert found.tobytes() == wanted, mode


@pytest.mark.parametrize("mode", MODES)
def test_values_at_subnormal_states_do_not_depend_on_the_mode(mode):
    spin = co.systems.spin_lattice("chain", 1, field=(0.0, 0.0, 1.0))
    wanted = spin.vector_field(SUBNORMAL), spin.energy(SUBNORMAL)
    assert np.abs(wanted[0]).max() > 0.0 and wanted[1] != 0.0
    with float_mode(mode):
        assert bits_of((spin.vector_field(SUBNORMAL), spin.energy(SUBNORMAL))) == bits_of(wanted)
