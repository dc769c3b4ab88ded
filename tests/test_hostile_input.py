"""Hostile values for every parameter of every public function: a result, or a refusal in one line."""

import contextlib
import dataclasses
import inspect
import linecache
import signal
import tempfile
import traceback
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis import fits, phase, rotations
from coadjoint.methods import registry
from coadjoint.pictures.level_surface import level_surface
from coadjoint.systems.matrices.streams import Weights
from domains.of_algebras import ALGEBRAS
from domains.of_parts import FORCES, HAMILTONIANS, OWN_SYSTEMS
from domains.of_schemes import EVENTS, SCHEMES
from domains.of_systems import SYSTEMS
from hostile_values import HOSTILE
from long import long_where

SOURCE = str(Path(co.__file__).parent)
MAX_MESSAGE = 1000  # characters of a message
TIME_LIMIT = 30  # seconds of the processor until a call counts as endless

SO3, SO4 = co.algebras.so(3), co.algebras.so(4)
BODY = co.systems.rigid_body()
X = (0.1, 1.0, 0.2)
P = co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1})
ENSEMBLE = co.integrate(BODY, [X, X], (0, 1), 0.5, attitude="coadjoint")
STEP = co.stepper(BODY, co.Splitting(), 0.1)
READY = co.prepare(BODY, co.Splitting(), 0.1)
PROMISED = co.prepare(BODY, accuracy=1e-4, x0=X, t_span=(0, 1))


def square(x):
    return float(x[0] ** 2)


def twice(x):
    return np.array([2 * x[0], 0.0, 0.0])


def J(x):
    return np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def euler(x, h):
    return x + h * BODY.vector_field(x)


def doubled(W):
    return 2.0 * W


SO3_MATRICES = co.MatrixAlgebra("so", 3)
TURNING = co.MatrixSystem(SO3_MATRICES, doubled)
H = co.Hamiltonian(square, twice)
KEPT = co.modified_hamiltonian(BODY, co.Splitting())
WITH_SYMBOLS = co.modified_hamiltonian(BODY, co.Splitting(parts="coordinates"), symbols=True)
WAVY = co.LiePoissonSystem(SO3, co.Separable({0: (np.sin, np.cos), 1: (np.cos, lambda y: -np.sin(y))}))
AT_POINTS = co.modified_hamiltonian(WAVY, co.Splitting())
FIELD = co.modified_field(BODY, co.GaussLegendre(1), 3)
SAMPLED = co.modified_field(BODY, co.GaussLegendre(1), 3, way="numerical")
BETTER = co.corrector(BODY, co.Splitting(), X)
TIMES = np.arange(128) * 0.1
LINES = co.frequencies(TIMES, np.cos(TIMES), 1)
LONG = co.integrate(BODY, X, (0, 20), 0.1)
SPINS = co.systems.spin_lattice()
WAVES = co.integrate(co.systems.spin_lattice("ring", 4), np.tile([0.6, 0.0, 0.8, 0.0, 0.6, 0.8], 2), (0, 1), 0.1)
ALONG = co.integrate(BODY, X, (0, 20), 0.5, attitude=True)


def beside(name):
    return ARCHIVE.parent / name if isinstance(name, str) else name


ARCHIVE = Path(tempfile.mkdtemp()) / "run.zarr"
co.integrate(BODY, X, (0, 1), 0.1, archive=ARCHIVE)
EYE = np.eye(3)
FORCED = BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque(lambda t: np.array([0.0, 0.0, t])))

# Functions with valid arguments; each argument is replaced by hostile values.
EXAMPLES = {name: registry.scheme(name).examples()[0] for name in registry.names()}

