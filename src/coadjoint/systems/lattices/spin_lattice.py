"""Classical spins on any graph: exchange, anisotropy, Dzyaloshinskii-Moriya coupling and fields."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, Self
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.families.products import copies
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.memory import RELEASED_SIZE, check_available_memory, release_freed_memory
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.closed_forms.spins import precession, total_spins
from coadjoint.systems.coefficients import EnergyCoefficients
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import FunctionTerm, Term
from coadjoint.systems.lattices.coupling_matrix import coefficients_of_spins, coupled_spins
from coadjoint.systems.lattices.dipolar import dipolar_energy
from coadjoint.systems.lattices.geometry import graph
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import as_tuples, read_finite, to_array

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]

# Peak during construction, with couplings of each bond or site, and if all are equal.
BYTES_PER_SPIN, BYTES_PER_EDGE = 500, 200
BYTES_PER_EQUAL_SPIN, BYTES_PER_EQUAL_EDGE = 150, 60
MAX_STORED_VALUES = 2**16  # largest number of values stored as parameters
MAX_COUPLING = 1e100
MAX_RECORDED_SPINS = 682  # largest number of spins with a recorded Casimir each, the limit of `copies`
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


EXAMPLE_SIDE = 18  # sites along an edge of the example run: room for two vortices


def _vortices() -> Floats:
    """Return spins in the plane that rotate once around each of two sites, and point up there."""
    x, y = np.indices((EXAMPLE_SIDE, EXAMPLE_SIDE)) - 0.5 * (EXAMPLE_SIDE - 1)
    angle, tilt = 0.5 * np.pi, np.zeros_like(x)
    for side in (-3.5, 3.5):
        angle = angle + np.arctan2(y, x - side)
        tilt = tilt + np.exp(-0.4 * ((x - side) ** 2 + y**2))
    in_plane = np.sqrt(1.0 - np.minimum(tilt, 1.0) ** 2)
    return np.stack([in_plane * np.cos(angle), in_plane * np.sin(angle), tilt], axis=-1).ravel()


def _mean(axis: int, x: Any) -> Any:
    return x[..., axis::3].mean(axis=-1)


_MEANS = {f"S{axis + 1}": partial(_mean, axis) for axis in range(3)}


def _coordinate_names(dim: int) -> tuple[str, ...]:
    return tuple(f"S{axis + 1}[{site + 1}]" for site in range(dim // 3) for axis in range(3))


def _couplings(J: Numbers, T: Numbers, D: Numbers, B: Numbers, K: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return the matrices of edges, those of sites, and the linear terms, for T and K that are matrices."""
    return -J[..., None, None] * T + np.einsum("...k,kab->...ab", D, LEVI_CIVITA), -2.0 * K, -B


def _energy(
    exchange: Numbers,
    tensor: Numbers,
    dm: Numbers,
    field: Numbers,
    on_site: Numbers,
    *,
    lattice: Any,
    shape: Any,
    periodic: Any,
) -> EnergyCoefficients:
    T, K = (np.diag(array) if array.ndim == 1 else array for array in (tensor, on_site))
    return coefficients_of_spins(*graph(lattice, shape, periodic), *_couplings(exchange, T, dm, field, K))


