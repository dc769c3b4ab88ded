"""High orders: sweeps, processed schemes, compositions."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.splitting_schemes import SCHEMES
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.table import build_program
from long import long_where

U = 2.0**-53
PROCESSED = ["blanes_casas_murua6", "blanes_casas_murua8", "blanes_casas_murua10"]
TOP = co.LiePoissonSystem(
    co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.375, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0]), sign=-1
)
X0 = np.array([1.0, -0.5, 1.5, 0.625, 0.0, 0.75])


@pytest.mark.parametrize("name", SCHEMES)
def test_the_sweeps_fill_one_step(name):
    """Fractions add up to one in the kernel and to none in the processor: k u of their sizes."""
    method = co.Splitting(scheme=name)
    for sweeps, whole in ((method.sweeps(), 1.0), (method.processor(), 0.0)):
        # A step of order 2 is half a sweep forward and half back: together they move every part.
        fractions = [sweep.coefficient for sweep in sweeps]
        assert abs(sum(fractions) - whole) <= max(1, len(fractions)) * U * max(1.0, sum(map(abs, fractions)))
    with mpmath.workdps(40):
        exact = co.Splitting(scheme=name).sweeps(mpmath.mpf)
        for a, b in zip(exact, method.sweeps(), strict=True):
            assert abs(a.coefficient - b.coefficient) <= 2 * U * abs(a.coefficient) and a.forward == b.forward


@pytest.mark.parametrize("name", SCHEMES)
def test_the_step_section_is_the_kernel_alone(name):
    """Between looks a processed scheme pays for the kernel, with the outer halves merged at every seam."""
    scheme, parts = SCHEMES[name], 3
    program = build_program(co.systems.paper_rigid_body(), co.Splitting(scheme=name, parts="coordinates"))
    start, step, finish = np.diff(program.rows.section).tolist()
    sweeps = len(scheme.sweeps(float))
    assert step == sweeps * (parts - 1)
    assert start == step + 2 * (parts - 1) * 2 * len(scheme.processor_half)
    assert finish == 1 + 2 * (parts - 1) * 2 * len(scheme.processor_half)


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "name", long_where(["blanes_casas_murua10"], [*PROCESSED, "sofroniou_spaletta8", "blanes_moan6"])
)
def test_start_steps_and_finish_are_single_steps_in_a_row(name):
    """P K^N P^-1 = (P K P^-1)^N, in 40 digits."""
    with mpmath.workdps(40):
        read = Interpreter(build_program(TOP, co.Splitting(scheme=name), number=mpmath.mpf))
        x = np.array([mpmath.mpf(v) for v in X0], dtype=object)
        together, single, h = read.steps(x, mpmath.mpf(0.25), 4), x, mpmath.mpf(0.25)
        for _ in range(4):
            single = read.steps(single, h, 1)
        assert np.max(np.abs(together - single)) < 1e-36


@pytest.mark.parametrize("name", PROCESSED)
def test_a_composition_of_a_processed_scheme_is_refused_by_name(name):
    with pytest.raises(ValueError, match=r"needs a symmetric base, which .*" + name + r".* is not; of a processed"):
        co.Composition(co.Splitting(scheme=name), (0.5, 0.5))


def test_a_composition_of_a_high_order():
    """Order 8 from the triple jump of the default of order 6, by its order conditions and by its slope."""
    c = 1 / (2 - 2 ** (1 / 7))
    method = co.Composition(co.Splitting(order=6), (c, 1 - 2 * c, c))
    assert (method.order, method.symmetric) == (8, True)
    with mpmath.workdps(40):
        c = 1 / (2 - mpmath.mpf(2) ** (mpmath.mpf(1) / 7))
        base = build_program(TOP, co.Splitting(order=6), number=mpmath.mpf)
        read, x0 = Interpreter(base), np.array([mpmath.mpf(v) for v in X0], dtype=object)

        def step(x, h):
            for fraction in (c, 1 - 2 * c, c):
                x = read.steps(x, fraction * h, 1)
            return x

        h = mpmath.mpf(0.125)
        x = Interpreter(method.program(TOP, number=mpmath.mpf)).steps(x0, h, 1)
        assert np.max(np.abs(x - step(x0, h))) < 1e-13  # the coefficients of a Composition are floats


@pytest.mark.parametrize("scheme", [name for name, known in SCHEMES.items() if known.processed])
def test_a_processor_is_undone_by_its_own_inverse(scheme):
    """Over a fixed time the error falls with the order: what the first step leaves of the processor would not."""
    n = 6
    rng = np.random.default_rng(1)
    B = rng.uniform(-0.25, 0.25, (n, n))
    M = np.diag(rng.uniform(0.5, 1.5, n)) + B + B.T
    system = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(M), sign=-1, casimirs={})
    x0 = rng.choice([-0.5, 0.5], n)
    exact = co.integrate(system, x0, (0.0, 2.0), 2.0**-6, co.GaussLegendre(8)).x[-1]
    method = co.Splitting(scheme=scheme)
    coarse, fine = (np.abs(co.integrate(system, x0, (0.0, 2.0), h, method).x[-1] - exact).max() for h in (0.5, 0.25))
    assert coarse / fine > 2.0 ** (method.order - 1) or fine < 2.0**-40
