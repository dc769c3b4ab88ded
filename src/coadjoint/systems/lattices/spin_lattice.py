"""Classical spins on any graph: exchange, anisotropy, Dzyaloshinskii-Moriya coupling and fields."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.families.products import copies
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.caching import MAX_CACHED_SIZE
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.closed_forms.closed_form import move_state, rotate_about
from coadjoint.systems.coefficients import EnergyCoefficients
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lattices.couplings import Blocks, coefficients_of_spins, coupled_spins, driving_field
from coadjoint.systems.lattices.dipoles import dipolar_energy, named_cells
from coadjoint.systems.lattices.geometry import graph
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.validation import as_tuples, read_finite

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]

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
    moments: npt.ArrayLike = 1.0,
) -> LiePoissonSystem:
    """Return classical spins on a lattice or any graph, ``S_i' = S_i cross B_i`` with ``B_i = -dH/dS_i``.

    The Landau-Lifshitz equations without damping: copies of so(3), sign +1, and, summed over edges (i, j) and sites i,
    ``H = sum(-J_ij S_i . T S_j + D_ij . (S_i cross S_j)) - sum(S_i . K S_i + B_i . S_i)``. J > 0 is ferromagnetic. One
    spin in a field B precesses about it by the angle ``-|B| t``. On structure files, with units, and with the sign of
    SpinW, choose `co.systems.spins`.

    Spins are angular momenta. For magnetic moments, ``m' = -gamma m cross B`` as in VAMPIRE, mumax3 and Spirit, with
    the mirrored precession, take S = -m: the states and `field` with the other sign, all else as it is.

    Sites of different moments mu_i, such as two sublattices of a ferrimagnet, have S_i of length 1 and the fields
    ``B_i = -(1/mu_i) dH/dS_i``: H is a function of directions as in VAMPIRE, and site i precesses in the field of its
    neighbours at a rate that goes with 1/mu_i. `co.forces.Gilbert` then has one damping constant and one temperature.

    Parameters
    ----------
    lattice : str or (edges, 2) array of int
        ``"chain"``, ``"ring"``, ``"square"``, ``"triangular"``, ``"honeycomb"``, ``"kagome"``, ``"cubic"`` or
        ``"complete"``; or pairs of sites, from 0, each pair once. Edges are in the order of the bonds of a cell, listed
        in Notes, each bond for all cells; ``coadjoint.systems.lattices.geometry.graph`` returns them.
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
    moments : number or (sites,)
        mu, positive, in the order of the state: the length of the angular momentum of which S_i is the direction,
        ``S_i' = S_i cross B_i`` with ``B_i = -(1/mu_i) dH/dS_i``. Energies over moments are frequencies: with magnetic
        moments the unit of time has gamma = 1, and the magnetic field b has the term ``-mu_i b . S_i``, so that `field`
        is mu_i b. Equal ones if there are dipoles.

    Returns
    -------
    LiePoissonSystem
        State: the spins in order, S_i at ``x[3 i : 3 i + 3]`` (angular momentum; energies over it are frequencies, so
        dimensionless spins go with energies over hbar). Casimirs: ``"|x|^2 [i]"`` of every spin, i from 1, up to 682
        spins; for more, the sum of all. Integrals: the components of the total spin, or its square, that the couplings
        leave constant, each spin times its moment. ``exact(x0, t)`` if all spins are coupled equally and isotropically
        (two spins, a ring of three, a complete graph) in a uniform field and have equal moments, or if none are
        coupled. The group element, for few spins, is the rotation
        of each. Parameters of more than 65536 numbers, and functions, are not stored.

    Raises
    ------
    TypeError, ValueError
        An unknown lattice, a wrong shape, duplicate edges, edges from a site to itself, or arrays of the wrong shape.

    Notes
    -----
    Bonds, from a site s0, s1, ... of a cell to one of the same cell or of that at the given edges a, b, c of cells
    (cells are numbered with the last axis fastest, sites by cells): chain, ring a; square a, b; cubic a, b, c;
    triangular a, b, a - b; honeycomb s0 to s1, s1 to s0 at a, s1 to s0 at b; kagome s0 to s1, s0 to s2, s1 to s2, s1 to
    s0 at a, s2 to s0 at b, s1 to s2 at a - b. a is along the first axis, b at 60 degrees to it (square, cubic: 90). A
    complete graph has (0, 1), (0, 2), ..., (1, 2), ...

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
    layout = {"lattice": lattice, "shape": shape} if np.ndim(lattice) == 0 else {"lattice": "graph"}
    mu = _read_moments(moments, sites)
    J = _numbers(exchange, "exchange", ((), (len(edges),)))
    T = _matrices(tensor, "tensor", len(edges))
    D = _numbers(dm, "dm", ((3,), (len(edges), 3)))
    K = _matrices(on_site, "on_site", sites, symmetric=True)
    driven = callable(field)
    B = np.zeros(3) if driven else _numbers(field, "field", ((3,), (sites, 3)))
    if not (len(edges) and np.any(J)):
        T = np.zeros((3, 3))
    if not len(edges):
        D = np.zeros(3)
    coupling, of_sites, linear = _couplings(J, T, D, B, K)
    H: Any = coupled_spins(sites, edges, Blocks.of(coupling, len(edges)), Blocks.of(of_sites, sites), linear)
    uniform = None
    if driven:
        driving, uniform = driving_field(field, sites)
        H = H + driving
    parameters = None if driven else _plain_parameters(lattice, shape, periodic, exchange, tensor, dm, field, on_site)
    if parameters is not None and mu.ndim + (mu.flat[0] != 1.0):
        parameters["moments"] = as_tuples(mu)
    strength = float(_numbers(dipolar, "dipolar", ((),)))
    if strength:
        if np.ptp(mu):
            raise ValueError(
                "dipolar is given with moments that differ, and has one strength for all pairs; give equal moments"
            )
        H = H + dipolar_energy(named_cells(layout["lattice"], shape, periodic), strength)
        parameters = None if parameters is None else {**parameters, "dipolar": strength}
    exact = None if driven or strength or np.any(D) else precession(sites, edges, J, T, K, B, mu)
    return LiePoissonSystem(
        hamiltonian=H,
        **on_spins(sites, mu),
        parameters=parameters,
        exact=exact,
        integrals={} if strength else KnownInvariants(total_spins(sites, T, D, K, B, uniform, mu)),
        layout=layout,
    )


