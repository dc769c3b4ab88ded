# Public names of `co.analysis`; lazy_loader and type checkers read this file.

from .frequencies import Combinations as Combinations
from .phase_drift import drift_of_series as drift_of_series
from .phase_error import attitude_angle as attitude_angle
from .phase_error import phase_error as phase_error
from .phase_error import precession_error as precession_error
from .phase_error import twist as twist
from .powers import Growth as Growth
from .powers import OrderFit as OrderFit
from .powers import fit_order as fit_order
from .powers import growth as growth
from .predicted_drift import Period as Period
from .predicted_drift import PredictedDrift as PredictedDrift
from .predicted_drift import period as period
from .spectral_lines import line_drift as line_drift
from .structure_defects import PoissonDefect as PoissonDefect
from .structure_defects import RandomWalk as RandomWalk
from .structure_defects import defect_of_tangent as defect_of_tangent
from .structure_defects import orthogonality as orthogonality
from .structure_defects import poisson_defect as poisson_defect
from .structure_defects import random_walk as random_walk
from .structure_defects import round_off as round_off
from .structure_defects import spatial_momentum as spatial_momentum

__all__: list[str]
