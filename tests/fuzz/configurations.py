"""Random configuration files: examples with random values, keys, names or bytes changed."""

from __future__ import annotations

import copy
import math
import random
import tomllib
from pathlib import Path

from coadjoint import forces, systems
from coadjoint.methods import registry

from .plausible import gently, plausible
from .wild import EXECUTED, FORMULAS, KEYS, NUMBERS, PLACES, SUFFIXES, TEXTS, any_name, wild
from .written import toml

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
    text = toml(table).encode("utf-8", "surrogatepass")
    if kind > 0.9:
        for _ in range(chosen.choice((1, 1, 2, 5, 30))):
            text = _other_bytes(chosen, text)
    return text


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
        table["system"] = {**_table(table.get("system")), "name": chosen.choice(systems.names())}
    elif kind == "method":
        table["method"] = {**_table(table.get("method")), "name": chosen.choice(registry.names())}
    elif kind == "algebra":
        table["algebra"] = {**_table(table.get("algebra")), "name": any_name(chosen)}
    elif kind == "forces":
        table["forces"] = [{"name": chosen.choice(forces.names()), chosen.choice(("rate", "alpha", "nu")): 0.1}]
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


_BASES = bases()
