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
from write_explorer import SCHEMES, code_of, first_values, on_grid

import coadjoint as co

STEPS, SAVED = 400, 100


def run(shown: Shown, name: str, scheme: str, values: Values, step: float, x0: Any) -> dict[str, Any]:
    """Return a run of the library, with everything that the page needs to repeat it."""
    code = code_of(scheme, shown)
    system, method = shown.build(values), eval(code, {"co": co})
    span = (0.0, STEPS * step)
    sol = co.integrate(system, x0, t_span=span, step=step, method=method, save_every=SAVED)
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
    }


def runs() -> list[dict[str, Any]]:
    """Return two runs of each scheme on each system."""
    random, found = np.random.default_rng(2), []
    for shown in SHOWN:
        for name, scheme, _ in SCHEMES:
            found.append(run(shown, name, scheme, first_values(shown), shown.step, shown.x0))
            values, step = on_grid(shown, random), float(np.round(shown.step * random.uniform(0.3, 1.0), 3))
            x0 = (np.array(shown.x0) * random.uniform(0.5, 1.0)).tolist()
            found.append(run(shown, name, scheme, values, step, x0))
    return found


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    Path(sys.argv[1]).write_text(json.dumps(runs()), encoding="utf-8")
