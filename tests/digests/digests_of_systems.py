"""Digests of runs of all ready-made systems of vectors and of random runs, as JSON.

`python -m digests.digests_of_systems [K]`, in the folder of the tests, takes every K-th system and random run.
Runs that call user functions of the C library are left out.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

import coadjoint as co
from coadjoint.methods.registry import suggested_scheme
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems
from matrix.results import attempted, numbers
from random_runs.cases import case_of

# The angles of seed 192 are beyond 10^6 radians.
SEEDS = (192, *range(30))
STEPS = 24


def digest(*arrays: Any) -> str:
    """Return a digest of numbers; all NaN are equal."""
    found = hashlib.sha256()
    for array in map(np.asarray, arrays):
        none = np.isnan(array)
        found.update(none.tobytes() + np.where(none, 0.0, array).tobytes())
    return found.hexdigest()


def ready_made(every: int) -> Iterator[tuple[str, co.Solution]]:
    """Run the ready-made systems of vectors from their own starts, rounded, since NumPy computed these."""
    for name, factory in [*ready_made_systems().items()][::every]:
        gallery_entry = gallery_entry_of(name)
        assert gallery_entry is not None, name
        system = factory(**gallery_entry.parameters)
        if isinstance(system, co.LiePoissonSystem | co.PoissonSystem):
            x0 = np.round(np.atleast_2d(gallery_entry.start())[:3], 3)
            span, method = (0.0, STEPS * gallery_entry.step), suggested_scheme(system)
            yield (
                name,
                co.integrate(
                    system, x0, span, gallery_entry.step, method, attitude=gallery_entry.attitude, save_every=8
                ),
            )


def digests(every: int) -> dict[str, str]:
    """Return digests of the arrays of all runs; "given SEED" is the digest of the inputs of a random run."""
    compositions = [co.methods.even_order(co.Splitting(order=1), 8, jump) for jump in ("triple", "suzuki")]
    found = {f"coefficients of {len(method.fractions)} steps": digest(method.fractions) for method in compositions}
    for name, sol in ready_made(every):
        arrays = {"x": sol.x, "energy": sol.energy, **sol.casimirs}
        arrays |= {f"change of {key}": change.tenths for key, change in sol.change().items()}
        arrays |= {} if sol.attitude is None else {"attitude": sol.attitude}
        found |= {f"{name}: {key}": digest(array) for key, array in arrays.items()}
    for seed in SEEDS[::every]:
        case, _ = case_of(seed)
        if any(isinstance(system.hamiltonian, co.Separable) for system in case.systems):
            continue
        with np.errstate(all="ignore"):
            fields = [system.vector_field(case.x0[0]) for system in case.systems]
        try:
            system = co.batch(case.systems) if case.batch else case.systems[0]
            options = {"attitude": case.attitude, "save_every": case.save_every, "watch": case.watch, "threads": 1}
            sol = attempted(system, case.x0, case.t_span, case.step, case.method, events=case.events, **options)
        except (ValueError, TypeError):
            continue  # refused
        found[f"given {seed}"] = f"{digest(case.x0, *fields)} {case}"
        found[f"seed {seed}"] = digest(*numbers(sol).values())
    return found


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    print(json.dumps(digests(int(sys.argv[1]) if len(sys.argv) > 1 else 1)))