# Constructors, with the arguments of the tables of domains.
CASES = {**SYSTEMS, **ALGEBRAS, **HAMILTONIANS, **OWN_SYSTEMS, **FORCES, **SCHEMES, **EVENTS}
CASES["spin_lattice"] = dataclasses.replace(SYSTEMS["spin_lattice"], make=co.systems.spin_lattice)
CALLS = {
    **{name: (case, case.arguments()) for name, case in CASES.items()},
    "a bracket": (lambda c: co.LieAlgebra.from_brackets(2, {(0, 1): {1: c}}), {"c": 1.0}),
    "an index of a bracket": (lambda k: co.LieAlgebra(((0, 1, k, 1.0),), dim=2), {"k": 1}),
    "structure_matrix": (SO3.structure_matrix, {"x": X}),
    "structure_operator": (SO3.structure_operator, {"x": X}),
    "bracket": (SO3.bracket, {"u": X, "v": X}),
    "coadjoint": (SO3.coadjoint, {"u": X}),
    "coadjoint_entries": (SO3.coadjoint_entries, {"u": {0: 1.0}}),
    "casimirs": (SO3.casimirs, {"max_degree": 2}),
    "commuting": (SO3.commuting, {"i": 0, "j": 1}),
    "get": (co.algebras.get, {"name": "so(3)"}),
    "get(so(n))": (lambda n: co.algebras.get("so(n)", n=n), {"n": 3}),
    "get(sp(2n))": (lambda n: co.algebras.get("sp(2n)", n=n), {"n": 1}),
    "get(A3,7)": (lambda a: co.algebras.get("A3,7", a=a), {"a": 1.0}),
    "get(A4,9)": (lambda b: co.algebras.get("A4,9", b=b), {"b": 0.5}),
    "low_dimensional": (lambda name: co.algebras.low_dimensional(name, a=1.0), {"name": "A3_7"}),
    "a coefficient": (lambda c: co.Polynomial({(1, 2): c})([1.0, 2.0]), {"c": 1.0}),
    "exponents": (lambda e: co.Polynomial({(1, 1): 1, e: 1}), {"e": (1, 2)}),
    "an exponent": (lambda e: co.Polynomial({(1, e): 1}).gradient([1.0, 2.0]), {"e": 1}),
    "a power": (lambda n: P**n, {"n": 2}),
    "derivative": (P.derivative, {"i": 0}),
    "a value": (P, {"x": X}),
    "Polynomial.gradient": (P.gradient, {"x": X}),
    "hessian": (P.hessian, {"x": X}),
    "Quadratic.gradient": (co.Quadratic(X).gradient, {"x": X}),
    "Quadratic.bind": (co.Quadratic(1.0).bind, {"n": 3}),
    "a coordinate": (lambda i: co.Separable({i: (np.sin, np.cos)}).bind(3), {"i": 0}),
    "a function of a coordinate": (lambda f: co.Separable({0: (f, np.cos)}).bind(3), {"f": np.sin}),
    "a piece": (lambda where, H: co.SplitHamiltonian([(where, H)]).bind(3), {"where": (0,), "H": co.Quadratic(1.0)}),
    "Hamiltonian.bind": (H.bind, {"n": 3}),
    "projected": (SO3_MATRICES.read, {"given": np.zeros((3, 3)), "what": "x0"}),
    "what a stream returns": (lambda value: co.MatrixSystem(SO3_MATRICES, lambda W: value),
                              {"value": np.zeros((3, 3))}),
    "what an energy returns": (lambda value: co.MatrixSystem(SO3_MATRICES, doubled, energy=lambda W: value),
                               {"value": 0.0}),
    "Weights": (Weights, {"weights": np.eye(3)}),
    "matrices": (TURNING.matrices, {"x": np.zeros((3, 3))}),
    "energy of matrices": (TURNING.energy, {"x": np.zeros((3, 3)), "t": 0.0}),
    "vector_field of matrices": (TURNING.vector_field, {"x": np.zeros((3, 3)), "t": 0.0}),
    "stream_of": (TURNING.stream_of, {"W": np.zeros((3, 3)), "t": 0.0}),
    "spectrum": (TURNING.spectrum, {"x": np.zeros((3, 3))}),
    "casimirs_at": (TURNING.casimirs_at, {"x": np.zeros((3, 3))}),
    "a run of matrices": (lambda x0, observe: co.integrate(TURNING, x0, (0, 1), 0.5, observe=observe),
                          {"x0": np.zeros((3, 3)), "observe": None}),
    "what J returns": (lambda value: co.PoissonSystem(lambda x: value, co.Quadratic(X)), {"value": J(X)}),
    "vector_field": (BODY.vector_field, {"x": X, "t": 0.0}),
    "energy": (BODY.energy, {"x": X, "t": 0.0}),
    "jacobian": (BODY.jacobian, {"x": X, "t": 0.0}),
    "exact": (BODY.exact, {"x0": X, "t": 1.0, "attitude": True}),
    "a torque": (lambda value: BODY.with_forces(co.forces.Torque(lambda x: value)), {"value": X}),
    "a flow": (lambda value: BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x + tau * value)), {"value": X}),
    "forces.get": (lambda name: co.forces.get(name, rate=1.0), {"name": "LinearDamping"}),
    "with_forces": (BODY.with_forces, {"forces": co.forces.LinearDamping(0.1)}),
    "vector_field with forces": (FORCED.vector_field, {"x": X, "t": 0.0}),
    "power": (FORCED.power, {"x": X, "t": 0.0}),
    "systems.get": (co.systems.get, {"name": "rigid_body"}),
    "methods.get": (lambda name: registry.get(name), {"name": "Taylor"}),
    "from_description": (registry.from_description, {"description": {"name": "Taylor"}}),
    "description_of": (registry.description_of, {"method": co.Splitting()}),
    "parts": (lambda parts: co.Splitting(parts=parts).describe(BODY), {"parts": ((0,), (1,), (2,))}),
    "describe": (co.Splitting().describe, {"system": BODY}),
    **{f"{name}.properties": (m.properties, {"system": BODY}) for name, m in EXAMPLES.items()},
    "ensemble": (co.ensemble, {"system": BODY, "x0": ENSEMBLE.x0, "t_span": (0, 1), "step": 0.1, "method": None,
                 "save_every": 1, "attitude": False, "watch": True, "observe": None, "client": None,
                 "members_per_block": None, "threads": 1, "progress": False, "coordinates": None}),
    "integrate": (co.integrate, {"system": BODY, "x0": X, "t_span": (0, 1), "step": 0.1, "method": None,
                  "save_every": 1, "attitude": False, "watch": True, "observe": None, "threads": None,
                  "progress": False}),
    "accuracy": (lambda accuracy: co.integrate(BODY, X, (0, 1), accuracy=accuracy), {"accuracy": 1e-3}),
    "a state": (lambda a: co.integrate(BODY, (a, 1.0, 1.0), (0, 1), 0.5, co.GaussLegendre(2)), {"a": 1.0}),
    "events": (lambda events: co.integrate(BODY, X, (0, 1), 0.1, events=events), {"events": None}),
    "section": (co.section, {"system": BODY, "x0s": X, "event": co.Event(0), "t_span": (0, 1), "step": 0.1,
                "method": None, "crossings": None, "threads": None, "progress": False}),
    "an observable": (lambda f: co.integrate(BODY, X, (0, 1), 0.5, observe={"f": f}), {"f": P}),
    "prepare": (co.prepare, {"system": BODY, "method": None, "step": 0.1, "attitude": False, "watch": True,
                "observe": None, "threads": None}),
    "run": (READY.run, {"x0": X, "t_span": (0, 1), "save_every": 1, "attitude": None, "progress": False}),
    "end": (READY.end, {"x0": X, "t_span": (0, 1)}),
    "prepare for an accuracy": (co.prepare, {"accuracy": 1e-4, "x0": X, "t_span": (0, 1), "system": BODY}),
    "run to an accuracy": (PROMISED.run, {"x0": X, "t_span": (0, 1), "save_every": 1}),
    "end to an accuracy": (PROMISED.end, {"x0": X, "t_span": (0, 1)}),
    "times": (lambda t_eval: co.integrate(BODY, X, (0, 1), 0.1, t_eval=t_eval), {"t_eval": [0.25, 0.5]}),
    "any time": (LONG.at, {"t": [0.25, 19.99]}),
    "choose": (lambda system, x0, t_span, accuracy, **more: co.choose(system, x0, t_span, accuracy, **more),
               {"system": BODY, "x0": X, "t_span": (0, 1), "accuracy": 1e-3, "attitude": False,
                "methods": co.GaussLegendre(2), "processed": False}),
    "fit": (co.fit, {"ready": READY, "x0": X, "t_span": (0, 1), "measured": {"x": READY.run(X, (0, 1)).x},
            "unknown": {"x0": True}, "save_every": 1, "sigma": {"x": 0.1}, "attitude": None}),
    "identify": (co.identify, {"algebra": co.algebras.so(3), "t": np.linspace(0, 4, 41),
                 "x": READY.run(X, (0, 4)).x, "degree": 2, "sign": -1, "radius": 8}),
    "an unknown": (lambda k: co.fit(READY, X, (0, 1), {"x": READY.run(X, (0, 1)).x}, {"x0": k}, sigma={"x": 0.1}),
                   {"k": (0, 1)}),
    "lyapunov": (co.lyapunov, {"system": BODY, "x0": X, "t_span": (0, 1), "step": 0.1, "method": None,
                 "exponents": None, "renormalize_every": 10, "transient": 0.0, "save_every": None, "threads": None}),
    "certify": (co.certify, {"system": BODY, "method": co.Splitting(), "x0": X, "step": 0.1, "steps": 10, "order": None,
                "properties": None, "symmetric": None}),
    "certify a function": (lambda order, properties, symmetric: co.certify(BODY, euler, X, 0.1, steps=10,
                           order=order, properties=properties, symmetric=symmetric),
                           {"order": 1, "properties": None, "symmetric": False}),
    "frequencies": (co.frequencies, {"given": TIMES, "signal": np.cos(TIMES), "count": 1, "window": 5}),
    "the signal of a run": (lambda signal: co.frequencies(LONG, signal, 1), {"signal": None}),
    "a sum of lines": (LINES, {"t": TIMES}),
    "combinations": (LINES.combinations, {"basis": None, "largest": 8}),
    "thermal_states": (co.thermal_states, {"system": SPINS, "temperature": 0.5, "members": 2, "seed": 1, "sweeps": 2,
                                           "method": "Metropolis", "over_relaxation": 1, "x0": np.ones(6)}),
    "structure_factor": (co.spectra.structure_factor, {"solution": WAVES, "path": [0.0, 0.5], "window": "hann"}),
    "autocorrelation": (co.spectra.autocorrelation, {"given": TIMES, "signal": np.cos(TIMES), "window": 5.0}),
    "phase_drift": (co.phase_drift, {"solution": ALONG, "reference": None, "of": "momentum"}),
    "predicted_drift": (co.predicted_drift, {"system": BODY, "x0": X, "modified": KEPT, "step": 0.1, "gradient": None,
                        "field": None, "attitude": True}),
    "the drift of a function": (lambda gradient: co.predicted_drift(BODY, X, gradient=gradient),
                                {"gradient": lambda x: KEPT.gradient(x, 0.1)}),
    "modified_hamiltonian": (co.modified_hamiltonian, {"system": BODY, "method": co.Splitting(), "order": 4,
                             "symbols": False}),
    "a modified Hamiltonian": (KEPT, {"x": X, "h": 0.1}),
    "its gradient": (KEPT.gradient, {"x": X, "h": 0.1}),
    "with_values": (WITH_SYMBOLS.with_values, {"values": None}),
    "a value of a symbol": (lambda m1: WITH_SYMBOLS.with_values({"m1": m1}), {"m1": 1.0}),
    "modified energies at points": (AT_POINTS, {"x": X, "h": 0.1}),
    "modified_energy": (ALONG.modified_energy, {"order": 4}),
    "modified_field": (co.modified_field, {"system": BODY, "method": co.GaussLegendre(1), "order": 3, "way": "auto"}),
    "a modified field": (FIELD, {"x": X, "h": 0.1}),
    "skew_matrix": (FIELD.skew_matrix, {"x": X, "h": 0.1}),
    "keeps": (FIELD.keeps, {"invariant": "energy"}),
    "rate": (FIELD.rate, {"invariant": "energy"}),
    "a modified field at points": (SAMPLED, {"x": X, "h": 0.1}),
    "what is kept at points": (SAMPLED.keeps, {"invariant": "energy"}),
    "suggest_step": (co.suggest_step, {"system": BODY, "method": co.Splitting(), "x0": X, "energy": 1e-3}),
    "corrector": (co.corrector, {"system": BODY, "method": co.Splitting(), "x0": X}),
    "a corrector": (BETTER, {"x": X, "h": 0.1}),
    "inverse": (BETTER.inverse, {"x": X, "h": 0.1}),
    "archive": (lambda archive: co.integrate(BODY, X, (0, 1), 0.1, archive=beside(archive)), {"archive": ARCHIVE}),
    "open_archive": (co.open_archive, {"path": ARCHIVE}),
    "load": (co.load, {"path": ARCHIVE, "system": None}),
    "resume": (co.resume, {"path": ARCHIVE}),
    "stepper": (co.stepper, {"system": BODY, "method": co.Splitting(), "h": 0.1}),
    "a step": (STEP, {"x": X, "t": 0.0}),
    "group": (STEP.group, {"x": X, "t": 0.0, "attitude": None}),
    "tangent": (STEP.tangent, {"x": X, "t": 0.0}),
    "fit_order": (fits.fit_order, {"steps": [0.4, 0.2, 0.1], "errors": [0.16, 0.04, 0.01], "floor": 0.0}),
    "phase_error": (phase.phase_error, {"system": BODY, "x0": X, "t": [1.0], "x": [X]}),
    "defect_of_tangent": (co.analysis.defect_of_tangent, {"P": EYE, "before": J(X), "after": J(X), "operations": 1}),
    "poisson_defect": (co.analysis.poisson_defect, {"step": STEP, "x": X, "operations": 1}),
    "attitude_angle": (rotations.attitude_angle, {"A": EYE, "B": EYE}),
    "precession_error": (rotations.precession_error, {"A": EYE, "B": EYE, "axis": X}),
    "random_walk": (co.analysis.random_walk, {"deviations": np.ones((3, 4)), "early": 1}),
    "round_off": (co.analysis.round_off, {"solution": ENSEMBLE, "early": 1}),
    "orthogonality": (co.analysis.orthogonality, {"solution": ENSEMBLE, "size": 3}),
    "spatial_momentum": (co.analysis.spatial_momentum, {"solution": ENSEMBLE}),
    "level_surface": (level_surface, {"function": P, "level": 1.0, "box": [(-1, 1)] * 3, "cells": 4, "period": 0.0}),
}  # fmt: skip

