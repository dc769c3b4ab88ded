"""Plausible random configurations: any system with any scheme, of the right dimension."""

from __future__ import annotations

from functools import cache

from coadjoint import systems
from coadjoint.methods import registry
from coadjoint.systems.matrices.matrix_system import MatrixSystem

SMALL = {"sphere_euler": {"N": 5}, "torus_euler": {"N": 5}, "reduced_mhd": {"N": 3}, "passive_scalar": {"N": 3}}
FORCES = (
    {"name": "LinearDamping", "rate": 0.1},
    {"name": "DoubleBracketDamping", "alpha": 0.1},
    {"name": "HeatBath", "alpha": 0.1, "temperature": 0.1, "seed": 3},
    {"name": "Viscosity", "nu": 0.1},
    {"name": "BetaPlane", "beta": 0.1},
    {"name": "Friction", "rate": 0.1},
    {"name": "RandomForcing", "energy_rate": 0.1, "band": [1, 2], "seed": 1},
)
FACTORS = (-1, 0, 0.5, 2, 3, 10, 1e3, 1e-3, 1e8, 1e-8, 1e150, 1e-150, 1e300)


@cache
def system_of(name):
    return systems.get(name, **SMALL.get(name, {}))


@cache
def schemes():
    """Return the descriptions of all serializable examples of schemes."""
    found = []
    for name in registry.names():
        for method in registry.scheme(name).examples():
            try:
                found.append(registry.description_of(method))
            except TypeError:
                continue
    return found


def plausible(chosen):
    """Return a configuration as tables."""
    name = chosen.choice(systems.names())
    system = system_of(name)
    described = chosen.choice(schemes())
    table = {
        "system": {"name": name, "parameters": dict(SMALL.get(name, {}))},
        "initial": {"x": _states(chosen, system)},
        "method": {"name": described["name"], "parameters": without_none(described["parameters"])},
        "run": {"t_span": chosen.choice(([0, 1], [1.0, -1.0], [0, 0.0625])), "step": 0.0625},
    }
    if isinstance(system, MatrixSystem) and "random" in getattr(system, "states_by_name", ()):
        table["initial"] = {"kind": "random", "seed": 1, "degrees": [1, 2]}
    if isinstance(system, MatrixSystem):
        table["method"] = {"name": chosen.choice(("IsospectralGauss", "ExplicitRungeKutta", "LineSplitting"))}
    further = {
        "save_every": lambda: table["run"].update(save_every=chosen.choice((1, 3, 100))),
        "t_eval": lambda: table["run"].update(t_eval=chosen.choice(([0.03, 0.25], [0.25, 0.03]))),
        "watch": lambda: table["run"].update(watch=False),
        "threads": lambda: table["run"].update(threads=chosen.choice((1, 2, 100))),
        "attitude": lambda: table["initial"].update(attitude=chosen.choice((True, "coadjoint", [[1, 0], [0, 1]]))),
        "forces": lambda: table.update(forces=[dict(chosen.choice(FORCES)) for _ in range(chosen.choice((1, 1, 2)))]),
        "observe": lambda: table.update(observe={"a": "x1^2", "b": "x2 - 1"}),
        "events": lambda: table.update(events={"a": {"g": chosen.choice((0, "x1", "x1*x2 - 0.1")), "count": 3}}),
        "output": lambda: table.update(
            output={chosen.choice(("file", "archive")): chosen.choice(("run.nc", "run.zarr"))}
        ),
        "figure": lambda: table.update(output={"figure": "run.png"}),
        "sweep": lambda: table.update(sweep=_sweep(chosen, table)),
    }
    likely = (*list(further)[:-3], *list(further)[:-3], *list(further)[-3:])
    for key in {chosen.choice(likely) for _ in range(chosen.choice((0, 1, 2, 3)))}:
        if key != "figure" or chosen.random() < 0.1:  # figures take a second
            further[key]()
    return table


def without_none(value):
    """Return a description without None, which TOML does not have."""
    if isinstance(value, dict):
        return {key: without_none(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [without_none(entry) for entry in value if entry is not None]
    return value


def _states(chosen, system):
    shape = getattr(system, "shape", None) or (system.dim,)
    if isinstance(system, MatrixSystem):
        return [[0.0 if i == j else (i - j) / 10 for j in range(shape[-1])] for i in range(shape[-2])]
    one = [round(chosen.uniform(-1, 1), 3) for _ in range(system.dim)]
    return [one, one[::-1]] if chosen.random() < 0.3 else one


def _sweep(chosen, table):
    place = chosen.choice(("initial.x[0]", "initial.x", "initial.x[0][0]", "system.parameters.N", "forces[0].rate"))
    settings = (
        [0.5, 0.25],
        {"linear": [0.5, 1.0], "count": 3},
        {"uniform": [0.0, 1.0]},
        {"sphere": 1.0},
        {"orbit": 0.1},
        {"file": "states.npy"},
        {"normal": [0.0, 1.0]},
    )
    over = {place: chosen.choice(settings)}
    drawn = {"samples": 2, "seed": 1} if chosen.random() < 0.6 else {}
    return {"over": over, **drawn}


def gently(chosen, value):
    """Return a similar number, a list of another length, or the value itself."""
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return chosen.choice(
            (value + 1, value - 1, 2 * value, -value, 0, 10 * value, max(-(10**9), min(value, 10**9)) + 0.0)
        )
    if isinstance(value, float):
        return value * chosen.choice(FACTORS)
    if isinstance(value, list) and value:
        return chosen.choice((value[:-1], [*value, value[-1]], value[::-1], [value[0]] * len(value), [value, value]))
    return value
