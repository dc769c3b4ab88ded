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
    if system := table.get("system"):
        given = system.get("parameters", {})
        system["parameters"] = {key: min(value, 7) if key == "N" else value for key, value in given.items()}
    return _short(table, 8)


def draw(seed):
    """Return the bytes of the configuration file of a seed."""
    chosen = random.Random(f"configuration {seed}")
    kind = chosen.random()
    table = plausible(chosen) if kind < 0.5 else copy.deepcopy(chosen.choice(_BASES))
    for _ in range(chosen.choice((0, 1, 1, 2) if kind < 0.5 else (1, 1, 1, 2, 3, 5))):
        _change(chosen, table, chosen.choice(GENTLE if kind < 0.6 else CHANGES))
    text = toml(_short(table)).encode("utf-8", "surrogatepass")
    for _ in range(chosen.choice((1, 1, 2, 5, 30)) if kind > 0.9 else 0):
        text = _other_bytes(chosen, text)
    return text


def _short(table, most=MAX_STEPS):
    """Cut a run of many steps, whatever the table contains otherwise."""
    run = table.get("run")
    span, step = (run.get("t_span"), run.get("step")) if isinstance(run, dict) else (None, None)
    if isinstance(span, list) and len(span) == 2:
        if all(type(v) in (int, float) and abs(v) < 1e300 for v in (*span, step)):
            if step and abs(span[1] - span[0]) > most * abs(step):
                run["t_span"] = [span[0], span[0] + math.copysign(most * abs(step), span[1] - span[0])]
    return table


def _slots(table):
    """Yield container and key or index of each value."""
    for key, value in list(table.items() if isinstance(table, dict) else enumerate(table)):
        yield table, key
        if isinstance(value, dict | list):
            yield from _slots(value)


def _slot(chosen, table, kinds=(object,)):
    """Return a random slot, mostly of a table, so that long lists do not dominate."""
    found = [slot for slot in _slots(table) if kinds == (object,) or type(slot[0][slot[1]]) in kinds]
    named = [slot for slot in found if isinstance(slot[0], dict)]
    return chosen.choice(named if named and chosen.random() < 0.6 else found) if found else (table, "run")


KINDS = {"number": (int, float), "text": (str,)}
CHANGES = ("replace", "replace", "number", "number", "text", "remove", "rename", "add", "move", "other", "wrap", "name",
    "name", "output")  # fmt: skip
GENTLE = (*4 * ("similar",), "number", "replace", "remove", "name", "move")


def _change(chosen, table, kind):
    """Change one place of a table."""
    if kind == "other":
        other = chosen.choice(_BASES)
        key = chosen.choice(list(other))
        table[key] = copy.deepcopy(other[key])
    elif kind == "output":
        table["output"] = {chosen.choice(("file", "figure", "movie")): chosen.choice(PLACES) + chosen.choice(SUFFIXES)}
    elif kind == "name":
        _other_name(chosen, table)
    else:
        container, key = _slot(chosen, table, KINDS.get(kind, (object,)))
        old = container.get(key) if isinstance(container, dict) else container[key]
        if kind == "remove":
            container.pop(key, None) if isinstance(container, dict) else container.pop(key)
        elif kind in ("rename", "add") and isinstance(container, dict):
            new = chosen.choice((*KEYS, key + "s", key[:-1], key.upper()))
            container[new] = container.pop(key, 1) if kind == "rename" else wild(chosen)
        elif kind == "add":
            container.insert(chosen.randrange(len(container) + 1), wild(chosen))
        elif kind == "move":
            other, place = _slot(chosen, table)
            container[key] = copy.deepcopy(other.get(place) if isinstance(other, dict) else other[place])
        else:
            new = {"number": lambda: chosen.choice(NUMBERS), "text": lambda: _text(chosen), "wrap": lambda: [old],
                "similar": lambda: gently(chosen, old)}  # fmt: skip
            container[key] = new.get(kind, lambda: wild(chosen))()


def _text(chosen):
    kinds = (TEXTS, FORMULAS, EXECUTED, [place + suffix for place in PLACES for suffix in SUFFIXES])
    return any_name(chosen) if chosen.random() < 0.4 else chosen.choice(chosen.choice(kinds))


def _other_name(chosen, table):
    """Replace a system, scheme, algebra, force or state by name, with the parameters of the old one."""
    kind = chosen.choice(("system", "method", "algebra", "forces", "initial", "method", "system"))
    old = table[kind] if isinstance(table.get(kind), dict) else {}
    if kind == "forces":
        table["forces"] = [{"name": chosen.choice(co.forces.names()), chosen.choice(("rate", "alpha", "nu")): 0.1}]
    elif kind == "initial":
        table["initial"] = {**old, "kind": chosen.choice(("random", "zonal_jet", "from_file"))}
    else:
        names = {"system": co.systems.names, "method": co.methods.names, "algebra": lambda: [any_name(chosen)]}
        table[kind] = {**old, "name": chosen.choice(names[kind]())}