def on_spins(sites: int, mu: Floats) -> dict[str, Any]:
    """Return the algebra, the sign, the Casimirs and the name of a system of spins of moments mu."""
    known = KnownInvariants({"sum of |x|^2": partial(_sum_of_squares, sites)}) if sites > MAX_RECORDED_SPINS else None
    algebra = _with_moments(_few_spins(sites) if sites <= 8 else _spins(sites), mu)
    return {"algebra": algebra, "sign": +1, "casimirs": known, "name": "spin_lattice"}


def _sum_of_squares(sites: int) -> Quadratic:
    return Quadratic(np.full(3 * sites, 2.0))


# Algebras of lattices that exist.
_ALGEBRAS: WeakValueDictionary[int, LieAlgebra] = WeakValueDictionary()


def _spins(sites: int) -> LieAlgebra:
    """Return the algebra of spins, shared by all systems that exist."""
    found = _ALGEBRAS.get(sites)
    if found is None:
        found = _ALGEBRAS[sites] = copies(catalogue.so(3), sites)
    return found


_few_spins = cache(_spins)


def _read_moments(moments: Any, sites: int) -> Floats:
    """Validate moments of sites, one number or (sites,)."""
    mu = _numbers(moments, "moments", ((), (sites,)))
    if not (mu >= 1.0 / MAX_COUPLING).all():
        raise ValueError(f"moments has the number {mu.min():g}; moments are positive, of at least {1 / MAX_COUPLING:g}")
    return mu


