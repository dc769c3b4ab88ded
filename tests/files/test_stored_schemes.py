"""Records and configuration files preserve every parameter of schemes, runs and quadratic Hamiltonians."""

import json
from dataclasses import fields
from inspect import Parameter, signature

import numpy as np
import pytest
from record_values import ALSO_REQUIRED, PLAIN, SL2, X, hamiltonian_properties, parameters, variants

import coadjoint as co
from coadjoint.files.configuration.loading import load
from coadjoint.files.configuration.models import File, HamiltonianTable, RunTable
from coadjoint.files.datasets.export import rebuild, solution_inputs
from coadjoint.methods import registry
from coadjoint.runs.results.run_record import COPIED_FIELDS
from coadjoint.systems.hamiltonians.quadratic import Quadratic

BODY = co.systems.rigid_body((1.0, 2.0, 2.5))


def as_toml(value):
    """Format a value as TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {as_toml(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return json.dumps(value)


def load_tables(tmp_path, **tables):
    path = tmp_path / "run.toml"
    path.write_text("".join(f"{key} = {as_toml(value)}\n" for key, value in tables.items()))
    return load(path)


def assert_same_run(sol, again):
    for part in COPIED_FIELDS:
        if part in sol.record and part not in (
            "system",
            "stats",
            "observed",
            "casimirs",
            "initial",
            "choice",
            "starts",
            "events",
        ):
            actual, other = getattr(sol.record, part), getattr(again.record, part)
            assert np.array_equal(actual, other) and type(actual) is type(other), part
    assert sol.stats.steps == again.stats.steps and sol.stats.evaluations == again.stats.evaluations


def required_of(name):
    """Return arguments for the required parameters of a scheme, from its first example."""
    example = registry.description_of(registry.scheme(name).examples()[0])["parameters"]
    return {key: example[key] for key, default in registry.parameters_of(name).items() if default is Parameter.empty}


def fields_of(method):
    return {field.name: getattr(method, field.name) for field in fields(method)}


@pytest.mark.thinned(12)
@pytest.mark.parametrize(("name", "parameter"), [(n, p) for n in registry.names() for p in registry.parameters_of(n)])
def test_scheme_parameters_are_stored(name, parameter, tmp_path):
    def make(**arguments):
        return registry.get(name, **arguments)

    arguments = required_of(name) | ALSO_REQUIRED.get((name, parameter), {})
    found = variants(make, arguments, parameter, lambda a, b: fields_of(a) == fields_of(b), PLAIN, most=6)
    for method in found:
        description = json.loads(json.dumps(registry.description_of(method)))
        again = registry.from_description(description)
        assert fields_of(again) == fields_of(method) and type(again) is type(method)
        assert list(map(type, fields_of(again).values())) == list(map(type, fields_of(method).values()))
        assert again.order == method.order and again.symmetric == method.symmetric
        written = {key: value for key, value in description["parameters"].items() if value is not None}
        table = {"name": name, "parameters": {key: without_none(value) for key, value in written.items()}}
        tables = {"system": {"name": "rigid_body", "parameters": {"inertia": [1.0, 2.0, 2.5]}}, "initial": {"x": X}}
        try:
            sol = co.integrate(BODY, X, (0.0, 0.5), 0.125, method)
        except ValueError:
            continue  # parts of another system
        assert_same_run(sol, rebuild(sol.to_xarray()))
        configured = load_tables(tmp_path, **tables, method=table, run={"t_span": [0.0, 0.5], "step": 0.125})
        assert fields_of(configured.method) == fields_of(method)
        assert_same_run(sol, configured.integrate())


def without_none(value):
    if isinstance(value, dict):
        return {key: without_none(entry) for key, entry in value.items() if entry is not None}
    return value


@pytest.mark.long
def test_tuned_schemes_are_stored():
    system = co.LiePoissonSystem(co.algebras.so(4), Quadratic(np.linspace(1.0, 2.0, 6)))
    x = np.linspace(0.5, 1.0, 6)
    method = co.Splitting.tuned(system, x, order=4)
    assert registry.from_description(json.loads(json.dumps(registry.description_of(method)))) == method
    sol = co.integrate(system, x, (0.0, 0.5), 0.125, method)
    assert_same_run(sol, rebuild(sol.to_xarray()))
    inner = co.Composition(co.Splitting.tuned(BODY, X), (0.25, 0.5, 0.25))
    assert registry.from_description(json.loads(json.dumps(registry.description_of(inner)))) == inner


RUNS = {
    "x0": [[0.5, 0.25, -1.0], [[0.5, 0.25, -1.0], [0.1, 0.2, 0.3]]],
    "t_span": [(1.0, -0.5), (0.25, 0.25)],
    "step": [0.0625],
    "method": [co.GaussLegendre(3)],
    "save_every": [3, 100],
    "attitude": [True, "coadjoint", [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]],
    "watch": [False],
    "accuracy": [1e-6],
    "t_eval": [[0.125, 0.3, 1.4]],
    "events": [co.Event(1), [co.Event(0, direction=-1, terminal=True)]],
}
# Parameters that change no number of a solution; functions in `observe` are not stored.
WITHOUT_EFFECT = {"system", "observe", "threads", "progress", "archive", "rtol", "atol"}


def test_every_run_parameter_is_tested():
    assert set(parameters(co.integrate)) == set(RUNS) | WITHOUT_EFFECT
    assert set(solution_inputs(co.integrate(BODY, X, (0.0, 0.5), 0.125).to_xarray())) == {"system", *RUNS} - {
        "accuracy"
    }


@pytest.mark.parametrize("parameter", RUNS)
def test_run_parameters_are_stored(parameter, tmp_path):
    usual = {"x0": X, "t_span": (0.0, 1.5), "step": 0.125, "method": co.Splitting(4)}
    for value in RUNS[parameter]:
        arguments = {**usual, parameter: value}
        if parameter == "accuracy":
            del arguments["step"], arguments["method"]
        sol = co.integrate(BODY, **arguments)
        assert_same_run(sol, rebuild(sol.to_xarray()))
        if parameter in ("method", "accuracy", "events"):
            continue
        initial = {"x": arguments["x0"], "attitude": arguments.get("attitude", False)}
        run = {key: arguments[key] for key in RunTable.model_fields if key in arguments}
        assert parameter in run or parameter in ("x0", "attitude")
        configured = load_tables(
            tmp_path,
            system={"name": "rigid_body", "parameters": {"inertia": [1.0, 2.0, 2.5]}},
            method={"name": "Splitting", "order": 4},
            initial=initial,
            run=run,
        )
        assert_same_run(sol, configured.integrate())


@pytest.mark.parametrize("parameter", parameters(Quadratic))
def test_quadratic_parameters_in_a_file(parameter, tmp_path):
    assert set(signature(Quadratic).parameters) <= set(HamiltonianTable.model_fields)
    values = {
        "M": [2.0, [1.0, 2.0, 4.0], [[2.0, 0.3, 0.1], [0.3, 1.5, -0.2], [0.1, -0.2, 1.0]]],
        "linear": [[0.1, -0.2, 0.3]],
        "constant": [0.75, -2],
    }
    for value in values[parameter]:
        table = {"M": [1.0, 1.5, 2.0], parameter: value}
        configured = load_tables(
            tmp_path,
            name="own",
            sign=-1,
            algebra={"dim": 3, "brackets": ["[e1, e2] = 2 e2", "[e1, e3] = -2 e3", "[e2, e3] = e1"]},
            hamiltonian=table,
            casimirs={"C": "1/4*x1^2 + x2*x3"},
            initial={"x": X},
            run={"t_span": [0.0, 0.5], "step": 0.125},
        )
        system, H = configured.system, Quadratic(**table)
        assert (system.name, system.sign, system.algebra, list(system.casimirs)) == ("own", -1, SL2, ["C"])
        assert hamiltonian_properties(system.hamiltonian) == hamiltonian_properties(H.bind(3))
        sol = co.integrate(co.LiePoissonSystem(SL2, H, -1, system.casimirs, name="own"), X, (0.0, 0.5), 0.125)
        again = configured.integrate()
        assert_same_run(sol, again)
        assert_same_run(sol, rebuild(configured.dataset(again)))
        assert sol.energy[0] == H.value(X)


def test_file_tables_name_library_parameters():
    assert set(RunTable.model_fields) <= set(parameters(co.integrate)) | {"workers"}
    assert "workers" in parameters(co.ensemble)
    assert {"name", "sign", "casimirs"} <= set(File.model_fields) & set(parameters(co.LiePoissonSystem))
