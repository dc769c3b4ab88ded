"""Digests of the bits of many runs: `python -m digests.digests_of_runs`, in the folder of the tests."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator

import numpy as np

import coadjoint as co
from coadjoint.analysis.lyapunov import frame_of
from coadjoint.kernels.tables.derivatives import Frame
from coadjoint.runs.loops.loops import loops_of_members
from coadjoint.runs.plan_and_state import Plan
from coadjoint.runs.run import Run
from coadjoint.runs.start import start_of
from coadjoint.runs.times import Times

from .schemes_under_test import schemes, serves
from .systems_under_test import all_cases, full_matrix

CASES = (
    "so(3), diagonal",
    "A3,7, full",
    "e(3), heavy top",
    "so(4), full, another basis",
    "sl(2), driven",
    "skew J, no Jacobi identity",
)
SCHEMES = (
    "Splitting 1 adjoint",
    "Splitting 2 coordinates",
    "Splitting 2 compensated",
    "Splitting 4",
    "Composition of GaussLegendre",
    "GaussLegendre 1",
    "GaussLegendre 3",
    "Modified 2 structure",
    "Modified 2 gradient",
    "Iterated 2",
    "rk4",
    "RadauEnergy 2",
    "Taylor 5",
    "Taylor 5 alone",
)
WITH_TANGENTS = (
    "Splitting 2 compensated",
    "Splitting 4",
    "GaussLegendre 3",
    "Modified 2 gradient",
    "Iterated 2",
    "rk4",
)
SPAN, STEP, MEMBERS = (0.0, 1.5), 0.0625, 35


def arrays_of(solution: co.Solution) -> list[np.ndarray]:
    """Return all arrays of a solution."""
    found = [solution.x, solution.energy, *solution.casimirs.values()]
    found += [drift.tenths for drift in solution.change().values()]
    found += [drift.tenths for drift in solution.balance().values()] if solution.work else []
    found += [done for of_force in solution.work.values() for done in of_force.values()]
    return found if solution.attitude is None else [*found, solution.attitude]


def runs() -> Iterator[tuple[str, co.Solution]]:
    """Run every scheme on every system that it supports, alone and as an ensemble, and batches."""
    systems, methods = all_cases(), schemes()
    chosen = {name: methods[name] for name in SCHEMES}
    named = {type(method) for method in chosen.values()}
    chosen |= {name: method for name, method in methods.items() if type(method) not in named}
    chosen["rational"] = co.Splitting(order=2, rotation="rational")
    for scheme, method in chosen.items():
        for case in CASES:
            system, x0, _ = systems[case]
            if (scheme == "rational" and case != "e(3), heavy top") or not serves(method, system):
                continue
            kind = method.properties(system).attitude
            how = {"attitude": False if kind == "none" else "coadjoint", "save_every": 6}
            ensemble = x0 * (1.0 - 0.02 * np.arange(MEMBERS)[:, None])
            yield f"{scheme} on {case}, alone", co.integrate(system, x0, SPAN, STEP, method, **how)
            yield f"{scheme} on {case}, an ensemble", co.integrate(system, ensemble, SPAN, STEP, method, **how)
    body, sizes = co.systems.rigid_body((1, 2, 3)), np.array([1e-200, 1e-9, 0.1, 8.0, 1e3, 1e7, 1e12])
    states = np.multiply.outer(sizes, [0.3, -1.0, 0.7])
    yield "angles of any size", co.integrate(body, states, SPAN, STEP)
    spirals = [
        co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic(full_matrix(seed, 3)))
        for seed, a in enumerate((1.0, 1.75, 2.5, 2.75))
    ]
    for scheme in ("Splitting 4", "GaussLegendre 3", "RadauEnergy 2", "Taylor 5"):
        yield f"{scheme} on a batch", co.integrate(co.batch(spirals), [0.7, -0.4, 0.5], SPAN, STEP, methods[scheme])
    for case in ("A3,7, full", "e(3), heavy top"):
        system, x0, _ = systems[case]
        n = system.dim
        forces = (
            co.forces.LinearDamping(full_matrix(3, n), np.linspace(-0.2, 0.3, n)),
            co.forces.LinearDamping(np.linspace(0.1, 30.0, n)),
            co.forces.Torque(np.linspace(0.1, -0.1, n)),
        )
        bath = co.forces.HeatBath(0.2, full_matrix(2, n), temperature=0.3, seed=3)
        # At order four forces act at negative fractions of the step too, which the bath and the second damping do not.
        for scheme, acting in (
            ("Splitting 2", (*forces, bath)),
            ("GaussLegendre 3", (*forces, bath)),
            ("Splitting 4", (forces[0], forces[2])),
        ):
            moved, starts = system.with_forces(*acting), x0 * (1.0 - 0.02 * np.arange(4)[:, None])
            run = co.integrate(moved, starts, SPAN, STEP, methods[scheme], attitude="coadjoint", save_every=6)
            yield f"{scheme} on {case}, with forces", run
    g = co.algebras
    shifted = [g.so(4), g.so(5), g.so(6), g.su(3), g.su(4), g.sl(2), g.sl(3), g.e(3), g.get("A4,10")]
    for algebra in shifted:
        system = co.LiePoissonSystem(algebra, co.Quadratic(full_matrix(4, algebra.dim)))
        x0 = np.linspace(-0.3, 0.4, algebra.dim)
        kinds = ("coadjoint",) if system.representation is None else ("coadjoint", True)
        for kind in kinds:
            yield f"attitude {kind} of {algebra.name}", co.integrate(system, x0, (0.0, 4.0), 0.05, attitude=kind)


def states_with_tangents() -> Iterator[tuple[str, list[np.ndarray]]]:
    """Run schemes of each kind of loop with tangent vectors, alone and as an ensemble."""
    systems, methods, times = all_cases(), schemes(), Times(0.0, STEP, 24, 24).with_saved_steps([24])
    for scheme in WITH_TANGENTS:
        for case in CASES:
            (system, x0, _), method = systems[case], methods[scheme]
            if not serves(method, system):
                continue
            ensemble = x0 * (1.0 - 0.02 * np.arange(MEMBERS)[:, None])
            for x, how in ((x0, "alone"), (ensemble, "an ensemble")):
                vectors = Frame(frame_of(system.dim, system.dim), 7)
                loops = loops_of_members([system], [method.tangent_loop(system, times.h, vectors)])
                start = start_of(system, method, x, False)
                run = Run(Plan(system, method, loops, times, start.groups.shape), start)
                run.advance()
                yield f"tangents of {scheme} on {case}, {how}", [run.saved["x"], run.state["memory"]]


def digests() -> dict[str, str]:
    """Return the digest of every run."""
    found = [(name, arrays_of(solution)) for name, solution in runs()]
    return {
        name: hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()
        for name, arrays in (*found, *states_with_tangents())
    }


if __name__ == "__main__":
    print(json.dumps(digests()))
