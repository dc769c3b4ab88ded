"""Random calls of public functions, which must give a result or a refusal in one sentence."""

from __future__ import annotations

import decimal
import fractions
import inspect
import os
import pathlib
import random
import tempfile
import warnings

import numpy as np
import scipy.sparse

import coadjoint as co
from coadjoint import algebras, forces, systems
from coadjoint.files.configuration.loading import load
from coadjoint.files.datasets.export import rebuild
from coadjoint.files.output.output_files import check_target
from coadjoint.short_repr import short
from hostile_values import HOSTILE
from test_hostile_input import ALONG, BODY, CALLS, ENSEMBLE, FORCED, LONG, SAMPLED, SO3, STEP, TURNING, P, X

from .folder import make
from .judging import TooLong, wrong_error, wrong_warning
from .wild import wild

TOP = systems.heavy_top()
STATE = np.linspace(-0.4, 0.9, 6)
WITH_EVENTS = co.integrate(BODY, X, (0, 5), 0.125, events=[co.Event("x1"), co.Event(P - 0.5)], observe={"a": P})
FLUID = systems.torus_euler(N=5)
FLOW = co.integrate(FLUID, FLUID.random(1, degrees=(1, 2)), (0, 0.5), 0.125, co.methods.get("IsospectralGauss"))
BATCH = co.batch([BODY, systems.rigid_body((1.0, 2.0, 2.5))])
OBJECTS = {
    "so(3)": SO3,
    "A5,23": algebras.get("A5,23", b=0.5),
    "a polynomial": P,
    "a quadratic": co.Quadratic(X, linear=X).bind(3),
    "a separable": co.Separable({0: (np.sin, np.cos)}).bind(3),
    "a body": BODY,
    "a top": TOP,
    "sklyanin": systems.sklyanin(),
    "a matrix system": TURNING,
    "a matrix algebra": TURNING.algebra,
    "a fluid": FLUID,
    "a forced system": FORCED,
    "a batch": BATCH,
    "a solution": LONG,
    "an ensemble": ENSEMBLE,
    "with attitude": ALONG,
    "with events": WITH_EVENTS,
    "a flow": FLOW,
    "events": WITH_EVENTS.events,
    "a drift": LONG.drift(),
    "a stepper": STEP,
    "a section": co.section(BODY, [X], co.Event(0), (0, 20), 0.125),
    "a choice": co.choose(BODY, X, (0, 1), 1e-3),
    "exponents": co.lyapunov(BODY, X, (0, 5), 0.125),
    "lines": co.frequencies(LONG, None, 1),
    "a phase drift": co.phase_drift(ALONG),
    "a field at points": SAMPLED,
}
VALID = {
    "system": BODY, "algebra": SO3, "method": co.Splitting(), "base": co.GaussLegendre(1), "x": X, "x0": X, "x0s": [X],
    "t": 0.25, "t_span": (0, 1), "step": 0.125, "h": 0.1, "tau": 0.1, "ratio": 1.0, "n": 3, "u": X, "v": X, "w": X,
    "i": 0, "j": 1, "k": 2, "dim": 3, "order": 4, "accuracy": 1e-3, "event": co.Event(0), "polynomial": P, "name": "a",
    "exponents": (1, 0, 0), "value": 1.0, "solution": LONG, "hamiltonian": P, "W": np.zeros((5, 5), complex), "size": 3,
    "x1": X, "g": np.eye(3), "theta": 0.1, "angle": 0.1, "given": X, "parameters": {}, "events": co.Event(0),
    "number": float, "substep": 0.1, "function": P, "count": 2, "degree": 2, "seed": 1, "functions": [P],
    "functional": P, "field": np.zeros((5, 5)), "grid": np.zeros((5, 5)), "force": forces.LinearDamping(0.1),
    "forces": forces.LinearDamping(0.1), "systems": [BODY, BODY], "path": "run.nc", "places": [[1.0, 1.0]],
    "strengths": 1.0, "widths": 0.5, "radii": 0.5, "vorticities": 1.0, "invariant": "energy", "other": P,
}  # fmt: skip
# Long runs and Casimirs of high degree may take long; they can be interrupted.
MAY_TAKE_LONG = {"casimirs", "max_degree", "t_span", "steps", "step", "t"}
LEFT_OUT = {"movie", "plot"}  # these take seconds
# Internal functions that are called with validated states, and do not validate again.
INTERNAL = {"absolute", "among", "both", "bracket", "chosen", "disc_profile", "dual", "ends", "from_coordinates",
         "from_vector", "is_in_numbers", "mode_array", "numbered_from",
         "pairing", "point_modes", "projected", "random_modes",
         "read", "read_places", "relative", "side_by_side", "slope_of", "spectrum_of_modes", "states",
         "tangent_by", "terms", "times", "to_vector"}  # fmt: skip


def _of_objects():
    """Yield the callables of each object with their parameters."""
    for label, thing in OBJECTS.items():
        kind = type(thing)
        for name in sorted(dir(kind)):
            member = inspect.getattr_static(kind, name)
            inner = name in INTERNAL and label not in ("so(3)", "A5,23")
            if name.startswith("_") or name in LEFT_OUT or inner or not callable(getattr(member, "__func__", member)):
                continue
            if isinstance(member, property | type) or hasattr(dict, name):  # a drift is a dict
                continue
            yield f"{name} of {label}", getattr(thing, name), _parameters(getattr(thing, name))
        if callable(thing):
            yield f"{label} itself", thing, _parameters(thing)


