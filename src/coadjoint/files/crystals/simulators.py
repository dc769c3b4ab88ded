"""Spin models as input of other simulators: scripts of Sunny.jl, and files of VAMPIRE."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.files.output.output_files import OutputError, pending
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.declared_spins import MEV_PER_JOULE, merged_bonds
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_finite, read_path

Floats = npt.NDArray[np.float64]

TERMS = ("exchange", "dzyaloshinskii_moriya")
FIELDS = (
    "crystal",
    "size",
    "periodic",
    "units",
    "spin",
    "g",
    "occupied",
    "substitutions",
    "couplings",
    "anisotropies",
    "field",
    "dipolar",
)
"""What a declaration may have; of anything else a simulator would not know."""
PARTS = (
    "what",
    "bond",
    "bonds",
    "sites",
    "matrices",
    "text",
    "source",
    "given",
    "name",
)  # of a coupling or an anisotropy
ROUNDING = 1e-12  # of matrices, relative to their largest entry


def _declared(model: Any, simulator: str) -> Any:
    """Return the declaration of a model; ValueError for terms that a simulator would not get."""
    if not isinstance(model, SpinModel):
        raise TypeError(f"model is {short(model)}; give a model of co.systems.spins")
    model._check_directions(simulator)
    declared: Any = model._declared
    if model.forces:
        raise ValueError(f"the model has forces, which {simulator} takes elsewhere; give model.unforced")
    others = [one.what for one in declared.couplings if one.what not in TERMS]
    for part in (*declared.couplings, *declared.anisotropies):
        others += [name for name, value in part._asdict().items() if name not in PARTS and len(value)]
    for known in dataclasses.fields(declared):
        if known.name not in FIELDS and getattr(declared, known.name) != known.default:
            others.append(known.name)
    if others:
        raise ValueError(f"the model has {short(', '.join(others))}, which is not written for {simulator}")
    if declared.substitutions:
        raise ValueError(f"the model has substituted ions, which are not written for {simulator}")
    if callable(declared.field):
        raise ValueError(f"the field of the model is a function of the time, which is not written for {simulator}")
    return declared


def _couplings(declared: Any) -> Iterable[tuple[tuple[int, ...], Floats]]:
    """Return bonds of the cell, each once, and their matrices for directions of spins."""
    bonds, distinct, kinds = merged_bonds(declared)
    return [(bond, distinct[kind]) for bond, kind in zip(bonds, kinds, strict=True)]


def _on_site(declared: Any) -> Floats:
    """Return the single-ion matrices of the sites of a cell, for directions of spins."""
    matrices = np.zeros((len(declared.crystal.labels), 3, 3))
    for one in declared.anisotropies:
        matrices[one.sites] += one.matrices
    return matrices


@suggest_keywords
def to_sunny(model: SpinModel, x: npt.ArrayLike | None = None) -> str:
    """Return a script of Sunny.jl that makes a model, to compare with it or to continue there.

    The script lists every bond of the cell, in the space group P 1, in the mode ``:dipole_uncorrected``, whose
    energies are those of this model. Signs and factors are Sunny's: g has the other sign.

    Parameters
    ----------
    model : SpinModel
        From `co.systems.spins`.
    x : (n,) array_like, optional
        A state, which the script sets.

    Returns
    -------
    str
        The script, for Sunny 0.7 and later.

    Raises
    ------
    ValueError, TypeError
        What Sunny does not have: spins that are no multiples of 1/2, left-handed lattice vectors, dipoles on open
        lattices; and forces, substituted ions, and fields that are functions.

    References
    ----------
    D. Dahlbom et al., "Sunny.jl: A Julia package for spin dynamics", J. Open Source Softw. 10, 8138 (2025).

    Examples
    --------
    >>> import coadjoint as co
    >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
    >>> model = co.systems.spins(chain, (4, 1, 1), spin=0.5).exchange(chain.bonds(1)["1"], 0.5)
    >>> [line for line in co.spins.to_sunny(model).splitlines() if line.startswith("set")]
    ['set_exchange!(sys, [0.5 0.0 0.0; 0.0 0.5 0.0; 0.0 0.0 0.5], Bond(1, 1, [1, 0, 0]))']
    """
    declared = _declared(model, "Sunny")
    crystal, meV = declared.crystal, declared.units == "meV"
    if np.linalg.det(crystal.lattice) < 0.0:
        raise ValueError("the lattice vectors are left-handed, which Sunny refuses; exchange two of them")
    odd = np.flatnonzero(2.0 * declared.spin != np.round(2.0 * declared.spin))
    if odd.size:
        raise ValueError(f"the spin {declared.spin[odd[0]]:g} is no multiple of 1/2, as Sunny needs; give such lengths")
    if declared.dipolar and not all(declared.periodic):
        raise ValueError("the model has dipoles on an open lattice, and Sunny has periodic ones; leave them out")
    start = None if x is None else read_finite(x, "x")
    if start is not None and start.shape != (model.dim,):
        raise ValueError(f"x has shape {start.shape}; the model needs ({model.dim},)")
    types = ", ".join(f'"{label}"' for label in crystal.labels)
    lines = [
        "using Sunny",
        "",
        "# Energies in meV, fields in tesla, lengths in angstroms; every bond is listed, without symmetry."
        if meV
        else "# Natural units; every bond is listed, without symmetry.",
        *(["units = Units(:meV, :angstrom)"] if meV else []),
        f"latvecs = {_matrix(crystal.lattice.T)}",
        f"positions = [{', '.join(_vector(row) for row in crystal.positions)}]",
        f"crystal = Crystal(latvecs, positions, 1; types=[{types}])",
        "moments = ["
        + ", ".join(
            f"{k} => Moment(s={_fraction(S)}, g={-g!r})"
            for k, (S, g) in enumerate(zip(declared.spin.tolist(), declared.g.tolist(), strict=True), 1)
        )
        + "]",
        f"sys = System(crystal, moments, :dipole_uncorrected; dims={tuple(declared.size)})",
    ]
    for (i, j, *n), matrix in _couplings(declared):
        J = matrix / (declared.spin[i] * declared.spin[j])
        lines.append(f"set_exchange!(sys, {_matrix(J)}, Bond({i + 1}, {j + 1}, {list(n)}))")
    for k, matrix in enumerate(_on_site(declared)):
        A = matrix / declared.spin[k] ** 2
        terms = [
            f"{float(A[a, b] + (A[b, a] if a != b else 0.0))!r}*S[{a + 1}]*S[{b + 1}]"
            for a in range(3)
            for b in range(a, 3)
            if A[a, b] or A[b, a]
        ]
        if terms:
            lines.append(f"set_onsite_coupling!(sys, S -> {' + '.join(terms)}, {k + 1})")
    if declared.dipolar:
        lines.append(f"enable_dipole_dipole!(sys, {'units.vacuum_permeability' if meV else '4pi'}; demag=0)")
    if not all(declared.periodic):
        flags = ", ".join(str(not flag).lower() for flag in declared.periodic)
        lines += ["sys = to_inhomogeneous(sys)", f"remove_periodicity!(sys, ({flags}))"]
    if declared.occupied is not None:
        if all(declared.periodic):
            lines.append("sys = to_inhomogeneous(sys)")
        everywhere = np.ndindex(*declared.size, len(crystal.labels))
        there = {(*cell, site) for *cell, site in np.column_stack([model.cells, model.sites]).tolist()}
        lines += [f"set_vacancy_at!(sys, {_site(place)})" for place in everywhere if place not in there]
    places = [(*cell, site) for *cell, site in np.column_stack([model.cells, model.sites]).tolist()]
    tesla = " * units.T" if meV else ""
    if declared.field is not None and np.ndim(declared.field) == 1:
        lines.append(f"set_field!(sys, {_vector(declared.field)}{tesla})")
    elif declared.field is not None:
        lines += [
            f"set_field_at!(sys, {_vector(B)}{tesla}, {_site(place)})"
            for place, B in zip(places, declared.field, strict=True)
        ]
    if start is not None:
        lines += [
            f"set_dipole!(sys, {_vector(S)}, {_site(place)})"
            for place, S in zip(places, start.reshape(-1, 3), strict=True)
        ]
    return "\n".join([*lines, ""])


def _vector(values: Any) -> str:
    return f"[{', '.join(map(repr, np.asarray(values, dtype=np.float64).tolist()))}]"


def _matrix(values: Floats) -> str:
    return f"[{'; '.join(' '.join(map(repr, row)) for row in (values + 0.0).tolist())}]"


def _fraction(spin: float) -> str:
    return f"{round(spin)}" if spin == round(spin) else f"{round(2 * spin)}/2"


def _site(place: tuple[int, ...]) -> str:
    return f"({', '.join(str(one + 1) for one in place)})"


@suggest_keywords
def to_vampire(model: SpinModel, folder: str | Path) -> tuple[Path, ...]:
    """Write a model as input of VAMPIRE: ``spins.mat``, ``spins.ucf`` and ``input``.

    Parameters
    ----------
    model : SpinModel
        From `co.systems.spins`, in units of meV.
    folder : str or Path
        A folder, made if there is none. Files of these names in it are replaced.

    Returns
    -------
    tuple of Path
        The three files. `co.spins.read_exchange` reads the second one. They are of the moments, which turn as those of
        models with negative g. The damping is VAMPIRE's default; edit ``input`` for temperatures, times and outputs.

    Raises
    ------
    ValueError, TypeError
        Natural units; lattice vectors not along x, y, z; anisotropies with three different axes, vacancies,
        dipoles, fields of sites or functions, forces, and substituted ions.
    OutputError
        A file cannot be written.

    References
    ----------
    R. F. L. Evans et al., J. Phys.: Condens. Matter 26, 103202 (2014).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import coadjoint as co
    >>> iron = co.spins.crystal(lattice=(2.87, 2.87, 2.87, 90, 90, 90), sites={"Fe": [(0, 0, 0), (0.5, 0.5, 0.5)]})
    >>> model = co.systems.spins(iron, (4, 4, 4), moments=2.2, units="meV").exchange(iron.bonds(2.5)["1"], -30)
    >>> mat, ucf, _ = co.spins.to_vampire(model, pathlib.Path(tempfile.mkdtemp(), "iron"))
    >>> co.spins.read_exchange(ucf, iron).matrices[0, 0, 0].round(2)
    np.float64(-36.3)
    """
    declared = _declared(model, "VAMPIRE")
    crystal, target = declared.crystal, read_path(folder, "folder")
    edges = crystal.lattice.diagonal()
    if declared.units != "meV":
        raise ValueError('the model has natural units, and VAMPIRE energies in joules; give one with units="meV"')
    if np.abs(crystal.lattice - np.diag(edges)).max() > 1e-9 * np.abs(edges).max() or not (edges > 0.0).all():
        raise ValueError(
            "the lattice vectors are not along x, y, z, as VAMPIRE builds its systems; give the crystal by a "
            "rectangular cell"
        )
    if declared.occupied is not None or declared.dipolar:
        what = "dipoles" if declared.dipolar else "vacancies"
        raise ValueError(f"the model has {what}, which are not written for VAMPIRE; add them in its input")
    field = np.zeros(3) if declared.field is None else declared.field
    if field.ndim == 2:
        raise ValueError("the model has a field for each spin, and VAMPIRE one; give one field")
    kinds: dict[Any, int] = {}
    materials, of_site = list[list[str]](), list[int]()
    for k, (label, matrix) in enumerate(zip(crystal.labels, _on_site(declared), strict=True)):
        constant, axis = _uniaxial(matrix, f"site {k} ({label})")
        moment, ratio = abs(float(declared.g[k] * declared.spin[k])), abs(float(declared.g[k])) / 2.0
        lines = [f"material-name={label}", f"atomic-spin-moment={moment!r} !muB", f"relative-gamma={ratio!r}"]
        if constant:
            lines.append(f"second-order-uniaxial-anisotropy-constant={constant / MEV_PER_JOULE!r}")
            lines.append(f"uniaxial-anisotropy-direction={','.join(map(repr, axis))}")
        number = kinds.setdefault(tuple(lines), len(kinds))
        of_site.append(number)
        if number == len(materials):
            materials.append(lines)
    mat = [f"material:num-materials={len(materials)}"]
    mat += [f"material[{k}]:{line}" for k, lines in enumerate(materials, 1) for line in lines]
    signs = np.sign(declared.g)  # between moments
    couplings = [(bond, -signs[bond[0]] * signs[bond[1]] / MEV_PER_JOULE * J) for bond, J in _couplings(declared)]
    isotropic = all(np.array_equal(matrix, matrix[0, 0] * np.eye(3)) for _, matrix in couplings)
    ucf = ["# Unit cell size", " ".join(map(repr, edges.tolist())), "# Unit cell vectors", "1 0 0", "0 1 0", "0 0 1"]
    ucf += ["# Atoms", f"{len(of_site)} {len(materials)}"]
    ucf += [
        f"{k} {' '.join(map(repr, place))} {number} 0 0"
        for k, (place, number) in enumerate(zip(crystal.positions.tolist(), of_site, strict=True))
    ]
    ucf += ["# Interactions", f"{2 * len(couplings)} {'isotropic' if isotropic else 'tensorial'}"]
    rows = []
    for (i, j, *n), matrix in couplings:
        rows += [((i, j, *n), matrix), ((j, i, *(-m for m in n)), matrix.T)]
    for k, (bond, matrix) in enumerate(rows):
        numbers = [matrix[0, 0]] if isotropic else matrix.ravel()
        ucf.append(f"{k} {' '.join(map(str, bond))} {' '.join(repr(float(one) + 0.0) for one in numbers)}")
    strength = float(np.linalg.norm(field))
    direction = field / strength if strength else np.array([0.0, 0.0, 1.0])
    sizes = (edges * declared.size * (1.0 - 1e-9)).tolist()  # the number of cells is rounded up
    lines = ["material:file=spins.mat", "material:unit-cell-file=spins.ucf"]
    lines += [f"dimensions:system-size-{axis}={size!r} !A" for axis, size in zip("xyz", sizes, strict=True)]
    lines += [f"create:periodic-boundaries-{axis}" for axis, flag in zip("xyz", declared.periodic, strict=True) if flag]
    lines += [
        f"sim:applied-field-strength={strength!r} !T",
        f"sim:applied-field-unit-vector={','.join(map(repr, direction.tolist()))}",
        "sim:program=time-series",
        "sim:integrator=llg-heun",
        "sim:temperature=0.0",
        "sim:time-step=0.1 !fs",
        "sim:total-time-steps=10000",
        "sim:time-steps-increment=100",
        "output:real-time",
        "output:magnetisation",
    ]
    try:
        target.mkdir(exist_ok=True)
    except OSError as reason:
        raise OutputError(f"{folder}: no folder can be made ({reason.strerror}); give another one") from None
    written = []
    for name, content in (("spins.mat", mat), ("spins.ucf", ucf), ("input", lines)):
        with pending(target / name) as unfinished:
            Path(unfinished.path).write_text("\n".join([*content, ""]), encoding="utf-8")
        written.append(target / name)
    return tuple(written)


def _uniaxial(matrix: Floats, site: str) -> tuple[float, list[float]]:
    """Return the constant k and axis e of an energy -k (m . e)^2, up to a constant; ValueError for others."""
    if not np.any(matrix):
        return 0.0, [0.0, 0.0, 1.0]
    values, vectors = np.linalg.eigh(matrix)
    rounding = ROUNDING * float(np.abs(values).max())
    for alone, (one, other) in ((0, (1, 2)), (2, (0, 1))):
        if abs(values[one] - values[other]) <= rounding:
            axis = vectors[:, alone] * (1.0 if vectors[np.abs(vectors[:, alone]).argmax(), alone] > 0.0 else -1.0)
            constant = float(values[one] - values[alone])
            return (constant if abs(constant) > rounding else 0.0), (axis + 0.0).tolist()
    raise ValueError(f"{site} has an anisotropy of three different axes, and VAMPIRE takes uniaxial ones")
