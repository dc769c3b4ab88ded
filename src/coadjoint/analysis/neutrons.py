"""What unpolarized neutrons measure of spins: form factors, polarization factor, temperature and domains."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.wave_vectors import ORTHOGONAL, Lattice, WaveVectors, turned_waves
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.lattices.crystals import label_of
from coadjoint.systems.lattices.declared_spins import UNITS
from coadjoint.systems.lattices.space_groups import rotations_in_space
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import as_tuples, read_finite, read_number, read_positive, set_fields

Floats = NDArray[np.float64]

SYMMETRY = "symmetry"
MAX_LENGTH = 25.0  # of q, 1/angstrom: the sums of Gaussians are fits, some of which grow beyond
F_ELEMENTS = (range(57, 72), range(89, 104))  # atomic numbers of lanthanides and actinides


@suggest_keywords
@dataclass(frozen=True)
class Neutrons:
    """What a measurement with unpolarized neutrons sees, for ``neutrons=`` of `structure_factor` and `linear_modes`.

    Choose it to compare spectra with experiments. Spins become moments g F(q) S in units of mu_B, with the form factor
    F of their ion, and the intensity is the sum over components of ``(delta_ab - q_a q_b / q^2) S_ab(q, omega)``, at
    q = 0 the mean of this over all directions, 2/3 of the trace. The cross section of a spin is (gamma r0 / 2)^2 =
    0.0726 barn times it and the ratio of the wave numbers of the neutron after and before.

    Parameters
    ----------
    form_factors : mapping, optional
        Label of sites, or the element of one label only -> its ion, such as ``"Mn2+"``; (ion, c2), with the factor of
        <j2>; or a function of an array of lengths of q. An ion has ``F = <j0> + c2 <j2>`` with the tables of the
        package periodictable, which need a crystal in angstroms. Without c2 it follows from the g-factor of the
        model: 1 - 2/g of ions with spin and a part of their orbital moment, L = (g - 2) S, and 2/g - 1 of lanthanides
        and actinides, whose "spin" is J with Lande's g. None is F = 1.
    temperature : float, optional
        Temperature in the unit of the model, kelvin for units of meV. S of a run, which is classical and even in
        omega, is multiplied by ``x / (1 - exp(-x))`` with ``x = hbar omega / (k_B T)``, which is right for linear spin
        waves and gives detailed balance; sum rules are those of S before this factor. Modes have the factor n + 1 of
        bosons, else that of zero temperature.
    domains : "symmetry" or (domains, 3, 3) array_like, optional
        Rotations, in the Cartesian frame of the lattice, of domains with equal parts of the sample, over which the
        intensity is averaged. ``"symmetry"`` has those of the crystal. Rotated wave vectors must fit the cells of a
        run.

    Raises
    ------
    ValueError, TypeError
        An ion without a form factor, with those of its element; a temperature that is not positive; matrices that are
        not orthogonal.

    Notes
    -----
    ``<j0> = A exp(-a s^2) + B exp(-b s^2) + C exp(-c s^2) + D`` with ``s = q / (4 pi)``, and <j2> is s^2 times such a
    sum. The dipole approximation is right for small q.

    References
    ----------
    S. W. Lovesey, Theory of Neutron Scattering from Condensed Matter, volume 2 (1984); P. J. Brown, International
    Tables for Crystallography C, section 4.4.5; S. Zhang et al., Phys. Rev. Lett. 122, 167203 (2019).

    Examples
    --------
    >>> import coadjoint as co
    >>> neutrons = co.spectra.Neutrons(form_factors={"Mn": "Mn2+"}, temperature=4.0)
    >>> F = neutrons.form_factor("Mn2+", [0.0, 2.0, 4.0], g=2.0)
    >>> F.round(3).tolist()
    [0.999, 0.763, 0.377]
    """

    form_factors: Any = None
    temperature: float | None = None
    domains: Any = None

    def __post_init__(self) -> None:
        if self.form_factors is not None:
            if not isinstance(self.form_factors, Mapping):
                raise TypeError(f"form_factors is {short(self.form_factors)}; give label -> ion, such as Mn: Mn2+")
            for label, ion in self.form_factors.items():
                if not callable(ion):
                    _table(ion, f"form_factors[{label!r}]")
            set_fields(self, form_factors=dict(self.form_factors))
        if self.temperature is not None:
            set_fields(self, temperature=read_positive(self.temperature, "temperature"))
        if self.domains is None or (isinstance(self.domains, str) and self.domains == SYMMETRY):
            return
        if isinstance(self.domains, str):
            raise ValueError(f"domains is {short(self.domains)}; give {SYMMETRY!r}, or matrices (domains, 3, 3)")
        matrices = read_finite(self.domains, "domains")
        if matrices.ndim != 3 or matrices.shape[1:] != (3, 3) or not len(matrices):
            raise ValueError(f"domains has shape {matrices.shape}; give matrices (domains, 3, 3)")
        with np.errstate(over="ignore", invalid="ignore"):
            defect = np.abs(matrices @ matrices.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
        wrong = np.flatnonzero(~(defect <= ORTHOGONAL))
        if wrong.size:
            raise ValueError(
                f"domains[{wrong[0]}] is {short(matrices[wrong[0]].tolist(), 120)}, which is not orthogonal; give "
                "rotations in the Cartesian frame of the lattice"
            )
        set_fields(self, domains=as_tuples(matrices))

    def form_factor(self, ion: Any, q: Any, g: float = 2.0) -> Floats:
        """Return the form factor of an ion.

        Parameters
        ----------
        ion : str, tuple or callable
            As in `form_factors`.
        q : array_like
            Lengths of wave vectors, in 1/angstrom, with the factor 2 pi.
        g : float
            The g-factor, from which c2 follows.

        Returns
        -------
        ndarray
            F(q), of the shape of q, 1 at q = 0 within the precision of the tables.

        Raises
        ------
        ValueError, TypeError
            An ion without a form factor, a g-factor of 0, or a function that returns other numbers.

        Examples
        --------
        >>> import coadjoint as co
        >>> float(co.spectra.Neutrons().form_factor("Fe2+", 3.0).round(4))
        0.5894
        """
        lengths = read_finite(q, "q")
        if callable(ion):
            return values_at(ion, lengths, "the form factor")
        if np.any(np.abs(lengths) > MAX_LENGTH):
            raise ValueError(
                f"q has the length {np.abs(lengths).max():.6g}, and tables of form factors reach {MAX_LENGTH:g} per "
                "angstrom; take shorter wave vectors, or give a function of q"
            )
        coefficients, is_f, c2 = _table(ion, "ion")
        factor = abs(read_number(g, "g"))
        if factor == 0.0:
            raise ValueError("g is 0; give another number")
        if c2 is None:
            c2 = 2.0 / factor - 1.0 if is_f else 1.0 - 2.0 / factor
        found = coefficients.j0_Q(lengths)
        return np.asarray(found if c2 == 0.0 else found + c2 * coefficients.j2_Q(lengths), dtype=np.float64)


def measured_waves(neutrons: Neutrons | None, waves: WaveVectors, lattice: Lattice, model: Any) -> WaveVectors:
    """Return wave vectors with those at which domains scatter."""
    if neutrons is None or neutrons.domains is None:
        return waves
    if neutrons.domains == SYMMETRY:
        rotations = rotations_in_space(np.unique(model.crystal.rotations, axis=0), model.crystal.lattice)
    else:
        rotations = np.array(neutrons.domains)
    return turned_waves(waves, lattice, rotations)


def values_at(function: Any, points: Floats, what: str) -> Floats:
    """Return a function of the user at an array of points; an error if it fails, or returns anything else."""
    try:
        found = np.asarray(function(np.array(points)))
    except Exception as reason:
        raise TypeError(f"{what} fails ({type(reason).__name__}: {short(str(reason))}); give a function") from None
    if found.shape not in ((), points.shape) or found.dtype.kind not in "iuf" or not np.isfinite(found).all():
        raise ValueError(f"{what} returns {short(found)}; it must return finite numbers of the shape {points.shape}")
    return np.broadcast_to(found, points.shape).astype(np.float64)


def spins_of_states(model: SpinModel) -> Floats:
    """Return the length of the spin S of each site whose coordinates have length 1, (sites,)."""
    # The first three coordinates of a site are the direction of S, or S itself; their bracket [1, 2] = 3 / (hbar S).
    i, j, k, c = model.algebra.triples
    d = model.dim // len(model.sites)
    rotations = (i % d == 0) & (j % d == 1) & (k % d == 2)
    lengths = np.empty(len(model.sites))
    lengths[i[rotations] // d] = 1.0 / (UNITS[model.units].hbar * c[rotations].astype(np.float64))
    return lengths


def scattering_lengths(neutrons: Neutrons | None, system: Any, lengths: Floats) -> Any:
    """Return what states of length 1 scatter at lengths of q, as (k or 1, sites), or 1 for lattices by name."""
    if not isinstance(system, SpinModel):
        return 1.0
    spins = spins_of_states(system)
    if neutrons is None:
        return spins
    moments = spins * (system.moments / system.spin)
    if neutrons.form_factors is None:
        return moments
    declared, labels, given = system._declared, system.crystal.labels, neutrons.form_factors
    ions = {label_of(system.crystal, label, "label"): ion for label, ion in given.items()}
    if len(ions) < len(given) or set(labels) - set(ions):
        raise ValueError(
            f"form_factors has {', '.join(map(str, given))}; give each of {', '.join(dict.fromkeys(labels))} once"
        )
    if declared.substitutions:
        raise ValueError(
            "form_factors is given for a model with substituted ions, whose form factors it does not have; leave it out"
        )
    if system.units != "meV" and not all(map(callable, ions.values())):
        raise ValueError(
            f'form_factors has ions, whose tables need lengths in angstroms, and the units of the model are "'
            f'{system.units}"; take units="meV", or give functions of q'
        )
    check_available_memory(16 * len(lengths) * len(system.sites), "the form factors of all spins and wave vectors")
    pairs = zip(labels, declared.g.tolist(), strict=True)
    factors = np.array([neutrons.form_factor(ions[label], lengths, g) for label, g in pairs])
    return moments * factors.T[:, system.sites]


def intensity(neutrons: Neutrons | None, amplitudes: NDArray[Any], q: Floats) -> Floats:
    """Return the sum of |A_a|^2, or of (delta_ab - q_a q_b / q^2) A_a A_b*, for A (3, k, m) at Cartesian q (k, 3)."""
    if neutrons is None:
        return np.asarray(np.sum(np.abs(amplitudes) ** 2, axis=0))
    # |A|^2 - |e . A|^2 would cancel along q.
    lengths = np.linalg.norm(q, axis=1)
    zero = lengths == 0.0
    e = (q / np.where(zero, 1.0, lengths)[:, None]).T[:, :, None]
    across = np.sum(np.abs(amplitudes - e * np.sum(e * amplitudes, axis=0)) ** 2, axis=0)
    across[zero] *= 2.0 / 3.0
    return np.asarray(across)


def quantum_factor(energies: Floats, kT: float) -> Floats:
    """Return x / (1 - exp(-x)) with x = energies / kT, the ratio of quantum to classical spectra of oscillators."""
    with np.errstate(over="ignore"):
        x = energies / kT
        return np.asarray(np.where(x == 0.0, 1.0, x / np.where(x == 0.0, 1.0, -np.expm1(-x))))


def check_neutrons(neutrons: Any, system: Any, lattice: Lattice) -> None:
    """Raise an error for other objects than `Neutrons`, and for lattices by name."""
    if neutrons is None:
        return
    if not isinstance(neutrons, Neutrons):
        raise TypeError(f"neutrons is {short(neutrons)}; give co.spectra.Neutrons(...)")
    if not isinstance(system, SpinModel):
        raise ValueError(f"neutrons is given for {lattice.text}; it needs a model on a crystal, of co.systems.spins")


def _table(ion: Any, what: str) -> tuple[Any, bool, float | None]:
    """Return the form factors of an ion, whether it is a lanthanide or actinide, and the factor of <j2> if given."""
    name, c2 = ion if isinstance(ion, tuple) and len(ion) == 2 else (ion, None)
    factor = None if c2 is None else read_number(c2, f"the factor of <j2> of {what}")
    parts = re.fullmatch(r"([A-Z][a-z]?)(\d*)(\+?)", name) if isinstance(name, str) else None
    if parts is None:
        raise ValueError(f"{what} is {short(ion)}; give an ion such as 'Mn2+', (ion, c2), or a function of q")
    require_packages("a magnetic form factor", "periodictable")
    import periodictable

    element, digits, plus = parts.groups()
    charge = int(digits) if digits else len(plus)
    known = {one.symbol: one for one in periodictable.elements if hasattr(one, "magnetic_ff")}
    if element not in known:
        raise ValueError(f"{what} is {short(name)}, without a form factor in the tables, which have {', '.join(known)}")
    tables: Any = known[element].magnetic_ff
    listed = {number: table for number, table in tables.items() if hasattr(table, "j0")}
    if charge not in listed:
        near = ", ".join(f"{element}{number or ''}{'+' if number else ''}" for number in sorted(listed))
        raise ValueError(f"{what} is {short(name)}, without a form factor in the tables, which have {near}")
    found, number = listed[charge], known[element].number
    if factor != 0.0 and not hasattr(found, "j2"):
        raise ValueError(f"{what} is {short(ion)}, of which the tables have no <j2>; give ({name!r}, 0)")
    return found, any(number in series for series in F_ELEMENTS), factor