@ready_made(
    energy=_energy,
    symmetric=("on_site",),
    gallery_entry=GalleryEntry(
        x0=_vortices,
        t_span=(0.0, 36.0),
        step=0.05,
        caption="Two vortices of the same sense in a square of 18 x 18 spins that prefer to lie in the plane. In the "
        "middle of each, spins point up. The vortices go around each other, and radiate a little. Arrows show the "
        "components in the plane, colours the component perpendicular to it.",
        pictures=(Picture("spins", at=0.0), Picture("spins", at=1.0)),
        components=Picture("components", functions=_MEANS, quantity="mean spin"),
        parameters={"lattice": "square", "shape": (EXAMPLE_SIDE, EXAMPLE_SIDE), "tensor": (1.0, 1.0, 0.85)},
        coordinates=_coordinate_names,
        quantity="spin",
    ),
)
def spin_lattice(
    lattice: Any = "chain",
    shape: Any = 2,
    periodic: Any = False,
    exchange: npt.ArrayLike = 1.0,
    tensor: npt.ArrayLike = (1.0, 1.0, 1.0),
    dm: npt.ArrayLike = (0.0, 0.0, 0.0),
    field: Any = (0.0, 0.0, 0.0),
    on_site: npt.ArrayLike = (0.0, 0.0, 0.0),
    dipolar: float = 0.0,
) -> LiePoissonSystem:
    """Return classical spins on a lattice or any graph, ``S_i' = S_i cross B_i`` with ``B_i = -dH/dS_i``.

    The Landau-Lifshitz equations without damping: copies of so(3), sign +1, and, summed over edges (i, j) and sites i,
    ``H = sum(-J_ij S_i . T S_j + D_ij . (S_i cross S_j)) - sum(S_i . K S_i + B_i . S_i)``. J > 0 is ferromagnetic. One
    spin in a field B precesses about it by the angle ``-|B| t``.

    Parameters
    ----------
    lattice : str or (edges, 2) array of int
        ``"chain"``, ``"ring"``, ``"square"``, ``"triangular"``, ``"honeycomb"``, ``"kagome"``, ``"cubic"`` or
        ``"complete"``; or pairs of sites, from 0, each pair once. ``coadjoint.systems.lattices.geometry.graph``
        returns the edges in order.
    shape : int or tuple of int
        Number of cells along each axis; number of sites for a complete graph, and if edges are given.
    periodic : bool or tuple of bool
        Whether the lattice is periodic along each axis. A ring always is.
    exchange : number or (edges,)
        J, for all edges or for each (energy per spin squared).
    tensor : (3,), (3, 3) or (edges, 3, 3)
        T: anisotropy of the exchange, diagonal or full; need not be symmetric. Dimensionless.
    dm : (3,) or (edges, 3)
        D, the Dzyaloshinskii-Moriya vector, for the given direction of the edge (energy per spin squared).
    field : (3,), (sites, 3), or function of the time that returns one of them
        B, including the gyromagnetic ratio (energy per spin). Numba compiles the function.
    on_site : (3,), (3, 3) or (sites, 3, 3)
        K, diagonal or full, symmetric (energy per spin squared): (0, 0, K) with K > 0 is an easy third axis.
    dipolar : number
        Strength of the dipolar energy, the factor of the sum over all pairs of
        ``(S_i . S_j - 3 (S_i . e) (S_j . e)) / r^3``, with the unit vector e between the sites and their distance r in
        distances of neighbours (energy per spin squared). For open lattices by name; a chain lies along the first axis,
        other lattices in the plane of the first two. Computed by FFT in time N log N: `SphericalMidpoint` and
        Runge-Kutta methods support it, splittings do not.

    Returns
    -------
    LiePoissonSystem
        State: the spins in order, S_i at ``x[3 i : 3 i + 3]`` (angular momentum; energies over it are frequencies, so
        dimensionless spins go with energies over hbar). Casimirs: ``"|x|^2 [i]"`` of every spin, i from 1, up to 682
        spins; for more, the sum of all. Integrals: the components of the total spin, or its square, that the couplings
        leave constant. ``exact(x0, t)`` if all spins are coupled equally and isotropically (two spins, a ring of three,
        a complete graph) in a uniform field, or if none are coupled. The group element, for few spins, is the rotation
        of each. Parameters of more than 65536 numbers, and functions, are not stored.

    Raises
    ------
    TypeError, ValueError
        An unknown lattice, a wrong shape, duplicate edges, edges from a site to itself, or arrays of the wrong shape.

    Notes
    -----
    Section 4 of Reich (1993): if T, K are diagonal and D is zero, all first components commute, as do all second and
    all third ones: a splitting has three parts on any graph. Frank, Huang and Leimkuhler, J. Comput. Phys. 133, 160
    (1997).

    Examples
    --------
    >>> pair = spin_lattice(exchange=2.0)
    >>> pair.vector_field([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    array([ 0.,  0.,  2.,  0.,  0., -2.])
    >>> list(spin_lattice("square", (4, 4), periodic=True, tensor=(1, 1, 0.5)).integrals)
    ['total S3']
    """
    sites, edges = graph(lattice, shape, periodic)
    J = _numbers(exchange, "exchange", ((), (len(edges),)))
    T = _matrices(tensor, "tensor", len(edges))
    D = _numbers(dm, "dm", ((3,), (len(edges), 3)))
    K = _matrices(on_site, "on_site", sites, symmetric=True)
    equal = J.ndim == 0 and T.ndim == 2 and D.ndim == 1 and K.ndim == 2
    per_spin, per_edge = (BYTES_PER_EQUAL_SPIN, BYTES_PER_EQUAL_EDGE) if equal else (BYTES_PER_SPIN, BYTES_PER_EDGE)
    check_available_memory(per_spin * sites + per_edge * len(edges), f"a lattice of {short(sites)} spins")
    driven = callable(field)
    B = np.zeros(3) if driven else _numbers(field, "field", ((3,), (sites, 3)))
    if not (len(edges) and np.any(J)):
        T = np.zeros((3, 3))
    if not len(edges):
        D = np.zeros(3)
    H: Any = coupled_spins(sites, edges, *_couplings(J, T, D, B, K))
    if driven:
        H = Driven(H, field, sites, 3, "field")
    parameters = None if driven else _plain_parameters(lattice, shape, periodic, exchange, tensor, dm, field, on_site)
    strength = float(_numbers(dipolar, "dipolar", ((),)))
    if strength:
        H = H + dipolar_energy(lattice, shape, periodic, strength)
        parameters = None if parameters is None else {**parameters, "dipolar": strength}
    if 3 * sites > RELEASED_SIZE:
        release_freed_memory()
    exact = None if driven or strength or np.any(D) else precession(sites, edges, J, T, K, B)
    return LiePoissonSystem(
        _few_spins(sites) if sites <= 8 else _spins(sites),
        H,
        sign=+1,
        casimirs=None
        if sites <= MAX_RECORDED_SPINS
        else KnownInvariants({"sum of |x|^2": partial(_sum_of_squares, sites)}),
        name="spin_lattice",
        parameters=parameters,
        exact=exact,
        integrals={} if strength else _integrals(sites, T, D, K, B, H.uniform if driven else None),
        layout={"lattice": lattice, "shape": shape} if isinstance(lattice, str) else {"lattice": "graph"},
    )


