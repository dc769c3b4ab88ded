"""Members of ensembles equal their single runs: group elements, observables, variable steps, branches and matrices."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.files.archives.archived_run import FIRST_ADVANCE
from coadjoint.systems.matrices.streams import Weights

from .schemes_under_test import schemes, serves

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 3.0))
STARTS = np.random.default_rng(8).uniform(-1.0, 1.0, (11, 3))


def same(found, wanted):
    np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted))


@pytest.mark.parametrize("units", [{0}, {1}, {0, 2}, {1, 2}, set()], ids=str)
@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2), co.Taylor(order=8)], ids=str)
def test_initial_elements_at_and_off_the_unit(units, method):
    turned = [expm(0.3 * (m + 1) * BODY.representation[m % 3]) for m in range(3)]
    start = np.stack([np.eye(3) if m in units else g for m, g in enumerate(turned)])
    whole = co.integrate(BODY, STARTS[:3], (1.0, 3.0), 0.125, method, attitude=start, save_every=5)
    for m in range(3):
        alone = co.integrate(BODY, STARTS[m], (1.0, 3.0), 0.125, method, attitude=start[m], save_every=5)
        same(whole.attitude[:, m], alone.attitude)
        exact = BODY.exact(STARTS[m], whole.t - 1.0, attitude=start[m])[1]
        assert np.abs(alone.attitude - exact).max() < 0.05  # of its own start: another one is off by 0.3


@pytest.mark.parametrize("span", [(0.0, 2.0), (1.5, 3.5), (1.5, -0.5)])
@pytest.mark.parametrize("members", [1, 2, 5, 11])
def test_time_dependent_observables_of_members(members, span):
    def clock(x, t):
        return x[0] + 10.0 * t

    given = {"observe": {"clock": clock}, "save_every": 3}
    whole = co.integrate(BODY, STARTS[:members], span, 0.125, co.Splitting(), **given)
    for m in range(members):
        alone = co.integrate(BODY, STARTS[m], span, 0.125, co.Splitting(), **given)
        same(whole.observed["clock"][:, m], alone.observed["clock"])
    np.testing.assert_allclose(whole.observed["clock"], whole.x[..., 0] + 10.0 * whole.t[:, None], rtol=0, atol=1e-13)


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", ["so(3)", "so(4)", "e(3)"])
@pytest.mark.parametrize("members", [2, 5, 9])
def test_variable_steps_in_pieces(tmp_path, name, members):
    """Between two pieces of a member the loop advances others; the archive has several pieces."""
    g = {"so(3)": co.algebras.so(3), "so(4)": co.algebras.so(4), "e(3)": co.algebras.e(3)}[name]
    system = co.LiePoissonSystem(g, co.Quadratic(np.linspace(0.4, 1.7, g.dim)), sign=-1)
    x0 = np.random.default_rng(3).uniform(-1.0, 1.0, (members, g.dim)) * (1 + np.arange(members) / 8)[:, None]
    method, span, step = co.Taylor(tolerance=1e-8), (0.0, 4.0), 2.0**-7
    assert span[1] / step > 2 * FIRST_ADVANCE
    times = np.sort(np.random.default_rng(4).uniform(*span, 40))
    ways = {
        "saved": {"save_every": 1},
        "archive": {"save_every": 1, "archive": tmp_path / "run.zarr"},
        "progress": {"save_every": 1, "progress": True},
        "t_eval": {"t_eval": times},
        "events": {"save_every": 1, "events": [co.Event(0, name="first")]},
    }
    for way, given in ways.items():
        whole = co.integrate(system, x0, span, step, method, threads=1, **given)
        for m in (0, members - 1):
            alone = co.integrate(
                system, x0[m], span, step, method, **{k: v for k, v in given.items() if k != "archive"}
            )
            np.testing.assert_array_equal(whole.x[:, m], alone.x, err_msg=way)


@dataclass(frozen=True)
class Euler(co.methods.StepMethod):
    """Explicit Euler steps, which preserve no invariant."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.vector_field(x, t)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("members", [1, 3, 9])
