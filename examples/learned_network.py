"""Learn the potential of a top as a neural network from noisy trajectories, by the weak form, and run it."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

import coadjoint as co

jax.config.update("jax_enable_x64", True)
rng, step, width = np.random.default_rng(7), 0.05, 20
s = np.linspace(-1, 1, width + 1)
bump, slope = (1 - s**2) ** 4, -8 * s * (1 - s**2) ** 3 / (width * step / 2)


def starts(count):
    """Return random momenta, and unit vectors."""
    x = rng.standard_normal((count, 6))
    return x / np.where(np.arange(6) < 3, 1, np.linalg.norm(x[:, 3:], axis=1)[:, None])


def windows(system, noise=1e-3):
    """Return samples (k, 21, 6), matrices of the integrals of ψ J(x) ∇H (k, 21, 6, 6), and those of -ψ' x (k, 6)."""
    x = co.integrate(system, starts(30), (0, 10), step, co.GaussLegendre(3)).x
    x = x + noise * rng.standard_normal(x.shape)
    x = np.lib.stride_tricks.sliding_window_view(x, width + 1, axis=0)[::width]
    x = np.moveaxis(x, -1, 2).reshape(-1, width + 1, 6)
    J = system.sign * np.array([system.algebra.structure_matrix(e) for e in np.eye(6)])
    return x, np.einsum("s,kij,wsk->wsij", bump, J, x), -np.einsum("s,wsi->wi", slope, x)


def model(w, x):
    """Return the energy: a diagonal kinetic part, and a network of two hidden layers."""
    hidden = jnp.tanh(jnp.tanh(x[3:] @ w["first"] + w["bias"]) @ w["second"] + w["shift"])
    return 0.5 * w["inverse inertia"] @ x[:3] ** 2 + hidden @ w["last"]


inertia = np.array([1.0, 2.0, 2.5])
H = co.Hamiltonian(lambda x: 0.5 * np.sum(x[:3] ** 2 / inertia) + np.cos(2 * x[5]) + x[3] * x[4])
truth = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)
sizes = {"first": (3, 16), "bias": 16, "second": (16, 16), "shift": 16, "last": 16}
start = {name: rng.standard_normal(size) / np.sqrt(np.atleast_1d(size)[0]) for name, size in sizes.items()}
start, unravel = ravel_pytree(start | {"inverse inertia": np.ones(3)})
x, A, b = windows(truth)


@jax.jit
@jax.value_and_grad
def loss(w):
    """Return the mean square of the residuals of the weak form."""
    gradients = jax.vmap(jax.vmap(lambda x: jax.grad(model, 1)(unravel(w), x)))(x)
    return jnp.mean((jnp.einsum("wsij,wsj->wi", A, gradients) - b) ** 2)


end = minimize(lambda w: tuple(map(np.asarray, loss(w))), start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
w = unravel(end.x)
assert np.allclose(1 / w["inverse inertia"], inertia, rtol=5e-3)

learned = co.LiePoissonSystem(co.algebras.e(3), co.Hamiltonian(lambda x: model(w, x)), sign=-1)
x0 = np.array([0.5, -0.3, 0.8, 0.6, 0.0, 0.8])
predicted, exact = (co.integrate(s, x0, (0, 20), step, co.GaussLegendre(2)) for s in (learned, truth))
assert np.abs(predicted.x - exact.x)[:200].max() < 0.1
assert all(np.abs(C(predicted.x) - C(x0)).max() < 4e-15 for C in truth.casimirs.values())
print(f"after 10 units of time the prediction is off by {np.abs(predicted.x[200] - exact.x[200]).max():.2f}")
