"""Warnings about moments of inertia that no distribution of mass has."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF

ROUNDING_TOLERANCE = 64 * UNIT_ROUNDOFF  # relative tolerance for rounded input
_QUADRATIC_FORM_HINT = (
    "if a quadratic form is meant, say so by co.LiePoissonSystem(co.algebras.{}, co.Quadratic(...), sign=-1)"
)


def warn_unphysical_inertia(inertia: npt.ArrayLike, algebra: str | None = "so(3)", what: str = "inertia") -> None:
    """Warn if a principal moment exceeds the sum of the other two by more than round-off (equal in a flat body).

    `inertia` is (3,) or (3, 3), validated; `algebra` is the one suggested for a quadratic form, None for bodies only.

    Examples
    --------
    >>> warn_unphysical_inertia((1.0, 2.0, 3.0))
    >>> with warnings.catch_warnings(record=True) as noticed:
    ...     warnings.simplefilter("always")
    ...     warn_unphysical_inertia((1.0, 1.0, 5.0))
    >>> len(noticed)
    1
    """
    given = np.asarray(inertia, dtype=np.float64)
    tensor = np.diag(given) if given.ndim == 1 else given
    # Scaling keeps the ratios of the moments, and their sum does not overflow.
    scaled = tensor / np.abs(tensor).max()
    moments = np.diag(scaled) if given.ndim == 1 else np.linalg.eigvalsh(scaled)
    if 2.0 * moments.max() - moments.sum() > ROUNDING_TOLERANCE * moments.sum():
        text = f"{what}: no body has a principal moment that exceeds the sum of the other two"
        _warn(text if algebra is None else f"{text}; {_QUADRATIC_FORM_HINT.format(algebra)}")


def warn_negative_mass(second_moments: npt.NDArray[np.float64]) -> None:
    """Warn if a second moment of the mass, (n,) principal or (n, n), is negative by more than round-off.

    Examples
    --------
    >>> warn_negative_mass(np.array([0.0, 1.0, 2.0]))
    """
    principal = second_moments if second_moments.ndim == 1 else np.linalg.eigvalsh(second_moments)
    if principal.min() < -ROUNDING_TOLERANCE * np.abs(principal).max():
        _warn(
            "inertia: a second moment of the mass is negative, and no body has that; "
            f"{_QUADRATIC_FORM_HINT.format(f'so({len(principal)})')}"
        )


def _warn(text: str) -> None:
    """Warn at the innermost calling line outside the package, so that Python's filter shows it once per line."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_back.f_globals.get("__name__", "").partition(".")[0] == "coadjoint":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, UserWarning, stacklevel=level + 1)
