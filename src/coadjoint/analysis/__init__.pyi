# Public names of `co.analysis`; lazy_loader and type checkers read this file.

from .frequencies import Combinations as Combinations
from .phase_drift import drift_of_series as drift_of_series
from .phase_error import attitude_angle as attitude_angle
from .phase_error import phase_error as phase_error
from .phase_error import precession_error as precession_error
from .phase_error import twist as twist
from .poisson_defect import PoissonDefect as PoissonDefect
from .poisson_defect import defect_of_tangent as defect_of_tangent
from .poisson_defect import poisson_defect as poisson_defect
from .powers import Growth as Growth
from .powers import OrderFit as OrderFit
from .powers import fit_order as fit_order
from .powers import growth as growth
from .predicted_drift import Period as Period
from .predicted_drift import PredictedDrift as PredictedDrift
from .predicted_drift import period as period
from .round_off import RandomWalk as RandomWalk
from .round_off import orthogonality as orthogonality
from .round_off import random_walk as random_walk
from .round_off import round_off as round_off
from .round_off import spatial_momentum as spatial_momentum
from .spectral_lines import line_drift as line_drift

__all__: list[str]