@pytest.mark.parametrize(
    ("method", "step"), [(Euler(), 0.25), (co.Taylor(order=2), 0.5), (co.GaussLegendre(1), 0.5)], ids=str
)
def test_multivalued_casimirs_in_pieces(tmp_path, members, method, step):
    """The angle in a Casimir winds; each piece continues on the branch of the one before."""
    system = co.LiePoissonSystem(co.algebras.get("A4,6", a=1.0, b=0.0), co.Quadratic((0.0,) * 4, linear=(0, 0, 0, 1.0)))
    [(name, casimir)] = [one for one in system.casimirs.items() if getattr(one[1], "period", 0.0)][:1]
    x0 = np.random.default_rng(9).uniform(0.2, 0.8, (members, 4))
    given = {"t_span": (0.0, 640 * step), "step": step, "method": method, "threads": 1}
    plain = co.integrate(system, x0, **given)
    archived = co.integrate(system, x0, **given, archive=tmp_path / "run.zarr")
    shown = co.integrate(system, x0, **given, progress=True)
    sparse = co.integrate(system, x0, **given, save_every=16)
    for other in (archived, shown):
        same(other.casimirs[name], plain.casimirs[name])
    same(sparse.casimirs[name], plain.casimirs[name][::16])
    # Without its branch, it would jump after half a period.
    changes = np.diff(plain.casimirs[name], axis=0)
    assert np.abs(changes).max() < casimir.period / 8
    assert np.abs(plain.casimirs[name][-1] - plain.casimirs[name][0]).min() > 2 * casimir.period


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(3), co.Taylor(order=12)], ids=str)
@pytest.mark.parametrize("direction", [-1, 0, 1])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_zero_at_a_step_is_one_crossing(method, direction, sense):
    """x1 moves by exactly 1/4 in a step: it is zero after four of eight steps."""
    line = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[0.0, sense, 0.0]))
    x0 = np.array([-sense, 0.0, 1.0])
    run = co.integrate(system, x0, (0.0, 2.0), 0.25, method, events=[co.Event(0, direction=direction)])
    assert run.x[4, 0] == 0.0, "this case must be zero at the step"
    wanted = [] if direction == -sense else [1.0]
    assert run.events.t.tolist() == wanted and run.events.direction.tolist() == [int(sense)] * len(wanted)


@pytest.mark.thinned(14)
@pytest.mark.parametrize("N", [31, 32, 33, 34, 35, 47, 64, 65, 66, 67, 70])
@pytest.mark.parametrize("kind", ["so", "u"])
def test_matrix_steps_of_odd_sizes(kind, N):
    """Against dense linear algebra."""
    rng = np.random.default_rng(N)
    weights = rng.uniform(0.5, 1.5, (N, N))
    algebra = co.MatrixAlgebra(kind, N)
    # A function is compiled for each size; real matrices have one.
    weights += weights.T
    system = co.MatrixSystem(algebra, Weights(weights) if kind == "u" else lambda W: weights * W)
    W = algebra.projected(rng.standard_normal((N, N)) + (1j * rng.standard_normal((N, N)) if kind == "u" else 0.0))
    W /= np.abs(np.linalg.eigvals(W)).max()
    h = 0.125
    end = co.integrate(system, W, (0.0, h), h, co.IsospectralGauss()).x[-1]
    np.testing.assert_allclose(end, co.IsospectralGauss().step(system, W, 0.0, h), rtol=0, atol=1e-13)
    assert np.abs(end - W).max() > 1e-3
    np.testing.assert_allclose(algebra.projected(end), end, rtol=0, atol=1e-13)


@pytest.mark.thinned(8)
@pytest.mark.parametrize("kind", ["so", "su", "u"])
@pytest.mark.parametrize("N", [3, 5, 8])
@pytest.mark.parametrize("stream", ["none", "function", "weights"])
def test_constant_part_of_the_stream(kind, N, stream):
    """It rotates the matrix by its exponential; a stream that commutes with the matrix has no effect."""
    rng, algebra = np.random.default_rng(N), co.MatrixAlgebra(kind, N)
    drawn = rng.standard_normal((2, N, N)) + (1j * rng.standard_normal((2, N, N)) if kind != "so" else 0.0)
    W, field = algebra.projected(drawn)
    streams = {"none": lambda W: 0.0 * W, "function": lambda W: W, "weights": Weights(np.full((N, N), 0.5))}
    system = co.MatrixSystem(algebra, streams[stream], linear=0.3 * field)
    end = co.integrate(system, W, (0.0, 0.125), 0.125, co.IsospectralGauss(2)).x[-1]
    formula = co.IsospectralGauss(2).step(system, W, 0.0, 0.125)
    np.testing.assert_allclose(end, formula, rtol=0, atol=1e-13 * np.abs(W).max())
    turned = expm(system.energy_sign * 0.125 * 0.3 * field)
    either = [turned @ W @ turned.conj().T, turned.conj().T @ W @ turned]
    # By either sign, which the formula settles; order 4.
    assert min(np.abs(end - exact).max() for exact in either) < 1e-3 * np.abs(W).max()
    assert np.abs(end - W).max() > 1e-2 * np.abs(W).max()


