"""Hysteresis loops of spin models: equilibria along a sequence of fields, each from the one before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.spin_descent import SpinSurface, angles, descend, tilted
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import read_seed
from coadjoint.systems.lattices.declared_spins import UNITS
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_finite, read_positive

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

JUMP = 0.5  # radians by which a spin turns at least when the state leaves its valley
TILT = 1e-4  # radians of the perturbation with which each descent starts, so that it leaves saddles
BALANCE = 1e-9  # largest torque of a state, relative to the largest field
MAX_FIELDS = 100_000


@dataclass(frozen=True, eq=False, repr=False)
class Hysteresis:
    """Equilibria of a model along a sequence of fields; `co.spins.hysteresis` computes them.

    Attributes
    ----------
    fields : (k, 3) ndarray
        The given fields, and those in between at which jumps were located; in the unit of the model, such as tesla.
    x : (k, n) ndarray
        The state in each field.
    magnetization : (k, 3) ndarray
        Sum of the moments over the sum of their sizes.
    energy : (k,) ndarray
        Energy of each state in its field.
    jumps : (j,) ndarray of int
        Numbers of the states that were reached by a jump from the one before.
    """

    fields: Floats
    x: Floats
    magnetization: Floats
    energy: Floats
    jumps: Integers

    def __repr__(self) -> str:
        return f"<{len(self.fields)} equilibria of {self.x.shape[1] // 3} spins, {len(self.jumps)} jumps>"

    @property
    def switching_fields(self) -> Floats:
        """Fields in the middle of the intervals in which the state jumps, (jumps, 3)."""
        return np.asarray(0.5 * (self.fields[self.jumps] + self.fields[self.jumps - 1])) + 0.0

    @property
    def coercive_fields(self) -> Floats:
        """Fields at which the magnetization along the largest field changes sign, (changes, 3); linear in between."""
        along = self.magnetization @ self.fields[np.linalg.norm(self.fields, axis=1).argmax()]
        k = np.flatnonzero((along[1:] > 0.0) != (along[:-1] > 0.0))
        part = along[k] / (along[k] - along[k + 1])
        return np.asarray(self.fields[k] + part[:, None] * (self.fields[k + 1] - self.fields[k]))


@suggest_keywords
@long_operation("hysteresis")
def hysteresis(
    model: SpinModel, fields: npt.ArrayLike, x0: npt.ArrayLike, *, tolerance: float | None = None, seed: int = 0
) -> Hysteresis:
    """Return equilibria of a model in a sequence of magnetic fields, each found from the one before.

    Choose it for hysteresis loops, coercive and switching fields, and spin flops at zero temperature: the state stays
    in its valley of the energy until the field removes it, as in a slow sweep with strong damping. At a temperature, or
    at a finite rate, integrate the model with a field that is a function of the time and with `Gilbert`.

    Parameters
    ----------
    model : SpinModel
        The model, without forces; a field that it has is replaced. Dipoles are taken along.
    fields : (k, 3) array_like
        The fields in their order, in the unit of the model (tesla for ``units="meV"``). A closed loop returns to its
        first field.
    x0 : (n,) array_like
        The state from which the equilibrium in the first field is found. Lengths of spins are kept.
    tolerance : float, optional
        Where a spin turns by more than 0.5 radians between two fields, the interval is halved until the turn is smaller
        or the interval is at most this long: then it is a jump. By default a thousandth of the largest field.
    seed : int
        Seed of the perturbations of 1e-4 radians with which states leave saddles, from 0 to 2^62.

    Returns
    -------
    Hysteresis
        With ``fields``, ``x``, ``magnetization``, ``energy``, ``jumps``, ``switching_fields``, ``coercive_fields``.

    Raises
    ------
    TypeError, ValueError
        Another system, forces, arguments of other shapes, or fields that are not along the axis of a twisted lattice.
    RuntimeError
        No equilibrium was found in 50 000 steps.

    References
    ----------
    E. C. Stoner, E. P. Wohlfarth, Phil. Trans. R. Soc. A 240, 599 (1948).

    Examples
    --------
    A particle with an easy axis z switches in the field 2 K/M along it, here 1 T:

    >>> import numpy as np, coadjoint as co
    >>> particle = co.spins.micromagnetic((1, 1, 1), (5e-9, 5e-9, 5e-9), Msat=8e5, Aex=0, Ku1=4e5)
    >>> sweep = np.linspace(1.5, -1.5, 13)[:, None] * [0, 0, 1]
    >>> loop = co.spins.hysteresis(particle, sweep, (0, 0, -1))
    >>> loop.switching_fields.round(2).tolist()
    [[0.0, 0.0, -1.0]]
    """
    if not isinstance(model, SpinModel):
        raise TypeError(f"model is {short(model)}; give one of co.spins.micromagnetic or co.systems.spins")
    model._check_directions("hysteresis")
    if model.forces:
        raise TypeError(f"{model.name} has forces; hysteresis takes the Hamiltonian part, model.unforced")
    targets, start = read_finite(fields, "fields"), read_finite(x0, "x0")
    if targets.ndim != 2 or targets.shape[1] != 3 or not len(targets):
        raise ValueError(f"fields has shape {targets.shape}; give one field (3,) in each row")
    if start.shape != (model.dim,):
        raise ValueError(f"x0 has shape {start.shape}; {model.name} needs ({model.dim},)")
    if model._declared.twist is not None:
        model._declared.twist.check_field(targets)
    largest = float(np.linalg.norm(targets, axis=1).max())
    resolution = 1e-3 * largest if tolerance is None else read_positive(tolerance, "tolerance")
    key = read_seed(seed, "seed")
    moments, surface = model.moments, SpinSurface(model.field((0.0, 0.0, 0.0)), start)

    def relaxed(s: Floats, B: Floats) -> Floats:
        surface.linear = -UNITS[model.units].mu_B * moments[:, None] * surface.lengths * B
        return descend(surface, tilted(s, TILT, key + len(states)), BALANCE)

    states, reached, jumps = list[Floats](), [targets[0]], list[int]()
    states.append(relaxed(surface.directions(start), targets[0]))
    energies = [surface.energy(states[0])]
    for number, target in enumerate(targets[1:], 1):
        pending = [target]
        while pending:
            found = relaxed(states[-1], pending[-1])
            jumped = bool(angles(states[-1], found).max(initial=0.0) > JUMP)
            if jumped and np.linalg.norm(pending[-1] - reached[-1]) > resolution:
                pending.append(0.5 * (pending[-1] + reached[-1]))
                continue
            if jumped:
                jumps.append(len(states))
            reached.append(pending.pop())
            states.append(found)
            energies.append(surface.energy(found))
            if len(states) > MAX_FIELDS:
                raise ValueError(f"the loop has more than {MAX_FIELDS} states; give a larger tolerance")
        note_progress("equilibria in fields", number / len(targets))
    magnetization = np.array([(moments[:, None] * surface.lengths * s).sum(axis=0) for s in states])
    return Hysteresis(
        np.array(reached),
        np.array([surface.state(s) for s in states]),
        magnetization / np.abs(moments[:, None] * surface.lengths).sum(),
        np.array(energies),
        np.array(jumps, dtype=np.int64),
    )
