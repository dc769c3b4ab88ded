"""Calls of everything in docs/public_names.txt with valid, hostile and drawn arguments."""

from __future__ import annotations

import decimal
import fractions
import functools
import inspect
import os
import pathlib
import random
import re
import tempfile
import warnings

import numpy as np
import scipy.sparse

import coadjoint as co
from domains.of_algebras import ALGEBRAS, CATALOGUE
from domains.of_parts import EVENTS, FORCES, HAMILTONIANS, OWN_SYSTEMS, SCHEMES, STATES
from domains.of_systems import SYSTEMS

from .folder import make
from .judging import TooLong, wrong_error, wrong_warning
from .values import HOSTILE, wild

NAMES = pathlib.Path(__file__).parents[2] / "docs" / "public_names.txt"
FOLDER = tempfile.TemporaryDirectory()
ARCHIVE = pathlib.Path(FOLDER.name, "run.zarr")
SO3, BODY, X, EYE = co.algebras.so(3), co.systems.rigid_body(), (0.1, 1.0, 0.2), np.eye(3)
P = co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1})
MATRICES = co.MatrixAlgebra("so", 3)
WEIGHTS = co.systems.Weights(np.ones((3, 3)))
TURNING = co.MatrixSystem(MATRICES, lambda W: 2.0 * W)
FORCED = BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque(lambda t: np.array([0.0, 0.0, t])))
READY = co.prepare(BODY, co.Splitting(), 0.1)
TIMES = np.arange(128) * 0.1
FIELD = co.modified_field(BODY, co.GaussLegendre(1), 3)
KEPT = co.modified_hamiltonian(BODY, co.Splitting())
LONG = co.integrate(BODY, X, (0, 20), 0.125, attitude=True)
ENSEMBLE = co.integrate(BODY, [X, X], (0, 1), 0.5, attitude="coadjoint")
WAVES = co.integrate(co.systems.spin_lattice("ring", 4), np.tile([0.6, 0.0, 0.8, 0.0, 0.6, 0.8], 2), (0, 1), 0.1)
co.integrate(BODY, X, (0, 1), 0.1, archive=ARCHIVE)
ROBOT = pathlib.Path(FOLDER.name, "robot.urdf")
INERTIAL = '<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/>'
ROBOT.write_text(f'<robot name="r"><link name="a"><inertial>{INERTIAL}</inertial></link></robot>', encoding="utf-8")

ORBIT = co.orbits.circular(7e6, epoch="2024-01-01", frame="J2000")
LOG = co.attitudes.AttitudeLog([0.0, 1.0], np.stack([EYE, EYE]))
LOGGED, EPHEMERIS = pathlib.Path(FOLDER.name, "log.csv"), pathlib.Path(FOLDER.name, "orbit.oem")
co.attitudes.write(LOGGED, LOG)
OVF = LOGGED.with_name("field.ovf")
SPINS = {"spins": np.tile((0.6, 0.0, 0.8), 4), "shape": (2, 2), "cell": (1e-9, 1e-9, 1e-9)}
co.spins.write_ovf(OVF, **SPINS)
VTI, MCIF = OVF.with_suffix(".vti"), OVF.with_suffix(".mcif")
co.spins.write_vtk(VTI, **SPINS)
MCIF.write_text(
    "data_a\n_cell_length_a 1\n_cell_length_b 1\n_cell_length_c 1\n_cell_angle_alpha 90\n_cell_angle_beta 90\n"
    "_cell_angle_gamma 90\nloop_\n_space_group_symop_magn_operation.xyz\nx,y,z,+1\nloop_\n_atom_site_label\n"
    "_atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\nFe 0 0 0\nloop_\n_atom_site_moment.label\n"
    "_atom_site_moment.crystalaxis_x\n_atom_site_moment.crystalaxis_y\n_atom_site_moment.crystalaxis_z\nFe 0 0 1\n",
    encoding="utf-8",
)
MESH = {"size": (1, 1, 1), "cell": (1e-9, 1e-9, 1e-9), "Msat": 8e5, "Aex": 1e-11, "Ku1": 1e5}
PARTICLE = co.spins.micromagnetic(**MESH)
FLIP = co.systems.spin_lattice([], 1, on_site=(0.0, -1.0, 1.0))
EPHEMERIS.write_text(
    "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2024-01-01T00:00:00\nORIGINATOR = ME\nMETA_START\nOBJECT_NAME = A\n"
    "OBJECT_ID = 1\nCENTER_NAME = EARTH\nREF_FRAME = EME2000\nTIME_SYSTEM = UTC\nSTART_TIME = 2024-01-01T00:00:00\n"
    "STOP_TIME = 2024-01-01T00:02:00\nMETA_STOP\n"
    + "".join(f"2024-01-01T00:0{k}:00 7000.0 {450 * k} 0.0 0.0 7.5 0.0\n" for k in range(3)),
    encoding="utf-8",
)
ELEMENTS = (
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927\n"
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537\n"
)
SAMPLES = pathlib.Path(FOLDER.name, "samples.csv")
ROD = co.checkcases.get("rod", samples=5)
ROD.write(SAMPLES)

