"""Systems, initial states and steps of Reich (1993), with the values that the paper omits."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra import catalogue
from coadjoint.experiments.convergence import ReferenceProblem, reference_problem
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.examples.paper_examples import paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

# Section 5.1: the paper gives h and a; initial state and time are chosen here to show the whole motion.
SPIRAL_START, SPIRAL_END, SPIRAL_STEP = (1.0, 1.0, 1.0), 20.0, 0.01

# Section 5.2: the state near the separatrix and the step are the paper's; [0, 5] reproduces its figures.
BODY_START, BODY_STEP, BODY_END, BODY_LATER = (1.0, 10.0, 1.0), 0.1, 5.0, 50.0

# A rigid body far from the separatrix, for long runs.
CALM_START, CALM_STEP = (1.0, 2.0, 0.5), 0.05

COORDINATES = Splitting(order=2, parts="coordinates")
"""Lemma 4.1 in the form of the paper: one coordinate at a time."""


def four_dimensional_body() -> LiePoissonSystem:
    """Return a rigid body in four dimensions: so(4), six coordinates, two Casimirs, generic M."""
    return LiePoissonSystem(catalogue.so(4), Quadratic([1.0, 0.8, 0.55, 0.9, 0.35, 0.6]), name="body in 4 dimensions")


def body_trial() -> ReferenceProblem:
    """Return the trial of the rigid body far from the separatrix up to t = 2."""
    return reference_problem(paper_rigid_body(), CALM_START, 2.0)


def four_dimensional_trial() -> ReferenceProblem:
    """Return the trial of the four-dimensional body up to t = 2."""
    return reference_problem(four_dimensional_body(), np.array([0.9, -0.4, 0.7, 0.5, 1.1, -0.6]), 2.0)
