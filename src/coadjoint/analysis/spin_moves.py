"""Monte Carlo moves of spins on sublattices without coupling, and their random numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.spin_energy import SpinEnergy, Sublattice, product

Floats = NDArray[np.float64]

STREAM = 1 << 63
"""The last word of counters, which no noise of forces uses."""
WORDS = 4  # random numbers of a spin in a sweep
MAX_STEP = 1.0  # largest size of a small rotation: at most a quarter turn


@dataclass(frozen=True, eq=False)
class StepSizes:
    """Lengths (sites, members), inverse temperatures (members,), and sizes of small rotations (sites, members)."""

    lengths: Floats
    beta: Floats
    sizes: Floats


def uniform_words(key: int, moment: tuple[int, int], sites: int, members: slice) -> Floats:
    """Return numbers in (0, 1), four for each spin, (4, sites, members): a function of seed, sweep, site and member."""
    sweep, part = moment
    first, count = members.start * sites, (members.stop - members.start) * sites
    # NumPy increments the counter before its first block of four words.
    counter = (((STREAM | part) << 192) | (sweep << 128)) + first - 1
    words = np.random.Philox(key=key, counter=counter).random_raw(WORDS * count)
    numbers = (np.asarray(words >> np.uint64(11), dtype=np.float64) + 0.5) * 2.0**-53
    return np.ascontiguousarray(numbers.reshape(-1, sites, WORDS).T)


def directions(u: Floats, v: Floats) -> Floats:
    """Return uniform unit vectors (sites, 3, members) from two uniform numbers each."""
    height, turn = 2.0 * u - 1.0, 2.0 * np.pi * v
    radius = np.sqrt((1.0 - height) * (1.0 + height))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def step_sizes(energies: SpinEnergy, lengths: Floats, beta: Floats) -> Floats:
    """Return sizes of small rotations that change the energy by about kT, from bounds of the local fields."""
    fields = product(energies.strengths, lengths) + np.linalg.norm(energies.linear.reshape(-1, 3), axis=1)[:, None]
    fields += np.linalg.norm(energies.on_site, axis=(1, 2))[:, None] * lengths
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(MAX_STEP, 1.0 / np.sqrt(beta * lengths * fields)))


def heat_bath(sublattice: Sublattice, S: Floats, here: StepSizes, words: Floats) -> Floats:
    """Draw spins in their local fields, in place; return the number of accepted moves of each member."""
    u, v, w = words[:3, sublattice.sites]
    field = sublattice.field(S)
    size = np.sqrt(np.sum(field**2, axis=1))
    strength = here.beta * here.lengths * size
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = -np.log1p(u * np.expm1(-2.0 * strength)) / strength  # 1 - cos of the angle to the field
    fall = np.clip(np.where(strength > 0.0, fall, 2.0 * u), 0.0, 2.0)
    axis = field / np.where(size > 0.0, size, 1.0)[:, None]
    axis[:, 2] = np.where(size > 0.0, axis[:, 2], 1.0)
    first, second = _perpendicular(axis)
    radius, turn = np.sqrt(fall * (2.0 - fall)), 2.0 * np.pi * v
    proposed = (1.0 - fall)[:, None] * axis
    proposed += (radius * np.cos(turn))[:, None] * first + (radius * np.sin(turn))[:, None] * second
    proposed *= here.lengths[:, None]
    old = S[sublattice.sites]
    return _accept(
        sublattice, S, proposed, sublattice.on_site_energy(proposed) - sublattice.on_site_energy(old), here.beta, w
    )


def metropolis(sublattice: Sublattice, S: Floats, here: StepSizes, words: Floats) -> Floats:
    """Propose small rotations, random directions and reversals, in place; return the number accepted."""
    u, v, w, kind = words[:, sublattice.sites]
    old, anywhere = S[sublattice.sites], directions(u, v)
    near = old + (here.sizes * here.lengths)[:, None] * anywhere
    size = np.sqrt(np.sum(near**2, axis=1))
    near *= (here.lengths / np.where(size > 0.0, size, 1.0))[:, None]
    proposed = np.where(
        (kind < 0.5)[:, None], near, np.where((kind < 0.75)[:, None], here.lengths[:, None] * anywhere, -old)
    )
    change = sublattice.on_site_energy(proposed) - sublattice.on_site_energy(old)
    change = change - np.sum((proposed - old) * sublattice.field(S), axis=1)
    return _accept(sublattice, S, proposed, change, here.beta, w)


def over_relax(sublattice: Sublattice, S: Floats, here: StepSizes, words: Floats) -> None:
    """Rotate spins by half a turn about their local fields, in place; a change on site is accepted as by Metropolis."""
    field, old = sublattice.field(S), S[sublattice.sites]
    square = np.sum(field**2, axis=1)
    along = 2.0 * np.sum(field * old, axis=1) / np.where(square > 0.0, square, 1.0)
    proposed = np.where((square > 0.0)[:, None], along[:, None] * field - old, old)
    # Rounding would change the lengths over many sweeps.
    size = np.sqrt(np.sum(proposed**2, axis=1))
    proposed *= (here.lengths / np.where(size > 0.0, size, 1.0))[:, None]
    change = sublattice.on_site_energy(proposed) - sublattice.on_site_energy(old)
    _accept(sublattice, S, proposed, change, here.beta, words[2, sublattice.sites])


METHODS: Mapping[str, Callable[[Sublattice, Floats, StepSizes, Floats], Floats]] = {
    "heat bath": heat_bath,
    "Metropolis": metropolis,
}


def _accept(
    sublattice: Sublattice, S: Floats, proposed: Floats, change: Floats | float, beta: Floats, w: Floats
) -> Floats:
    """Take proposed spins with probability min(1, exp(-change/kT)); return how many of each member."""
    accepted = np.log(w) <= -beta * change
    S[sublattice.sites] = np.where(accepted[:, None], proposed, S[sublattice.sites])
    return np.asarray(np.sum(accepted, axis=0), dtype=np.float64)


def _perpendicular(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors perpendicular to each unit vector (sites, 3, members) and to each other."""
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    sign = np.copysign(1.0, z)  # T. Duff et al., J. Comput. Graph. Tech. 6 (2017)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x**2 * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y**2 * a, -y], axis=1)
    return first, second
