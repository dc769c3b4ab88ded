"""The exported header of free bodies against 60 digits, in both precisions, and its invariants."""

import math
import re
import shutil
import subprocess
from ctypes import c_double, c_float, c_void_p
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp

from c_compilers import compiled, compilers
from exact_body import exact_motion, taylor_motion
from exported_body import UNITS, Body, error, exact, exact_derivatives, export_header, matrix_of
from long import long_between, long_beyond

if not compilers():
    pytest.skip("there is no compiler of C", allow_module_level=True)

DOCS = Path(__file__).parents[3] / "docs"
FIRST = next(iter(compilers()))
KINDS = {"double": np.float64, "float": np.float32}
# Inverse moments and momentum. The separatrix is |x|^2 m = 2 T for the middle m.
SHAPES = {
    "ball": ((1.0, 1.0, 1.0), (0.3, 0.7, -0.5)),
    "rod": ((1.0, 1.0, 0.0), (0.6, 0.8, 0.0)),
    "plate": ((2 / 3, 1.0, 0.4), (0.3, 0.7, -0.5)),
    "symmetric top": ((1.0, 0.3, 1.0), (0.3, 0.7, -0.5)),
    "nearly symmetric": ((1.0, 1 + 1e-12, 0.3), (0.3, 0.7, -0.5)),
    "nearly a ball": ((1.0, 1 + 1e-12, 1 - 2e-12), (0.3, 0.7, -0.5)),
    "separatrix": ((1.0, 2.0, 3.0), (1.0, 0.0, 1.0)),
    "separatrix, other way": ((3.0, 1.0, 2.0), (1.0, -1.0, 0.25)),
    "near the separatrix": ((1.0, 2.0, 3.0), (1.0, 1e-3, 1 + 1e-12)),
    "middle axis": ((1.0, 2.0, 3.0), (1e-9, 1.0, -1e-8)),
    "long axis": ((2.0, 1.0, 3.0), (0.0, 0.0, -1.3)),
    "near the axis of symmetry": ((-1.43875547, 0.55939662, 0.58660169), (-3.83793, 0.28704, 0.74043)),
    "any": ((0.3, 1.7, 0.9), (0.3, 0.7, -0.5)),
    "of both signs": ((-1.0, 0.4, 2.0), (0.3, 0.7, -0.5)),
    "thin rod": ((1.0, 1.0, 2.0**20), (0.3, 0.2, 2.0**-20)),
}


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return export_header(tmp_path_factory.mktemp("header"))


@pytest.fixture(scope="module")
def body(source):
    return Body(FIRST, source, source.with_name("body.so"), "-O2")


def drawn(seed, kind, spread=0.0):
    """Return inverse moments, momentum and a time of some tenths of a turn."""
    rng = np.random.default_rng(seed)
    m, x = rng.uniform(0.2, 2.0, 3), rng.standard_normal(3) * 10 ** (-spread * rng.random(3))
    return m.astype(kind), x.astype(kind), kind(rng.uniform(0.1, 3.0))


def check_motion(body, kind, m, h, x):
    """Compare momentum and rotation with 60 digits; the bound is derived on the page of the header.

    A piece adds 3 u |x| to the momentum and 10 u (1 + angle) to the rotation, and the motion carries the former on as
    it does a change of the initial momentum, by J and G.
    """
    m, x, h, u = np.array(m, kind), np.array(x, kind), kind(h), UNITS[kind]
    found = body.call("jacobian", kind, m, h, x)
    r, J, G = found.others
    assert found.pieces > 0
    with mp.workdps(40):
        length = float(np.linalg.norm(x.astype(np.float64)))
        angle = float(np.abs(m).max()) * length * abs(float(h))
        end, A = exact(m, h, x)
        n = found.pieces
        assert error(found.x, end) <= 3 * u * length * n * max(1.0, float(np.linalg.norm(J.astype(np.float64))))
        carried = 3 * n * length * float(np.linalg.norm(G.astype(np.float64))) if n > 1 else 0.0
        exact_r = np.array([mp.mpf(float(v)) for v in r])
        assert error_of(matrix_of(exact_r), A) <= u * (10 * (n + angle) + carried)
    plain = body.call("rotation", kind, m, h, x)
    if n == 1:
        assert (plain.x == found.x).all() and (plain.others[0] == r).all()