BONDS = pathlib.Path(FOLDER.name, "bonds.csv")
BONDS.write_text("i,j,n1,n2,n3,J\n0,0,1,0,0,1\n")
CUBE = co.spins.crystal(lattice=(1.0, 1.0, 1.0, 90.0, 90.0, 90.0), sites={"Fe": (0.0, 0.0, 0.0)})
DIMERS = co.spins.crystal(lattice=(3.0, 3.0, 3.0, 90.0, 90.0, 90.0), sites={"Fe": (0.1, 0.2, 0.0)}, space_group="P 1")
MODEL = co.systems.spins(DIMERS, (3, 3, 3))
UP = np.tile([0.0, 0.0, 1.0], 27)
LEVELS = co.systems.spins(DIMERS, (3, 1, 1), spin=1, mode="SU(N)", periodic=False)
PROJECTION = np.diag([1.0, 0.0, 1.0])

OBJECTS = {
    "AttitudeLog": LOG,
    "Bond": CUBE.bonds(1.0)[0],
    "Crystal": CUBE,
    "Site": CUBE.site(0),
    "MagneticStructure": co.spins.magnetic_structure(MCIF),
    "OvfField": co.spins.read_ovf(OVF),
    "SpinModel": MODEL,
    "CoherentSpinModel": LEVELS,
    "Orbit": ORBIT,
    "CheckCase": ROD,
    "Certificate": co.certify(BODY, co.Splitting(), X, 0.1, steps=4),
    "Corrector": co.make_corrector(BODY, co.Splitting(), X),
    "Force": co.forces.LinearDamping(0.1),
    "Frequencies": co.frequencies(TIMES, np.cos(TIMES), 1),
    "LieAlgebra": SO3,
    "LiePoissonSystem": BODY,
    "MatrixAlgebra": MATRICES,
    "MatrixSystem": TURNING,
    "MassProperties": co.bodies.read(ROBOT),
    "Method": co.GaussLegendre(2),
    "LinearModes": co.spectra.linear_modes(MODEL.field((0, 0, 1)), UP, [(0, 0, 0), (1, 0, 0)], 3),
    "ModifiedField": FIELD,
    "Neutrons": co.spectra.Neutrons(),
    "PhaseDrift": co.phase_drift(LONG),
    "Polynomial": P,
    "PreparedRun": READY,
    "Solution": LONG,
    "Splitting": co.Splitting(),
    "StructureFactor": co.spectra.structure_factor(WAVES),
    "Stepper": co.stepper(BODY, co.Splitting(), 0.1),
    "System": BODY,
}
# Further objects, and functions of which every argument is tried.
FURTHER = {
    "a modified Hamiltonian": KEPT,
    "a modified field": FIELD,
    "a modified field at points": co.modified_field(BODY, co.GaussLegendre(1), 3, way="numerical"),
    "a field with forces": FORCED.vector_field,
    "the power of forces": FORCED.power,
    "a corrector": OBJECTS["Corrector"],
    "a step": OBJECTS["Stepper"],
    "a sum of lines": OBJECTS["Frequencies"],
    "a value": P,
    "a state": lambda a: co.integrate(BODY, (a, 1.0, 1.0), (0, 1), 0.5, co.GaussLegendre(2)),
    "a prepared accuracy": lambda x0, t_span: co.prepare(BODY, accuracy=1e-4, x0=X, t_span=(0, 1)).run(x0, t_span),
    "what J returns": lambda value: co.PoissonSystem(lambda x: value, co.Quadratic(X)),
    "what a stream returns": lambda value: co.MatrixSystem(MATRICES, lambda W: value),
    "a torque": lambda value: BODY.with_forces(co.forces.Torque(lambda x: value)),
    "a flow": lambda value: BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x + tau * value)),
    "an observable": lambda value: co.integrate(BODY, X, (0, 1), 0.5, observe={"f": value}),
    "a bracket": lambda value: co.LieAlgebra.from_brackets(2, {(0, 1): {1: value}}),
    "an exponent": lambda n: co.Polynomial({(1, n): 1}).gradient([1.0, 2.0]),
    "a power": lambda n: P**n,
    "a parameter of the catalogue": lambda a: co.algebras.get("A3,7", a=a),
    "a size of the catalogue": lambda n: co.algebras.get("so(n)", n=n),
    "parts": lambda parts: co.Splitting(parts=parts).describe(BODY),
    "a check-case": lambda inertia, rates, end, samples: co.checkcases.get(
        "free_body", inertia=inertia, rates=rates, end=end, samples=samples
    ),
    "a tensor of a check-case": lambda moments, rotation: co.checkcases.get(
        "free_body_products", moments=moments, rotation=rotation
    ),
    "a top of a check-case": lambda axial, weight, distance, tilt: co.checkcases.get(
        "kovalevskaya_top", axial=axial, weight=weight, distance=distance, tilt=tilt
    ),
    "a libration of a check-case": lambda mean_motion, pitch: co.checkcases.get(
        "pitch_libration", mean_motion=mean_motion, pitch=pitch
    ),
    "a rotor of a check-case": lambda rotor: co.checkcases.get("gyrostat", rotor=rotor),
    "a torque of a check-case": lambda torque: co.checkcases.get("spin_up", torque=torque),
    "a run of matrices": lambda W, t_span: co.integrate(TURNING, W, t_span, 0.5),
}
# Constructors with the domain of each parameter.
CASES = {**SYSTEMS, **STATES, **ALGEBRAS, **CATALOGUE, **HAMILTONIANS, **OWN_SYSTEMS, **FORCES, **SCHEMES, **EVENTS}
# Valid values of parameters of all other functions by name; others are those of defaults.
VALID = {
    "system": BODY, "algebra": SO3, "method": co.Splitting(), "base": co.GaussLegendre(1), "x": X, "x0": X, "x0s": [X],
    "t": 0.25, "t_span": (0, 1), "step": 0.125, "h": 0.1, "n": 3, "u": X, "v": X, "i": 0, "dim": 3, "order": 4,
    "accuracy": 1e-3, "event": co.Event(0), "polynomial": P, "a": 1.0, "value": X, "solution": LONG, "hamiltonian": P,
    "W": np.zeros((3, 3)), "A": EYE, "B": EYE, "size": 3, "g": SO3, "given": LONG, "count": 2, "degree": 2, "seed": 1,
    "forces": co.forces.LinearDamping(0.1), "path": ARCHIVE, "invariant": "energy", "ready": READY,
    "measured": {"x": LONG.x[::8]}, "unknown": {"x0": True}, "sigma": {"x": 0.1}, "temperature": 0.5, "energy": 1e-3,
    "matrices": [EYE], "parts": ((0,), (1,), (2,)), "directions": {"x0": X}, "basis": None, "N": 3, "stream": WEIGHTS,
    "M": X, "monomials": {(2, 0, 0): 0.5}, "text": "x1^2", "steps": [0.4, 0.2, 0.1], "errors": [0.16, 0.04, 0.01],
    "floors": [1e-16] * 3, "axis": X, "P": EYE, "before": np.zeros((3, 3)), "after": np.zeros((3, 3)), "early": 1,
    "operations": 1, "lead": TIMES, "deviations": np.ones((3, 4)), "function": P, "level": 1.0, "box": [(-1, 1)] * 3,
    "cells": 4, "matrix": EYE, "window": 5.0, "frequency": 1.0, "field": lambda x: -x, "dataset": LONG.to_xarray(),
    "error": ValueError("no"), "scheme": co.Splitting, "weights": np.ones((3, 3)), "q": X, "p": X,
}  # fmt: skip
RUN, BRACKETS, ZERO = {"attitude": None}, {"brackets": {(0, 1): {2: 1.0}}, "dim": 3}, np.zeros((3, 3))
OWN = {
    "co.identify": {"t": LONG.t, "x": LONG.x},
    "co.fit": {"t_span": (0, 2), "sigma": {"x": 1.0}},
    "co.thermal_states": {"system": co.systems.spin_lattice(), "members": 2, "sweeps": 2},
    "co.spectra.structure_factor": {"solution": WAVES},
    "co.spectra.linear_modes": {"system": MODEL, "state": UP, "path": [(0, 0, 0), (1, 0, 0)], "points": 3},
    "co.spectra.Neutrons": {"form_factors": {"Fe": "Fe2+"}, "domains": [EYE]},
    "co.spectra.Plane": {"origin": X, "first": EYE[0], "second": EYE[1]},
    "co.spectra.Powder": {"edges": [0.5, 1.0, 1.5]},
    "Neutrons.form_factor": {"ion": "Fe2+", "g": 1.5},
    "StructureFactor.broadened": {"fwhm": 0.5},
    "StructureFactor.integrated": {"low": 0.0, "high": 1.0},
    "LinearModes.spectrum": {"energies": [0.0, 0.5, 1.0], "fwhm": 0.5},
    "co.bodies.MassProperties": {"mass": 1.0, "inertia": (1.0, 2.0, 2.5)},
    "co.bodies.read": {"path": ROBOT},
    "co.spins.crystal": {"lattice": (1.0, 1.0, 1.0, 90.0, 90.0, 90.0), "sites": {"Fe": (0.0, 0.0, 0.0)}},
    "Crystal.bonds": {"max_distance": 1.0},
    "Crystal.site": {"site": "Fe"},
    "SpinModel.biquadratic": {"bond": DIMERS.bonds(3.0)[0], "K": 0.5},
    "CoherentSpinModel.biquadratic": {"bond": DIMERS.bonds(3.0)[0], "K": 0.3},
    "CoherentSpinModel.coherent": {"directions": X},
    "CoherentSpinModel.dipoles": {"x": LEVELS.coherent((0.0, 0.0, 1.0))},
    "CoherentSpinModel.expectation": {"x": LEVELS.coherent((0.0, 0.0, 1.0)), "operator": PROJECTION},
    "CoherentSpinModel.from_amplitudes": {"Z": np.ones((3, 3))},
    "CoherentSpinModel.pair_coupling": {"bond": DIMERS.bonds(3.0)[0], "operator": np.eye(9)},
    "CoherentSpinModel.random": {"members": 3},
    "CoherentSpinModel.single_ion": {"site": "Fe", "matrix": PROJECTION},
    "SpinModel.dzyaloshinskii_moriya": {"bond": DIMERS.bonds(3.0)[0], "D": X},
    "SpinModel.exchange": {"bond": DIMERS.bonds(3.0)[0], "J": EYE},
    "SpinModel.field": {"B": X},
    "SpinModel.single_ion": {"site": "Fe"},
    "SpinModel.vacancies": {"fraction": 0.4},
    "SpinModel.substitute": {"label": "Fe", "fraction": 0.4, "spin": 2.0},
    "co.spins.read_exchange": {"path": BONDS, "crystal": CUBE},
    "co.spins.structure": {"name": "MnF2"},
    "co.systems.spins": {"crystal": CUBE, "size": (1, 1, 1)},
    "MassProperties.about": {"point": X},
    "co.certify": {"steps": 4},
    "co.export_c": {"prepared": READY, "path": ARCHIVE.with_name("run.h")},
    "co.export_table": {"prepared": READY, "path": ARCHIVE.with_name("run.json")},
    "co.analysis.phase_error": {"t": [1.0], "x": [X]},
    "co.resume": {"t_end": 2.0},
    "co.integrate_ensemble": {"x0": ENSEMBLE.x0, "threads": 1},
    "co.LieAlgebra.from_brackets": BRACKETS,
    "LieAlgebra.from_brackets": BRACKETS,
    "PreparedRun.vjp": RUN,
    "PreparedRun.jvp": RUN,
    "PreparedRun.run": RUN,
    "MatrixSystem.spectrum": {"x": ZERO},
    "co.algebras.get": {"name": "so(3)"},
    "co.algebras.low_dimensional": {"name": "A3_1"},
    "co.analysis.drift_of_series": {"t": TIMES},
    **{f"co.analysis.{name}": {"solution": ENSEMBLE} for name in ("orthogonality", "round_off", "spatial_momentum")},
    "co.analysis.poisson_defect": {"step": OBJECTS["Stepper"]},
    "co.frequencies": {"count": 1},
    **{f"co.{name}": {"step": 0.1} for name in ("integrate", "poincare_section", "prepare")},
    "co.methods.get": {"name": "Taylor"},
    "co.attitudes.AttitudeLog": {"t": [0.0, 1.0], "rotation": [EYE, EYE]},
    "co.attitudes.read": {"path": LOGGED},
    "co.spins.read_ovf": {"path": OVF},
    "co.spins.write_ovf": {"path": OVF, **SPINS},
    "co.spins.read_vtk": {"path": VTI},
    "co.spins.write_vtk": {"path": VTI, **SPINS},
    "OvfField.spins": {"shape": (2, 2)},
    "co.spins.magnetic_structure": {"path": MCIF},
    "MagneticStructure.state": {"model": co.systems.spins(CUBE, (1, 1, 1))},
    "co.spins.micromagnetic": MESH,
    "co.spins.hysteresis": {"model": PARTICLE, "fields": [X, X], "x0": X},
    "co.spins.minimum_energy_path": {"system": FLIP, "start": (0.0, 0.0, 1.0), "end": (0.0, 0.0, -1.0), "images": 5},
    "co.spins.skyrmion_number": {"model": co.systems.spins(CUBE, (1, 1, 1)), "x": X},
    "co.spins.thermal_averages": {"system": FLIP, "temperature": 1.0, "sweeps": 16, "every": 1, "members": 1},
    "co.spins.to_sunny": {"model": MODEL},
    "co.spins.to_vampire": {"model": co.systems.spins(DIMERS, (3, 3, 3), units="meV"), "folder": VTI.with_name("run")},
    "co.attitudes.write": {"path": LOGGED.with_name("other.tum"), "log": LOG},
    "co.orbits.Orbit": {"position": ORBIT.position, "velocity": ORBIT.velocity},
    "co.orbits.Planet": {"mu": 1.0},
    "co.orbits.circular": {"radius": 7e6},
    "co.orbits.kepler": {"semi_major_axis": 7e6},
    "co.orbits.from_samples": {
        "t": TIMES[:12],
        "position": np.stack([np.cos(TIMES), np.sin(TIMES), TIMES], axis=1)[:12],
        "planet": co.orbits.Planet(1.0),
    },
    "co.orbits.from_tle": {"lines": ELEMENTS, "t_span": (0.0, 600.0)},
    "co.orbits.igrf": {"orbit": ORBIT, "t_span": (0.0, 600.0)},
    "co.orbits.read_oem": {"path": EPHEMERIS},
    "co.orbits.tilted_dipole": {"orbit": ORBIT},
    "co.checkcases.get": {"name": "rod"},
    "co.checkcases.read_table": {"path": SAMPLES},
    "CheckCase.compare": {"samples": SAMPLES},
    "CheckCase.reference": {"t": [0.0, 1.0]},
    "CheckCase.write": {"path": SAMPLES.with_name("other.csv")},
    "a check-case": {"inertia": (1.0, 2.0, 2.5), "rates": X, "end": 2.0, "samples": 5},
    "a tensor of a check-case": {"moments": (1.0, 2.0, 2.5), "rotation": X},
    "a top of a check-case": {"axial": 1.0, "weight": 1.0, "distance": 0.1, "tilt": 0.5},
    "a libration of a check-case": {"mean_motion": 1e-3, "pitch": 0.5},
    "a rotor of a check-case": {"rotor": 1.0},
    "a torque of a check-case": {"torque": X},
    "co.predicted_drift": {"modified": KEPT, "step": 0.1},
    "co.systems.get": {"name": "rigid_body"},
    **{f"what {name} returns": {"value": ZERO} for name in ("J", "a stream")},
    "a flow": {"value": 1.0},
    "a bracket": {"value": 1.0},
    "an observable": {"value": P},
}
# Pictures and movies take seconds; base classes are made by subclasses; the others are results of the library, which
# does not check them again, or lower calls whose states have been checked. OVF needs a run of spins.
LEFT_OUT = re.compile(
    r"\.(plot|movie)\(|co\.plotting\.|co\.torch|co\.jax|workers|co\.methods\.(Coeff|Oper|Sweep|Work|begin|iterate|regis|"
    r"compile|gauss|.*Method\()|co\.forces\.(Force\(|get)|co\.(analysis|checkcases)\.[A-Z]|co\.spectra\.(Auto|Linear|Struct)|co\.orbits\.(Epoch|OrbitStates)|describe_to|"
    r"Force\.(flow|check|field)|hamiltonian_field|co\.System\(|"
    r"MatrixAlgebra\.(br|pair|pro)|MatrixSystem\.(from|to)|co\.systems\.([A-Z]|ready_made)|Stepper\.(both|tangent_by)|"
    r"co\.analysis\.(growth|line_drift|period|slope)\(|ModifiedField\.values|with_forces|direct_sum|\.spectrum\(\)|"
    r"co\.results\.(mark|dataset|rebuild|solution)|Method\.(step|tangent|flow_table|work)|Solution\.(check|to_ovf)|"
    r"Splitting\.(sweeps|processor)|co\.equilibrium|Crystal\.subcrystal|"
    r"co\.(Certificate|Choice|Corrector|Equi|Freq|Integr.*Error|Lyap|Modified(F|H)|PhaseD|PreparedR|Rec|Sect|Sol|Therm)"
)


