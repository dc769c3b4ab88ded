"""Damping that stays on the coadjoint orbit, and the heat bath that it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.given import read_number, read_whole
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.forces.matrices import applied, check_dimension, read_matrix, root_of
from coadjoint.systems.forces.normal_deviates import normal_deviates

MOST = 192
SMALL = 2.0**-40
MOST_TERMS = 60
LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class DoubleBracketDamping(Force):
    """Damping along the coadjoint orbit, ``x' = alpha J(x) P J(x) grad H``: energy falls, every Casimir stays.

    For spins (copies of so(3), with H = -B.S and the like) this is the damping of Landau and Lifshitz,
    ``S' = -alpha S x (S x B)`` with B = -grad H. For the form of Gilbert with damping a multiply the Hamiltonian by
    1/(1 + a^2), and take alpha = a. For fluids it is the selective decay of energy at constant vorticity. The energy
    falls at the rate ``alpha f.P f``, f the Hamiltonian part of x'.

    Its flow is the midpoint rule on the orbit, by exponentials: of order 2, symmetric, with every Casimir to round-off.

    Parameters
    ----------
    alpha : float
        Strength, zero or positive.
    metric : float, (n,) or (n, n) array_like
        P, symmetric and positive semidefinite. One is right where the invariant form of the algebra is the sum of
        squares, as for spins and so(n).

    Raises
    ------
    ValueError, TypeError
        Negative, or of another shape, or no finite numbers.

    References
    ----------
    A. Bloch, P. S. Krishnaprasad, J. E. Marsden, T. S. Ratiu, The Euler-Poincare equations and double bracket
    dissipation, Communications in Mathematical Physics 175 (1996).

    Examples
    --------
    A spin in a field along the third axis turns into it, ``S_3 = tanh(alpha B t)``, and keeps its length:

    >>> import coadjoint as co
    >>> field = co.Polynomial({(0, 0, 1): -1.0})
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(co.forces.DoubleBracketDamping(0.1))
    >>> sol = co.integrate(spin, (1.0, 0.0, 0.0), t_span=(0, 10), step=0.125)
    >>> import numpy as np
    >>> bool(abs(sol.x[-1, 2] - np.tanh(1.0)) < 1e-5), bool(sol.balance()["|x|^2"] < 1e-14)
    (True, True)
    """

    alpha: float
    metric: Any = 1.0

    casimirs: ClassVar[bool] = True

    def __post_init__(self) -> None:
        name = type(self).__name__
        alpha = read_number(self.alpha, f"alpha of {name}")
        if alpha < 0.0:
            raise ValueError(f"alpha of {name} is {alpha!r}; damping needs zero or a positive number")
        object.__setattr__(self, "alpha", alpha)
        object.__setattr__(self, "metric", read_matrix(self.metric, f"metric of {name}"))
        root_of(self.metric, f"metric of {name}")

    def check(self, system: Any) -> None:
        name = type(self).__name__
        if system.algebra is None or getattr(system.algebra, "triples", None) is None:
            raise ValueError(
                f"{name} moves states along coadjoint orbits, by structure constants, which {system.name} does not "
                "have; take LinearDamping"
            )
        check_dimension(self.metric, f"metric of {name}", system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return np.asarray(_product(system, x, self._pull(system, x, t)))

    def _pull(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return self.alpha * applied(self.metric, system.vector_field(x, t))

    def _noise(self, n: int, t: Any, tau: Any) -> NDArray[np.float64]:
        return np.zeros(n)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        noise, middle, last = self._noise(system.dim, t, tau), x, np.inf
        for _ in range(MOST):
            v = tau * self._pull(system, middle, t + 0.5 * tau) + noise
            before, middle = middle, _exponential(system, 0.5 * v, x)
            moved = float(np.sum(np.abs(middle - before)))
            if moved == 0.0 or (moved >= 0.5 * last and moved <= SMALL * float(np.sum(np.abs(x)))):
                return _exponential(system, v, x)
            last = moved
        raise IntegrationError(
            f"the midpoint rule of {type(self).__name__} did not converge; take a smaller step",
            step=1,
            time=float(t),
            residual=last,
        )

    def _amplitude(self) -> float:
        return 0.0

    def given_to(self, reader: ForceReader, n: int) -> Any:
        metric = self.alpha * np.asarray(self.metric)
        root = root_of(self.metric, "metric")
        return reader.on_orbit(metric, root, self._amplitude(), getattr(self, "seed", 0), getattr(self, "stream", 0))


@dataclass(frozen=True)
class HeatBath(DoubleBracketDamping):
    """A heat bath for spins, and for any coadjoint orbit: damping, and the noise of its temperature.

    ``dx = J(x) (grad H dt + sign alpha P J(x) grad H dt + sqrt(2 alpha k T) L o dW)`` in the sense of Stratonovich, with
    L L^T = P and independent Wiener processes W. Its stationary density on an orbit is that of Boltzmann,
    exp(-H / kT), with respect to the symplectic volume of the orbit: for spins the surface of their spheres.

    The flow is the stochastic midpoint rule on the orbit, by exponentials: every Casimir is kept to round-off, for every
    draw, and no increment has to be cut off for it to be solvable. With a symmetric splitting the averages over the
    stationary density have an error of the second order in the step. A path converges with order 1/2 to 1.

    The noise is a function of the seed, the number of the member and the time, and of nothing else: the same on any
    number of threads, with or without other members, however often the run is cut. Two spans that follow each other
    have different noise. A run backward is refused.

    Parameters
    ----------
    alpha : float
        Strength of the damping, as for `DoubleBracketDamping`.
    metric : float, (n,) or (n, n) array_like
        As for `DoubleBracketDamping`.
    temperature : float
        Boltzmann's constant times the temperature, in units of the energy; zero or positive.
    seed : int
        Of the noise, from 0 to 2^63 - 1. Give one: there is no default, so that no two runs share a noise by accident.
    stream : int
        The member m of a run has the noise number ``stream + m`` of the seed. With stream=m a member alone has the bits
        that it has as number m of an ensemble.

    Raises
    ------
    ValueError, TypeError
        Negative, or of another shape, or no finite numbers; no seed.

    References
    ----------
    W. F. Brown, Thermal fluctuations of a single-domain particle, Physical Review 130 (1963); J. H. Mentink,
    M. V. Tretyakov, A. Fasolino, M. I. Katsnelson, Th. Rasing, Stable and fast semi-implicit integration of the
    stochastic Landau-Lifshitz equation, Journal of Physics: Condensed Matter 22 (2010); A. Arnaudon, A. L. De Castro,
    D. D. Holm, Noise and dissipation on coadjoint orbits, Journal of Nonlinear Science 28 (2018).

    Examples
    --------
    >>> import coadjoint as co
    >>> field = co.Polynomial({(0, 0, 1): -1.0})
    >>> bath = co.forces.HeatBath(0.5, temperature=0.5, seed=7)
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(bath)
    >>> sol = co.integrate(spin, [(0.0, 0.6, 0.8)] * 3, t_span=(0, 10), step=0.125)
    >>> bool(sol.balance()["|x|^2"] < 1e-13)
    True
    """

    temperature: float = 0.0
    seed: Any = None
    stream: int = 0

    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        temperature = read_number(self.temperature, "temperature of HeatBath")
        if temperature < 0.0:
            raise ValueError(f"temperature of HeatBath is {temperature!r}; it must be zero or positive")
        object.__setattr__(self, "temperature", temperature)
        if self.seed is None:
            raise TypeError("HeatBath needs a seed, a whole number: runs with the same seed have the same noise")
        object.__setattr__(self, "seed", read_whole(self.seed, "seed of HeatBath", 0, LARGEST_SEED))
        object.__setattr__(self, "stream", read_whole(self.stream, "stream of HeatBath", 0, 2**62))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("HeatBath is a noise, which has no field; its mean part is that of DoubleBracketDamping")

    def _amplitude(self) -> float:
        return float(np.sqrt(2.0 * self.alpha * self.temperature))

    def _noise(self, n: int, t: Any, tau: Any) -> NDArray[np.float64]:
        if tau < 0.0:
            raise ValueError("HeatBath is a noise, which does not run backward")
        deviates = normal_deviates(self.seed, self.stream, float(t), n)
        return np.asarray(self._amplitude() * np.sqrt(float(tau)) * applied(root_of(self.metric, "metric"), deviates))


def _product(system: Any, x: NDArray[Any], u: NDArray[Any]) -> NDArray[Any]:
    """Return sign J(x) u."""
    return np.asarray(system.sign * (system.algebra.structure_matrix(x) @ u))


def _exponential(system: Any, v: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """Return exp(D_v) x, D_v x = sign J(x) v, by its series in substeps."""
    D = system.sign * np.asarray(system.algebra.coadjoint(v), dtype=np.float64)
    pieces = max(1, int(np.ceil(np.max(np.sum(np.abs(D), axis=1), initial=0.0))))
    for _ in range(pieces):
        term, total = x, np.zeros_like(x)
        for k in range(1, MOST_TERMS):
            term = D @ term / (k * pieces)
            total = total + term
            if not np.any(np.abs(term) > 2.0**-60 * np.abs(x).max(initial=0.0)):
                break
        x = x + total
    return np.asarray(x)