def error_of(found, wanted):
    """Return the Frobenius norm of a difference of numbers of mpmath."""
    return float(mp.sqrt(sum((a - b) ** 2 for a, b in zip(found.ravel(), wanted.ravel(), strict=True))))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("turns", [1e-8, 0.03, -0.3, *long_beyond(1, (4.0, 1e-3, -40.0, 1000.0))])
@pytest.mark.parametrize("shape", SHAPES)
def test_motion_in_60_digits(body, shape, turns, kind):
    m, x = SHAPES[shape]
    rate = np.linalg.norm(np.array(m) * x)
    limit = 3.0 if "separatrix" in shape or shape == "middle axis" else 100.0 if kind == "float" else 1000.0
    check_motion(body, KINDS[kind], m, math.copysign(min(abs(turns), limit), turns) * 2 * np.pi / rate, x)


@pytest.mark.parametrize("shape", long_beyond(2, [*SHAPES][::-1]))
def test_the_60_digits_are_those_of_taylor_series(shape):
    m, x = SHAPES[shape]
    with mp.workdps(50):
        for found, wanted in zip(exact_motion(m, x, 0.7), taylor_motion(m, x, 0.7, steps=20), strict=True):
            assert error_of(np.array(found), np.array(wanted)) < 1e-45


def longest_piece(kind, m, x):
    """Return a time of just less than one piece, or of a turn if all moments are equal."""
    piece = 0.1875 if kind == np.float64 else 0.5
    spread = float(max(m) - min(m))
    return kind(0.999 * (piece / spread if spread > 1e-6 else 6.0) / np.linalg.norm(np.array(x, np.float64)))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_longest_pieces_in_60_digits(body, shape, kind):
    """The series are cut off below rounding."""
    (m, x), kind = SHAPES[shape], KINDS[kind]
    check_motion(body, kind, m, longest_piece(kind, m, x), x)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", long_beyond(8, range(200)))
