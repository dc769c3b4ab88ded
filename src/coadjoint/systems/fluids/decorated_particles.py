"""Particles with finite width: positions, momenta and second moments of each."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.phase_space import heisenberg, moments
from coadjoint.algebra.families.products import copies, direct_sum
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.closed_forms.closed_form import move_state, oscillator_solutions
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.systems.user_functions import check_derivative
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
DerivativeFunctions = tuple[Callable[..., Any], ...]  # a function of one number and its first three derivatives

MAX_POTENTIAL_DEGREE = 20  # degree of a potential
MAX_COEFFICIENT = 1e50
MAX_DENSE_SQUARE = 64  # largest number of particles for which the dense energy of the centre is given


@lru_cache(maxsize=8)
def _algebra(particles: int) -> LieAlgebra:
    """Return the sum of `heisenberg` and the second moments of each particle: q1, ..., qn, p1, ..., pn, z, moments."""
    # At z = 1 and sign +1 it gives ``q' = dH/dp``, ``p' = -dH/dq`` and the equations of moments; sign -1 reverses time.
    algebra = direct_sum(heisenberg(particles), copies(moments(2), particles))
    casimirs = {name.rpartition(" [")[0]: casimir for name, casimir in algebra.casimirs_known.items()}
    return LieAlgebra._from_valid(
        algebra.triples, algebra.dim, algebra.basis, algebra.name, algebra.representation, casimirs
    )


def _position_and_width_coordinates(dim: int) -> list[int]:
    """Return the coordinates q and x20 of at most four particles."""
    n = (dim - 1) // 5
    return [*range(n)][:4] + [2 * n + 1 + 3 * a for a in range(n)][:4]


def _centres_and_widths(x: Any, system: Any) -> list[tuple[Any, ...]]:
    """Return the centre and the second moments per mass of each particle, for states (k, n)."""
    particles = []
    for a, w in enumerate(system.parameters["weights"]):
        n = len(system.parameters["weights"])
        second = x[:, 2 * n + 1 + 3 * a : 2 * n + 4 + 3 * a].T / w
        particles.append((x[:, a], x[:, n + a] / w, *second))
    return particles


def _energy(
    weights: npt.NDArray[Any], external: npt.NDArray[Any], *, pair: npt.ArrayLike
) -> dict[tuple[int, ...], Any]:
    return energy_coefficients(weights, external, np.asarray(pair, dtype=np.float64))


# Odd coefficients of a pair potential are zero, so that its entries cannot change.
@ready_made(
    unit="z",
    coordinates={"q": ("position", "length"), "p": ("momentum", "mass length/time"), "z": ("constant", "1")},
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(-1.0, 0.5, 0.0, 0.5, 1.0, 0.02, 0.0, 0.04, 0.05, 0.0, 0.02),
        t_span=(0.0, 12.0),
        step=0.02,
        caption="Two lumps in a harmonic well that attract each other by the fourth power of their distance: their "
        "centres oscillate (thin lines), and the ellipses of their widths turn and stretch; each keeps its "
        "area.",
        pictures=(
            Picture("phase ellipse", lumps=_centres_and_widths, times=7, labels=("position $q$", "velocity $p/w$")),
        ),
        components=Picture("components", chosen=_position_and_width_coordinates, quantity="positions and widths"),
        quantity="state",
    ),
)
def decorated_particles(
    weights: npt.ArrayLike = (1.0, 1.0), external: Any = (0.0, 0.0, 0.5), pair: Any = (0.0, 0.0, 0.0, 0.0, 0.25)
) -> LiePoissonSystem:
    """Return particles on a line, each with a position, a momentum and the second moments of its finite width.

    Each particle is a distribution f_a, described by its mass w_a, centre (q_a, p_a / w_a) and moments ``x_ij =
    integral of (q - q_a)^i (v - p_a / w_a)^j f_a`` of degree 2. Sign +1; with potentials expanded to second order,
    ``H = sum of p^2/(2 w) + x02/2 + w W(q) + W''(q) x20/2 + U''(0) w x20/2`` over particles plus ``w_a w_b U(r) +
    U''(r) (w_b x20_a + w_a x20_b)/2``, r = q_a - q_b, over pairs.

    Parameters
    ----------
    weights : (particles,)
        Masses w, positive.
    external : sequence of numbers, or four functions
        W (energy per mass): its coefficients, ``sum of external[k] q^k`` up to degree 20, or a function of one number
        and its first three derivatives, which Numba compiles.
    pair : sequence of numbers, or four functions
        U as a function of the distance (energy per mass squared), even.

    Returns
    -------
    LiePoissonSystem
        State: ``(q_1, ..., q_n, p_1, ..., p_n, 1, x20_1, x11_1, x02_1, x20_2, ...)``, as
        ``co.systems.canonical_state(q, p, x)`` makes it. The 1 is the central coordinate z. Casimirs:
        z and the squared emittance x20 x02 - x11^2 of each particle. Integrals: the total momentum if there is no
        external potential, and the energy of the centre of mass if it is ``(0, 0, k)``. ``exact(x0, t)`` if both
        potentials are at most quadratic. Functions are not stored in ``parameters``.

    Raises
    ------
    TypeError, ValueError
        Weights that are not positive, coefficients that are not finite, a pair potential that is not even, or functions
        that are not the stated derivatives.

    Notes
    -----
    Scovel and Weinstein, Comm. Pure Appl. Math. 47, 683 (1994). Positions commute with x20, and momenta with x02, so a
    splitting has two parts. The expansion is exact for potentials of degree at most 3.

    Examples
    --------
    >>> from coadjoint.systems.coordinates import canonical_state
    >>> lump = decorated_particles(weights=[2.0], external=(0, 0, 0.5), pair=(0,))
    >>> lump.vector_field(canonical_state(1.0, 3.0, [0.5, 0.0, 0.25]))
    array([ 1.5 , -2.  ,  0.  ,  0.  , -0.25,  0.  ])
    """
    w = _weights(weights)
    n = len(w)
    algebra = _algebra(n)
    functions = validate_potential(external, "external"), validate_potential(pair, "pair")
    W, U = (
        None if f else _coefficients(c, what) for f, c, what in zip(functions, (external, pair), _NAMES, strict=True)
    )
    if U is not None and np.any(U[1::2]):
        raise ValueError(f"pair is {short(U.tolist())}; the potential of a pair is even, with no odd powers")
    if functions[1]:
        check_even(functions[1])
    q, p, x20 = np.arange(n), np.arange(n, 2 * n), 2 * n + 1 + 3 * np.arange(n)
    if W is not None and U is not None:
        H: Any = Polynomial(_energy(w, W, pair=U), dim=algebra.dim)
    else:
        kinetic = Quadratic(np.r_[1 / w, np.zeros(n)], linear=np.r_[np.zeros(n), np.full(n, 0.5)])
        chains = [f or polynomial_derivatives(c) for f, c in zip(functions, (W, U), strict=True)]
        potential = potential_energy(w, chains[0], chains[1])
        H = SplitHamiltonian([((*p.tolist(), *(x20 + 2).tolist()), kinetic), ((*q.tolist(), *x20.tolist()), potential)])
    return LiePoissonSystem(
        algebra,
        H,
        sign=+1,
        name="decorated_particles",
        parameters=None
        if W is None or U is None
        else {"weights": tuple(w.tolist()), "external": tuple(W.tolist()), "pair": tuple(U.tolist())},
        exact=None
        if W is None or U is None or np.any(W[3:]) or np.any(U[3:])
        else partial(move_state, "decorated_particles", algebra.dim, partial(_oscillators, w, W, U)),
        integrals={} if W is None else _integrals(algebra.dim, w, W),
    )


_NAMES = ("external", "pair")


def _coefficient_at(coefficients: Floats, k: int) -> float:
    return float(coefficients[k]) if k < len(coefficients) else 0.0


def _weights(weights: Any) -> Floats:
    w = read_finite(weights, "weights")
    if w.ndim != 1 or not w.size:
        raise ValueError(f"weights has shape {w.shape}; give one mass for each particle")
    for a in np.flatnonzero((w <= 1 / MAX_COEFFICIENT) | (w > MAX_COEFFICIENT))[:1].tolist():
        raise ValueError(
            f"weights[{a}] is {w[a]:g}; masses are positive, from {1 / MAX_COEFFICIENT:g} to {MAX_COEFFICIENT:g}"
        )
    return w


def _coefficients(argument: Any, what: str) -> Floats:
    c = read_finite(argument, what)
    if c.ndim != 1 or not 0 < c.size <= MAX_POTENTIAL_DEGREE + 1:
        raise ValueError(
            f"{what} has shape {c.shape}; give the coefficients of a polynomial, up to degree {MAX_POTENTIAL_DEGREE}"
        )
    if np.abs(c).max() > MAX_COEFFICIENT:
        raise ValueError(f"{what} has coefficients beyond {MAX_COEFFICIENT:g}; take other units")
    return c


def _integrals(dim: int, w: Floats, W: Floats) -> dict[str, Quadratic]:
    n = len(w)
    if not np.any(W[1:]):
        return {"total momentum": Quadratic(0.0, linear=np.r_[np.zeros(n), np.ones(n), np.zeros(dim - 2 * n)])}
    if np.any(W[3:]) or _coefficient_at(W, 1) or n > MAX_DENSE_SQUARE:
        return {}
    M = np.zeros((dim, dim))
    M[:n, :n] = 2 * _coefficient_at(W, 2) * np.outer(w, w) / w.sum()
    M[n : 2 * n, n : 2 * n] = 1 / w.sum()
    return {"energy of the centre": Quadratic(M)}


def _oscillators(w: Floats, W: Floats, U: Floats, start: Floats, times: Floats) -> Floats:
    """Return the motion for W = push q + k q^2/2 and U = u r^2/2, up to constants."""
    # The centre of mass follows W; relative positions and widths have the stiffness k + u sum(w). At a value z of the
    # central coordinate, positions and momenta evolve in the time z t.
    n, push, k, u = len(w), _coefficient_at(W, 1), 2 * _coefficient_at(W, 2), 2 * _coefficient_at(U, 2)
    q, p, z, x = start[:n], start[n : 2 * n], start[2 * n], start[2 * n + 1 :].reshape(n, 3)
    total, stiff = w.sum(), k + u * w.sum()
    Q, V = (w @ q) / total, p.sum() / total
    T = (z * times)[..., None]
    c, s, fall = oscillator_solutions(k, T)
    centre, speed = c * Q + s * V - push * fall, c * V - s * (k * Q + push)
    c, s, _ = oscillator_solutions(stiff, T)
    relative_q, relative_v = c * (q - Q) + s * (p / w - V), c * (p / w - V) - stiff * s * (q - Q)
    c, s, _ = oscillator_solutions(stiff, times[..., None])
    x20, x11, x02 = x.T
    widths = np.stack(
        [
            c * c * x20 + 2 * c * s * x11 + s * s * x02,
            -stiff * c * s * x20 + (c * c - stiff * s * s) * x11 + c * s * x02,
            (stiff * s) ** 2 * x20 - 2 * stiff * c * s * x11 + c * c * x02,
        ],
        axis=-1,
    ).reshape(len(times), 3 * n)
    constant = np.full((len(times), 1), z)
    return np.concatenate([centre + relative_q, w * (speed + relative_v), constant, widths], axis=-1)


def validate_potential(argument: Any, what: str) -> DerivativeFunctions | None:
    """Validate a function and its first three derivatives; None if `argument` is not callables."""
    if callable(argument) or (isinstance(argument, tuple | list) and any(callable(f) for f in argument)):
        if callable(argument) or len(argument) != 4 or not all(callable(f) for f in argument):
            raise TypeError(f"{what} is {short(argument)}; give a function and its first three derivatives")
        names = [f"{what}[{k}]" for k in range(4)]
        for k in range(3):
            pair = (names[k], names[k + 1])
            check_derivative(argument[k], argument[k + 1], names=pair, shapes=((), ()), n=None, timed=False)
        return tuple(argument)
    return None


def check_even(chain: DerivativeFunctions) -> None:
    """Raise ValueError if the potential of a pair is not even."""
    for r in (0.375, 1.5):
        right, left = float(chain[0](r)), float(chain[0](-r))
        if not abs(right - left) <= 64 * UNIT_ROUNDOFF * (abs(right) + abs(left)):
            raise ValueError(f"pair is {right:g} at {r} and {left:g} at {-r}; the potential of a pair is even")


def energy_coefficients(w: Numbers, W: Numbers, U: Floats) -> dict[tuple[int, ...], Any]:
    """Return the coefficients of H for polynomial potentials, from theirs; see `decorated_particles`."""
    n = len(w)
    dim = 5 * n + 1
    total: dict[tuple[int, ...], Any] = {}

    def add(c: Any, *powers: tuple[int, int]) -> None:
        if c:
            exponents = [0] * dim
            for coordinate, power in powers:
                exponents[coordinate] += power
            key = tuple(exponents)
            total[key] = total.get(key, 0.0) + c

    x20 = [2 * n + 1 + 3 * a for a in range(n)]
    for a in range(n):
        add(0.5 / w[a], (n + a, 2))
        add(0.5, (x20[a] + 2, 1))
        add((U[2] if len(U) > 2 else 0.0) * w[a], (x20[a], 1))
        for k, c in enumerate(W.tolist()):
            add(w[a] * c, (a, k))
            if k >= 2:
                add(c * k * (k - 1) / 2, (a, k - 2), (x20[a], 1))
        for b in range(a):
            for k, c in enumerate(U.tolist()):
                for j in range(k + 1):
                    add((-1) ** j * comb(k, j) * c * w[a] * w[b], (a, k - j), (b, j))
                for j in range(k - 1):
                    slope = (-1) ** j * comb(k - 2, j) * c * k * (k - 1) / 2
                    add(slope * w[b], (a, k - 2 - j), (b, j), (x20[a], 1))
                    add(slope * w[a], (a, k - 2 - j), (b, j), (x20[b], 1))
    return total


def polynomial_derivatives(coefficients: Floats | None) -> DerivativeFunctions:
    """Return a polynomial and its first three derivatives as functions of one number; zero for None."""

    def polynomial_function(c: Floats) -> Callable[..., Any]:
        def value(x: Any) -> Any:
            total = 0.0
            for k in range(len(c) - 1, -1, -1):
                total = total * x + c[k]
            return total

        return value

    functions = []
    c = np.zeros(1) if coefficients is None else coefficients
    for _ in range(4):
        functions.append(polynomial_function(c))
        c = np.arange(1, len(c)) * c[1:] if len(c) > 1 else np.zeros(1)
    return tuple(functions)


def potential_energy(w: Floats, external: DerivativeFunctions, pair: DerivativeFunctions) -> Hamiltonian:
    """Return the potential energy as a function of (q_1, ..., q_n, x20_1, ..., x20_n); see `decorated_particles`."""
    n = len(w)
    W0, W1, W2, W3 = external
    U0, U1, U2, U3 = pair

    def value(y: Any) -> Any:
        total = 0.0 * y[0]
        for a in range(n):
            q, x = y[a], y[n + a]
            total += w[a] * W0(q) + (W2(q) + U2(0.0) * w[a]) * x / 2
            for b in range(a):
                r = q - y[b]
                total += w[a] * w[b] * U0(r) + U2(r) * (w[b] * x + w[a] * y[n + b]) / 2
        return total

    def gradient(y: Any) -> Any:
        slope = 0.0 * y
        for a in range(n):
            q, x = y[a], y[n + a]
            slope[a] += w[a] * W1(q) + W3(q) * x / 2
            slope[n + a] += (W2(q) + U2(0.0) * w[a]) / 2
            for b in range(a):
                r = q - y[b]
                force = w[a] * w[b] * U1(r) + U3(r) * (w[b] * x + w[a] * y[n + b]) / 2
                slope[a] += force
                slope[b] -= force
                slope[n + a] += U2(r) * w[b] / 2
                slope[n + b] += U2(r) * w[a] / 2
        return slope

    return Hamiltonian(value, gradient)