def _parameters(function):
    """Return the parameters of a function by name, with a valid value if one is known."""
    known = inspect.signature(function).parameters.values()
    named = [each for each in known if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
    empty = inspect.Parameter.empty
    return {each.name: VALID.get(each.name, None if each.default is empty else each.default) for each in named}


def _all():
    yield from ((name, function, parameters) for name, (function, parameters) in CALLS.items())
    yield from _of_objects()
    for name in algebras.__all__:
        yield f"algebras.{name}", getattr(algebras, name), _parameters(getattr(algebras, name))
    for name in forces.__all__:
        if callable(getattr(forces, name)) and name != "Force":
            yield f"forces.{name}", getattr(forces, name), _parameters(getattr(forces, name))
    yield "load", load, {"path": "run.toml"}
    yield "rebuild", rebuild, {"dataset": LONG.to_xarray()}
    yield "check_target", check_target, {"path": "run.nc"}


ENTRIES = list(_all())


def returning(value):
    """Return a constant function."""

    def returned(*_):
        return value

    return returned


class Arrays:
    """An object that claims to be an array, but fails."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("no array")


def _itself():
    found = [1.0]
    found.append(found)
    return found


CONSTRUCTED = (
    lambda chosen: np.full(chosen.choice(((3,), (6,), (1, 3), (2, 3), (3, 3), (0,), (3, 0), ())), _number(chosen)),
    lambda chosen: np.arange(3, dtype=chosen.choice(("f4", "i1", "u8", "c16", "f2", "O", "m8[s]"))),
    lambda chosen: np.float64(_number(chosen)),
    lambda chosen: np.zeros((3, 3)).T[::2],
    lambda chosen: scipy.sparse.csr_array(np.diag([1.0, 2.0, _number(chosen)])),
    lambda chosen: chosen.choice(list(OBJECTS.values())),
    lambda chosen: chosen.choice((co.Event(0), co.Event("x1"), co.LieAlgebra, co.Splitting, co, systems, pathlib, P)),
    lambda chosen: returning(_any(chosen)),
    lambda chosen: returning(X),
    lambda chosen: chosen.choice((lambda: 1.0, lambda x: x, lambda x, t: x, abs, len, print, int, np.sin, iter)),
    lambda chosen: (value for value in (1.0, 2.0, 3.0)),
    lambda chosen: range(chosen.choice((0, 3, 10**9))),
    lambda chosen: tuple(_any(chosen) for _ in range(chosen.choice((0, 1, 2, 3, 3, 6)))),
    lambda chosen: chosen.choice((fractions.Fraction(1, 3), decimal.Decimal("0.1"), decimal.Decimal("NaN"), 1 + 0j)),
    lambda chosen: {chosen.choice((0, 1, 2, 9, -1, "a", "e1", (0, 1), (0, 0, 2), None)): _any(chosen)},
    lambda chosen: chosen.choice((Arrays(), _itself(), object(), ..., slice(None), pathlib.Path("run"))),
    lambda chosen: chosen.choice((memoryview(b"123"), bytearray(b"1"), {1.0, 2.0}, frozenset({1}), Exception)),
    lambda chosen: [1.0, 0.5, 0.25] * chosen.choice((1, 2, 3)),
    lambda chosen: chosen.choice(("energy", "coadjoint", "auto", "|x|^2", "x1", "exact", "structure", "numerical")),
)  # fmt: skip


def _number(chosen):
    return chosen.choice((0.0, 1.0, -1.0, 0.1, 1e308, 1e-308, 5e-324, np.nan, np.inf, 1e16, 1e150))


def _any(chosen):
    kind = chosen.random()
    if kind < 0.35:
        return wild(chosen)
    if kind < 0.6:
        return chosen.choice(list(HOSTILE.values()))
    return chosen.choice(CONSTRUCTED)(chosen)


def drawn(seed):
    """Return name, function and arguments of the call of a seed."""
    chosen = random.Random(f"call {seed}")
    name, function, known = chosen.choice(ENTRIES)
    optional = {
        key
        for key, arguments in inspect.signature(function).parameters.items()
        if arguments.default is not inspect.Parameter.empty
    }
    arguments = {}
    wrong = chosen.choice(list(known)) if known else None
    for key, value in known.items():
        kind = chosen.random()
        if key == wrong or kind < 0.12:
            arguments[key] = _any(chosen)
        elif key not in optional or kind < 0.6:
            arguments[key] = value
    if chosen.random() < 0.02:
        arguments[chosen.choice(("x", "unknown", "self", ""))] = _any(chosen)
    positional = [key for key, one in inspect.signature(function).parameters.items() if one.kind is one.POSITIONAL_ONLY]
    return name, function, [arguments.pop(key) for key in positional if key in arguments], arguments


_FOLDER = tempfile.TemporaryDirectory()


def tried(seed):
    """Return descriptions of what is wrong with the outcome of a call."""
    folder = pathlib.Path(_FOLDER.name, "outside", "work")
    if not folder.exists():
        make(folder.parent)
    os.chdir(folder)
    name, function, positional, arguments = drawn(seed)
    error = None
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        try:
            result = function(*positional, **arguments)
            if type(result).__module__.partition(".")[0] == "coadjoint":
                repr(result)
        except Exception as raised:
            error = raised
        except TooLong:
            if not MAY_TAKE_LONG & {name, *arguments}:
                raise
            return []
    sentences = [found for found in (error and wrong_error(error, name), wrong_warning(noticed)) if found]
    if error is None and isinstance(result, co.Solution) and not np.isfinite(result.x).all():
        sentences.append("a solution with numbers that are not finite")

    shown = ", ".join(
        [
            *(short(value, 60) for value in positional),
            *(f"{key}={short(value, 60)}" for key, value in arguments.items()),
        ]
    )
    return [f"{name}({shown[:300]}): {sentence}" for sentence in sentences]
