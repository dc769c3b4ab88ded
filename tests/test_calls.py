"""Calls of public functions with wrong arguments, each answered with the name of the function and what to give."""

import copy
import dataclasses
import datetime
import inspect
import pickle
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import coadjoint as co
import coadjoint.results
from hostile_values import HOSTILE
from test_hostile_input import NOT_CALLED

SPACES = {
    "co": co,
    "algebras": co.algebras,
    "analysis": co.analysis,
    "forces": co.forces,
    "methods": co.methods,
    "plotting": co.plotting,
    "results": co.results,
    "spectra": co.spectra,
    "systems": co.systems,
}
BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1)
RUN, READY = co.integrate(BODY, X, (0, 1), 0.1, attitude=True), co.prepare(BODY, co.Splitting(), 0.1)
ABSTRACT = {"Force", "Method", "StepMethod", "FlowMethod", "RungeKuttaMethod", "CompiledStepMethod"}


def public_calls():
    """Return the public functions, the constructors and class methods of public classes, and the methods of runs."""
    found = {}
    for space, module in SPACES.items():
        for name in dir(module):
            value = getattr(module, name)
            if name.startswith("_") or not callable(value) or name in NOT_CALLED | ABSTRACT:
                continue
            if isinstance(value, type):
                if issubclass(value, Exception | tuple) or value.__name__ in NOT_CALLED:
                    continue  # errors, and results of functions
                for key in dir(value):
                    own = inspect.getattr_static(value, key)
                    if isinstance(own, classmethod) and not key.startswith("_"):
                        found[f"{space}.{name}.{key}"] = getattr(value, key)
            found[f"{space}.{name}"] = value
    documented = (Path(__file__).parents[1] / "docs" / "api.md").read_text()
    for label, owner in (("Solution", RUN), ("PreparedRun", READY)):
        for name in re.findall(rf"^\| `{label}\.(\w+)` \|", documented, re.M):
            if callable(getattr(owner, name)):
                found[f"{label}.{name}"] = getattr(owner, name)
    return found


CALLS = public_calls()


def refused(function, /, *arguments, **keywords):
    with pytest.raises(TypeError) as caught:
        function(*arguments, **keywords)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 700
    assert not re.search(r"unexpected keyword|positional argument|multiple values|required argument|\(\) ", message)
    return message


def test_registry_holds_the_main_names():
    assert {"co.integrate", "co.fit", "co.Splitting", "forces.LinearDamping", "systems.toda"} <= set(CALLS)
    assert {"co.LieAlgebra", "co.LieAlgebra.from_brackets", "Solution.at", "PreparedRun.run"} <= set(CALLS)
    assert len(CALLS) > 140


@pytest.mark.parametrize("name", CALLS)
def test_wrong_arguments_are_explained(name):
    function = CALLS[name]
    parameters = inspect.signature(function).parameters
    kinds = {key: parameter.kind for key, parameter in parameters.items()}
    short_name = (function.__name__ if not name.startswith(("Solution", "Prepared")) else name).rpartition(".")[2]
    by_position = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    positional = [key for key, kind in kinds.items() if kind in by_position]
    if inspect.Parameter.VAR_KEYWORD not in kinds.values():
        assert f"{short_name} has no no_such_name; " in refused(function, no_such_name=1)
    if inspect.Parameter.VAR_POSITIONAL not in kinds.values():
        message = refused(function, *[None] * (len(positional) + 1))
        assert f"{short_name} was given {len(positional) + 1} arguments, and takes " in message
    if positional and kinds[positional[0]] is inspect.Parameter.POSITIONAL_OR_KEYWORD:
        message = refused(function, None, **{positional[0]: None})
        assert f"{short_name} was given {positional[0]} twice, by position and by name; " in message
    required = [
        key
        for key, parameter in parameters.items()
        if parameter.default is inspect.Parameter.empty
        and parameter.kind in (*by_position, inspect.Parameter.KEYWORD_ONLY)
    ]
    if required:
        assert f"{short_name} needs {', '.join(required)}; its arguments are " in refused(function)


