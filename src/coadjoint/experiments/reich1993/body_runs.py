"""Runs of section 5.2 of Reich (1993): the rigid body by three schemes, with the exact attitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.phase_drift import ANGLES, PhaseDrift, drift_of_series
from coadjoint.analysis.rotations import attitude_angle, precession_error
from coadjoint.experiments.reich1993.systems import COORDINATES
from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.integrate import integrate
from coadjoint.runs.solution import Solution
from coadjoint.systems.examples.paper_examples import paper_rigid_body

Floats = npt.NDArray[np.float64]

RUNGE: Method = ExplicitRungeKutta("runge2")
MIDPOINT: Method = GaussLegendre(1)
MODIFIED: Method = ModifiedGaussLegendre(1, freeze="gradient")
SPLITTING: Method = COORDINATES


class BodyRun(NamedTuple):
    """A run of the rigid body with attitude, and the exact attitude (k, 3, 3) at the saved times."""

    solution: Solution
    exact: Floats

    @property
    def angle(self) -> Floats:
        """Angle between computed and exact attitude in radians, shape (k,)."""
        attitude = self.solution.attitude
        assert attitude is not None
        return np.asarray(attitude_angle(attitude, self.exact))

    @property
    def phase(self) -> Floats:
        """Phase lead of the computed body about the constant spatial momentum, in radians, signed, shape (k,)."""
        attitude = self.solution.attitude
        assert attitude is not None
        return np.asarray(precession_error(attitude, self.exact, self.solution.x[0]))

    @property
    def drift(self) -> PhaseDrift:
        """Growth of the phase of the attitude, in radians."""
        return drift_of_series(self.solution.t, self.phase, ANGLES)

    def at(self, time: float) -> int:
        """Return the index of a saved time."""
        return int(np.argmin(np.abs(self.solution.t - time)))


def body_run(method: Method, x0: tuple[float, ...], end: float, step: float, save_every: int = 1) -> BodyRun:
    """Integrate the paper's rigid body from the body angular momentum x0 and attitude I."""
    body = paper_rigid_body()
    solution = integrate(body, x0, (0.0, end), step, method, attitude=True, save_every=save_every)
    return BodyRun(solution, body.exact(x0, solution.t, attitude=True)[1])
