"""Prepared runs as C99: the bits of the library from every compiler, the derivative of a step."""

import itertools
import math
import random
import re
import subprocess
import sys
from ctypes import c_double
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from c_compilers import STRICT, compiled, compilers, library
from exported_run import Build, RunInC, assert_same, builds, check_run
from long import long_between, long_beyond
from random_runs.cases import REFUSALS, some_method, some_systems

if not compilers():
    pytest.skip("there is no compiler of C", allow_module_level=True)

BUILDS = builds()
FIRST = BUILDS[0]
SCHEMES = (
    co.Splitting(order=4),
    co.ExplicitRungeKutta(),
    co.Splitting(order=2, rotation="rational"),
    co.Splitting(order=2, parts="free_body"),
    co.IteratedGaussLegendre(2, 3),
)
TOP = co.systems.heavy_top()
BODY = co.systems.rigid_body((1, 2, 2.5))
FULL = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([[1, 0.2, 0.1], [0.2, 2, 0.3], [0.1, 0.3, 3]]))


def monomial(*powers):
    """Return the exponents of a monomial in 13 coordinates."""
    return tuple(sum(e for i, e in powers if i == k) for k in range(13))


QUARTIC = co.LiePoissonSystem(
    co.algebras.heisenberg(6),
    co.Polynomial(
        {
            **{monomial((k, 2)): 0.5 for k in range(12)},
            **{monomial((k, 4)): 0.25 for k in range(6)},
            **{monomial((k, 2), (k + 1, 1)): 0.1 for k in range(5)},
            monomial((8, 7)): 0.01,
        }
    ),
)
STRETCHED = co.LiePoissonSystem(
    co.algebras.change_of_basis(co.algebras.so(3), [[2, 0, 0], [0, 1, 0], [0, 0, 1]]), co.Quadratic([1, 2, 3])
)
"""A body whose axes have generators of different lengths: rotations by their angles."""
WIDE = co.LiePoissonSystem(
    co.algebras.so(5), co.Quadratic(np.diag(np.linspace(1.0, 2.0, 10)) + 0.05, linear=np.linspace(-0.3, 0.4, 10))
)
"""Each component of the gradient is a sum of ten products and a number."""
CASES = {
    "joined bonds": (co.systems.spin_lattice("ring", 12), co.Splitting(order=4, parts="bonds")),
    "bonds in a field": (
        co.systems.spin_lattice("ring", 6, field=(0.1, 0.2, 0.3), on_site=(0.1, 0.0, 0.2)),
        co.Splitting(parts="bonds"),
    ),
    "rotations in loops": (co.systems.spin_lattice("square", (4, 5), periodic=True), co.Splitting()),
    "blocks of copies": (co.systems.spin_lattice("kagome", (2, 2), dm=(0.0, 0.0, 0.3)), co.Splitting()),
    "long sums": (FULL, co.Splitting(order=4)),
    "long sums of stages": (WIDE, co.ExplicitRungeKutta()),
    "a full body": (FULL, co.Splitting(order=4, parts="free_body")),
    "a body in an unequal basis": (STRETCHED, co.Splitting(parts="free_body")),
    "monomials in loops": (QUARTIC, co.Splitting(order=4)),
    "monomials in stages": (QUARTIC, co.ExplicitRungeKutta()),
    "a lattice in stages": (co.systems.spin_lattice("cubic", (3, 3, 3), periodic=True), co.ExplicitRungeKutta()),
    "flows in loops": (co.systems.toda(12), co.Splitting(order=10)),
    "a body of eight dimensions": (co.systems.so_n_body(range(1, 9)), co.Splitting(order=2)),
    "a composition": (TOP, co.Composition(co.Splitting(), (0.25, 0.5, 0.25))),
    "a processed splitting": (TOP, co.Splitting(scheme="blanes_casas_murua6")),
    "an adjoint": (TOP, co.Splitting(order=1, adjoint=True)),
    "damping and torque": (
        BODY.with_forces(co.forces.Torque((0.1, 0.2, -0.3)), co.forces.LinearDamping((0.1, 0.2, 0.3), toward=0.1)),
        co.Splitting(order=4),
    ),
    "damping at substeps": (TOP.with_forces(co.forces.LinearDamping(0.3)), co.Splitting(order=6)),
    "damping of stages": (BODY.with_forces(co.forces.LinearDamping(0.3)), co.ExplicitRungeKutta()),
}