def _sum_of_squares(sites: int) -> Quadratic:
    return Quadratic(np.full(3 * sites, 2.0))


def _integrals(sites: int, *couplings: Any) -> Mapping[str, Any]:
    """Return the constant components of the total spin, checked for few spins, and for many made when they are read."""
    found = total_spins(sites, *couplings)
    return KnownInvariants(found) if sites > MAX_RECORDED_SPINS else {name: make() for name, make in found.items()}


# Algebras of lattices that exist.
_ALGEBRAS: WeakValueDictionary[int, LieAlgebra] = WeakValueDictionary()


def _spins(sites: int) -> LieAlgebra:
    """Return the algebra of spins, shared by all systems that exist."""
    found = _ALGEBRAS.get(sites)
    if found is None:
        found = _ALGEBRAS[sites] = copies(catalogue.so(3), sites)
    return found


_few_spins = cache(_spins)


def _numbers(argument: Any, what: str, shapes: tuple[tuple[int, ...], ...]) -> Floats:
    array = read_finite(argument, what)
    if array.shape not in shapes:
        expected = " or ".join(str(shape) for shape in shapes).replace("()", "one number")
        raise ValueError(f"{what} has shape {array.shape}; give {expected}")
    if np.abs(array).max(initial=0.0) > MAX_COUPLING:
        raise ValueError(
            f"{what} has numbers beyond {MAX_COUPLING:g}, whose products leave the range of float64; take larger units"
        )
    return array


def _matrices(argument: Any, what: str, count: int, symmetric: bool = False) -> Floats:
    array = _numbers(argument, what, ((3,), (3, 3), (count, 3, 3)))
    matrices = np.diag(array) if array.ndim == 1 else array
    asymmetric = np.argwhere(matrices != np.swapaxes(matrices, -1, -2)) if symmetric else np.zeros(0)
    if asymmetric.size:
        raise ValueError(f"{what} is not symmetric at {asymmetric[0].tolist()}; give the same value on both sides")
    return matrices