def resolved(name):
    """Return the object of a line of the list of public names, such as ``co.Event`` or ``Solution.at``."""
    first, _, rest = name.partition(".")
    owner = co if first == "co" else OBJECTS.get(first)
    return functools.reduce(getattr, rest.split("."), owner) if owner is not None else None


def entries():
    """Return functions with valid arguments by name."""
    lines = NAMES.read_text(encoding="utf-8").splitlines()
    found = {line.partition("(")[0]: line for line in lines if "(" in line and not LEFT_OUT.search(line)}
    known = {name: resolved(name) for name in found if "'" not in name} | FURTHER
    return {
        name: (value, arguments_of(value) | domains_of(name) | OWN.get(name, {}))
        for name, value in known.items()
        if callable(value)
    }


def domains_of(name):
    """Return the usual arguments of a constructor."""
    case = CASES.get(re.sub(r"^co\.(algebras\.|systems\.|forces\.|methods\.)?", "", name))
    return case.arguments() if case else {}


def arguments_of(function):
    """Return the parameters of a function by name, with a valid value if one is known."""
    known = inspect.signature(function).parameters.values()
    named = [one for one in known if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)]
    empty = inspect.Parameter.empty
    return {
        one.name: VALID.get(one.name) if one.default is empty else one.default
        for one in named
        if one.name != "archive" and one.name != "client"
    }


