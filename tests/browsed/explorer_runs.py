"""Runs of the library for the tests of the explorer: ``python tests/browsed/explorer_runs.py FILE`` writes them."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "docs"))

from explorer_systems import SHOWN, Shown, Values
from write_explorer import OF_MATRICES, SCHEMES, code_of, first_values, on_grid

import coadjoint as co

STEPS, SAVED = 400, 100


def run(shown: Shown, name: str, scheme: str, values: Values, step: float, x0: Any) -> dict[str, Any]:
    """Return a run of the library, with everything that the page needs to repeat it."""
    code = code_of(scheme, shown)
    system, method = shown.build(values), eval(code, {"co": co})
    span = (0.0, STEPS * step)
    sol = co.integrate(system, x0, t_span=span, step=step, method=method, save_every=SAVED, attitude=shown.attitude)
    invariants = [sol.energy, *(sol.casimirs[key] for key in system.casimirs)]
    return {
        "system": shown.name,
        "scheme": name,
        "values": values,
        "step": step,
        "x0": list(x0),
        "steps": STEPS,
        "save_every": SAVED,
        "x": sol.x.tolist(),
        "invariants": np.array(invariants).T.tolist(),
        "attitudes": [] if sol.attitude is None else sol.attitude[1:].reshape(len(sol.t) - 1, -1).tolist(),
    }


# Structure constants of [e1, e2], [e2, e3] and [e3, e1], by e1, e2 and e3: algebras for all kinds of blocks. The last
# is so(3) in a skew basis, whose generators the library solves in closed form, and the page by their series.
ALGEBRAS = {
    "so(3)": (0, 0, 1, 1, 0, 0, 0, 1, 0),
    "se(2)": (0, 0, 1, 0, 0, 0, 0, 1, 0),
    "Heisenberg": (0, 0, 1, 0, 0, 0, 0, 0, 0),
    "scalings": (0, 1, 0, 0, 0, 0, 0, 0, -0.5),
    "equal scalings": (0, 0.7, 0, 0, 0, 0, 0, 0, -0.7),
    "sl(2)": (0, 2, 0, 1, 0, 0, 0, 0, 2),
    "planes": (0, 0.5, 1, 0, 0, 0, 0, 1, -0.5),
    "III": (0, 1, 1, 0, 0, 0, 0, -1, -1),
    "so(3), scaled": (0, 0, 1.5, -0.5, 0, 0, 0, 0.75, 0),
    "so(3), skew": (0, 0, 1, 2, -1, 0, -1, 1, 0),
}
ENERGIES = (((1.0, 0.6, 0.4), (0.0, 0.0, 0.0)), ((0.5, 0.0, 0.9), (0.1, -0.3, 0.0)), ((0.8, 0.3, 0.0), (0.0, 0.0, 0.0)))
ROUNDED = ("so(3), skew",)
TYPED_STEPS, TYPED_STEP = 60, 0.1


def typed(name: str, scheme: str, title: str, energy: Any) -> dict[str, Any]:
    """Return a run on a typed algebra; `exact` unless the page computes in another order."""
    c, (squares, linear) = ALGEBRAS[name], energy
    pairs = ((0, 1), (1, 2), (2, 0))
    triples = [(*pairs[n // 3], n % 3, float(x)) for n, x in enumerate(c) if x]
    system = co.LiePoissonSystem(co.LieAlgebra(triples, dim=3), co.Quadratic(list(squares), linear=list(linear)))
    splitting = title.startswith("splitting")
    method = eval(f"{scheme[:-1]}, parts='coordinates')" if splitting else scheme, {"co": co})
    x0, span = (0.3, -0.5, 0.4), (0.0, TYPED_STEPS * TYPED_STEP)
    sol = co.integrate(system, x0, t_span=span, step=TYPED_STEP, method=method)
    return {
        "name": name,
        "algebra": {"constants": c, "squares": squares, "linear": linear},
        "scheme": title,
        "step": TYPED_STEP,
        "x0": x0,
        "exact": title != "taylor" and not (splitting and name in ROUNDED),
        "x": sol.x.tolist(),
        "energy": sol.energy.tolist(),
        # The page finds polynomials alone, no powers and logarithms.
        "casimirs": sum(not isinstance(casimir, co.Invariant) for casimir in system.casimirs.values()),
    }


def runs() -> list[dict[str, Any]]:
    """Return two runs of each scheme on each system."""
    random, found = np.random.default_rng(2), []
    for shown in (one for one in SHOWN if not one.start):
        for name, scheme, _ in SCHEMES:
            found.append(run(shown, name, scheme, first_values(shown), shown.step, shown.x0))
            values, step = on_grid(shown, random), float(np.round(shown.step * random.uniform(0.3, 1.0), 3))
            x0 = (np.array(shown.x0) * random.uniform(0.5, 1.0)).tolist()
            found.append(run(shown, name, scheme, values, step, x0))
    return found


PLANETS = (
    {"N": 16, "lamb": 0.0, "rotation": 0.0},
    {"N": 32, "lamb": 900.0, "rotation": 60.0},
    {"N": 48, "lamb": 350.0, "rotation": 15.0},
)
PLANET_STEPS, MAP = 100, (48, 96)


def planet(shown: Shown, name: str, scheme: str, values: Values) -> dict[str, Any]:
    """Return a run of a flow on a sphere: its first and last state as pairs of numbers, invariants, and last fields."""
    system, method = shown.build(values), eval(scheme, {"co": co})
    x0, span = shown.initial(system), (0.0, PLANET_STEPS * shown.step)
    sol = co.integrate(system, x0, t_span=span, step=shown.step, method=method, save_every=PLANET_STEPS)
    ends = np.array(sol.x)[[0, -1]]
    return {
        "scheme": name,
        "values": values,
        "step": shown.step,
        "steps": PLANET_STEPS,
        "x": np.ascontiguousarray(ends).view(np.float64).reshape(2, -1).tolist(),
        "invariants": [[sol.energy[k], *(sol.casimirs[f"tr W^{power}"][k] for power in (2, 3, 4))] for k in (0, -1)],
        "vorticity": system.to_grid(ends[1], MAP, "fejer").ravel().tolist(),
        "zonal": system.velocity(ends[1], MAP, "fejer")[0].mean(axis=1).tolist(),
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    algebras = [
        typed(name, scheme, title, energy) for name in ALGEBRAS for title, scheme, _ in SCHEMES for energy in ENERGIES
    ]
    (shown,) = (one for one in SHOWN if one.start)
    planets = [planet(shown, name, scheme, values) for name, scheme, _ in OF_MATRICES for values in PLANETS]
    data = {"runs": runs(), "algebras": algebras, "planets": planets}
    Path(sys.argv[1]).write_text(json.dumps(data), encoding="utf-8")