def _with_moments(algebra: LieAlgebra, mu: Floats) -> LieAlgebra:
    """Return the algebra of directions of spins of moments mu: brackets over moments."""
    if np.all(mu == 1.0):
        return algebra
    if np.ndim(mu) == 0 and algebra.dim > 3:
        return copies(_with_moments(_spins(1), mu), algebra.dim // 3)
    inverse = np.repeat(np.broadcast_to(1.0 / mu, algebra.dim // 3), 3)
    matrices = None if algebra.representation is None else algebra.representation * inverse[:, None, None]
    known = dict(algebra.casimirs_known)
    brackets = partial(_over_moments, algebra, inverse)
    constants = brackets if algebra.dim > MAX_CACHED_SIZE else brackets()
    # Names are made when they are read.
    names = partial(getattr, algebra, "basis")
    return LieAlgebra._from_valid(constants, algebra.dim, names, f"{algebra.name} of moments", matrices, known)


def _over_moments(algebra: LieAlgebra, inverse: Floats) -> Triples:
    i, j, k, c = algebra.triples
    return Triples(i.copy(), j.copy(), k.copy(), c * inverse[i])


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


def _plain_parameters(*arguments: Any) -> dict[str, Any] | None:
    """Return the parameters as plain numbers and tuples; None if they are too many."""
    names = ("lattice", "shape", "periodic", "exchange", "tensor", "dm", "field", "on_site")
    if sum(np.size(argument) for argument in arguments) > MAX_STORED_VALUES:
        return None
    return {
        name: as_tuples(np.asarray(argument, dtype=np.float64 if k > 2 else None))
        for k, (name, argument) in enumerate(zip(names, arguments, strict=True))
    }


def precession(
    sites: int, edges: npt.NDArray[np.int64], J: Floats, T: Floats, K: Floats, B: Floats, mu: Any = 1.0
) -> Callable[..., Any] | None:
    """Return the closed form ``exact(x0, t, attitude)`` of spins without Dzyaloshinskii-Moriya coupling, or None."""
    # J is () or (edges,), B (3,) or (sites, 3); T, K (..., 3, 3) are tensors of exchange (zero if uncoupled) and sites;
    # mu is () or (sites,).
    is_uniform = bool(np.all(B == B.reshape(-1, 3)[0]) and not np.ptp(mu))
    J, B = J / np.max(mu), B / (np.max(mu) if not np.ptp(mu) else np.reshape(mu, (-1, 1)))
    if np.any(K != K[..., :1, :1] * np.eye(3)):
        return None
    if not np.any(T):
        return partial(move_state, "spin_lattice", 3 * sites, partial(_precess, sites, 0.0, B))
    complete = 2 * len(edges) == sites * (sites - 1)
    if not complete:
        return None
    strengths = np.unique(J * T[..., 0, 0])
    if np.any(T != T[..., :1, :1] * np.eye(3)) or len(strengths) > 1 or not is_uniform:
        return None
    return partial(move_state, "spin_lattice", 3 * sites, partial(_precess, sites, float(strengths[0]), B))


def _precess(sites: int, strength: float, B: Floats, start: Floats, times: Floats) -> Floats:
    """Rotate all spins about their total, ``S_i' = strength S_i cross S``, and the total about the field."""
    spins = start.reshape(sites, 3)
    about_total = rotate_about(spins, strength * spins.sum(axis=0), times[:, None])
    return rotate_about(about_total, B, times[:, None]).reshape(len(times), 3 * sites)


MAX_DENSE_SQUARE = 64  # largest number of spins for which the dense |sum S|^2 is given
# The total spin along n generates rotations of all spins about n; (turn_k)_ab = -eps_kab generates those about axis k.
ROTATION_GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)


def total_spins(
    sites: int, T: Floats, D: Floats, K: Floats, B: Floats, uniform: bool | None, mu: Any = 1.0
) -> dict[str, Callable[[], Quadratic]]:
    """Return the constant components of the total spin, or its square, by name as functions that make them."""
    # T, K (..., 3, 3) are tensors of exchange and of sites, D, B (..., 3) Dzyaloshinskii-Moriya vectors and fields;
    # `uniform` is whether a time-dependent field in place of B is equal at all sites, None without such a field.
    constraints = np.concatenate([_tensor_constraints(T), _tensor_constraints(K), _vector_constraints(D)])
    isotropic = not np.any(constraints)
    is_uniform = bool(np.all(B == B.reshape(-1, 3)[0])) if uniform is None else uniform
    integrals: dict[str, Callable[[], Quadratic]] = {}
    if uniform is None:
        for axis in axes_orthogonal_to(np.concatenate([constraints, _vector_constraints(B)])):
            nonzero = np.flatnonzero(axis)
            name = f"S{nonzero[0] + 1}" if len(nonzero) == 1 else f"S along ({', '.join(f'{a:.6g}' for a in axis)})"
            integrals[f"total {name}"] = partial(_total_along, sites, axis, mu)
    # Spins of different moments precess about a field at different rates.
    if isotropic and is_uniform and not np.ptp(mu) and len(integrals) < 3 and sites <= MAX_DENSE_SQUARE:
        integrals["|total S|^2"] = partial(_total_squared, sites, float(np.max(mu)))
    return integrals


def _total_along(sites: int, axis: Floats, mu: Any) -> Quadratic:
    return Quadratic(np.zeros(3 * sites), linear=np.outer(np.broadcast_to(mu, sites), axis).ravel())


def _total_squared(sites: int, mu: float) -> Quadratic:
    return Quadratic(np.kron(np.full((sites, sites), 2.0 * mu**2), np.eye(3)))


def _tensor_constraints(tensors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all tensors commute with the rotation about n."""
    different = np.unique(tensors.reshape(-1, 9), axis=0).reshape(-1, 3, 3)
    commutators = np.einsum("eab,kbc->eack", different, ROTATION_GENERATORS) - np.einsum(
        "kab,ebc->eack", ROTATION_GENERATORS, different
    )
    return _unique_nonzero(commutators.reshape(-1, 3))


def _vector_constraints(vectors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all vectors are parallel to n."""
    return _unique_nonzero(
        np.einsum("kab,eb->eak", ROTATION_GENERATORS, np.unique(vectors.reshape(-1, 3), axis=0)).reshape(-1, 3)
    )


def _unique_nonzero(rows: Floats) -> Floats:
    return np.unique(rows[np.any(rows, axis=1)], axis=0)


def axes_orthogonal_to(rows: Floats) -> Floats:
    """Return the axes orthogonal to all rows: three, one (with largest entry 1), or none."""
    # There are never two: rotations about two axes generate those about all.
    if not len(rows):
        return np.eye(3)
    with np.errstate(over="ignore", under="ignore"):
        units = rows / np.abs(rows).max(axis=1, keepdims=True)
        crosses = np.cross(units[0], units)
        axis = crosses[np.argmax(np.abs(crosses).max(axis=1))]
        size = np.abs(axis).max()
        if size == 0.0:
            return np.zeros((0, 3))
        axis = axis / axis[np.argmax(np.abs(axis))]
        is_orthogonal = np.abs(units @ axis).max() <= 16 * UNIT_ROUNDOFF / min(size, 1.0)
    return axis[None] + 0.0 if is_orthogonal else np.zeros((0, 3))
