"""Directions in the unknowns of a fit that the measurements do not determine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import MAX_LISTED_NAMES
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import Parameter, parameters_at, parameters_of

Floats = NDArray[np.float64]

# Half the distance of the states between which the derivative of the energy is differentiated; exact for quadratics.
DISTANCE = 2.0**-10
# Singular values, relative to the largest, of unknowns that Jacobians with central differences do not determine.
BY_DIFFERENCES = 2.0**-26
# Largest field of a Casimir, relative to the field of other directions of H.
CASIMIR = 1e-6


def check_determined(J: Floats, problem: Any) -> None:
    """Raise ValueError if the Jacobian has directions without influence on the measurements."""
    from scipy.linalg import qr

    unknowns = problem.unknowns
    if len(J) < len(unknowns):
        raise ValueError(f"{len(J)} numbers were measured for {len(unknowns)} unknowns; measure more")
    scale = np.linalg.norm(J, axis=0)
    scaled = J / np.where(scale > 0, scale, 1.0)
    _, values, vectors = np.linalg.svd(scaled, full_matrices=False)
    exact = problem.quantities is None
    free = values <= (16 * max(J.shape) * UNIT_ROUNDOFF if exact else BY_DIFFERENCES) * values[0]
    if free.any():
        directions = np.abs(vectors[free] / np.where(scale > 0, scale, 1.0))
        involved = np.flatnonzero((directions > 1e-3 * directions.max(axis=1, keepdims=True)).any(axis=0))
        names = " and ".join(dict.fromkeys(unknowns[k][0] for k in involved))
        # Without the last columns of a pivoted factorization, the others are independent.
        order = qr(scaled, mode="r", pivoting=True)[1]
        omitted = ", ".join(problem.entry(*unknowns[k]) for k in sorted(order[-free.sum() :])[:MAX_LISTED_NAMES])
        reason = _casimirs_among(vectors[free] / np.where(scale > 0, scale, 1.0), problem)
        raise ValueError(
            f"the measurements do not determine all unknown entries of {names}{reason}; omit, for instance, {omitted}"
        )


def _casimirs_among(directions: Floats, problem: Any) -> str:
    """Return the number of directions without influence that change H by a Casimir, in words for a message."""
    system = problem.system.unforced
    x = np.random.default_rng(1).standard_normal((4, system.dim))
    of_energy = parameters_of(system)
    named = {name: problem.values[name] for name in problem.chosen if name in of_energy}
    parameters, rows = parameters_at(system, named), []
    for z in directions:
        moved, rest = problem.split(z, named)
        gradients = _energy_gradients(parameters, moved, x)
        fields = [system.structure_matrix(point) @ gradient for point, gradient in zip(x, gradients, strict=True)]
        rows.append(np.concatenate([np.ravel(fields), rest]) / np.abs(z).max())
    count = len(rows) - int(np.linalg.matrix_rank(np.array(rows), CASIMIR))
    if not count:
        return ""
    return f" (in {count} of {len(rows)} free directions H changes by a Casimir, which moves nothing)"


def _energy_gradients(parameters: Mapping[str, Parameter], directions: Mapping[str, Floats], x: Floats) -> Floats:
    """Return the gradients at states (points, n) of the derivative of the energy along directions of parameters."""
    n = x.shape[-1]
    shifted = x[:, None, None] + DISTANCE * np.array([np.eye(n), -np.eye(n)])
    along = np.zeros(shifted.shape[:-1])
    for name, direction in directions.items():
        along += parameters[name].energy().at(shifted) @ direction.ravel()
    return (along[:, 0] - along[:, 1]) / (2 * DISTANCE)