GROWING = co.LiePoissonSystem(
    co.algebras.change_of_basis(co.algebras.sl(2), [[1, 0, 0], [0, 1, 1], [0, 1, -1]]),
    co.Quadratic(np.zeros(3), linear=[0.0, 1.0, 0.0]),
)
ACTED = co.LiePoissonSystem(
    co.LieAlgebra([(0, 1, 2, 3.0), (0, 2, 1, -3.0), (0, 1, 3, 1.0), (0, 3, 2, 1.0), (0, 3, 3, 2.0)], dim=4),
    co.Quadratic(np.zeros(4), linear=[1.0, 0.0, 0.0, 0.0]),
)
"""One element acts on three by a general matrix: a series."""
SCALED = co.LiePoissonSystem(co.algebras.get("A4_12"), co.Quadratic(np.zeros(4), linear=[0.0, 0.0, 1.0, 0.0]))
SERIES = co.LiePoissonSystem(co.algebras.get("gl(n)", n=3), co.Quadratic(np.eye(9) + 0.1))
FAR_RUNS = {
    "angles": (TOP, co.Splitting(), 1e4, 1.0, 4),
    "far angles": (BODY, co.Splitting(), 1.0, 1e9, 4),
    "a body": (TOP, co.Splitting(parts="free_body"), 2.0, 4.0, 4),
    "growth": (co.systems.lorenz_1960(), co.Splitting(), 0.05, 1.0, 4),
    "hyperbolic growth": (GROWING, co.Splitting(), 710.0, 1e-304, 1),
    "exponential growth": (SCALED, co.Splitting(), 707.3, 1e-300, 1),
    "series": (ACTED, co.Splitting(), 2.0, 1.0, 4),
    "squared exponentials": (ACTED, co.Splitting(), 40.0, 1.0, 1),
    "stages": (TOP, co.ExplicitRungeKutta(), 0.05, 1.0, 2000),
}
"""System, scheme, step, size of the state, and steps."""


def state_of(system, seed=0, size=1.0):
    x = size * np.random.default_rng(seed).standard_normal(system.dim)
    if "z" in system.casimirs:
        x[np.argmax(np.abs(system.casimirs["z"].gradient(x)))] = 1.0
    return x


@pytest.mark.thinned(14)
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("name", co.systems.names())
def test_ready_made_systems_have_the_bits_of_the_library(name, scheme, tmp_path):
    """Or what they have and C has not is named."""
    system = getattr(co.systems, name)()
    try:
        prepared = co.prepare(system, scheme, step=0.05)
        co.export_c(prepared, tmp_path / "tried.h")
    except (TypeError, ValueError) as reason:
        assert name in str(reason) or str(type(scheme).__name__) in str(reason) or "rational" in str(reason)
        return
    check_run(prepared, state_of(system), 8, tmp_path / "run", FIRST)


CASES |= {
    f"compensated sums of {name}": (system, co.Splitting(order=2, compensated=True, **given))
    for name, system, given in (
        ("rotations and shears", TOP, {}),
        ("bodies", TOP, {"parts": "free_body"}),
        ("a body in an unequal basis", STRETCHED, {"parts": "free_body"}),
        ("bonds", co.systems.spin_lattice("ring", 12), {"parts": "bonds"}),
        ("cubic blocks", FULL, {}),
        ("growth", co.systems.lorenz_1960(), {}),
        ("series", SERIES, {}),
        ("rational rotations", FULL, {"rotation": "rational"}),
    )
}


@pytest.mark.thinned(7)
@pytest.mark.parametrize("name", CASES)
def test_every_kind_of_flow_has_the_bits_of_the_library(name, tmp_path):
    system, scheme = CASES[name]
    prepared = co.prepare(system, scheme, step=0.05)
    exported = check_run(prepared, state_of(system), 6, tmp_path, FIRST)
    check_run(prepared, state_of(system, 1), 3, tmp_path, FIRST, h=-0.05) if "damping" not in name else None
    assert max(map(len, exported.header.read_text().splitlines())) <= 120


ATTITUDES = {
    "rotations and shears": (TOP, co.Splitting(order=4), True),
    "in the coadjoint representation": (TOP, co.Splitting(order=4), "coadjoint"),
    "compensated sums": (TOP, co.Splitting(compensated=True), True),
    "a free body": (BODY, co.Splitting(parts="free_body"), True),
    "a full body": (FULL, co.Splitting(parts="free_body"), True),
    "a body in an unequal basis": (STRETCHED, co.Splitting(parts="free_body"), "coadjoint"),
    "a top as a body": (TOP, co.Splitting(order=4, parts="free_body"), True),
    "many flows": (TOP, co.Splitting(scheme="blanes_casas_murua6"), True),
    "rational rotations": (TOP, co.Splitting(rotation="rational"), True),
}