EXTRA = (b"[", b"]", b'"', b"'", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n", b"=", b".", b"#", b'"""', b"[[" * 200)


def _other_bytes(chosen, text):
    at = chosen.randrange(len(text) + 1)
    end = min(len(text), at + chosen.choice((1, 1, 4, 40)))
    more = {0: bytes([chosen.randrange(256)]) + text[at + 1 :], 1: text[end:], 2: text[at:end] + text[at:], 3: b""}
    return text[:at] + more.get(chosen.randrange(5), chosen.choice(EXTRA) + text[at:])


SMALL = {
    "sphere_euler": {"N": 5},
    "torus_euler": {"N": 5},
    "sphere_qg": {"N": 5},
    "torus_qg": {"N": 5},
    "surface_qg": {"N": 3},
    "layered_qg": {"N": 3},
    "thermal_qg": {"N": 3},
    "reduced_mhd": {"N": 3},
    "passive_scalar": {"N": 3},
}
FORCES = (
    {"name": "LinearDamping", "rate": 0.1},
    {"name": "DoubleBracketDamping", "alpha": 0.1},
    {"name": "HeatBath", "alpha": 0.1, "temperature": 0.1, "seed": 3},
    {"name": "Viscosity", "nu": 0.1},
    {"name": "BetaPlane", "beta": 0.1},
    {"name": "Friction", "rate": 0.1},
    {"name": "RandomForcing", "energy_rate": 0.1, "band": [1, 2], "seed": 1},
    {"name": "TransportNoise", "degrees": [1, 2], "strength": 0.1, "seed": 1},
)
BASE = {"base": co.Splitting()}
LEAST = {"Composition": {**BASE, "coefficients": (1.0,)}, "Projected": {"base": co.GaussLegendre(1)}}
LEAST |= {"ReversibleSteps": BASE, "Forced": BASE}
FACTORS = (-1, 0, 0.5, 2, 3, 10, 1e3, 1e-3, 1e8, 1e-8, 1e150, 1e-150, 1e300)
# Further settings, by the table that contains them; those of the last line are drawn less often.
FURTHER_SETTINGS = {
    "save_every": ("run", (1, 3, 100)),
    "t_eval": ("run", ([0.03, 0.25], [0.25, 0.03])),
    "watch": ("run", (False,)),
    "threads": ("run", (1, 2, 100)),
    "attitude": ("initial", (True, "coadjoint", [[1, 0], [0, 1]])),
    "forces": ("", tuple([dict(one)] for one in FORCES) + tuple([dict(one), dict(FORCES[0])] for one in FORCES)),
    "observe": ("", ({"a": "x1^2", "b": "x2 - 1"},)),
    "events": ("", tuple({"a": {"g": g, "count": 3}} for g in (0, "x1", "x1*x2 - 0.1"))),
    "output": ("", tuple({kind: name} for kind in ("file", "archive") for name in ("run.nc", "run.zarr"))),
}
OVER = ("initial.x[0]", "initial.x", "initial.x[0][0]", "system.parameters.N", "forces[0].rate")
SETTINGS = ([0.5, 0.25], {"linear": [0.5, 1.0], "count": 3}, {"uniform": [0.0, 1.0]}, {"sphere": 1.0}, {"orbit": 0.1},
    {"file": "states.npy"}, {"normal": [0.0, 1.0]})  # fmt: skip


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


def without_none(value):
    """Return a description without None, which TOML does not have."""
    if isinstance(value, dict):
        return {key: without_none(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [without_none(entry) for entry in value if entry is not None]
    return value


def plausible(chosen):
    """Return a configuration as tables."""
    name = chosen.choice(co.systems.names())
    system = co.systems.get(name, **SMALL.get(name, {}))
    matrices = isinstance(system, co.MatrixSystem)
    table = {
        "system": {"name": name, "parameters": dict(SMALL.get(name, {}))},
        "initial": {"x": _states(chosen, system)},
        "method": copy.deepcopy(chosen.choice(schemes())),
        "run": {"t_span": chosen.choice(([0, 1], [1.0, -1.0], [0, 0.0625])), "step": 0.0625},
    }
    if matrices:
        table["method"] = {"name": chosen.choice(("IsospectralGauss", "ExplicitRungeKutta", "LineSplitting"))}
        if "random" in getattr(system, "states_by_name", ()):
            table["initial"] = {"kind": "random", "seed": 1, "degrees": [1, 2]}
    for key in {chosen.choice([*FURTHER_SETTINGS]) for _ in range(chosen.choice((0, 1, 2, 3)))}:
        place, values = FURTHER_SETTINGS[key]
        (table[place] if place else table)[key] = copy.deepcopy(chosen.choice(values))
    if chosen.random() < 0.02:  # figures take a second
        table["output"] = {"figure": "run.png"}
    if chosen.random() < 0.1:
        drawn = {"samples": 2, "seed": 1} if chosen.random() < 0.6 else {}
        table["sweep"] = {"over": {chosen.choice(OVER): copy.deepcopy(chosen.choice(SETTINGS))}, **drawn}
    return table


def _states(chosen, system):
    if isinstance(system, co.MatrixSystem):
        *_, rows, columns = getattr(system, "shape", None) or (system.dim,) * 2
        return [[0.0 if i == j else (i - j) / 10 for j in range(columns)] for i in range(rows)]
    one = [round(chosen.uniform(-1, 1), 3) for _ in range(system.dim)]
    return [one, one[::-1]] if chosen.random() < 0.3 else one


def gently(chosen, value):
    """Return a similar number, a list of another length, or the value itself."""
    if isinstance(value, int) and not isinstance(value, bool):
        near = max(-(10**9), min(value, 10**9)) + 0.0
        return chosen.choice((value + 1, value - 1, 2 * value, -value, 0, 10 * value, near))
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
