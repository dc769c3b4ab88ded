"""Manakov's top: integrable quadratic Hamiltonians on so(n)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.closed_forms.manakov_integrals import halves_of_so4, manakov_integrals, planes, rotations
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite


def _energy(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    first, second = planes(len(a))
    return ((b[first] - b[second]) / (a[first] - a[second]),)


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.3, 0.2, 0.1, 0.6, 0.5),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="An integrable energy on so(4), which is two copies of so(3): the momentum is two vectors of constant "
        "lengths, each on a sphere of its own (both drawn on one), and the paths fill bands with sharp edges.",
        pictures=(
            Picture(
                "directions",
                vectors={"self-dual part": halves_of_so4(1.0), "anti-self-dual part": halves_of_so4(-1.0)},
                title="so(4) as two spheres: the directions of both parts",
            ),
        ),
        coordinates=lambda dim: ("x12", "x13", "x14", "x23", "x24", "x34") if dim == 6 else (),
        quantity="angular momentum",
    ),
)
def manakov_top(a: npt.ArrayLike = (1.0, 2.0, 4.0, 7.0), b: npt.ArrayLike = (1.0, 3.0, 2.0, 5.0)) -> LiePoissonSystem:
    """Return Manakov's top on so(n), ``X' = [X, Omega]`` with ``Omega_ij = (b_i - b_j)/(a_i - a_j) x_ij``.

    State, sign -1 and group element are those of `so_n_body`, which is the case ``a = l^2``, ``b = l``. The energy
    ``sum of (b_i - b_j)/(a_i - a_j) x_ij^2 / 2`` need not be positive.

    The equations are equivalent to ``(X + mu a)' = [X + mu a, Omega + mu b]`` for every number mu, with a and b as
    diagonal matrices. So the coefficients of ``tr (X + mu a)^m`` are constant, and they are in involution.

    Parameters
    ----------
    a : (n,)
        Distinct numbers, n >= 3.
    b : (n,)
        Any numbers, in units such that (b_i - b_j)/(a_i - a_j) is an inverse moment of inertia.

    Returns
    -------
    LiePoissonSystem
        With the quadratic integrals ``"X^2 a"``, ``"X^2 a^2"``, ..., ``"X^2 a^(n-2)"``, ten at most, and those of
        higher degree, such as ``"X^4 a"``, up to n = 6: ``(-1)^j / m`` times the coefficient of mu^(m - 2j) of
        ``tr (X + mu a)^m`` is called X^2j a^(m - 2j). The energy is a combination of the quadratic ones and
        of ``|x|^2``.

    Raises
    ------
    ValueError
        a and b are not finite, differ in length or have fewer than three entries, two entries of a are equal, or a
        quotient or a power of a overflows.

    Notes
    -----
    Manakov, "Note on the integration of Euler's equations of the dynamics of an n-dimensional rigid body", Funct. Anal.
    Appl. 10, 328 (1976).

    Examples
    --------
    >>> top = manakov_top(a=(1.0, 2.0, 4.0, 7.0), b=(1.0, 3.0, 2.0, 5.0))
    >>> top.energy([1.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    3.0
    >>> top.integrals["X^2 a"].value([1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    14.0
    """
    a_values = read_finite(a, "a")
    if a_values.ndim != 1 or a_values.size < 3:
        raise ValueError(f"a has shape {a_values.shape}; give n numbers, n from 3")
    b_values = read_vector(b, "b", a_values.size)
    algebra = rotations(a_values.size)
    first, second = planes(a_values.size)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        (M,) = _energy(a_values, b_values)
    equal = a_values[first] == a_values[second]
    if equal.any():
        i, j = sorted((int(first[equal][0]), int(second[equal][0])))
        raise ValueError(f"a[{i}] and a[{j}] are both {a_values[i]:g}; give different numbers")
    if not np.isfinite(M).all():
        raise ValueError("a quotient (b_i - b_j)/(a_i - a_j) overflows; take smaller b, or a farther apart")
    return LiePoissonSystem(
        algebra,
        Quadratic(M),
        sign=-1,
        name="manakov_top",
        parameters={"a": tuple(a_values.tolist()), "b": tuple(b_values.tolist())},
        integrals=manakov_integrals(a_values),
    )
