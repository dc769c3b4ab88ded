"""Random configuration files: examples with random values, keys, names or bytes changed."""

from __future__ import annotations

import copy
import dataclasses
import datetime
import json
import math
import random
import tomllib
from functools import cache
from pathlib import Path

import coadjoint as co

from .values import EXECUTED, FORMULAS, KEYS, NUMBERS, PLACES, SUFFIXES, TEXTS, any_name, wild

MAX_STEPS = 40
EXAMPLES = Path(__file__).parents[2] / "examples"
FLUID = "system = {name = 'torus_euler', parameters = {N = 5}}\nmethod = {name = 'IsospectralGauss', stages = 1}\n"
FURTHER = (
    "system = {name = 'spin_lattice', parameters = {lattice = 'chain', shape = 3}}\ninitial = {x = [1, 0, 0, 0, 1, 0, "
    "0, 0, 1]}\nmethod = {name = 'SphericalMidpoint'}\nrun = {t_span = [0, 1], step = 0.25, watch = false}\n",
    "system = {name = 'heavy_top'}\ninitial = {x = [1, 0, 0, 0, 1, 0], attitude = 'coadjoint'}\n"
    "method = {name = 'Taylor', order = 8}\nrun = {t_span = [1, 0], step = 0.25, t_eval = [0.5, 0.3]}\n"
    "events = {turn = {g = 0, count = 2}, far = {g = 'x1*x2 - 0.1', direction = 1, terminal = true}}\n"
    "forces = [{name = 'LinearDamping', rate = 0.1}]\n",
    FLUID + "initial = {kind = 'random', seed = 1, degrees = [1, 2]}\nrun = {t_span = [0, 0.5], step = 0.125}\n"
    "forces = [{name = 'Viscosity', nu = 0.1}, {name = 'BetaPlane', beta = 1.0}]\n",
    FLUID + "initial = {kind = 'blobs', places = [[1.0, 2.0]], strengths = 1.0, widths = 0.5}\n"
    "run = {t_span = [0, 0.5], step = 0.125, save_every = 2}\n[output]\nfile = 'run.nc'\n",
    FLUID + "initial = {x = 'matrices.npy'}\nrun = {t_span = [0, 0.25], step = 0.125}\n",
    "system = {name = 'rigid_body'}\ninitial = {x = 'states.npy'}\nrun = {t_span = [0, 1], step = 0.5}\n"
    "method = {name = 'Composition', base = {name = 'GaussLegendre', stages = 1}, coefficients = [0.5, 0.5]}\n"
    "observe = {xy = 'x1*x2'}\n[output]\nfile = 'run.zarr'\n",
    "system = {name = 'sklyanin'}\ninitial = {x = [1, 0.5, 0.2, 0.1]}\nrun = {t_span = [0, 1], step = 0.25}\n"
    "method = {name = 'ModifiedGaussLegendre', stages = 2, iterations = 4, freeze = 'structure'}\n",
    "algebra = {name = 'so(p,q)', parameters = {p = 2, q = 1}}\nhamiltonian = {M = 1, constant = 2.0}\n"
    "initial = {x = [1, 0.5, 0.2]}\nrun = {t_span = [0, 1], step = 0.25}\nmethod = {name = 'Projected', "
    "base = {name = 'ExplicitRungeKutta', parameters = {name = 'rk4'}}}\n",
)


def bases():
    """Return the configurations to be changed, as tables: the examples, and some with further features."""
    shipped = [path.read_text(encoding="utf-8") for path in sorted(EXAMPLES.glob("*.toml"))]
    return [_quick(tomllib.loads(text)) for text in (*shipped, *FURTHER)]


def _quick(table):
    """Return a configuration with few steps, and of small matrices for fluids."""
    table["system"] = {**table.get("system", {})}
    table["system"]["parameters"] = {
        key: min(value, 7) if key == "N" else value for key, value in table["system"].get("parameters", {}).items()
    }
    if not table["system"].get("name"):
        del table["system"]
    step, start, end = table["run"]["step"], *table["run"]["t_span"]
    table["run"]["t_span"] = [start, start + math.copysign(min(abs(end - start), 8 * step), end - start)]
    return table