def test_classes_of_users_are_explained_too():
    @dataclasses.dataclass(frozen=True)
    class Spin(co.forces.Torque):
        rate: float = 1.0

    class Bath(co.forces.LinearDamping):
        def __init__(self, strength, *, seed):
            super().__init__(strength)

    @dataclasses.dataclass(frozen=True)
    class Halved(co.methods.StepMethod):
        share: float
        order, symmetric, explicit = 1, False, True

        def step(self, system, x, t, h):
            return x

        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    assert refused(Spin, rat=2.0) == "Spin has no rat; did you mean rate=?"
    assert refused(Bath, 0.1) == "Bath needs seed; its arguments are strength, seed"
    assert refused(Halved) == "Halved needs share; its arguments are share"
    assert refused(Halved, 1, 2).startswith("Halved was given 2 arguments, and takes share; ")
    for made in (Halved(0.5), Bath(0.1, seed=3), Spin((0.0, 0.0, 1.0))):
        assert copy.deepcopy(made) == made
    for made in (co.forces.LinearDamping(0.1), co.Composition(co.Kahan(), (0.5, 0.5))):
        assert pickle.loads(pickle.dumps(made)) == made
    assert list(inspect.signature(Halved).parameters) == ["share"]
    assert list(inspect.signature(co.GaussLegendre).parameters) == ["stages"]


def test_errors_of_the_functions_themselves_pass_through():
    """A TypeError that a call raises with right arguments is not replaced."""

    def failing(x):
        raise TypeError("a message of the user")

    with pytest.raises(TypeError, match=r"^a message of the user$"):
        co.integrate(BODY, X, (0, 1), 0.1, events=co.Event(failing))

    @dataclasses.dataclass(frozen=True)
    class Refusing(co.forces.LinearDamping):
        def __post_init__(self):
            raise TypeError("a message of the force")

    with pytest.raises(TypeError, match=r"^a message of the force$"):
        Refusing(0.1)
    with pytest.raises(TypeError, match="abstract"):
        co.methods.Method()


DURATIONS = {
    "timedelta": (datetime.timedelta(seconds=2), r"datetime\.timedelta.*such as its total_seconds\(\)$"),
    "timedelta64": (np.timedelta64(2, "s"), r"np\.timedelta64\(2,'s'\); .* divided by np\.timedelta64\(1, 's'\)$"),
    "datetime": (datetime.datetime(2026, 1, 2), "such as the seconds since the start$"),
    "datetime64": (np.datetime64("2026-01-02"), "such as the seconds since the start$"),
    "quantity": (HOSTILE["a quantity"], "is 0.5 second; .*such as its magnitude in these$"),
    "quantity of NumPy": (HOSTILE["a number with a unit"], "such as its magnitude in these$"),
    "Timedelta": (pd.Timedelta("2s"), "such as its total_seconds"),
}


@pytest.mark.parametrize("name", DURATIONS)
def test_durations_and_quantities_are_numbers_in_the_units_of_the_system(name):
    value, message = DURATIONS[name]
    calls = {
        "step is": lambda: co.integrate(BODY, X, (0, 1), value),
        "the end of t_span is": lambda: co.integrate(BODY, X, (0, value), 0.1),
        "t_eval is": lambda: READY.run(X, (0, 1), t_eval=[value, value]),
        "t is": lambda: RUN.at(value),
        "h is": lambda: co.stepper(BODY, co.Splitting(), value),
        "x0 is": lambda: co.integrate(BODY, [1.0, value, 0.2], (0, 1), 0.1),
        "transient is": lambda: co.lyapunov(BODY, X, (0, 10), 0.1, transient=value),
        "inertia": lambda: co.systems.rigid_body((1, 2, value)),
    }
    for beginning, call in calls.items():
        with pytest.raises(TypeError, match=f"^{beginning}.* must be (a number|numbers) in the units of the system, "):
            call()
    with pytest.raises(TypeError, match=message):
        calls["step is"]()
    # Numbers made of them are accepted.
    assert co.integrate(BODY, X, (0, 1), datetime.timedelta(seconds=0.5).total_seconds()).stats.steps == 2
    assert co.integrate(BODY, X, (0, 1), np.timedelta64(500, "ms") / np.timedelta64(1, "s")).stats.steps == 2
