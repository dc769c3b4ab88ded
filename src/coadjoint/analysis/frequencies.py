"""Frequency analysis of sampled motions by windowed Fourier transforms."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.signals import sampled
from coadjoint.analysis.spectral_lines import (
    FINAL_ITERATIONS,
    Lines,
    find_lines,
    frequency_uncertainty,
    hann,
    refine_lines,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import record_repr, short
from coadjoint.validation import read_finite, read_integer

Floats = NDArray[np.float64]

WINDOW = 5  # default power of the cosine window: side lobes fall like the 11th power
MIN_SAMPLES = 64
MAX_NUMBERS = 2**23  # largest size of the arrays of a group of members
MAX_COMBINATIONS = 2**21  # of integers: 16 MB for each basic frequency
# Reduction of the power for the second window; the change of the result estimates the leakage of lines.
WINDOW_REDUCTION = 2


@suggest_keywords
@dataclass(frozen=True)
class Combinations:
    """Spectral lines as integer combinations of a few basic frequencies.

    Attributes
    ----------
    basis : ndarray, shape (d,)
        The basic frequencies.
    integers : ndarray of int, shape (lines, d)
        The frequency of line k is approximately ``integers[k] @ basis``.
    misfit : ndarray, shape (lines,)
        Frequency of the line minus that of the combination, in radians per unit of time.
    found : ndarray of bool, shape (lines,)
        Whether the misfit is within the uncertainty of the frequencies. If not, the integers are those of the
        nearest combination.
    """

    basis: Floats
    integers: NDArray[np.int64]
    misfit: Floats
    found: NDArray[np.bool_]

    def __repr__(self) -> str:
        return record_repr(self)


@dataclass(frozen=True)
class Frequencies:
    """The strongest spectral lines of a signal, strongest first; for ensembles the first axis of each array is the
    member.

    Attributes
    ----------
    frequency : ndarray, shape (lines,)
        In radians per unit of time; positive for a real signal. NaN if fewer lines are above round-off.
    amplitude : ndarray, shape (lines,) or (lines, channels)
        Complex, at time zero: a real signal is mean + Re(sum_k a_k exp(i w_k t)), a complex one without Re.
    uncertainty : ndarray, shape (lines,)
        Standard error of the frequency: the change under a narrower window, the effect of noise near the line, and
        round-off, combined.
    diffusion : ndarray, shape (lines,)
        Frequency in the second half of the span minus that in the first. For quasi-periodic motions it is small and
        decreases as a high power of the span; for chaotic motions it does not decrease.
    mean : complex or float, or ndarray, shape (channels,)
        The constant part of the signal.
    residual : float or ndarray, shape (members,)
        Root mean square, under the window, of the signal without these lines.
    """

    frequency: Floats
    amplitude: NDArray[np.complex128]
    uncertainty: Floats
    diffusion: Floats
    mean: Any
    residual: Any
    _real: bool

    def __repr__(self) -> str:
        return record_repr(self)

    def __call__(self, t: ArrayLike) -> NDArray[Any]:
        """Return the sum of the lines at times, shape (k,), (k, channels) or (k, members, channels)."""
        times = read_finite(t, "t")
        several = self.frequency.ndim == 2
        w = np.atleast_2d(np.nan_to_num(self.frequency))
        a = np.nan_to_num(self.amplitude).reshape(*w.shape, -1)
        waves = np.exp(1j * np.multiply.outer(times, w))
        total = np.einsum("...mk,mkc->...mc", waves, a)
        total = np.asarray(total.real if self._real else total) + np.reshape(self.mean, (len(w), -1))
        if self.amplitude.ndim == self.frequency.ndim:
            total = total[..., 0]
        return total if several else total[..., 0] if total.ndim == times.ndim + 1 else total[..., 0, :]

    def combinations(self, basis: ArrayLike | None = None, largest: int = 8) -> Combinations:
        """Return the lines as integer combinations of a few basic frequencies.

        Parameters
        ----------
        basis : array_like, shape (d,), optional
            The basic frequencies. None selects lines in order of strength, each not a combination of the previous ones.
        largest : int
            Largest absolute value of an integer.

        Returns
        -------
        Combinations
            For each line the combination within the uncertainty that has the smallest integers.

        Raises
        ------
        ValueError
            The result is of an ensemble, or there are more than two million combinations.

        Examples
        --------
        >>> t = np.arange(4096) * 0.1
        >>> lines = frequencies(t, 2.0 * np.cos(t) + np.cos(np.sqrt(2.0) * t) + 0.1 * np.cos((1 + np.sqrt(2.0)) * t))
        >>> lines.combinations().integers.tolist()
        [[1, 0], [0, 1], [1, 1]]
        """
        if self.frequency.ndim == 2:
            raise ValueError("these are the frequencies of an ensemble; analyse one member")
        largest = read_integer(largest, "largest", 1, MAX_COMBINATIONS)
        present = np.isfinite(self.frequency)
        w = self.frequency[present]
        tolerance = 4.0 * self.uncertainty[present] + 4.0 * UNIT_ROUNDOFF * np.abs(w)
        if basis is not None:
            axes = np.atleast_1d(read_finite(basis, "basis"))
            if axes.ndim != 1 or largest * axes.size * float(np.max(np.abs(axes), initial=0.0)) == np.inf:
                raise ValueError(f"basis is {short(basis)}; give a few frequencies, (d,), whose sums fit float64")
            return _nearest_combinations(axes, np.zeros(len(axes)), w, tolerance, largest)

        def of_lines(basis_lines: list[int], lines: slice) -> Combinations:
            return _nearest_combinations(w[basis_lines], tolerance[basis_lines], w[lines], tolerance[lines], largest)

        chosen: list[int] = []
        for k in range(len(w)):
            if not chosen or not of_lines(chosen, slice(k, k + 1)).found[0]:
                chosen.append(k)
        return of_lines(chosen, slice(None))

    def __str__(self) -> str:
        """Format as a table with one row for each frequency."""
        if self.frequency.ndim == 2:
            return f"<frequencies of {len(self.frequency)} members>"
        rows = [f"{'frequency':>20} {'uncertainty':>12} {'diffusion':>12} {'amplitude':>12}"]
        size = np.linalg.norm(self.amplitude.reshape(len(self.frequency), -1), axis=1)
        for w, u, d, a in zip(self.frequency, self.uncertainty, self.diffusion, size, strict=True):
            rows.append(f"{w:20.14g} {u:12.1e} {d:12.1e} {a:12.5g}")
        return "\n".join(rows)


@suggest_keywords
def frequencies(given: Any, signal: Any = None, count: int = 5, window: int = WINDOW) -> Frequencies:
    """Return the strongest frequencies of a run or of samples, with amplitudes and uncertainties.

    Choose it for the rotation and libration frequencies of a periodic or quasi-periodic motion, for the error of a
    scheme in each of them (`Frequencies` of two runs), and for frequency diffusion, an indicator of chaos.

    Parameters
    ----------
    given : Solution or array_like, shape (k,)
        A run, or equidistant times; at least 64. A last time of a run that is off the grid is ignored.
    signal : None, int, str, callable or array_like
        For a run: None is the momentum, an integer one of its components, ``"attitude"`` the entries of the group
        element, ``"energy"`` the energy, another name an observable; a function receives ``sol.x`` and returns an array
        over the times. An array holds the samples: (k,), (k, channels), or (k, members, channels). The channels
        share their frequencies, and each line has an amplitude in each of them.
    count : int
        Number of lines. Weaker lines that are not included perturb the others; a larger count shows by how much.
    window : int
        Power p of the Hann window (1 + cos)^p, from 1 to 12. Lines that are m > p bins of 2 pi / span apart perturb
        each other by about m^-(2p+1); below p + 1 bins they are poorly resolved. A small p suits noise, a large one
        smooth signals.

    Returns
    -------
    Frequencies
        Strongest first. Frequencies above pi / spacing are aliased.

    Raises
    ------
    ValueError
        The times are not equidistant, there are too few samples, values are not finite, or the span resolves fewer
        lines.
    TypeError
        The signal has another type.

    Notes
    -----
    Laskar's frequency analysis: find the highest peak of the windowed transform, refine it, subtract it, and repeat.
    After each new line all lines are corrected together, by windowed least squares in frequencies and amplitudes. A
    finite sum of lines is found to round-off; for an infinite sum the window suppresses the remaining lines.

    References
    ----------
    J. Laskar, The chaotic motion of the solar system, Icarus 88 (1990); Introduction to frequency map analysis (1999).

    Examples
    --------
    >>> t = np.arange(2000) * 0.25
    >>> lines = frequencies(t, np.cos(0.7 * t) + 1e-5 * np.sin(np.sqrt(3.0) * t), count=2)
    >>> bool(np.all(np.abs(lines.frequency - [0.7, np.sqrt(3.0)]) < [1e-14, 1e-9]))
    True
    """
    count, power = read_integer(count, "count"), read_integer(window, "window", 1, 12)
    data = sampled(given, signal, MIN_SAMPLES)
    samples = len(data.t)
    most = samples // (8 * (power + 1))
    if count > most:
        raise ValueError(
            f"count is {short(count)}; {samples} samples resolve at most {most} lines; give more samples or a smaller "
            "count"
        )
    group = max(1, MAX_NUMBERS // (samples * (8 * count + 3 * data.values.shape[2])))
    groups = [_analyse(data.t, data.values[i : i + group], count, power) for i in range(0, len(data.values), group)]
    w, a, uncertainty, diffusion, mean, residual = (np.concatenate(arrays) for arrays in zip(*groups, strict=True))
    a, mean = data.shaped(a), data.shaped(mean)
    if not data.members:
        w, a, uncertainty, diffusion, mean, residual = w[0], a[0], uncertainty[0], diffusion[0], mean[0], residual[0]
    return Frequencies(w, a, uncertainty, diffusion, mean, residual, not np.iscomplexobj(data.values))


def _analyse(t: Floats, values: NDArray[Any], count: int, power: int) -> tuple[NDArray[Any], ...]:
    """Return the first six attributes of `Frequencies` for signals (members, samples, channels)."""
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    s = np.linspace(-1.0, 1.0, len(t))
    lines = find_lines(s, values, min(count + 1, len(t) // (8 * (power + 1))), power)
    narrower = hann(s, max(1, power - WINDOW_REDUCTION))
    other = refine_lines(s, values, lines.frequency, lines.present, narrower, FINAL_ITERATIONS)
    rounding = UNIT_ROUNDOFF * np.abs(lines.frequency)
    uncertainty = np.sqrt(
        (other.frequency - lines.frequency) ** 2 + frequency_uncertainty(lines, s, power) ** 2 + rounding**2
    )
    diffusion = _diffusion(s, values, lines, power)
    w = lines.frequency / half
    a = lines.amplitude * np.exp(-1j * w * middle)[..., None]
    mirrored = (w < 0.0) & (not np.iscomplexobj(values))  # backward runs, or corrections across zero
    w, a = np.where(mirrored, -w, w), np.where(mirrored[..., None], a.conj(), a)
    diffusion = np.where(mirrored, -diffusion, diffusion)
    size = np.where(lines.present, np.linalg.norm(a, axis=2), -1.0)
    order = np.argsort(-size, axis=1, kind="stable")[:, :count]
    present = np.take_along_axis(lines.present, order, axis=1)

    def strongest(series: NDArray[Any]) -> Any:
        ordered = np.take_along_axis(series, order, axis=1)
        return np.pad(np.where(present, ordered, np.nan), ((0, 0), (0, count - order.shape[1])), constant_values=np.nan)

    amplitude = np.take_along_axis(a, order[..., None], axis=1)
    amplitude = np.where(present[..., None], amplitude, np.nan)
    amplitude = np.pad(amplitude, ((0, 0), (0, count - order.shape[1]), (0, 0)), constant_values=np.nan)
    omitted = lines.present.copy()
    np.put_along_axis(omitted, order, False, axis=1)
    weaker = np.exp(1j * s[:, None] * lines.frequency[:, None]) @ np.where(omitted[..., None], lines.amplitude, 0.0)
    residual = lines.residual + (weaker if np.iscomplexobj(values) else weaker.real)
    rms = np.sqrt(np.einsum("s,msc->m", hann(s, power), np.abs(residual) ** 2))
    return strongest(w), amplitude, strongest(uncertainty / abs(half)), strongest(diffusion / half), lines.mean, rms


def _diffusion(s: Floats, values: NDArray[Any], lines: Lines, power: int) -> Floats:
    """Return the change of each frequency from the first half of the span to the second."""
    size = (len(s) + 1) // 2
    half = np.linspace(-1.0, 1.0, size)
    weight, scale = hann(half, power), (size - 1) / (len(s) - 1)
    early, late = (
        refine_lines(half, part, lines.frequency * scale, lines.present, weight, FINAL_ITERATIONS).frequency
        for part in (values[:, :size], values[:, len(s) - size :])
    )
    return np.asarray((late - early) / scale)


def _nearest_combinations(
    basis: Floats, basis_tolerance: Floats, w: Floats, tolerance: Floats, largest: int
) -> Combinations:
    d = len(basis)
    if (2 * largest + 1) ** d > MAX_COMBINATIONS:
        raise ValueError(
            f"{d} frequencies with integers up to {short(largest)} have too many combinations; "
            f"give fewer, or a smaller largest; basis = {short(basis.tolist())}"
        )
    grid = np.array(list(product(range(-largest, largest + 1), repeat=d)))
    grid = grid[np.argsort(np.sum(np.abs(grid), axis=1), kind="stable")]
    # Rounded are the basis, the products and their sum.
    rounded = (d + 1) * UNIT_ROUNDOFF * np.abs(basis)
    sums, slack = grid @ basis, np.abs(grid) @ (basis_tolerance + rounded)
    integers, misfit, found = [], [], []
    for line, allowed in zip(w, tolerance, strict=True):
        distance = np.abs(sums - line)
        within = distance <= allowed + slack
        index = int(np.argmax(within)) if np.any(within) else int(np.argmin(distance))
        integers.append(grid[index])
        misfit.append(line - sums[index])
        found.append(bool(within[index]))
    return Combinations(basis, np.array(integers), np.array(misfit), np.array(found))
