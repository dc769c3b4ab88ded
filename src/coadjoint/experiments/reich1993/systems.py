"""Systems, initial states, steps, schemes and runs of Reich (1993), with the values that the paper omits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.analysis.phase_drift import ANGLES, PhaseDrift, drift_of_series
from coadjoint.analysis.rotations import attitude_angle, precession_error
from coadjoint.experiments.statements import ReferenceProblem, reference_problem
from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.splitting import Splitting
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.examples.paper_examples import paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]

# Section 5.1: the paper gives h and a; initial state and time are chosen here to show the whole motion.
SPIRAL_START, SPIRAL_END, SPIRAL_STEP = (1.0, 1.0, 1.0), 20.0, 0.01

# Section 5.2: the state near the separatrix and the step are the paper's; [0, 5] reproduces its figures.
BODY_START, BODY_STEP, BODY_END, BODY_LATER = (1.0, 10.0, 1.0), 0.1, 5.0, 50.0

# A rigid body far from the separatrix, for long runs.
CALM_START, CALM_STEP = (1.0, 2.0, 0.5), 0.05

COORDINATES = Splitting(order=2, parts="coordinates")
"""Lemma 4.1 in the form of the paper: one coordinate at a time."""

RUNGE: Method = ExplicitRungeKutta("runge2")
MIDPOINT: Method = GaussLegendre(1)
MODIFIED: Method = ModifiedGaussLegendre(1, freeze="gradient")
M_ORTHOGONAL = ModifiedGaussLegendre(1, freeze="structure")
"""The modified midpoint rule that keeps the energy."""
SPLITTING: Method = COORDINATES


def four_dimensional_body() -> LiePoissonSystem:
    """Return a rigid body in four dimensions: so(4), six coordinates, two Casimirs, generic M."""
    return LiePoissonSystem(catalogue.so(4), Quadratic([1.0, 0.8, 0.55, 0.9, 0.35, 0.6]), name="body in 4 dimensions")


def body_trial() -> ReferenceProblem:
    """Return the trial of the rigid body far from the separatrix up to t = 2."""
    return reference_problem(paper_rigid_body(), CALM_START, 2.0)


def four_dimensional_trial() -> ReferenceProblem:
    """Return the trial of the four-dimensional body up to t = 2."""
    return reference_problem(four_dimensional_body(), np.array([0.9, -0.4, 0.7, 0.5, 1.1, -0.6]), 2.0)


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