@pytest.mark.thinned(1)
def test_drawn_motions_in_60_digits(body, seed, kind):
    m, x, h = drawn(seed, KINDS[kind], spread=6.0 * (seed % 2))
    check_motion(body, KINDS[kind], m, h, x)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_in_60_digits(body, shape, kind):
    """Of one piece within 10 u of their size, of several as the derivatives of what follows carry it."""
    (m, x), kind = SHAPES[shape], KINDS[kind]
    m, x, u = np.array(m, kind), np.array(x, kind), UNITS[kind]
    turn = 2 * np.pi / np.linalg.norm(m * x)
    for h in (kind(1e-6 * turn), longest_piece(kind, m, x), kind(0.4 * turn)):
        found = body.call("jacobian", kind, m, h, x)
        J, G = exact_derivatives(m, h, x)
        for one, wanted in ((found.others[1], J), (found.others[2], G)):
            assert error(one, wanted) <= 10 * u * found.pieces * np.linalg.norm(wanted.astype(np.float64))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_momenta_and_times_of_any_size(body, kind):
    """Powers of two change no bit, from 1e-300 to 1e300 (float: 1e-37 to 1e37)."""
    kind = KINDS[kind]
    m, x, h = drawn(1, kind)
    h *= kind(8)
    wanted = body.call("jacobian", kind, m, h, x)
    assert wanted.pieces > 1
    most = 990 if kind == np.float64 else 120
    for k in (-most, -most // 2, -64, -1, 1, 64, most // 2, most):
        power = kind(2.0) ** k
        for moments, time in ((m, h / power), (m / power, h)):
            found = body.call("jacobian", kind, moments, time, x * power)
            assert found.pieces == wanted.pieces and (found.x == wanted.x * power).all()
            for one, other in zip(found.others, (*wanted.others[:2], wanted.others[2] / power), strict=True):
                assert (one == other).all()


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_tiny_motions_keep_their_digits(body, kind):
    """The rotation is m x h, J is 1 and h times the slopes of x cross w, and G is m h: to subnormal numbers."""
    kind = KINDS[kind]
    m, x, tiny = np.array((1.0, 0.5, 0.25), kind), np.array((3.0, -5.0, 7.0), kind), np.finfo(kind).tiny
    for h, scale in ((kind(2.0) ** -20, tiny), (kind(1.0), tiny * 16), (tiny * 1024, kind(1.0)), (kind(1.0), 0)):
        found = body.call("jacobian", kind, m, h, x * scale)
        r, J, G = found.others
        assert found.pieces == 1 and (found.x == x * scale).all() and r[0] == 1
        near = {"rtol": 8 * np.finfo(kind).eps, "atol": 2 * np.finfo(kind).smallest_subnormal}
        assert np.allclose(r[1:], m * x * scale * h / 2, **near)
        y, a = x * scale, np.roll(m, 1) - np.roll(m, 2)
        field = np.array([[0, a[0] * y[2], a[0] * y[1]], [a[1] * y[2], 0, a[1] * y[0]], [a[2] * y[1], a[2] * y[0], 0]])
        assert np.allclose(J.reshape(3, 3), np.eye(3) + h * field, **near)
        assert np.abs(G.reshape(3, 3) - np.diag(m * h)).max() <= 8 * UNITS[kind] * h


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("m", "h", "x"),
    [
        ((1, 2, 3), math.nan, (1, 1, 1)),
        ((1, 2, 3), 1.0, (1, math.nan, 1)),
        ((1, 2, math.nan), 1.0, (1, 1, 1)),
        ((1, 2, 3), -math.inf, (1, 1, 1)),
        ((1, 2, 3), 1.0, (1, math.inf, 0)),
        ((1, math.inf, 3), 1.0, (1, 1, 1)),
        ((1, 2, 3), math.inf, (0, 0, 1)),
        ((1, 2, 3), 1e10, (1, 1, 1)),
        ((1, 1, 1), 1e10, (1, 1, 1)),
        ((1, 2, 3), 1e30, (1, 1, 1e8)),
    ],
)
def test_too_long_times_are_refused(body, m, h, x, kind):
    kind = KINDS[kind]
    for name, attitude in (("step", np.eye(4)[0]), ("step_matrix", np.eye(3)), ("jacobian", np.eye(4)[0])):
        found = body.call(name, kind, m, h, x, attitude)
        assert found.pieces == 0 and np.isnan([*found.x, *np.concatenate(found.others)]).all()


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_extreme_numbers_are_refused_or_have_finite_results(body, kind):
    """Zeros, subnormal and largest numbers, infinities and NaN in every place."""
    kind, rng = KINDS[kind], np.random.default_rng(1)
    info = np.finfo(kind)
    pool = [0.0, -0.0, 1.0, -1.0, 3.3, 1e-20, 1e20, info.max, -info.max, info.tiny, info.smallest_subnormal]
    refused = 0
    for _ in range(1000):
        m, x, h = (rng.choice([*pool, math.inf, math.nan] if rng.random() < 0.1 else pool, n) for n in (3, 3, 1))
        found = body.call("jacobian", kind, m, h[0], x)
        result = np.concatenate([found.x, *found.others])
        # After many turns about the unstable axis only the derivatives are not resolved.
        assert np.isnan(result if found.pieces == 0 else result[7:]).all() or not np.isnan(result).any()
        assert found.pieces == 0 or np.isfinite([*m, *x, *h]).all()
        refused += found.pieces == 0
    assert 100 < refused < 900


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_the_longest_time(body, kind):
    """2^30 radians (float: 2^20) about the momentum, or of the momentum."""
    radians = 2**20 if kind == "float" else 2**30
    for m, rate in (((1, 1, 2), 2), ((1, 1, 1), 1), ((-1, 0, 1), 1)):
        for factor, refused in ((0.999, False), (1.001, True)):
            x = (0, 0, 1) if m[0] > 0 else (1e-9, 1, 0)
            found = body.call("rotation", KINDS[kind], m, radians / rate * factor, x)
            assert (found.pieces == 0) == refused and found.pieces <= 1500


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_steps_are_a_group(body, kind):
    """A step back ends where it began, and two steps are one."""
    kind, bound = KINDS[kind], 200 * UNITS[KINDS[kind]]
    for seed in range(20):
        m, x, h = drawn(seed, kind)
        q = np.array((0.5, -0.5, 0.5, 0.5), kind)
        there = body.call("step", kind, m, h, x, q)
        back = body.call("step", kind, m, -h, there.x, there.others[0])
        assert np.abs(back.x - x).max() <= bound and np.abs(back.others[0] - q).max() <= bound
        half = body.call("step", kind, m, h / 2, x, q)
        whole = body.call("step", kind, m, h / 2, half.x, half.others[0])
        assert np.abs(whole.x - there.x).max() <= bound and np.abs(whole.others[0] - there.others[0]).max() <= bound


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_attitudes_agree(body, kind):
    """As quaternion and as matrix, from momentum and from velocity; a matrix is made orthonormal again."""
    kind, u = KINDS[kind], UNITS[KINDS[kind]]
    for seed in range(20):
        m, x, h = drawn(seed, kind)
        q = np.array((0.5, -0.5, 0.5, 0.5), kind)
        A = matrix_of(q) + 1e-3 * math.sqrt(u) * np.random.default_rng(seed).standard_normal((3, 3))
        step = body.call("step", kind, m, h, x, 7 * q)
        A = body.call("step_matrix", kind, m, h, x, A).others[0].reshape(3, 3)
        assert np.abs(A - matrix_of(step.others[0])).max() <= 0.1 * math.sqrt(u)
        assert np.abs(A.T @ A - np.eye(3)).max() <= 4 * u
        velocity = body.call("step_velocity", kind, 1 / m, h, m * x, q)
        assert np.abs(velocity.x - m * step.x).max() <= 200 * u
        assert np.abs(velocity.others[0] - step.others[0]).max() <= 200 * u


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_a_matrix_is_made_orthonormal_or_refused(body, kind):
    """From lengths of 0.9 to 1.1, and as the same rotation; farther from a rotation it is NaN."""
    kind, u = KINDS[kind], UNITS[KINDS[kind]]
    m, x, h = drawn(4, kind)
    wanted = body.call("step_matrix", kind, m, h, x, np.eye(3, dtype=kind)).others[0].reshape(3, 3)
    for factor in (0.9, 0.999, 1.001, 1.1):
        found = body.call("step_matrix", kind, m, h, x, factor * np.eye(3, dtype=kind)).others[0].reshape(3, 3)
        assert np.abs(found.T @ found - np.eye(3)).max() <= 8 * u and np.abs(found - wanted).max() <= 16 * u
    for matrix in (1.2 * np.eye(3), 0.5 * np.eye(3), np.eye(3) + [[0, 0.4, 0], [0, 0, 0], [0, 0, 0]]):
        refused = body.call("step_matrix", kind, m, h, x, matrix.astype(kind))
        assert refused.pieces == 0 and np.isnan(refused.others[0]).all()


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_a_rod_does_not_rotate_about_itself(body, kind):
    kind = KINDS[kind]
    found = body.call("step_velocity", kind, (2, 2, 0), 0.5, (0.6, 0.8, 3), (1, 0, 0, 0))
    half = 0.25
    assert np.abs(found.x - (0.6, 0.8, 0)).max() <= 2 * UNITS[kind]
    assert (
        np.abs(found.others[0] - (math.cos(half), 0.6 * math.sin(half), 0.8 * math.sin(half), 0)).max()
        <= 4 * UNITS[kind]
    )


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind", KINDS)
def test_many_steps(body, kind):
    """After 1e5 steps the attitude is orthogonal to rounding, and the momentum in space has made a random walk."""
    kind, u, steps = KINDS[kind], UNITS[KINDS[kind]], 100_000
    m, x, q, A = (
        np.array((1, 0.6, 0.4), kind),
        np.array((0.3, 1, 0.2), kind),
        np.eye(4, dtype=kind)[0],
        np.eye(3, dtype=kind),
    )
    start = x.astype(np.float64)
    y, suffix = x.copy(), "f" if kind == np.float32 else ""
    step, with_matrix = (getattr(body.library, name + suffix) for name in ("step", "step_matrix"))
    time = (c_float if suffix else c_double)(0.1)
    of_m, of_x, of_y, of_q, of_A = (c_void_p(v.ctypes.data) for v in (m, x, y, q, A))
    for _ in range(steps):
        step(of_m, time, of_x, of_q)
        with_matrix(of_m, time, of_y, of_A)
    q, A = q.astype(np.float64), A.astype(np.float64)
    assert (x == y).all() and abs(q @ q - 1) <= 4 * u and np.abs(A.T @ A - np.eye(3)).max() <= 4 * u
    walk = 10 * u * math.sqrt(steps) + 0.1 * u * steps
    assert np.linalg.norm(A @ x - start) <= walk and np.linalg.norm(matrix_of(q) @ x - start) <= walk


