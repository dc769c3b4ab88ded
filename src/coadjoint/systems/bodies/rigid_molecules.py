"""Rigid molecules with Lennard-Jones and Coulomb forces between their sites."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.bodies import BodiesSystem, system_of_bodies
from coadjoint.systems.bodies.body import IN_SPACE, momentum_in_space
from coadjoint.systems.bodies.body_pictures import DIPOLES, distances_of_bodies, pictures_of_molecules
from coadjoint.systems.bodies.inertia import BodyInertia, check_products, read_body_inertia, read_in_range
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.site_forces import SiteTables, site_forces
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_choice, read_finite, read_integer, read_list, read_number, set_fields

Floats = npt.NDArray[np.float64]

MIXING = ("lorentz-berthelot", "geometric")
SWITCHED_PART = 0.1
"""Width of the switch relative to the cutoff, by default."""
COLLINEAR = 64 * UNIT_ROUNDOFF
"""Largest distance of a site from the axis of its linear molecule, relative to the size, that is left as it is."""
ROUNDED_LINE, ROUNDED_CHARGE = 1e-6, 1e-4
"""Largest distances of sites with and without a mass from the axis of a linear molecule, relative to the size, that are
taken for the rounding of input: of seven and five decimals of a bond length in nm. Farther ones with a mass are a bent
molecule, which turns fast about its axis; without one they would turn what has no moment of inertia."""
MAX_MOLECULES = 10**5
ARGUMENTS = ("sites", "charges", "lj", "masses", "count")
"""The arguments that each kind of molecules has."""
KIND = "give one molecule, or a list of kinds, of which each of sites, charges, lj, masses and count has one"

WATER = ((0.0, 0.0, 0.0), (0.0756950, 0.0, 0.0585882), (-0.0756950, 0.0, 0.0585882))


class MoleculesSystem(BodiesSystem):
    """Rigid molecules with forces between their sites; `rigid_molecules` makes it."""

    tables: SiteTables

    def sites(self, x: npt.ArrayLike) -> Floats:
        """Return the positions of the sites of all molecules in space, molecule by molecule.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., sites, 3)

        Examples
        --------
        >>> import coadjoint as co
        >>> water = co.systems.rigid_molecules(count=2)
        >>> O, H, _ = water.sites(water.state([[0, 0, 0], [0.3, 0, 0]]))[3:]
        >>> float(np.linalg.norm(H - O).round(4))
        0.0957
        """
        A, r, begin, first = self.attitudes(x), self.positions(x), 0, 0
        found = []
        for count, types in zip(self.tables.molecules.tolist(), self.tables.types.tolist(), strict=True):
            own, places = slice(begin, begin + count), self.tables.places[first : first + types]
            turned = np.einsum("...mij,sj->...msi", A[..., own, :, :], places)
            found.append((r[..., own, None, :] + turned).reshape(*r.shape[:-2], -1, 3))
            begin, first = begin + count, first + types
        return np.concatenate(found, axis=-2)


def _dimer() -> Floats:
    """Return two molecules of water with a hydrogen bond, which turn slowly."""
    a, b = np.array([WATER[1][0], WATER[1][2]]) / np.hypot(WATER[1][0], WATER[1][2])
    c, s = np.cos(1.0), np.sin(1.0)
    donor = [[a, 0.0, b], [0.0, 1.0, 0.0], [-b, 0.0, a]]  # a bond of the first molecule points to the second one
    acceptor = [[0.0, -c, s], [1.0, 0.0, 0.0], [0.0, s, c]]
    return rigid_molecules().state(
        positions=[[-0.14, 0.0, 0.0], [0.14, 0.0, 0.0]],
        attitudes=[donor, acceptor],
        angular_velocities=[[2.0, 1.0, 0.0], [0.0, -1.0, 2.0]],
    )


@ready_made(
    unit="z",
    coordinates=IN_SPACE,
    gallery_entry=GalleryEntry(
        x0=_dimer,
        t_span=(0.0, 2.0),
        step=0.0005,
        caption="Two molecules of water with a hydrogen bond: the directions of their dipoles in space, which librate, "
        "and the distance of their centres of mass.",
        pictures=(DIPOLES, Picture("bodies")),
        components=Picture("components", functions=distances_of_bodies, quantity="distance of the centres [nm]"),
        quantity="state",
        variant=lambda system: pictures_of_molecules(system, WATER),
    ),
)
def rigid_molecules(
    sites: Any = WATER,
    charges: Any = (-0.834, 0.417, 0.417),
    lj: Any = ((0.636386, 0.315061), (0.0, 0.0), (0.0, 0.0)),
    masses: Any = (15.9994, 1.008, 1.008),
    count: Any = 2,
    box: Any = None,
    cutoff: float | None = None,
    switch_from: float | None = None,
    dielectric: float = 1.0,
    mixing: str = "lorentz-berthelot",
    coulomb: float = 138.935458,
) -> MoleculesSystem:
    """Return rigid molecules with Lennard-Jones and Coulomb forces between the sites of different molecules.

    Choose it for molecular dynamics of small molecules with fixed bonds at constant energy: water, nitrogen, ions. The
    defaults are two molecules of TIP3P water. As `bodies`, with ``V = sum over pairs of molecules, and over sites i of
    one and j of the other, of coulomb q_i q_j/s + 4 epsilon_ij ((sigma_ij/s)^12 - (sigma_ij/s)^6)``, s the distance of
    the sites. Molecules are in free space, all pairs or with a cutoff, or in a periodic box.

    With a cutoff, the energy of two molecules is multiplied by ``1 - 10 x^3 + 15 x^4 - 6 x^5`` of their centres of
    mass, where x goes from 0 at the distance `switch_from` to 1 at `cutoff`, so that forces and their derivatives are
    continuous. The Coulomb energy then has a reaction field, ``coulomb q_i q_j (1/s + k s^2 - 1/cutoff - k cutoff^2)``,
    ``k = (dielectric - 1)/((2 dielectric + 1) cutoff^3)``; with dielectric 1 it is shifted.

    Parameters
    ----------
    sites : (s, 3), or a list of kinds
        Positions of the sites of a molecule, in any frame: its axes are those of the molecule, the origin is moved to
        the centre of mass.
    charges : (s,)
        Charges of the sites.
    lj : (s, 2)
        Depth epsilon and diameter sigma of each site, not negative.
    masses : (s,)
        Masses of the sites; zero for virtual ones. The moments of inertia are computed from them.
    count : int
        Number of molecules, of each kind. Those of the first kind come first.
    box : float or (3,), optional
        Sides of a periodic box. Forces are those of the nearest images; positions are not wrapped.
    cutoff : float, optional
        Distance of the centres from which on two molecules do not interact; at most half of the smallest side of `box`,
        with which it must be given.
    switch_from : float, optional
        Distance at which the switch begins, positive and less than `cutoff`; by default 0.9 times the cutoff.
    dielectric : float
        Relative permittivity of the reaction field, at least 1.
    mixing : {"lorentz-berthelot", "geometric"}
        Rule for pairs of sites: arithmetic means of sigma, or geometric ones; those of epsilon are geometric.
    coulomb : float
        Coulomb constant, positive.

    Returns
    -------
    MoleculesSystem
        As from `bodies`, with ``sites(x)``, the positions of all sites in space. Integrals: the total momentum
        ``"total p1"``, ... and without a box angular momentum ``"total L1"``, ... in space.

    Raises
    ------
    TypeError, ValueError
        Arguments of wrong shapes or out of range; different numbers of kinds; a box without a cutoff; or a massless
        site beside the axis of a linear molecule or beside an atom, which would turn it.

    Notes
    -----
    Units are those of the constants. The defaults are in nm, ps, atomic mass units, elementary charges and kJ/mol, as
    in GROMACS and OpenMM. TIP3P: Jorgensen et al., J. Chem. Phys. 79, 926 (1983). Atoms are molecules of one site, and
    linear molecules do not turn about their axes: take ``Splitting(parts="free_body")`` with them.

    Examples
    --------
    Water and a linear molecule, with massless charges, which conserve their momentum:

    >>> import coadjoint as co
    >>> linear = [(0, 0, -0.05), (0, 0, 0.05), (0, 0, 0)]
    >>> mixture = co.systems.rigid_molecules(
    ...     sites=[[(0, 0, 0), (0.0757, 0, 0.0586), (-0.0757, 0, 0.0586)], linear],
    ...     charges=[(-0.834, 0.417, 0.417), (-0.4, -0.4, 0.8)],
    ...     lj=[((0.636, 0.315), (0, 0), (0, 0)), ((0.3, 0.33), (0.3, 0.33), (0, 0))],
    ...     masses=[(16, 1, 1), (14, 14, 0)],
    ...     count=(1, 2),
    ... )
    >>> x0 = mixture.state([[0, 0, 0], [0.4, 0, 0], [0, 0.4, 0]])
    >>> sol = co.integrate(mixture, x0, (0, 0.5), 0.001, co.Splitting(order=2, parts="free_body"))
    >>> bool(sol.drift()["energy"] < 1e-3), bool(abs(sol.velocities[-1].T @ mixture.masses).max() < 1e-12)
    (True, True)
    """
    several = _depth(sites) > 2
    kinds = _read_kinds(several, sites, charges, lj, masses, count)
    bodies = [
        _body_of_sites(places, m, f"[{k}]" if several else "")
        for k, (places, m) in enumerate(zip(kinds["sites"], kinds["masses"], strict=True))
    ]
    total = sum(kinds["count"])
    if total > MAX_MOLECULES:
        raise ValueError(f"count is {short(count)}; give at most {MAX_MOLECULES} molecules")
    sides, ends = _read_box(box), _read_cutoff(box, cutoff, switch_from, dielectric)
    constant = read_in_range(coulomb, "coulomb")
    places, weights, inertias = zip(*bodies, strict=True)
    tables = _tables(kinds, places, sides, ends, read_choice(mixing, "mixing", MIXING), constant)
    named = {key: tuple(map(as_tuples, values)) for key, values in kinds.items()}
    parameters = {key: values if several else values[0] for key, values in named.items()} | {
        "box": None if box is None else as_tuples(sides),
        "cutoff": None if cutoff is None else ends[1],
        "switch_from": None if switch_from is None else ends[0],
        "dielectric": ends[2],
        "mixing": mixing,
        "coulomb": constant,
    }
    order = np.repeat(np.arange(len(bodies)), kinds["count"]).tolist()
    system = system_of_bodies(
        "rigid_molecules",
        tuple(inertias[k] for k in order),
        np.array([weights[k] for k in order]),
        site_forces(tables),
        parameters,
        integrals=momentum_in_space(total, 18 * total + 1, turning=box is None),
        kind=MoleculesSystem,
    )
    set_fields(system, tables=tables)
    return system


def _depth(values: Any) -> int:
    """Return the number of axes of nested lists, by their first entries."""
    depth = 0
    while isinstance(values, list | tuple) and values:
        values, depth = values[0], depth + 1
    return depth + getattr(values, "ndim", 0)


def _read_kinds(several: bool, *arguments: Any) -> dict[str, list[Any]]:
    """Validate molecules of one kind, or lists with an entry for each of several; return lists of kinds by argument."""
    if not several:
        return {name: [value] for name, value in zip(ARGUMENTS, _read_kind("", *arguments), strict=True)}
    read = {name: read_list(values, name, KIND) for name, values in zip(ARGUMENTS, arguments, strict=True)}
    for name, values in read.items():
        if len(values) != len(read["sites"]):
            raise ValueError(f"{name} has {len(values)} entries, and sites {len(read['sites'])} kinds; {KIND}")
    kinds = [_read_kind(f"[{k}]", *values) for k, values in enumerate(zip(*read.values(), strict=True))]
    return {name: list(values) for name, values in zip(ARGUMENTS, zip(*kinds, strict=True), strict=True)}


def _read_kind(which: str, sites: Any, charges: Any, lj: Any, masses: Any, count: Any) -> tuple[Any, ...]:
    """Validate the arguments of one kind of molecule, in their order; `which` is its index in messages."""
    places = read_finite(sites, f"sites{which}")
    if places.ndim != 2 or places.shape[1] != 3 or not len(places):
        raise ValueError(f"sites{which} has shape {places.shape}; give (s, 3) for a molecule of s sites, or a list")
    q, pairs, m = (
        read_finite(values, name + which) for values, name in ((charges, "charges"), (lj, "lj"), (masses, "masses"))
    )
    size = len(places)
    for array, name, shape in ((q, "charges", (size,)), (pairs, "lj", (size, 2)), (m, "masses", (size,))):
        if array.shape != shape:
            raise ValueError(f"{name}{which} has shape {array.shape}; give {shape}, as sites{which} has {size} sites")
    for array, name in ((pairs, "lj"), (m, "masses")):
        if (array < 0.0).any():
            raise ValueError(f"{name}{which} is {short(as_tuples(array))}; its numbers must not be negative")
    return places, q, pairs, m, read_integer(count, f"count{which}")


def _body_of_sites(places: Floats, m: Floats, which: str) -> tuple[Floats, float, BodyInertia]:
    """Return the sites of a molecule from its centre of mass, its mass, and its inertia."""
    mass = read_in_range(math.fsum(m), f"the sum of masses{which}")
    # Relative to the first site, so that an atom is at its centre exactly.
    apart = places - places[0]
    centre = [math.fsum((m * apart[:, i]).tolist()) / mass for i in range(3)]
    from_centre = apart - centre
    with np.errstate(over="ignore"):
        moments = [
            [math.fsum((m * from_centre[:, i] * from_centre[:, j]).tolist()) for j in range(3)] for i in range(3)
        ]
    tensor = np.diag([math.fsum([moments[i][i] for i in range(3) if i != j]) for j in range(3)])
    for i, j in ((0, 1), (0, 2), (1, 2)):
        tensor[i, j] = tensor[j, i] = -moments[i][j]
    diagonal = not (tensor - np.diag(np.diag(tensor))).any()
    line, what = _on_a_line(from_centre, m), f"the inertia of sites{which}"
    try:
        inertia = read_body_inertia(np.diag(tensor) if diagonal else tensor, what)
        _check_axis(inertia, from_centre, which)
    except ValueError:
        if line is None:
            raise
    else:
        if line is None or inertia.rotating is not None:
            return from_centre, mass, inertia
    return line[0], mass, read_body_inertia(line[1], what)


def _on_a_line(places: Floats, m: Floats) -> tuple[Floats, Floats] | None:
    """Return sites from their centre of mass, moved to the axis, and the inertia of a molecule that is linear up to the
    rounding of its sites; None for other molecules.
    """
    size = np.abs(places[m > 0.0]).max()
    if not size > 0.0:
        return None
    # The axis of the largest second moment; one of the others is below the square of the tolerance.
    scaled = places / size
    axis = scaled[np.argmax(m * (scaled * scaled).sum(axis=1))]
    for _ in range(3):
        axis = _unit(axis)
        weights = m * np.array([math.fsum(row) for row in (scaled * axis).tolist()])
        axis = np.array([math.fsum((weights * scaled[:, i]).tolist()) for i in range(3)])
    axis = _unit(axis)
    axis[np.abs(axis) < ROUNDED_LINE] = 0.0  # an axis of coordinates is one exactly
    axis = _unit(axis)
    along = np.array([math.fsum(row) for row in (scaled * axis).tolist()])
    beside = np.abs(scaled - along[:, None] * axis).max(axis=1)
    if (beside > np.where(m > 0.0, ROUNDED_LINE, ROUNDED_CHARGE)).any():
        return None
    places = size * (along[:, None] * axis)
    moment = math.fsum((m * (size * along) ** 2).tolist())
    tensor = moment * (np.eye(3) - axis[:, None] * axis)
    return places, np.diag(tensor) if np.count_nonzero(axis) == 1 else tensor


def _unit(vector: Floats) -> Floats:
    return vector / math.sqrt(math.fsum((vector * vector).tolist()))


def _check_axis(inertia: BodyInertia, places: Floats, which: str) -> None:
    """Raise ValueError if a site turns a molecule about an axis without a moment of inertia."""
    if inertia.rotating is None:
        return
    beside = np.abs(np.einsum("ij,sj->si", inertia.rotating, places) if inertia.tensor.any() else places).max(axis=1)
    if beside.max() > COLLINEAR * np.abs(places).max():
        raise ValueError(
            f"sites{which} has a massless site {int(beside.argmax())} beside the axis or the centre of its masses, "
            "where it has no moment of inertia; give masses that are not on one line, or move the site"
        )


def _read_box(box: Any) -> Floats:
    """Return the sides of the box, (3,), zero without one."""
    if box is None:
        return np.zeros(3)
    sides = read_finite(box, "box")
    if sides.shape not in ((), (3,)):
        raise ValueError(f"box has shape {sides.shape}; give one side of a cube, or three sides")
    sides = np.broadcast_to(sides, 3).copy()
    for side in sides.tolist():
        read_in_range(side, "box")
    return sides


def _read_cutoff(box: Any, cutoff: Any, switch_from: Any, dielectric: Any) -> tuple[float, float, float]:
    """Return where the switch begins and ends, zero without a cutoff, and the permittivity."""
    permittivity = read_number(dielectric, "dielectric")
    if not 1.0 <= permittivity < math.inf:
        raise ValueError(f"dielectric is {permittivity:g}; give a number of at least 1, which is that of empty space")
    if cutoff is None:
        for name, given in (("box", box is not None), ("switch_from", switch_from is not None)):
            if given:
                raise ValueError(f"{name} was given without cutoff; give the distance at which forces end")
        if permittivity != 1.0:
            raise ValueError(f"dielectric is {permittivity:g} without cutoff; the reaction field begins at a cutoff")
        return 0.0, 0.0, 1.0
    end = read_in_range(cutoff, "cutoff")
    check_products("powers of cutoff", lambda: np.float64(end) ** 3)
    begin = (1.0 - SWITCHED_PART) * end if switch_from is None else read_in_range(switch_from, "switch_from")
    if not begin < end:
        raise ValueError(f"switch_from is {begin:g}, and cutoff {end:g}; the switch must begin before the cutoff")
    if box is not None and end > 0.5 * _read_box(box).min():
        raise ValueError(f"cutoff is {end:g}; with this box give at most {0.5 * _read_box(box).min():g}, half its side")
    return begin, end, permittivity


def _tables(
    kinds: dict[str, list[Any]],
    places: tuple[Floats, ...],
    box: Floats,
    ends: tuple[float, float, float],
    mixing: str,
    constant: float,
) -> SiteTables:
    """Return the tables of all molecules; pairs of types have constants by the rule of mixing."""
    q, (epsilon, sigma) = np.concatenate(kinds["charges"]), np.concatenate(kinds["lj"]).T
    near, cutoff, permittivity = ends
    with np.errstate(all="ignore"):
        square = sigma[:, None] * sigma if mixing == "geometric" else (0.5 * (sigma[:, None] + sigma)) ** 2
        sixth = square * square * square
        depth = 4.0 * np.sqrt(epsilon[:, None] * epsilon)
        qq, a, b = constant * (q[:, None] * q), depth * sixth * sixth, depth * sixth
        field = (permittivity - 1.0) / ((2.0 * permittivity + 1.0) * cutoff * cutoff * cutoff) if cutoff else 0.0
        shift = 1.0 / cutoff + field * cutoff * cutoff if cutoff else 0.0
    for name, array in (("charges", qq), ("lj", a)):
        if not np.isfinite(array).all():
            raise ValueError(f"{name} are so large that products of them leave the range of float64; change units")
    types = np.array([len(sites) for sites in places])
    return SiteTables(
        np.array(kinds["count"]), types, np.concatenate(places), qq, a, b, box, near, cutoff, field, shift
    )
