"""Micromagnetic models: a spin for each cell of a mesh, with the material constants of mumax3 in SI units."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.bonds import antisymmetric
from coadjoint.systems.lattices.crystals import Crystal
from coadjoint.systems.lattices.declared_spins import MEV_PER_JOULE, UNITS, ExchangeTable
from coadjoint.systems.lattices.geometry import read_flags, read_sizes
from coadjoint.systems.lattices.space_groups import SymmetryOperations
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.systems.lattices.spins_on_crystals import spins
from coadjoint.validation import read_finite, read_number, read_positive

Floats = npt.NDArray[np.float64]

GAMMA = 1.7595e11  # rad/(T s), GammaLL of mumax3
ANGSTROM = 1e-10


@suggest_keywords
def micromagnetic(
    size: tuple[int, int, int],
    cell: npt.ArrayLike,
    *,
    Msat: float,
    Aex: float,
    Ku1: float = 0.0,
    axis: npt.ArrayLike = (0.0, 0.0, 1.0),
    Dind: float = 0.0,
    Dbulk: float = 0.0,
    gamma: float = GAMMA,
    periodic: Any = False,
) -> SpinModel:
    """Return the model of a magnet on a rectangular mesh, with the names and units of mumax3.

    Choose it to repeat a micromagnetic simulation, or for material constants in SI units. The energy is that of the
    finite differences of mumax3, of a moment ``Msat V`` in each cell of volume V: ``Aex (grad m)^2 - Ku1 (m . axis)^2 +
    Dind (m_z div m - (m . grad) m_z) + Dbulk m . curl m``. Fields are added by ``model.field(B)`` in tesla, damping by
    `Gilbert`; ``model.dipolar()`` couples the moments as point dipoles at the centres of the cells, which is not the
    demagnetization of whole cells.

    Parameters
    ----------
    size : tuple of int
        Cells along x, y, z.
    cell : (3,) array_like
        Edges of a cell in metres.
    Msat : float
        Saturation magnetization in A/m.
    Aex : float
        Exchange stiffness in J/m.
    Ku1 : float
        Uniaxial anisotropy in J/m^3; positive for an easy axis.
    axis : (3,) array_like
        Axis of the anisotropy, of any length.
    Dind, Dbulk : float
        Interfacial and bulk Dzyaloshinskii-Moriya constants in J/m^2.
    gamma : float
        Gyromagnetic ratio in rad/(T s); by default that of mumax3, 0.08 per cent below that of g = 2.
    periodic : bool or tuple of bool
        Whether the mesh is periodic along x, y, z; axes of one cell have no exchange.

    Returns
    -------
    SpinModel
        In ``units="meV"``: fields in tesla, times in ps, temperatures in kelvin, positions in angstroms. States are
        spins S = -m, opposite to the moments, as those of `read_ovf`.

    Raises
    ------
    ValueError, TypeError
        Constants out of range, a zero axis, or a periodic axis of two cells.

    Notes
    -----
    Neighbours at the distance d along an axis are coupled by ``-2 Aex V/d^2 m_i . m_j``, ``Dind V/d (z x r) . (m_i x
    m_j)`` and ``-Dbulk V/d r . (m_i x m_j)``, r the direction of the bond. At open edges neighbours are missing, as
    with ``OpenBC = true`` of mumax3; its other boundaries extrapolate the magnetization where there is a
    Dzyaloshinskii-Moriya coupling. Cells must be smaller than the exchange length sqrt(2 Aex/(mu0 Msat^2)).

    References
    ----------
    A. Vansteenkiste et al., "The design and verification of MuMax3", AIP Advances 4, 107133 (2014).

    Examples
    --------
    The ferromagnetic resonance of a uniaxial magnet, gamma (B + 2 Ku1/Msat), in GHz:

    >>> import numpy as np, coadjoint as co
    >>> cube = co.spins.micromagnetic((2, 2, 2), (2e-9, 2e-9, 2e-9), Msat=8e5, Aex=1e-11, Ku1=1e5).field((0, 0, 0.5))
    >>> omega = co.equilibrium(cube, np.tile((0.0, 0.0, -1.0), 8)).frequencies
    >>> float((1000 * omega.min() / (2 * np.pi)).round(3)), round(1.7595e11 * (0.5 + 2 * 1e5 / 8e5) / (2e9 * np.pi), 3)
    (21.002, 21.002)
    """
    (nx, ny, nz), flags = read_sizes(size, 3, "size"), read_flags(periodic, 3)
    edges, u = read_finite(cell, "cell"), read_finite(axis, "axis")
    if edges.shape != (3,) or not ((edges > 1e-12) & (edges < 1.0)).all():
        raise ValueError(f"cell is {short(cell)}; give three edges in metres, along x, y, z, as (4e-9, 4e-9, 1e-9)")
    length = float(np.linalg.norm(u)) if u.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise ValueError(f"axis is {short(axis)}; give a direction (3,), not zero")
    M, A, g = read_positive(Msat, "Msat"), read_number(Aex, "Aex"), read_positive(gamma, "gamma")
    K, D, D_bulk = (read_number(value, what) for value, what in ((Ku1, "Ku1"), (Dind, "Dind"), (Dbulk, "Dbulk")))
    for value, most, what, unit in (
        (M, 1e8, "Msat", "A/m"),
        (A, 1e-6, "Aex", "J/m"),
        (K, 1e12, "Ku1", "J/m^3"),
        (D, 1.0, "Dind", "J/m^2"),
        (D_bulk, 1.0, "Dbulk", "J/m^2"),
        (g, 1e15, "gamma", "rad/(T s)"),
    ):
        if abs(value) > most:
            raise ValueError(f"{what} is {value:g}, far beyond any magnet; give it in {unit}")
    volume, units = math.prod(edges.tolist()), UNITS["meV"]
    moment = M * volume * MEV_PER_JOULE / units.mu_B  # in Bohr magnetons
    factor = 1e-12 * g * units.hbar / units.mu_B
    lattice = np.diag(edges / ANGSTROM)
    alone = SymmetryOperations(np.eye(3, dtype=np.int64)[None], np.zeros((1, 3)), "P 1 (1)")
    crystal = Crystal(lattice, ["m"], ["m"], np.zeros((1, 3)), alone, 1e-3)
    model = spins(crystal, (nx, ny, nz), spin=moment / factor, g=-factor, periodic=flags, units="meV")
    along = np.array([axis for axis, count in enumerate((nx, ny, nz)) if count > 1], dtype=np.int64)
    r, d = np.eye(3)[along], edges[along, None, None]
    vectors = D * np.cross((0.0, 0.0, 1.0), r) - D_bulk * r
    couplings = volume / d * (antisymmetric(vectors) - 2.0 * A / d * np.eye(3))
    if np.any(couplings):
        table = ExchangeTable(
            np.zeros((len(r), 2), dtype=np.int64),
            np.eye(3, dtype=np.int64)[along],
            MEV_PER_JOULE * couplings,
            "meV",
            of_directions=True,
            source="material constants",
        )
        model = model.exchange(table)
    if K:
        u = u / length
        model = model.single_ion(0, -K * volume * MEV_PER_JOULE / (moment / factor) ** 2 * np.outer(u, u))
    return model