def call(function, arguments):
    """Call a function, with arguments by name where it takes them so."""
    known = inspect.signature(function).parameters.values()
    positional = [one.name for one in known if one.kind is one.POSITIONAL_ONLY and one.name in arguments]
    named = {name: value for name, value in arguments.items() if name not in positional}
    return function(*[arguments[name] for name in positional], **named)


def returning(value):
    return lambda *_: value


class Arrays:
    """An object that claims to be an array, but fails."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("no array")


NUMBERS = (0.0, 1.0, -1.0, 0.1, 1e308, 1e-308, 5e-324, np.nan, np.inf, 1e16, 1e150)
SHAPES = ((3,), (6,), (1, 3), (2, 3), (3, 3), (0,), (3, 0), ())
CONSTRUCTED = (
    lambda chosen: np.full(chosen.choice(SHAPES), chosen.choice(NUMBERS)),
    lambda chosen: np.arange(3, dtype=chosen.choice(("f4", "i1", "u8", "c16", "f2", "O", "m8[s]"))),
    lambda chosen: scipy.sparse.csr_array(np.diag([1.0, 2.0, chosen.choice(NUMBERS)])),
    lambda chosen: chosen.choice([*OBJECTS.values(), *VALID.values(), co.LieAlgebra, co, Arrays(), ..., object()]),
    lambda chosen: returning(drawn_value(chosen)),
    lambda chosen: chosen.choice((lambda: 1.0, lambda x: x, lambda x, t: x, abs, len, print, int, np.sin, iter)),
    lambda chosen: (value for value in (1.0, 2.0, 3.0)),
    lambda chosen: range(chosen.choice((0, 3, 10**9))),
    lambda chosen: tuple(drawn_value(chosen) for _ in range(chosen.choice((0, 1, 2, 3, 3, 6)))),
    lambda chosen: chosen.choice(
        (fractions.Fraction(1, 3), decimal.Decimal("0.1"), decimal.Decimal("NaN"), {1.0, 2.0})
    ),
    lambda chosen: {chosen.choice((0, 1, 9, -1, "a", "e1", (0, 1), (0, 0, 2), None)): drawn_value(chosen)},
    lambda chosen: [1.0, 0.5, 0.25] * chosen.choice((1, 2, 3)),
    lambda chosen: chosen.choice(("energy", "coadjoint", "auto", "|x|^2", "x1", "exact", "structure", "numerical")),
)


def drawn_value(chosen):
    kind = chosen.random()
    if kind < 0.35:
        return wild(chosen)
    return chosen.choice(list(HOSTILE.values())) if kind < 0.6 else chosen.choice(CONSTRUCTED)(chosen)


def drawn(seed):
    """Return name, function and arguments of the call of a seed."""
    chosen = random.Random(f"call {seed}")
    name, (function, known) = chosen.choice(list(ENTRIES.items()))
    wrong = chosen.choice(list(known)) if known else None
    arguments = {}
    for key, value in known.items():
        kind, default = chosen.random(), inspect.signature(function).parameters[key].default
        if key == wrong or kind < 0.12:
            arguments[key] = drawn_value(chosen)
        elif default is inspect.Parameter.empty or kind < 0.6:
            arguments[key] = value
    if chosen.random() < 0.02:
        arguments[chosen.choice(("x", "unknown", "self", ""))] = drawn_value(chosen)
    return name, function, arguments


ENTRIES = entries()
# Long runs and Casimirs of high degree may take long; they can be interrupted.
MAY_TAKE_LONG = {"max_degree", "t_span", "steps", "step", "t", "t_end"}


def tried(seed):
    """Return descriptions of what is wrong with the outcome of a call."""
    folder = pathlib.Path(FOLDER.name, "outside", "work")
    if not folder.exists():
        make(folder.parent)
    os.chdir(folder)
    name, function, arguments = drawn(seed)
    error = None
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        try:
            result = call(function, arguments)
            if type(result).__module__.partition(".")[0] == "coadjoint":
                repr(result)
        except Exception as raised:
            error = raised
        except TooLong:
            if not MAY_TAKE_LONG & {*arguments}:
                raise
            return []
    sentences = [found for found in (error and wrong_error(error, name), wrong_warning(noticed)) if found]
    if error is None and isinstance(result, co.Solution) and not np.isfinite(result.x).all():
        sentences.append("a solution with numbers that are not finite")
    shown = ", ".join(f"{key} of {type(value).__name__}" for key, value in arguments.items())
    return [f"{name}({shown}): {sentence}" for sentence in sentences]