# Created by the library, or called without arguments.
NOT_CALLED = {"Certificate", "Choice", "Corrector", "Frequencies", "IntegrationError", "LargeStepWarning",
              "LongWait", "Equilibrium", "equilibrium", "ThermalStates",
              "LyapunovExponents", "ModifiedField", "ModifiedHamiltonian", "PhaseDrift", "PreparedRun",
              "RecordedEvents", "RoundingWarning", "Section", "Solution"}  # fmt: skip
SLOW = [("predicted_drift", "step"), ("certify", "step"), ("exact", "t"), ("level_surface", "box")]
# A prepared run validates its span as "run" does.
SLOW += [(name, "t_span") for name in ("end", "run to an accuracy", "end to an accuracy")]


def test_every_public_name_is_called():
    called = {getattr(function, "__name__", "") for function, _ in CALLS.values()} | set(CALLS)
    values = {getattr(co, name) for name in dir(co) if name[0] != "_" and callable(getattr(co, name))}
    public = {value.__name__ for value in values} - NOT_CALLED
    # A scheme without parameters is called without arguments.
    assert public <= called | {name for name, m in EXAMPLES.items() if not dataclasses.fields(m)}
    assert set(co.algebras.__all__) - {"names"} <= called
    assert set(co.systems.names()) <= called


