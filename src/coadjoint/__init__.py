"""Structure-preserving integration of Lie-Poisson systems, generalized Euler equations x' = J(x) grad H(x).

A system combines a Lie algebra, of any finite dimension, and a Hamiltonian; `integrate` runs it with a scheme:

>>> import coadjoint as co
>>> body = co.systems.rigid_body(inertia=(1, 2, 3))
>>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 100), step=0.1, method=co.Splitting(order=4))
>>> sol.x.shape
(1001, 3)

Names are loaded lazily: importing this package loads NumPy and nothing heavier.
"""

from __future__ import annotations

import importlib

from coadjoint.interruption import complete_imports

# Importing typing would take most of the import time of this package.
TYPE_CHECKING = False

__version__ = "0.1.0"

complete_imports()

_HOME = {
    "IntegrationError": "coadjoint.errors",
    "Invariant": "coadjoint.algebra.invariants.invariant",
    "IsospectralGauss": "coadjoint.methods.isospectral_gauss",
    "LieAlgebra": "coadjoint.algebra.lie_algebra",
    "LongWait": "coadjoint.long_operations",
    "LineSplitting": "coadjoint.methods.line_splitting",
    "Polynomial": "coadjoint.algebra.polynomials.polynomial",
    "ForcedSystem": "coadjoint.systems.forced",
    "Hamiltonian": "coadjoint.systems.hamiltonians.hamiltonian",
    "LiePoissonSystem": "coadjoint.systems.lie_poisson",
    "PoissonSystem": "coadjoint.systems.poisson",
    "Quadratic": "coadjoint.systems.hamiltonians.quadratic",
    "Separable": "coadjoint.systems.hamiltonians.separable",
    "SplitHamiltonian": "coadjoint.systems.hamiltonians.split_hamiltonian",
    "batch": "coadjoint.systems.batch",
    "CommutatorFree": "coadjoint.methods.commutator_free",
    "Composition": "coadjoint.methods.composition",
    "ExplicitRungeKutta": "coadjoint.methods.explicit_runge_kutta",
    "GaussLegendre": "coadjoint.methods.gauss_legendre",
    "IteratedGaussLegendre": "coadjoint.methods.iterated_gauss_legendre",
    "Kahan": "coadjoint.methods.kahan",
    "ModifiedGaussLegendre": "coadjoint.methods.modified_gauss_legendre",
    "Projected": "coadjoint.methods.projected",
    "ReversibleSteps": "coadjoint.methods.reversible_steps",
    "RadauEnergy": "coadjoint.methods.radau_energy",
    "MatrixAlgebra": "coadjoint.algebra.families.matrix_algebra",
    "MatrixSystem": "coadjoint.systems.matrices.matrix_system",
    "SphericalMidpoint": "coadjoint.methods.spherical_midpoint",
    "Splitting": "coadjoint.methods.splitting",
    "TwoLayerSystem": "coadjoint.systems.matrices.two_layer_system",
    "Taylor": "coadjoint.methods.taylor",
    "Event": "coadjoint.runs.events",
    "Events": "coadjoint.runs.events",
    "PreparedRun": "coadjoint.runs.prepared_run",
    "Section": "coadjoint.runs.section",
    "Solution": "coadjoint.runs.solution",
    "ensemble": "coadjoint.files.archives.ensemble",
    "integrate": "coadjoint.runs.integrate",
    "prepare": "coadjoint.runs.prepared_run",
    "section": "coadjoint.runs.section",
    "stepper": "coadjoint.runs.stepper",
    "Choice": "coadjoint.choosing.accuracy",
    "choose": "coadjoint.choosing.accuracy",
    "Certificate": "coadjoint.analysis.certificates.certificate",
    "Corrector": "coadjoint.analysis.backward_error.corrector",
    "Frequencies": "coadjoint.analysis.frequencies",
    "LyapunovExponents": "coadjoint.analysis.lyapunov",
    "ModifiedField": "coadjoint.analysis.backward_error.modified_field_base",
    "ModifiedHamiltonian": "coadjoint.analysis.backward_error.modified_hamiltonian",
    "PhaseDrift": "coadjoint.analysis.phase_drift",
    "certify": "coadjoint.analysis.certificates.certify",
    "corrector": "coadjoint.analysis.backward_error.corrector",
    "frequencies": "coadjoint.analysis.frequencies",
    "lyapunov": "coadjoint.analysis.lyapunov",
    "modified_field": "coadjoint.analysis.backward_error.modified_field",
    "modified_hamiltonian": "coadjoint.analysis.backward_error.modified_hamiltonian",
    "phase_drift": "coadjoint.analysis.phase_drift",
    "load": "coadjoint.files.datasets.loaded_solution",
    "open_archive": "coadjoint.files.archives.archived_solution",
    "predicted_drift": "coadjoint.analysis.predicted_drift",
    "resume": "coadjoint.files.archives.resume",
    "suggest_step": "coadjoint.analysis.suggested_step",
}
_MODULES = {
    "algebras": "coadjoint.algebra.catalogue",
    "forces": "coadjoint.systems.forces",
    "systems": "coadjoint.systems",
    "methods": "coadjoint.methods",
}