@pytest.mark.parametrize("name", ATTITUDES)
def test_attitudes_have_the_bits_of_the_library(name, tmp_path):
    system, scheme, attitude = ATTITUDES[name]
    prepared = co.prepare(system, scheme, step=0.05, attitude=attitude)
    exported, x0 = RunInC(prepared, tmp_path, FIRST), state_of(system)
    sol = prepared.run(x0, (0.0, 8 * 0.05))
    for steps in (0, 1, 2, 8):
        A = np.ascontiguousarray(sol.attitude[0])
        assert_same(exported.call("run_with_attitude", x0, 0.05, A=A, steps=steps), sol.x[steps])
        assert_same(A, sol.attitude[steps])
    assert np.abs(sol.attitude[8] - sol.attitude[0]).max() > 0.05


def drawn_run(seed, folder):
    """Return a random run that can be exported, and its state."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            (system,), method = some_systems(rng, 1), some_method(rng)
            x0, step = rng.standard_normal(system.dim) * 10.0 ** rng.choice([-3, 0, 0, 1]), rng.choice([0.02, 0.1, 0.5])
            prepared = co.prepare(system, method, step=float(step))
            co.export_c(prepared, folder / "tried.h")
            prepared.run(x0, (0.0, 5 * prepared.step))
            return prepared, x0
        except (*REFUSALS, co.IntegrationError):
            continue  # refusals are tested below, and failed runs have no bits


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning")
@pytest.mark.thinned(1)
@pytest.mark.parametrize("seed", long_beyond(4, range(200)))
def test_drawn_runs_have_the_bits_of_the_library(seed, tmp_path):
    """From both compilers at every level, with fused products of the processor and without."""
    prepared, x0 = drawn_run(seed, tmp_path)
    check_run(prepared, x0, 5, tmp_path / "run", BUILDS[seed % len(BUILDS)], tangent=prepared.system.dim < 15)


@pytest.mark.thinned(3)
@pytest.mark.parametrize(Build._fields, long_between(14, [*BUILDS, *builds("c++")]))
def test_compilers_give_the_same_bits(compiler, level, native, language, tmp_path):
    """Angles beyond any reduction, exponentials that overflow, long bodies, squared exponentials, and stages."""
    for name, (system, scheme, step, size, steps) in FAR_RUNS.items():
        prepared = co.prepare(system, scheme, step=step)
        build = Build(compiler, level, native, language)
        exported = RunInC(prepared, tmp_path / name.replace(" ", "_"), build, tangent=False)
        x0 = state_of(system, 3, size)
        assert_same(exported.call("run", x0, step, steps=steps), prepared.end(x0, (0.0, steps * step)))


def test_inputs_are_arguments(tmp_path):
    """Coefficients of the linear term and torques, in the order in which they were prepared."""
    rng = np.random.default_rng(2)
    u, x0 = rng.standard_normal(6), state_of(TOP)
    for scheme in (co.Splitting(order=4), co.ExplicitRungeKutta()):
        prepared = co.prepare(TOP, scheme, step=0.05, inputs=True)
        check_run(prepared, x0, 5, tmp_path / scheme.__class__.__name__, FIRST, u=u, linear=u)
    prepared = co.prepare(TOP, co.Splitting(parts="free_body"), step=0.05, inputs={"g": (4, 3)})
    exported = check_run(prepared, x0, 5, tmp_path / "some", FIRST, u=u[:2], g=u[:2])
    assert "g from u[0] on" in exported.header.read_text()
    forced = BODY.with_forces(co.forces.Torque((0.1, 0.2, -0.3)), co.forces.LinearDamping(0.1))
    prepared = co.prepare(forced, co.Splitting(), step=0.05, inputs={"wheel": "Torque", "spin": (1,)})
    exported = check_run(prepared, x0[:3], 5, tmp_path / "forces", FIRST, u=u[:4], wheel=u[:3], spin=u[3:4])
    text = " ".join(exported.header.read_text().split())
    assert "wheel from u[0] on, spin from u[3] on" in text and "const double u[4]" in text
    prepared = co.prepare(forced, co.Splitting(order=4), step=0.05, inputs={"wheel": "Torque", "spin": (1,)})
    check_run(prepared, x0[:3], 5, tmp_path / "substeps", FIRST, u=u[:4], wheel=u[:3], spin=u[3:4])


def test_repeated_steps_are_runs_of_one_step(tmp_path):
    """The flows between two steps are joined in a run alone: its end differs by rounding."""
    prepared = co.prepare(TOP, co.Splitting(order=4), step=0.05)
    exported = RunInC(prepared, tmp_path, FIRST, tangent=False)
    state = expected = state_of(TOP)
    for _ in range(20):
        state, expected = exported.call("step", state, 0.05), prepared.end(expected, (0.0, 0.05))
        assert_same(state, expected)
    end = exported.call("run", state_of(TOP), 0.05, steps=20)
    assert 0 < np.abs(end - state).max() < 1e-13
    assert_same(exported.call("run", state, 0.05, steps=0), state)
    other = co.prepare(TOP, co.Splitting(order=4), step=0.03)
    assert_same(exported.call("run", state, 0.03, steps=4), other.end(state, (0.0, 0.12)))


def test_flows_that_are_too_long_are_nan(tmp_path):
    """Where the library raises an error."""
    for name, (system, step, size) in {
        "bodies": (BODY, 1e11, 1.0),
        "series": (SERIES, 1e6, 3.0),
    }.items():
        scheme = co.Splitting(parts="free_body" if name == "bodies" else "auto")
        prepared = co.prepare(system, scheme, step=step)
        x0 = state_of(system, 1, size)
        with pytest.raises(co.IntegrationError):
            prepared.end(x0, (0.0, step))
        assert not np.isfinite(RunInC(prepared, tmp_path / name, FIRST).call("step", x0, step)).all()


@pytest.mark.parametrize("count", long_beyond(1, (20_000, 1_000_000)))
def test_fused_products_by_integers_are_rounded_once(count, tmp_path):
    """Numbers of any size, subnormal results, cancellation, and ties."""
    header = co.export_c(co.prepare(BODY, co.Splitting(), step=0.1), tmp_path / "own.h")
    source = header.with_name("fused.c")
    source.write_text(
        '#include "own.h"\ndouble fused(double a, double b, double c);\n'
        "double fused(double a, double b, double c) { return own_fma(a, b, c); }\n"
    )
    call = library(FIRST.compiler, source, tmp_path / "fused.so", "-O2").fused
    given = library(FIRST.compiler, source, tmp_path / "given.so", "-O2", "-DOWN_FMA=fma").fused
    for function in (call, given):
        function.restype, function.argtypes = c_double, [c_double] * 3
    rng = random.Random(1)

    def drawn(low, high):
        return math.ldexp(
            rng.choice((rng.uniform(-2, 2), rng.choice((1.0, -1.5, 1 + 2.0**-52)))), rng.randint(low, high)
        )

    compared = 0
    for k in range(count):
        a, b = drawn(-560, 500), drawn(-560, 500)
        near = -a * b * (1 + rng.randint(-2, 2) * 2.0**-52)
        far = math.ldexp(near, min(rng.randint(-130, 130), 1000 - math.frexp(near)[1]))
        c = (drawn(-1074, 1000), near, far, 0.0)[k % 4]
        exact = Fraction(a) * Fraction(b) + Fraction(c)
        if exact and abs(exact) < Fraction(2) ** 1023:
            assert call(a, b, c) == float(exact) == given(a, b, c), (a, b, c)
            compared += 1
    assert compared > 0.7 * count
    special = (0.0, -0.0, 1.0, -2.5, 5e-324, -1e308, math.inf, -math.inf, math.nan)
    for a, b, c in itertools.product(special, repeat=3):
        found = call(a, b, c)
        if not (a and b and math.isfinite(a) and math.isfinite(b)):
            expected = a * b + c
        elif not (c and math.isfinite(c)):
            expected = c or a * b
        else:
            continue
        assert np.array([found]).tobytes() == np.array([expected]).tobytes() or math.isnan(found + expected)
        assert math.isnan(found) == math.isnan(expected)


@pytest.mark.skipif("gcc" not in compilers(), reason="needs GCC and nm")
def test_exported_code_needs_only_square_roots(tmp_path):
    """And the copies of memory that any compiler may call."""
    prepared = co.prepare(TOP, co.Splitting(parts="free_body"), step=0.05)
    header = co.export_c(prepared, tmp_path / "own.h", tangent=True)
    source = header.with_name("calls.c")
    source.write_text(
        '#include "own.h"\nvoid calls(double *x, double *v);\n'
        "void calls(double *x, double *v) { own_run(x, 0.1, 9); own_step_with_tangents(x, v, 1, 0.1); }\n"
    )
    target = compiled("gcc", source, tmp_path / "calls.o", "-c", "-O2", "-fno-pic")
    needed = subprocess.run(["nm", "-u", target], capture_output=True, text=True, check=True).stdout.split()
    assert set(needed) - {"U", "w"} <= {"sqrt", "memset", "memcpy"}
    assert "malloc" not in header.read_text()


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs the package ziglang")
@pytest.mark.parametrize(
    ("system", "scheme", "most"),
    [(BODY, co.Splitting(), 6000), (TOP, co.ExplicitRungeKutta(), 5000), (TOP, co.Splitting(parts="free_body"), 13000)],
)
def test_microcontrollers(system, scheme, most, tmp_path):
    """Without any header but those of the compiler, in a few thousand bytes of a Cortex-M4."""
    header = co.export_c(co.prepare(system, scheme, step=0.1), tmp_path / "own.h")
    source = header.with_name("main.c")
    source.write_text('#include "own.h"\nvoid run(double *x);\nvoid run(double *x) { own_run(x, OWN_STEP, 100); }\n')
    command = [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined", *STRICT["c"], "-Os", "-ffreestanding"]
    command += ["-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4", "-c", str(source)]
    target = tmp_path / "main.o"
    done = subprocess.run([*command, "-o", str(target)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert target.stat().st_size < 2 * most


@pytest.mark.parametrize(
    ("name", "option"),
    [(name, "-ffast-math") for name in compilers()]
    + [
        ("gcc", option)
        for option in ("-funsafe-math-optimizations", "-freciprocal-math", "-fno-signed-zeros", "-ffinite-math-only")
        if "gcc" in compilers()
    ],
)
def test_options_that_change_sums_are_refused(name, option, tmp_path):
    header = co.export_c(co.prepare(BODY, co.Splitting(), step=0.1), tmp_path / "own.h")
    source = header.with_name("main.c")
    source.write_text('#include "own.h"\nint main(void) { return 0; }\n')
    done = subprocess.run(
        [*compilers()[name], option, str(source), "-o", str(tmp_path / "main"), "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0 and "-ffast-math" in done.stderr


def test_several_exports_share_a_file(tmp_path):
    """Also if their names differ in case alone or begin with one another, with the header of free bodies, which the
    derivative of a body contains, and included twice.
    """
    prepared = co.prepare(TOP, co.Splitting(parts="free_body"), step=0.05)
    forced = co.prepare(TOP.with_forces(co.forces.LinearDamping((0.1,) * 3 + (0,) * 3)), co.Splitting(4), step=0.05)
    names = ("one", "two", "Two", "TWO", "one_inner", "one_run", "one_free", "a")
    for name in names:
        co.export_c(
            prepared if name in ("one", "one_free") else forced, tmp_path / f"_{name}.h", name=name, tangent=True
        )
    subprocess.run(
        [sys.executable, "-m", "coadjoint", "export", "--free-body", "-o", str(tmp_path / "coadjoint.h")], check=True
    )
    source = tmp_path / "main.c"
    files = [f"_{name}" for name in names]
    includes = "".join(f'#include "{name}.h"\n' for name in (*files, "coadjoint", *files))
    calls = " ".join(f"{name}_step(x, 0.1); {name}_run(x, 0.1, 2);" for name in names)
    source.write_text(f"{includes}int main(void) {{ double x[6] = {{1}}; {calls} return 0; }}\n")
    for language in ("c", "c++"):
        compiled(FIRST.compiler, source, tmp_path / "main", language=language)


@pytest.mark.skipif("gcc" not in compilers(), reason="needs GCC")
def test_the_example_of_the_page(tmp_path, monkeypatch):
    """The configuration, the command and the program, as they are written there."""
    page = (Path(__file__).parents[3] / "docs" / "c.md").read_text(encoding="utf-8")
    texts = [re.search(rf"```{kind}\n(.*?)```", page, re.DOTALL)[1] for kind in ("toml", "sh", "c", "text")]
    (tmp_path / "top.toml").write_text(texts[0])
    monkeypatch.chdir(tmp_path)
    subprocess.run([sys.executable, "-m", *texts[1].split()], check=True, capture_output=True)
    (tmp_path / "spin.c").write_text(texts[2])
    program = compiled("gcc", tmp_path / "spin.c", tmp_path / "spin", "-O2")
    assert subprocess.run([program], capture_output=True, text=True, check=True).stdout == texts[3]
