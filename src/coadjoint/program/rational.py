"""Which angles may be rational? Where tan(phi/2) := angle/2 in place of the angle is still a Poisson map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.blocks import Kind
from coadjoint.program.numbers import Number, array_of, convert, roundoff
from coadjoint.program.parts import LinearShare, Part, Parts, PolynomialShare, Share
from coadjoint.systems.lie_poisson import LiePoissonSystem


def rational_frequencies(system: LiePoissonSystem, parts: Parts, state: Action, number: Number) -> NDArray[Any]:
    """Return the frequency w of every angle that becomes rational, 2/w atan(w angle/2), and 0 for those that stay.

    That is the exact flow of another function of l.x, hence Poisson, if the angle is a function of l.x alone. It needs
    no trigonometry where the generator of l turns with the one frequency w; nilpotent generators need none anyway.

    Parameters
    ----------
    system : LiePoissonSystem
        For messages.
    parts : Parts
        The parts.
    state : Action
        Their coadjoint action.
    number : callable
        Number type.

    Returns
    -------
    ndarray, shape (angles,)
        Part after part, in the order of their forms.

    Raises
    ------
    ValueError
        If some generator is neither nilpotent nor a rotation of one frequency, or its angle is coupled to others.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.program.table import build_program
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> build_program(body, co.Splitting(rotation="rational", parts="coordinates")).frequency
    array([1., 1., 1.])
    """
    found: list[Any] = []
    for p, part in enumerate(parts):
        own = _frequencies_of(state, p, len(part.forms))
        coupled = [flag for share, forms in _shares_with_forms(part) for flag in _coupled(share, forms)]
        for form, several, alone in zip(part.forms, own, coupled, strict=True):
            frequency, reason = _single(several, number), ""
            if frequency is None:
                reason = "is neither nilpotent nor a rotation of a single frequency"
            elif frequency != 0 and alone:
                reason = "is a rotation by an angle that depends on more than itself"
            if reason:
                name = " + ".join(system.algebra.basis[i] for i in form[0])
                raise ValueError(
                    f'rotation="rational" would not be a Poisson map for {system.name}: the flow along {name} '
                    f'{reason}; take rotation="exact"'
                )
            found.append(frequency)
    return array_of(number, found)


def _frequencies_of(action: Action, part: int, angles: int) -> list[list[Any]]:
    """Return for each angle the frequencies of its blocks: 0 where nilpotent, None for what is no rotation."""
    found: list[list[Any]] = [[] for _ in range(angles)]
    for run in range(action.run[part], action.run[part + 1]):
        kind, constant = action.kind[run], int(action.constant[run])
        for q in range(action.angles[run]):
            first: Any = action.constants[constant + (q if kind == Kind.ROTATE else 0)]
            frequency = None
            if kind == Kind.ROTATE:
                frequency = first
            elif kind == Kind.CUBIC and first < 0:
                frequency = action.constants[constant + 1]
            elif kind == Kind.SHEAR or (kind == Kind.SERIES and first == 0):
                frequency = 0 * first
            found[int(action.angle[run]) + q].append(frequency)
    return found


def _single(frequencies: list[Any], number: Number) -> Any:
    """Return the frequency that all blocks share up to rounding of D^3 = -w^2 D, or None."""
    if not frequencies:
        return convert(number, 0)
    if any(frequency is None for frequency in frequencies):
        return None
    least, largest = min(frequencies), max(frequencies)
    return largest if largest - least <= 64 * roundoff(number) * largest else None


def _shares_with_forms(part: Part) -> Any:
    start = 0
    for share in part.shares:
        if isinstance(share, LinearShare):
            count = len(share.offset)
        else:
            count = len(share.coordinates if isinstance(share, PolynomialShare) else share.term.coordinates)
        yield share, part.forms[start : start + count]
        start += count


def _coupled(share: Share, forms: Sequence[Any]) -> list[bool]:
    """Return for each angle of a share whether it depends on more than its own form."""
    if isinstance(share, LinearShare):
        return [not _along(share, row, form) for row, form in enumerate(forms)]
    if isinstance(share, PolynomialShare):
        mixed = [e for e in share.polynomial.monomials if sum(1 for power in e if power) > 1]
        return [any(e[i] for e in mixed) for i in share.coordinates]
    return [len(forms) > 1] * len(forms)


def _along(share: LinearShare, row: int, form: tuple[Sequence[int], Sequence[Any]]) -> bool:
    """Return whether the weights of a row are a multiple of its form, up to the rounding of the products."""
    entries = range(int(share.indptr[row]), int(share.indptr[row + 1]))
    weights = {int(share.columns[e]): share.weights[e] for e in entries if share.weights[e] != 0}
    values = {int(i): value for i, value in zip(*form, strict=True) if value != 0}
    if not weights:
        return True
    if weights.keys() != values.keys():
        return False
    first = next(iter(values))
    products = [(weights[i] * values[first], weights[first] * values[i]) for i in values]
    return all(abs(a - b) <= 8 * 2.0**-53 * abs(a) for a, b in products)


def bent(angle: Any, frequency: Any, atan: Any) -> Any:
    """Return the angle 2/w atan(w angle/2) of a rational rotation of frequency w, or the angle itself where w is 0."""
    return angle if frequency == 0 else 2 / frequency * atan(frequency * angle / 2)


def acts_rationally(action: Action, parts: Parts, frequency: NDArray[Any]) -> NDArray[np.bool_]:
    """Return for each part whether its blocks in a representation turn with the frequencies of the coadjoint ones.

    Then a rational rotation needs no arc tangent there either.
    """
    agree = np.ones(len(parts), dtype=bool)
    start = 0
    for p, part in enumerate(parts):
        for several, w in zip(_frequencies_of(action, p, len(part.forms)), frequency[start:], strict=False):
            agree[p] &= all(own is not None and abs(own - w) <= 64 * 2.0**-53 * abs(w) for own in several)
        start += len(part.forms)
    return agree
