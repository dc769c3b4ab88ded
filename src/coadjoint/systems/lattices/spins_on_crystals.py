"""Spins on crystals: the function that makes models without energy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.crystals import Crystal
from coadjoint.systems.lattices.declared_spins import UNITS, Declaration, check_sizes
from coadjoint.systems.lattices.geometry import MAX_SITES, read_flags, read_sizes
from coadjoint.systems.lattices.spin_lattice import MAX_COUPLING
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.systems.lattices.twists import Twist
from coadjoint.validation import read_choice, read_finite, read_number

Floats = npt.NDArray[np.float64]

MODES: Mapping[str, type[SpinModel]] = {"dipole": SpinModel, "SU(N)": CoherentSpinModel}


@suggest_keywords
def spins(
    crystal: Crystal,
    size: tuple[int, int, int],
    *,
    spin: Any = None,
    g: Any = None,
    moments: Any = None,
    periodic: Any = True,
    units: str = "natural",
    twist: Any = None,
    axis: Any = (0.0, 0.0, 1.0),
    mode: str = "dipole",
) -> SpinModel:
    """Return spins on the sites of a crystal, without energy; methods of the model add its terms.

    Choose it for spins on a real structure, with exchange by bonds, anisotropies by sites, and units of the laboratory;
    `spin_lattice` is for lattices by name and for graphs. The energy is, with each bond once,

    ``H = sum(S_i . J_ij S_j + D_ij . (S_i x S_j)) + sum(S_i . A_i S_i - g_i mu_B B . S_i) + dipoles``,

    so that J > 0 is antiferromagnetic and A < 0 along an easy axis. The states are directions of length 1, and S_i is S
    times the direction: all lengths and moments are numbers of the model. The equations are those of angular momenta,
    ``hbar S_i' = S_i x (-dH/dS_i)``.

    Parameters
    ----------
    crystal : Crystal
        From `co.spins.crystal`, magnetic sites only (``subcrystal`` keeps them).
    size : tuple of int
        Cells along the three lattice vectors.
    spin : float, mapping or (sites of a cell,) array_like, optional
        Length S of the spins: for all, label -> S, or one for each site of a cell. 1 by default.
    g : float, mapping or array_like, optional
        g-factor, not zero; 2 by default. See `SpinModel.field` for its sign.
    moments : float, mapping or array_like, optional
        Moments g S in units of mu_B, in place of `spin` or of `g`: with `spin` they give g, else S by the size of g.
    periodic : bool or tuple of bool
        Whether the lattice is periodic along each lattice vector.
    units : {"natural", "meV"}
        "natural": hbar = mu_B = k_B = 1, dipoles of moments m at distance r of the order m^2/r^3. "meV": energies in
        meV, fields in tesla, times in ps, temperatures in kelvin (also those of `thermal_states`, `HeatBath` and
        `Gilbert`), lengths in angstroms.
    twist : (3,) array_like, optional
        Twisted boundaries, for spirals whose period is not that of the lattice: beyond its end along each lattice
        vector the spins are turned by these angles, in radians, about `axis`, S(n + size) = R S(n). A spiral of wave
        vector q along the first one has the twist 2 pi q times its cells. For energies that rotations about the axis
        leave invariant; other terms are refused. Zero along open axes.
    axis : (3,) array_like
        Axis of the twist in the Cartesian frame of the lattice; the third one by default.
    mode : {"dipole", "SU(N)"}
        "dipole": spins are vectors. "SU(N)": they are pure quantum states of N = 2 S + 1 levels, and the model is a
        `CoherentSpinModel`, whose energies are operators; choose it for anisotropies as strong as the exchange.

    Returns
    -------
    SpinModel
        State: directions of the spins, S_i at ``x[3 i : 3 i + 3]``, cell by cell, with the last axis of `size` fastest,
        and within a cell in the order of ``crystal.labels``.

    Raises
    ------
    ValueError, TypeError
        Sizes or lengths that are not positive; unknown labels or units; all of `spin`, `g` and `moments`.

    References
    ----------
    S. Toth, B. Lake, J. Phys.: Condens. Matter 27, 166002 (2015), the form of the energy; L. M. Sandratskii, Adv. Phys.
    47, 91 (1998), spirals in one cell; CODATA 2022.

    Examples
    --------
    An ion of spin 5/2 precesses in one tesla at 27.99 GHz, 0.1759 radians in a picosecond:

    >>> import coadjoint as co
    >>> cube = co.spins.crystal(lattice=(3, 3, 3, 90, 90, 90), sites={"Mn": (0, 0, 0)})
    >>> model = co.systems.spins(cube, (1, 1, 1), spin=5 / 2, units="meV").field((0, 0, 1.0))
    >>> co.integrate(model, (1.0, 0.0, 0.0), (0, 1), 0.1).x[-1].round(4) + 0.0
    array([ 0.9846, -0.175 ,  0.    ])
    """
    if not isinstance(crystal, Crystal):
        raise TypeError(f"crystal is {short(crystal)}; give one of co.spins.crystal")
    sizes = read_sizes(size, 3, "size")
    total = len(crystal.labels) * math.prod(sizes)
    if total > MAX_SITES:
        raise ValueError(f"size is {short(sizes)}, which makes {short(total)} spins; at most {MAX_SITES} are possible")
    flags = read_flags(periodic, 3)
    choice = read_choice(units, "units", UNITS)
    given = [name for name, value in (("spin", spin), ("g", g), ("moments", moments)) if value is not None]
    if len(given) == 3:
        raise ValueError("spin, g and moments are given, and moments are g times spin; give two of them")
    of_g = _of_sites(2.0 if g is None else g, "g", crystal)
    if np.any(of_g == 0.0):
        raise ValueError("g has a zero; give numbers other than zero")
    if moments is None:
        lengths = _of_sites(1.0 if spin is None else spin, "spin", crystal)
    else:
        mu = _of_sites(moments, "moments", crystal)
        lengths = np.abs(mu / of_g) if spin is None else _of_sites(spin, "spin", crystal)
        if spin is None and g is not None and np.any(mu * of_g < 0.0):
            raise ValueError("moments and g have other signs, and moments are g times a length; give them one sign")
        of_g = np.copysign(of_g, mu) if spin is None else mu / np.where(lengths, lengths, 1.0)
    what = "spin" if moments is None or spin is not None else "moments"
    if not np.all(lengths >= 1.0 / MAX_COUPLING):
        raise ValueError(f"{what} is {short(moments if what == 'moments' else spin)}; lengths of spins are positive")
    turned = Twist.of(twist, axis, flags)
    declared = Declaration(crystal, sizes, flags, choice, lengths, of_g, turned)  # type: ignore[arg-type]
    return MODES[read_choice(mode, "mode", MODES)](declared)


def _of_sites(values: Any, what: str, crystal: Crystal) -> Floats:
    """Return numbers of the sites of a cell, given for all, by labels, or for each."""
    if isinstance(values, Mapping):
        labels = dict.fromkeys(crystal.labels)
        for label in values:
            read_choice(label, f"label of {what}", labels)
        missing = [label for label in labels if label not in values]
        if missing:
            raise ValueError(f"{what} has no number for {short(missing)}; give one for each label")
        values = [read_number(values[label], f"{what}[{short(label)}]") for label in crystal.labels]
    found = read_finite(values, what)
    if found.shape not in ((), (len(crystal.labels),)):
        raise ValueError(
            f"{what} has shape {found.shape}; give one number, label -> number, or ({len(crystal.labels)},) for the "
            "sites of a cell"
        )
    check_sizes(found, what)
    return np.array(np.broadcast_to(found, len(crystal.labels)))