def digest_of(body):
    """Return the bits of all functions on drawn bodies and times."""
    found = []
    for kind in KINDS.values():
        for seed in range(40):
            m, x, h = drawn(seed, kind, spread=3.0)
            h *= kind(10.0 ** (seed % 5 - 2))
            for name, attitude in (("step", np.eye(4)[0]), ("step_matrix", np.eye(3)), ("jacobian", np.eye(4)[0])):
                one = body.call(name, kind, m, h, x, attitude)
                found.append(b"".join(v.tobytes() for v in (one.x, *one.others)))
    return b"".join(found)


BUILDS = [(name, level, language) for language in ("c", "c++") for level in "2031" for name in compilers()]


@pytest.mark.parametrize(("compiler", "level", "language"), long_between(9, BUILDS))
@pytest.mark.thinned(1)
def test_compilers_give_the_same_bits(body, source, tmp_path, compiler, level, language):
    """At every level of optimisation, in C and in C++, also where the processor has fused products."""
    flags = (f"-O{level}", "-march=native", "-ffp-contract=off")
    built = Body(compiler, source, tmp_path / "built.so", *flags, language=language)
    assert digest_of(built) == digest_of(body)


@pytest.mark.skipif("gcc" not in compilers() or shutil.which("nm") is None, reason="needs GCC and nm")
def test_the_header_needs_only_square_roots(source, tmp_path):
    text = source.with_name("coadjoint.h").read_text()
    assert [line for line in text.splitlines() if "#include <" in line] == ["#include <math.h>"]
    target = compiled("gcc", source, tmp_path / "functions.o", "-c", "-O2", "-fno-pic")
    needed = subprocess.run(["nm", "-u", target], capture_output=True, text=True, check=True).stdout.split()
    assert set(needed) - {"U", "w"} <= {"sqrt", "sqrtf"}