class Explicit(co.methods.StepMethod):
    """Steps with the structure matrix itself, falsely declared symmetric so that they can be composed."""

    order, explicit, symmetric = 2, True, True

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.structure_matrix(x) @ np.arange(1.0, len(x) + 1.0) + h * t * x


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("g", [co.algebras.so(3), co.algebras.e(3), co.algebras.get("A5,3")], ids=str)
@pytest.mark.parametrize("composed", [False, True])
def test_compiled_python_steps_use_structure_matrix_and_time(g, sign, composed):
    system = co.LiePoissonSystem(g, co.Quadratic(1.0), sign=sign)
    base, x0, h = Explicit(), np.linspace(0.3, 0.8, g.dim), 0.125
    method = co.Composition(base, (0.25, 0.5, 0.25)) if composed else base
    found = co.integrate(system, x0, (2.0, 2.5), h, method).x
    x, t, wanted = x0, 2.0, [x0]
    for _ in range(4):
        for part in (0.25, 0.5, 0.25) if composed else (1.0,):
            x, t = base.step(system, x, t, part * h), t + part * h
        wanted.append(x)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)


ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "su(2)": co.algebras.su(2),
    "e(3)": co.algebras.e(3),
    "so(4)": co.algebras.so(4),
    "su(3)": co.algebras.su(3),
    "three so(3)": co.algebras.copies(co.algebras.so(3), 3),
    "A4,8": co.algebras.get("A4,8"),
}
MAGNITUDES = np.array(
    [1.0, 1e-300, 30.0, 1e3, 1e-8, 3.0, 1e4, 0.0, 1e6, 100.0, 1e-3, 10.0, 1e5, 300.0, 3e3, 1e-160, 0.3]
)
IMPLICIT = [name for name, method in schemes().items() if not method.explicit]


def attempt(*args, **options):
    """Return the solution, or what there is of it."""
    try:
        return co.integrate(*args, **options)
    except co.IntegrationError as error:
        return error.partial


@pytest.mark.thinned(6)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("algebra", ALGEBRAS)
@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("scheme", IMPLICIT)
def test_implicit_schemes_at_every_magnitude(scheme, isotropic, algebra):
    """Iterations end at round-off, by Newton's method or at their limit, whatever the neighbours and the attitude.

    The isotropic H leaves momenta where they are, up to round-off, and turns the group element by angles of any size.
    """
    g, method = ALGEBRAS[algebra], schemes()[scheme]
    rng = np.random.default_rng(5)
    B = rng.standard_normal((g.dim, g.dim))
    H = co.Quadratic(0.3357900246) if isotropic else co.Quadratic((B + B.T) / (2 * np.sqrt(g.dim)) + np.eye(g.dim))
    system = co.LiePoissonSystem(g, H)
    if not serves(method, system):
        pytest.skip("another system")
    x0 = MAGNITUDES[:, None] * rng.standard_normal((len(MAGNITUDES), g.dim))
    given = (0.0, 1.8), 0.3, method
    options = {"threads": 1, "watch": False}
    plain = attempt(system, x0, *given, **options)
    assert np.isfinite(plain.x[-1]).any(), "every member fails"
    attitudes = [False] if method.properties(system).attitude == "none" else [False, "coadjoint"]
    for attitude in attitudes:
        whole = attempt(system, x0, *given, attitude=attitude, **options)
        # A group element may overflow where the momentum does not.
        reached = np.isfinite(whole.x)
        same(whole.x[reached], plain.x[reached])
        for part in [slice(None, None, -1), *(slice(0, count) for count in (3, 4, 7, 8, 9))]:
            other = attempt(system, x0[part], *given, attitude=attitude, **options)
            same(other.x, whole.x[:, part])
            if attitude:
                same(other.attitude, whole.attitude[:, part])
        for m in range(len(x0)):
            alone = attempt(system, x0[m], *given, attitude=attitude, **options)
            same(alone.x, whole.x[: len(alone.t), m])
            assert np.isnan(whole.x[len(alone.t) :, m]).all()
            if attitude:
                same(alone.attitude, whole.attitude[: len(alone.t), m])