def raised_by_library(error):
    """Return whether the last line of an error is a `raise` of the library, or a call in this file."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    if last.filename == __file__:
        return True
    return last.filename.startswith(SOURCE) and "raise" in linecache.getline(last.filename, last.lineno)


@contextlib.contextmanager
def time_limit():
    def give_up(*_):
        raise TimeoutError(f"not done after {TIME_LIMIT} s")

    if not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, TIME_LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@pytest.mark.thinned(152)
@pytest.mark.filterwarnings("ignore:.*no body has:UserWarning")
@pytest.mark.parametrize(
    ("name", "parameter"), long_where(SLOW, [(name, key) for name in CALLS for key in CALLS[name][1]])
)
@pytest.mark.filterwarnings("ignore:.*no body has a principal moment")
def test_hostile_values_give_a_result_or_a_refusal(name, parameter, monkeypatch):
    monkeypatch.setattr("coadjoint.memory.available", lambda: 3 * 10**8)
    function, arguments = CALLS[name]
    if name != "choose" and name not in CASES:
        parameters = inspect.signature(function).parameters
        assert set(arguments) <= set(parameters)
    wrong = []
    for kind, value in HOSTILE.items():
        try:
            with time_limit():
                function(**{**arguments, parameter: value})
        except (ValueError, TypeError, co.IntegrationError) as error:
            message = str(error)
            if len(message) > MAX_MESSAGE or "\n" in message or not raised_by_library(error):
                last = traceback.extract_tb(error.__traceback__)[-1]
                wrong.append(f"{kind}: {type(error).__name__}: {message[:300]} ({last.filename}:{last.lineno})")
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            wrong.append(f"{kind}: {type(error).__name__}: {str(error)[:200]} ({last.filename}:{last.lineno})")
    assert not wrong, f"{name}, {parameter}:\n" + "\n".join(wrong)