def draw(seed):
    """Return the bytes of the configuration file of a seed."""
    chosen = random.Random(f"configuration {seed}")
    kind = chosen.random()
    table = plausible(chosen) if kind < 0.5 else copy.deepcopy(chosen.choice(_BASES))
    for _ in range(chosen.choice((0, 1, 1, 2) if kind < 0.5 else (1, 1, 1, 2, 3, 5))):
        chosen.choice(_GENTLE if kind < 0.6 else _CHANGES)(chosen, table)
    text = toml(_short(table)).encode("utf-8", "surrogatepass")
    if kind > 0.9:
        for _ in range(chosen.choice((1, 1, 2, 5, 30))):
            text = _other_bytes(chosen, text)
    return text


def _short(table):
    """Cut a run of many steps, whatever the table contains otherwise."""
    run = table.get("run")
    span, step = (run.get("t_span"), run.get("step")) if isinstance(run, dict) else (None, None)
    if (
        isinstance(span, list)
        and len(span) == 2
        and all(type(v) in (int, float) and abs(v) < 1e300 for v in (*span, step))
    ):
        if step and abs(span[1] - span[0]) > MAX_STEPS * abs(step):
            run["t_span"] = [span[0], span[0] + math.copysign(MAX_STEPS * abs(step), span[1] - span[0])]
    return table


def _slots(table, inside=()):
    """Yield container and key or index of each value."""
    for key, value in list(table.items() if isinstance(table, dict) else enumerate(table)):
        yield table, key
        if isinstance(value, dict | list):
            yield from _slots(value)


def _slot(chosen, table):
    """Return a random slot, mostly of a table, so that long lists do not dominate."""
    found = list(_slots(table))
    if not found:
        return table, "run"
    named = [slot for slot in found if isinstance(slot[0], dict)]
    return chosen.choice(named if named and chosen.random() < 0.6 else found)


def _replaced(chosen, table):
    container, key = _slot(chosen, table)
    container[key] = wild(chosen)


def _number_changed(chosen, table):
    found = [slot for slot in _slots(table) if type(slot[0][slot[1]]) in (int, float)]
    if found:
        container, key = chosen.choice(found)
        container[key] = chosen.choice(NUMBERS)


def _text_changed(chosen, table):
    found = [slot for slot in _slots(table) if isinstance(slot[0][slot[1]], str)]
    if found:
        container, key = chosen.choice(found)
        kinds = (TEXTS, FORMULAS, EXECUTED, [place + suffix for place in PLACES for suffix in SUFFIXES])
        container[key] = any_name(chosen) if chosen.random() < 0.4 else chosen.choice(chosen.choice(kinds))


def _gently_changed(chosen, table):
    container, key = _slot(chosen, table)
    if not (isinstance(container, dict) and key not in container):
        container[key] = gently(chosen, container[key])


def _taken_out(chosen, table):
    container, key = _slot(chosen, table)
    del container[key]


def _renamed(chosen, table):
    container, key = _slot(chosen, table)
    if isinstance(container, dict):
        other = chosen.choice((*KEYS, key + "s", key[:-1], key.upper()))
        container[other] = container.pop(key, 1)


def _added(chosen, table):
    container, _ = _slot(chosen, table)
    if isinstance(container, dict):
        container[chosen.choice(KEYS)] = wild(chosen)
    else:
        container.insert(chosen.randrange(len(container) + 1), wild(chosen))


def _moved(chosen, table):
    (one, first), (other, second) = _slot(chosen, table), _slot(chosen, table)
    one[first] = copy.deepcopy(other.get(second) if isinstance(other, dict) else other[second])


def _of_another(chosen, table):
    other = chosen.choice(_BASES)
    key = chosen.choice(list(other))
    table[key] = copy.deepcopy(other[key])


def _wrapped(chosen, table):
    container, key = _slot(chosen, table)
    container[key] = [container.get(key) if isinstance(container, dict) else container[key]]


def _of_one_name(chosen, table):
    """Replace a system, scheme, algebra, force or state by name, with the parameters of the old one."""
    kind = chosen.choice(("system", "method", "algebra", "forces", "initial", "method", "system"))
    if kind == "system":
        table["system"] = {**_table(table.get("system")), "name": chosen.choice(co.systems.names())}
    elif kind == "method":
        table["method"] = {**_table(table.get("method")), "name": chosen.choice(co.methods.names())}
    elif kind == "algebra":
        table["algebra"] = {**_table(table.get("algebra")), "name": any_name(chosen)}
    elif kind == "forces":
        table["forces"] = [{"name": chosen.choice(co.forces.names()), chosen.choice(("rate", "alpha", "nu")): 0.1}]
    else:
        table["initial"] = {**_table(table.get("initial")), "kind": chosen.choice(("random", "zonal_jet", "from_file"))}


