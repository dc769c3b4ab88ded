"""Parts of runs as operations of JAX: every kind of block, sparse products, and segments of scans."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
jnp = jax.numpy

from coadjoint.runs.derivatives import xla_run, xla_sparse  # noqa: E402


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


# The algebra so(2,1) in a basis of a rotation and two boosts.
BOOSTS = co.LieAlgebra([(0, 1, 2, -1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3)


def kinds_of_blocks():
    """Return a system whose parts turn, boost, grow, and are nilpotent up to the third degree."""
    algebra = co.algebras.direct_sum(BOOSTS, co.algebras.get("A5,2"), co.algebras.get("A3,7", a=0.5))
    n = algebra.dim
    return co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(0.3, 1.0, n), np.linspace(-0.2, 0.3, n)), sign=-1)


def test_blocks_of_every_kind_have_the_flows_and_derivatives_of_the_compiled_run():
    h = -0.5
    ready = co.prepare(kinds_of_blocks(), co.Splitting(order=1), abs(h))
    x0 = 0.7 * np.cos(1.0 + np.arange(ready.system.dim))
    f = co.jax.solution(ready, (1.0, 1.0 + 2 * h), backend="xla")
    sol, pullback = ready.vjp(x0, (1.0, 1.0 + 2 * h))
    weights = np.sin(np.arange(sol.x.size)).reshape(sol.x.shape)
    x, transposed = jax.vjp(f, x0)
    size = max(1.0, np.abs(sol.x).max())
    np.testing.assert_allclose(x, sol.x, rtol=0, atol=2.0**8 * UNIT_ROUNDOFF * size)
    wanted = pullback(weights)["x0"]
    np.testing.assert_allclose(
        transposed(jnp.array(weights))[0], wanted, rtol=0, atol=2.0**10 * UNIT_ROUNDOFF * np.abs(wanted).max()
    )


@pytest.mark.parametrize("most_dense", [0, 2**12])
def test_sparse_products_are_those_of_the_matrix(monkeypatch, most_dense):
    """Rows of different lengths, an empty one and entries in any order."""
    monkeypatch.setattr(xla_sparse, "MOST_DENSE", most_dense)
    rng = np.random.default_rng(3)
    dense = rng.standard_normal((5, 7)) * (rng.random((5, 7)) < 0.5)
    dense[2] = 0.0
    dense[4, [0, 6]] = 1.0, 2.0
    rows, columns = np.nonzero(dense)
    order, x = rng.permutation(len(rows)), rng.standard_normal(7)
    rows, columns = rows[order], columns[order]
    matrix = xla_sparse.sparse(rows, columns, jnp.array(dense[rows, columns]), dense.shape)
    assert (matrix.columns is None) == (most_dense > 0)
    np.testing.assert_allclose(matrix.times(jnp.array(x)), dense @ x, rtol=0, atol=16 * UNIT_ROUNDOFF)


@pytest.mark.parametrize("count", [15, 97, 10007])
def test_segments_of_scans_do_not_change_the_results(count):
    """Prime numbers of steps leave a rest after the segments."""

    def body(x, k):
        return jnp.cos(x + k), x[0] * k

    def total(scan, x):
        carry, ys = scan(body, x, 0.001 * jnp.arange(count))
        return carry.sum() + (ys * jnp.arange(count)).sum() / count**2

    x0 = jnp.array([0.1, 0.4])
    found = jax.value_and_grad(lambda x: total(xla_run.scan_in_segments, x))(x0)
    wanted = jax.value_and_grad(lambda x: total(jax.lax.scan, x))(x0)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)


def test_output_times_on_steps_take_no_partial_steps():
    ready = co.prepare(co.systems.rigid_body((1, 2, 2.5)), co.Splitting(order=1), 0.25)
    times, x0 = [1.0, 1.5, 1.75, 3.0], np.array([1.0, 0.2, 0.5])
    f = co.jax.solution(ready, (1.0, 4.0), t_eval=times, backend="xla")
    np.testing.assert_allclose(f(x0), ready.run(x0, (1.0, 4.0), t_eval=times).x, rtol=0, atol=1e-14)