def test_the_header_may_be_included_by_several_files(source, tmp_path):
    """Twice in a file, and beside macros of short names that other headers have."""
    file = source.with_name("twice.c")
    file.write_text(
        '#define I 1\n#define real 2\n#include "coadjoint.h"\n#include "coadjoint.h"\nint main(void) { return 0; }\n'
    )
    compiled(FIRST, file, tmp_path / "twice")
    text = source.with_name("coadjoint.h").read_text()
    defined = {line.split()[1].partition("(")[0] for line in text.splitlines() if line.startswith("#define")}
    kept = {line.split()[1] for line in text.splitlines() if line.startswith("#undef")}
    assert defined - kept == {"COADJOINT_H"} and all(name.lower().startswith("coadjoint_") for name in defined)


@pytest.mark.skipif("gcc" not in compilers(), reason="needs GCC")
@pytest.mark.parametrize(
    ("page", "fence", "language"), [("c", "c", "c"), ("example", "cpp", "c++"), ("tumbling_bodies", "cpp", "c++")]
)
def test_examples_of_the_pages(source, tmp_path, page, fence, language):
    """They compile as they are and print what the page, or a comment, shows."""
    if page == "example":
        code = (DOCS.parent / "examples" / "turn.cpp").read_text(encoding="utf-8")
        printed = "".join(f"{line}\n" for line in re.findall(r"^//     (.*)$", code, re.MULTILINE))
    else:
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        text = text[max(text.find("## The free body"), 0) :]
        code, printed = re.search(rf"```{fence}\n(.*?)```.*?```text\n(.*?)```", text, re.DOTALL).groups()
    example = source.with_name(f"example.{fence}")
    example.write_text(code)
    program = compiled("gcc", example, tmp_path / "example", "-O2", "-ffp-contract=off", language=language)
    assert subprocess.run([program], capture_output=True, text=True, check=True).stdout == printed


@pytest.mark.skipif(
    "gcc" not in compilers() or not all(map(shutil.which, ("ar", "rustc"))), reason="needs GCC and rustc"
)
def test_the_example_in_rust(source, tmp_path):
    text = (DOCS / "tumbling_bodies.md").read_text(encoding="utf-8")
    printed = re.search(r"```rust\n.*?```.*?```text\n(.*?)```", text, re.DOTALL)[1]
    (source.with_name("body.c")).write_text((DOCS.parent / "examples" / "body.c").read_text())
    target = compiled("gcc", source.with_name("body.c"), tmp_path / "body.o", "-c", "-O2", "-ffp-contract=off")
    subprocess.run(["ar", "rcs", tmp_path / "libbody.a", target], check=True)
    (tmp_path / "tumble.rs").write_text((DOCS.parent / "examples" / "tumble.rs").read_text())
    subprocess.run(["rustc", "-O", "tumble.rs", "-L", "."], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "tumble"], capture_output=True, text=True, check=True)
    assert done.stdout == printed