def _table(arguments):
    return arguments if isinstance(arguments, dict) else {}


def _written(chosen, table):
    table["output"] = {chosen.choice(("file", "figure", "movie")): chosen.choice(PLACES) + chosen.choice(SUFFIXES)}


_CHANGES = (_replaced, _replaced, _number_changed, _number_changed, _text_changed, _taken_out, _renamed, _added, _moved)
_CHANGES = (*_CHANGES, _of_another, _wrapped, _of_one_name, _of_one_name, _written)


_GENTLE = (*4 * (_gently_changed,), _number_changed, _replaced, _taken_out, _of_one_name, _moved)


def _other_bytes(chosen, text):
    at = chosen.randrange(len(text) + 1)
    end = min(len(text), at + chosen.choice((1, 1, 4, 40)))
    kind = chosen.randrange(5)
    if kind == 0:
        return text[:at] + bytes([chosen.randrange(256)]) + text[at + 1 :]
    if kind == 1:
        return text[:at] + text[end:]
    if kind == 2:
        return text[:end] + text[at:]
    if kind == 3:
        return text[:at]
    extra = (
        b"[",
        b"]",
        b'"',
        b"'",
        b"\x00",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\r",
        b"\n",
        b"=",
        b".",
        b"#",
        b'"""',
        b"[[" * 200,
    )
    return text[:at] + chosen.choice(extra) + text[at:]


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
LEAST = {
    "Composition": {"base": co.Splitting(), "coefficients": (1.0,)},
    "Projected": {"base": co.GaussLegendre(1)},
    "ReversibleSteps": {"base": co.Splitting()},
    "Forced": {"base": co.Splitting()},
}
FACTORS = (-1, 0, 0.5, 2, 3, 10, 1e3, 1e-3, 1e8, 1e-8, 1e150, 1e-150, 1e300)


@cache
def system_of(name):
    return co.systems.get(name, **SMALL.get(name, {}))


@cache
def schemes():
    """Return the names and parameters of the examples of all schemes."""
    return [table for name in co.methods.names() for one in type(co.methods.get(name, **LEAST.get(name, {}))).examples()
            if (table := described(one))]  # fmt: skip


def described(method):
    """Return the table of a scheme, or None if a parameter is neither a number nor a text nor a scheme."""
    parameters = {}
    for field in dataclasses.fields(method):
        value = getattr(method, field.name)
        value = described(value) if isinstance(value, co.methods.Method) else value
        if value is not None and not isinstance(value, bool | int | float | str | tuple | dict):
            return None
        parameters[field.name] = value
    return {"name": type(method).__name__, **without_none(parameters)}


def plausible(chosen):
    """Return a configuration as tables."""
    name = chosen.choice(co.systems.names())
    system = system_of(name)
    table = {
        "system": {"name": name, "parameters": dict(SMALL.get(name, {}))},
        "initial": {"x": _states(chosen, system)},
        "method": chosen.choice(schemes()),
        "run": {"t_span": chosen.choice(([0, 1], [1.0, -1.0], [0, 0.0625])), "step": 0.0625},
    }
    if isinstance(system, co.MatrixSystem) and "random" in getattr(system, "states_by_name", ()):
        table["initial"] = {"kind": "random", "seed": 1, "degrees": [1, 2]}
    if isinstance(system, co.MatrixSystem):
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
    if isinstance(system, co.MatrixSystem):
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


def toml(table):
    """Return the TOML text of a table, one key per line, inner tables inline."""
    return "".join(f"{quoted(key)} = {value(entry)}\n" for key, entry in table.items())


def value(entry):
    if isinstance(entry, bool):
        return str(entry).lower()
    if isinstance(entry, float):
        return "nan" if math.isnan(entry) else f"{'-' if entry < 0 else ''}inf" if math.isinf(entry) else repr(entry)
    if isinstance(entry, int):
        return str(entry) if abs(entry) < 10**4000 else f"0x{entry:x}"
    if isinstance(entry, str):
        return quoted(entry)
    if isinstance(entry, datetime.date):
        return entry.isoformat()
    if isinstance(entry, list):
        return f"[{', '.join(map(value, entry))}]"
    return f"{{{', '.join(f'{quoted(key)} = {value(one)}' for key, one in entry.items())}}}"


def quoted(text):
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


_BASES = bases()