__all__ = ["__version__", "algebras", *sorted(_HOME), *sorted(_MODULES.keys() - {"algebras"})]

if TYPE_CHECKING:
    from typing import Any

    from coadjoint import methods as methods
    from coadjoint import systems as systems
    from coadjoint.algebra import catalogue as algebras
    from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra as MatrixAlgebra
    from coadjoint.algebra.invariants.invariant import Invariant as Invariant
    from coadjoint.algebra.lie_algebra import LieAlgebra as LieAlgebra
    from coadjoint.algebra.polynomials.polynomial import Polynomial as Polynomial
    from coadjoint.analysis.backward_error.corrector import Corrector as Corrector
    from coadjoint.analysis.backward_error.corrector import corrector as corrector
    from coadjoint.analysis.backward_error.modified_field import modified_field as modified_field
    from coadjoint.analysis.backward_error.modified_field_base import ModifiedField as ModifiedField
    from coadjoint.analysis.backward_error.modified_hamiltonian import ModifiedHamiltonian as ModifiedHamiltonian
    from coadjoint.analysis.backward_error.modified_hamiltonian import modified_hamiltonian as modified_hamiltonian
    from coadjoint.analysis.certificates.certificate import Certificate as Certificate
    from coadjoint.analysis.certificates.certify import certify as certify
    from coadjoint.analysis.frequencies import Frequencies as Frequencies
    from coadjoint.analysis.frequencies import frequencies as frequencies
    from coadjoint.analysis.lyapunov import LyapunovExponents as LyapunovExponents
    from coadjoint.analysis.lyapunov import lyapunov as lyapunov
    from coadjoint.analysis.phase_drift import PhaseDrift as PhaseDrift
    from coadjoint.analysis.phase_drift import phase_drift as phase_drift
    from coadjoint.analysis.predicted_drift import predicted_drift as predicted_drift
    from coadjoint.analysis.suggested_step import suggest_step as suggest_step
    from coadjoint.choosing.accuracy import Choice as Choice
    from coadjoint.choosing.accuracy import choose as choose
    from coadjoint.errors import IntegrationError as IntegrationError
    from coadjoint.files.archives.archived_solution import open_archive as open_archive
    from coadjoint.files.archives.ensemble import ensemble as ensemble
    from coadjoint.files.archives.resume import resume as resume
    from coadjoint.files.datasets.loaded_solution import load as load
    from coadjoint.long_operations import LongWait as LongWait
    from coadjoint.methods.commutator_free import CommutatorFree as CommutatorFree
    from coadjoint.methods.composition import Composition as Composition
    from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta as ExplicitRungeKutta
    from coadjoint.methods.gauss_legendre import GaussLegendre as GaussLegendre
    from coadjoint.methods.isospectral_gauss import IsospectralGauss as IsospectralGauss
    from coadjoint.methods.iterated_gauss_legendre import IteratedGaussLegendre as IteratedGaussLegendre
    from coadjoint.methods.kahan import Kahan as Kahan
    from coadjoint.methods.line_splitting import LineSplitting as LineSplitting
    from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre as ModifiedGaussLegendre
    from coadjoint.methods.projected import Projected as Projected
    from coadjoint.methods.radau_energy import RadauEnergy as RadauEnergy
    from coadjoint.methods.reversible_steps import ReversibleSteps as ReversibleSteps
    from coadjoint.methods.spherical_midpoint import SphericalMidpoint as SphericalMidpoint
    from coadjoint.methods.splitting import Splitting as Splitting
    from coadjoint.methods.taylor import Taylor as Taylor
    from coadjoint.runs.events import Event as Event
    from coadjoint.runs.events import Events as Events
    from coadjoint.runs.integrate import integrate as integrate
    from coadjoint.runs.prepared_run import PreparedRun as PreparedRun
    from coadjoint.runs.prepared_run import prepare as prepare
    from coadjoint.runs.section import Section as Section
    from coadjoint.runs.section import section as section
    from coadjoint.runs.solution import Solution as Solution
    from coadjoint.runs.stepper import stepper as stepper
    from coadjoint.systems import forces as forces
    from coadjoint.systems.batch import batch as batch
    from coadjoint.systems.forced import ForcedSystem as ForcedSystem
    from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian as Hamiltonian
    from coadjoint.systems.hamiltonians.quadratic import Quadratic as Quadratic
    from coadjoint.systems.hamiltonians.separable import Separable as Separable
    from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian as SplitHamiltonian
    from coadjoint.systems.lie_poisson import LiePoissonSystem as LiePoissonSystem
    from coadjoint.systems.matrices.matrix_system import MatrixSystem as MatrixSystem
    from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem as TwoLayerSystem
    from coadjoint.systems.poisson import PoissonSystem as PoissonSystem


if not TYPE_CHECKING:  # type checkers know the names above and must report any other

    def __getattr__(name: str) -> Any:
        if name in _MODULES:
            value: Any = importlib.import_module(_MODULES[name])
        elif name in _HOME:
            value = getattr(importlib.import_module(_HOME[name]), name)
        else:
            from coadjoint.errors import unknown_attribute

            raise unknown_attribute("coadjoint", name, __all__)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