def _plain_parameters(lattice: Any, *arguments: Any) -> dict[str, Any] | None:
    """Return the parameters as plain numbers and tuples; None if they are too many."""
    names = ("shape", "periodic", "exchange", "tensor", "dm", "field", "on_site")
    edges = lattice if isinstance(lattice, str) else to_array(lattice, "lattice")
    if sum(np.size(argument) for argument in (edges, *arguments)) > MAX_STORED_VALUES:
        return None
    return {
        "lattice": lattice if isinstance(lattice, str) else as_tuples(np.asarray(edges)),
        **{
            name: as_tuples(np.asarray(argument, dtype=np.float64 if k > 1 else None))
            for k, (name, argument) in enumerate(zip(names, arguments, strict=True))
        },
    }


class Driven(Summable):
    """``H(x, t) = Q(x) - sum over sites s and axes a of f_sa(t) x_sa``, Q quadratic in ``sites * axes`` coordinates."""

    # Numba compiles `force`, of the time alone: (axes,), common to all sites, or (sites, axes). Axes commute over
    # sites.

    timed = True

    def __init__(self, quadratic: Quadratic, force: Callable[..., Any], sites: int, axes: int, what: str) -> None:
        self.dim: int | None = quadratic.dim
        self._quadratic, self._sites, self._axes = quadratic, sites, axes
        if isinstance(force, type) or takes_time(force, what):
            raise TypeError(f"{what} is {short(force)}; give a function of the time t alone")
        try:
            values = np.asarray(force(0.0), dtype=np.float64)
        except Exception as reason:
            raise TypeError(
                f"{what}(0.0) fails ({type(reason).__name__}: {short(str(reason))}); give numbers"
            ) from None
        if values.shape not in ((axes,), (sites, axes)):
            raise ValueError(f"{what}(t) has shape {values.shape}; it must return ({axes},) or ({sites}, {axes})")
        if not np.isfinite(values).all():
            raise ValueError(f"{what}(0.0) is not finite; give a function with finite values")
        self.uniform = values.ndim == 1
        self._force, self._factor = force, 1.0
        self._terms: tuple[Term, ...] | None = None

    def bind(self, n: int) -> Driven:
        """Return this Hamiltonian; raise an error if n is not its dimension."""
        self._quadratic.bind(n)
        return self

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        result = copy.copy(self)
        result._quadratic, result._factor, result._terms = factor * self._quadratic, factor * self._factor, None
        return result

    def _forces(self, t: float, like: npt.NDArray[Any]) -> npt.NDArray[Any]:
        values = np.asarray(self._force(t), dtype=None if like.dtype == object else np.float64)
        return self._factor * np.broadcast_to(values, (self._sites, self._axes)).ravel()

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t)."""
        y = read_point(x, self.dim)
        return self._quadratic.value(y, t) - self._forces(t, y) @ y

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        y = read_point(x, self.dim)
        return self._quadratic.gradient(y, t) - self._forces(t, y)

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the dense matrix of the quadratic part."""
        return self._quadratic.hessian(x, t)

    def terms(self) -> tuple[Term, ...]:
        """Return the quadratic term and one function term for each axis."""
        if self._terms is None:
            require_packages("a time-dependent field", "numba")
            import numba

            compiled = numba.njit(self._force) if inspect.isfunction(self._force) else self._force
            drive_terms = [
                _term(compiled, -self._factor, np.arange(axis, self.dim or 0, self._axes), axis, self.uniform)
                for axis in range(self._axes)
            ]
            self._terms = (*self._quadratic.terms(), *drive_terms)
        return self._terms

    def __repr__(self) -> str:
        return f"Driven({self._quadratic!r}, in time)"


def _term(
    force: Callable[..., Any], factor: float, coordinates: npt.NDArray[np.int64], axis: int, uniform: bool
) -> FunctionTerm:
    if uniform:

        def value(y: Any, t: Any) -> Any:
            return factor * force(t)[axis] * np.sum(y)

        def gradient(y: Any, t: Any) -> Any:
            return np.full(len(y), factor * force(t)[axis])

    else:

        def value(y: Any, t: Any) -> Any:
            forces, total = force(t), 0.0
            for site in range(len(y)):
                total += factor * forces[site][axis] * y[site]
            return total

        def gradient(y: Any, t: Any) -> Any:
            forces, result = force(t), np.zeros(len(y))
            for site in range(len(y)):
                result[site] = factor * forces[site][axis]
            return result

    def hessian(y: Any, t: Any) -> Any:
        return np.zeros((len(y), len(y)))

    return FunctionTerm(coordinates.astype(np.int64), value, gradient, hessian, timed=True)
