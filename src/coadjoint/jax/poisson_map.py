"""Maps of layers that are flows of features with learned functions: Poisson maps for all parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.jax.feature_flows import feature_flow
from coadjoint.jax.library import FeatureEnergy
from coadjoint.jax.primitives import doubles
from coadjoint.jax.stage_steps import CoadjointAction
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.system_checks import read_sign
from coadjoint.validation import read_integer, read_list


def function_of_layer(y: Any, weights: Any) -> Any:
    """Return the function f(y) of a layer: a network of one number, with tanh between its matrices."""
    z = y[None]
    for matrix, offset in weights[:-1]:
        z = jnp.tanh(matrix @ z + offset)
    return weights[-1] @ z


class PoissonMap:
    """A map of states that is a Poisson map for all its parameters: layers of coadjoint motions.

    Use it to learn the map from one sample to the next where no energy is wanted, or the samples are too far apart for
    steps. Each layer is the exact flow of a learned function f of one linear combination <a, x> over a time h. The map
    has the bracket and all Casimirs of the algebra to rounding, before, during and after training; its inverse is
    explicit. `coadjoint.certify` takes ``lambda x, h: poisson_map(x, params, h)`` as a scheme of order 1 for the system
    with the energy `energy`. For an energy with steps of higher order take `features`.

    Parameters
    ----------
    algebra : LieAlgebra
        Of dimension n.
    depth : int
        Number of layers, from 1.
    widths : sequence of int
        Numbers of hidden units of the network f of each layer.
    sign : {1, -1}
        Sign of the bracket, as that of a `LiePoissonSystem`.

    Attributes
    ----------
    algebra, depth, widths, sign
        The arguments.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError, ValueError
        An argument is of another type, or out of range.

    Notes
    -----
    For small h the map is a step of order 1 of the sum of the energies of the layers, `energy`. Where the norm of the
    generator exceeds 4 in one layer, the result is NaN. The layers of sympnets and LPNets (C. Eldred, F. Gay-Balmaz,
    S. Huraka, V. Putkaradze, Neural Networks 173 (2024) 106162) are those whose a are vectors of the basis.

    Examples
    --------
    >>> import jax
    >>> import numpy as np
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> poisson_map = co.jax.PoissonMap(co.algebras.so(3), depth=6, widths=(16,))
    >>> params = poisson_map.init(seed=0)
    >>> x = np.array([[1.0, 0.2, 0.5], [0.0, 1.0, 0.0]])
    >>> y = poisson_map(x, params, h=0.5)
    >>> bool(abs((y**2).sum(axis=1) - (x**2).sum(axis=1)).max() < 1e-14)
    True
    >>> bool(abs(poisson_map.inverse(y, params, h=0.5) - x).max() < 1e-14)
    True
    """

    def __init__(self, algebra: LieAlgebra, depth: int, widths: Sequence[int] = (16,), *, sign: int = 1) -> None:
        if not isinstance(algebra, LieAlgebra):
            raise TypeError(f"algebra is {short(algebra)}; give a LieAlgebra, such as co.algebras.so(3)")
        rule = "give a list of numbers of hidden units, such as (16,)"
        self.algebra, self.sign = algebra, read_sign(sign)
        self.depth = read_integer(depth, "depth", 1)
        self.widths = tuple(read_integer(one, "a width", 1) for one in read_list(widths, "widths", rule))
        if not self.widths:
            raise ValueError(f"widths are empty; {rule}")
        self._layers = FeatureEnergy(function_of_layer, self.init())
        flow = feature_flow(CoadjointAction(algebra, self.sign), self._layers)

        def of_state(x: Any, layers: Any, tau: Any, backward: bool) -> Any:
            return lax.scan(lambda x, layer: (flow(layer, x, tau), None), x, layers, reverse=backward)[0]

        self._of_states = jax.jit(jnp.vectorize(of_state, signature="(n)->(n)", excluded=(1, 2, 3)), static_argnums=3)

    def __repr__(self) -> str:
        return f"PoissonMap({self.algebra.name or self.algebra}, depth={self.depth}, widths={self.widths})"

    def init(self, seed: int = 0) -> Any:
        """Return random parameters: directions (depth, n) of length about one, and the weights of all networks.

        Parameters
        ----------
        seed : int
            Of the draws.

        Returns
        -------
        tuple
            Directions (depth, n), and a list of weights, each with a first axis of layers.

        Examples
        --------
        >>> import jax
        >>> import coadjoint as co
        >>> jax.config.update("jax_enable_x64", True)
        >>> co.jax.PoissonMap(co.algebras.e(3), depth=4).init()[0].shape
        (4, 6)
        """
        rng = np.random.default_rng(read_integer(seed, "seed", 0))

        def drawn(*shape: int) -> Any:
            return rng.standard_normal((self.depth, *shape)) / math.sqrt(shape[-1])

        sizes = list(zip(self.widths, (1, *self.widths[:-1]), strict=True))
        hidden = [(drawn(*size), np.zeros((self.depth, size[0]))) for size in sizes]
        return FeatureEnergy.trees.read(
            (drawn(self.algebra.dim), [*hidden, 0.1 * drawn(self.widths[-1])]), "PoissonMap.init"
        )

    def __call__(self, x: Any, params: Any, h: Any = 1.0) -> Any:
        """Return the states after all layers, of states (n,) or (..., n); h may be learned too."""
        return self._mapped(x, params, h, False)

    def inverse(self, x: Any, params: Any, h: Any = 1.0) -> Any:
        """Return the states before all layers: the inverse of the map of the same h.

        Parameters
        ----------
        x : (n,) or (..., n)
            States.
        params
            As of `init`.
        h : scalar
            The time.

        Returns
        -------
        array

        Examples
        --------
        See `PoissonMap`.
        """
        return self._mapped(x, params, h, True)

    def energy(self, params: Any) -> Hamiltonian:
        """Return the sum of the energies of the layers, of which the map is a step of order 1.

        Parameters
        ----------
        params
            As of `init`.

        Returns
        -------
        Hamiltonian
            That of `features`.

        Examples
        --------
        See `PoissonMap`.
        """
        return Hamiltonian(FeatureEnergy(function_of_layer, self._read(params)))

    def _read(self, params: Any) -> Any:
        return self._layers.trees.read_like(self._layers.params, params, "as that of PoissonMap.init")

    def _mapped(self, x: Any, params: Any, h: Any, backward: bool) -> Any:
        values = doubles({"x": x, "h": h})
        states, tau = values["x"], -values["h"] if backward else values["h"]
        n = self.algebra.dim
        if states.shape[-1:] != (n,) or tau.shape:
            raise ValueError(f"x and h have the shapes {states.shape} and {tau.shape}; they must be (..., {n}) and ()")
        return self._of_states(states, self._read(params), tau, backward)
