"""Ensembles: 20 000 rigid bodies and more, steps of one member in a second, beside C, JAX, NumPy and heyoka.

python benchmarks/ensembles.py [--members N] [--rounds R]
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
from typing import Any

import numpy as np
from c_programs import HERE
from ensemble_contenders import Contender, H, M, by_heyoka, others, splittings

import coadjoint as co

UNIT_ROUNDOFF = 2.0**-53
CHECKED_STEPS = 20
CHECKED_MEMBERS = 1024
SPAN_STEPS = 2500  # heyoka's span, and the one at whose end errors are taken
SECONDS = 1.0  # of a measurement: threads need some tenths to spread over the cores
REFERENCE = "coadjoint"
TWO_THREADS = "coadjoint, 2 threads"


def initial_states(members: int) -> np.ndarray:
    """Return momenta of length 1 in all directions."""
    x = np.random.default_rng(1993).normal(size=(members, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def check_same_steps(found: dict[str, Contender], x0: np.ndarray) -> None:
    """Compare the states after a few steps: 16 roundings in each of 5 rotations a step, that grow 4 times at most."""
    tolerance = 16 * 5 * CHECKED_STEPS * 4 * UNIT_ROUNDOFF
    expected = found[REFERENCE](x0, CHECKED_STEPS)[2]
    for name, contender in found.items():
        difference = np.abs(contender(x0, CHECKED_STEPS)[2] - expected).max()
        if not difference < tolerance:
            raise SystemExit(f"{name} and coadjoint differ by {difference:.2g} after {CHECKED_STEPS} steps")


def exact(x0: np.ndarray) -> np.ndarray:
    """Integrate to the end of SPAN_STEPS steps by 16th-order Gauss-Legendre, to round-off."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(list(M)), name="rigid body")
    span = SPAN_STEPS * H
    return co.integrate(system, x0, (0.0, span), span / 100, co.GaussLegendre(stages=8), save_every=100).x[-1]


def as_accurate(x0: np.ndarray, expected: np.ndarray, error: float) -> float:
    """Return the loosest tolerance, in powers of ten, with which heyoka's median error is not larger than `error`."""
    for power in range(1, 16):
        if median_error(by_heyoka(x0, SPAN_STEPS, 10.0**-power)[2], expected) <= error:
            return 10.0**-power
    raise SystemExit(f"heyoka did not reach an error of {error:.2g}")


def median_error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)))


def installed(chosen: dict[str, tuple[Contender, str]], missing: set[str]) -> dict[str, Contender]:
    """Leave out what cannot be imported, and name it in `missing`."""
    lacking = {package for _, package in chosen.values() if package and importlib.util.find_spec(package) is None}
    missing |= lacking
    return {name: contender for name, (contender, package) in chosen.items() if package not in lacking}


def measure(members: int, rounds: int) -> dict[str, Any]:
    """Measure in turns; every contender takes as many steps as fill SECONDS, heyoka its whole span."""
    members -= members % 64  # whole registers for C, whole batches for heyoka
    x0 = initial_states(members)
    few = x0[:CHECKED_MEMBERS]
    missing: set[str] = set()
    found = installed(splittings(), missing)
    check_same_steps(found, few)
    expected = exact(few)
    error = median_error(found[REFERENCE](few, SPAN_STEPS)[2], expected)
    tolerance = as_accurate(few, expected, error) if importlib.util.find_spec("heyoka") else 0.0
    found |= installed(others(tolerance), missing)
    steps, errors = {}, {}
    for name, contender in found.items():
        errors[name] = median_error(contender(few, SPAN_STEPS)[2], expected)
        contender(x0, 1)  # whatever is compiled for this number of members
        each = contender(x0, CHECKED_STEPS)[0] / CHECKED_STEPS
        steps[name] = SPAN_STEPS if "heyoka" in name else max(CHECKED_STEPS, int(SECONDS / each))
    rates: dict[str, list[tuple[float, float]]] = {name: [] for name in found}
    for _ in range(rounds):
        for name, contender in found.items():
            cpu, wall, _ = contender(x0, steps[name])
            rates[name].append((members * steps[name] / cpu, members * steps[name] / wall))
    measured = {"members": members, "rounds": rounds, "missing": sorted(missing), "errors": errors, "rates": rates}
    (HERE / "build" / "ensembles.json").write_text(json.dumps(measured, indent=1))
    return measured


def table(measured: dict[str, Any]) -> str:
    """Rates are the best of the rounds; ratios to coadjoint on one thread are medians of the rounds."""
    rates = measured["rates"]
    lines = [f"**Missing: {name}**; `pip install 'coadjoint[bench]'`\n" for name in measured["missing"]]
    lines += [
        f"{measured['members']} rigid bodies, order 2, h = {H}; a second of CPU, of two threads a second of the clock;"
        f" heyoka's own steps are counted as the {SPAN_STEPS} of its span",
        "",
        "| | million member-steps/s | over coadjoint on one thread | median error at the end of the span |",
        "|---|---|---|---|",
    ]
    for name, rounds in rates.items():
        which = 1 if name == TWO_THREADS else 0
        best = max(rate[which] for rate in rounds)
        pairs = zip(rounds, rates[REFERENCE], strict=True)
        ratio = statistics.median(rate[which] / ours[which] for rate, ours in pairs)
        lines.append(f"| {name} | {1e-6 * best:.3g} | {ratio:.2f} | {measured['errors'][name]:.0e} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="many members: steps a second beside C, JAX, NumPy, heyoka")
    parser.add_argument("--members", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    print(table(measure(given.members, given.rounds)))


if __name__ == "__main__":
    main()
