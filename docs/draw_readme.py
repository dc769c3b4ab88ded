"""Draw the pictures of the README, except the turbulence: ``python docs/draw_readme.py [flip spins drift fit]``."""

from __future__ import annotations

import io
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import coadjoint as co

DOCS = Path(__file__).parent
START, DRIFT_STEP = (0.3, 1.0, 0.2), 0.5


def flip() -> None:
    """Draw the run of the lines that the README has, and its movie."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    sol = co.integrate(body, (0.01, 1.0, 0.01), (0, 90), 0.05, co.Splitting(order=4), attitude=True)
    sol.movie(DOCS / "intermediate_axis_flip.gif", frames=300, fps=25, size=(480, 360))


def spins() -> None:
    """Draw the structure factor of the lines that the README has, of more spins and members."""
    lattice = co.systems.spin_lattice("square", (24, 24), periodic=True, field=(0, 0, 0.5))
    states = co.thermal_states(lattice, temperature=0.1, members=8, sweeps=500, seed=1)
    sol = co.integrate(lattice, states.x, (0, 60), 0.05, co.SphericalMidpoint(), save_every=5)
    S = co.spectra.structure_factor(sol, path=[(0, 0), (1 / 2, 0), (1 / 2, 1 / 2), (0, 0)])
    store(S.plot(), "spin_waves.png")


def drift() -> None:
    """Draw the largest energy errors so far of two schemes of order four."""
    body, figure = co.systems.rigid_body(inertia=(1, 2, 3)), Figure(figsize=(6.4, 3.6), layout="constrained")
    axes: Any = figure.add_subplot()
    for scheme, text in (
        (co.Splitting(order=4), "Splitting(order=4)"),
        (co.ExplicitRungeKutta(), "ExplicitRungeKutta()"),
    ):
        sol = co.integrate(body, START, (0, 1e5 * DRIFT_STEP), DRIFT_STEP, scheme)
        errors = np.maximum.accumulate(np.abs(sol.energy - sol.energy[0]))
        steps = np.unique(np.geomspace(1, len(errors) - 1, 400).astype(int))
        axes.loglog(steps, errors[steps] / sol.energy[0], label=text)
    axes.set(xlabel="steps", ylabel="relative error of the energy", title=f"free rigid body, step {DRIFT_STEP:g}")
    axes.grid(alpha=0.3)
    axes.legend()
    store(figure, "energy_error.png")


def fit() -> None:
    """Draw the log of the example of a fit, the fitted motion, and the fitted numbers with their errors."""
    program = runpy.run_path(str(DOCS.parent / "examples" / "fit_a_log.py"))
    log, found, figure = program["log"], program["found"], Figure(figsize=(6.4, 3.6), layout="constrained")
    values, q, axes = found.values, log.rotation.as_quat(), figure.add_subplot()
    damping = co.forces.LinearDamping(values["LinearDamping.rate"])
    body = co.systems.rigid_body(values["inertia"]).with_forces(damping)
    sol = co.integrate(body, values["x0"], log.t_span, 0.05, co.Splitting(order=4), attitude=values["attitude0"])
    fitted = sol.rotation.as_quat()
    fitted *= np.cumprod(np.append(1.0, np.sign(np.sum(fitted[1:] * fitted[:-1], axis=1))))[:, None]  # continuous
    q *= np.sign(np.sum(fitted[::10] * q, axis=1))[:, None]
    for k, name in enumerate("xyzw"):
        axes.plot(log.t, q[:, k], f"C{k}o", ms=3)
        axes.plot(sol.t, fitted[:, k], f"C{k}", lw=1, label=f"$q_{name}$")
    one, _, three = values["inertia"]
    errors = [*found.standard_deviation("inertia")[[0, 2]], found.standard_deviation("LinearDamping.rate")]
    numbers = f"$I_1/I_2$ = {one / 2:.4f} ± {errors[0] / 2:.4f}, $I_3/I_2$ = {three / 2:.3f} ± {errors[1] / 2:.3f}"
    axes.set(xlabel="t [s]", ylabel="quaternion")
    axes.set_title(f"{numbers}, rate = {damping.rate:.4f} ± {errors[2]:.4f}/s", fontsize=10)
    axes.legend(ncol=4, loc="lower left")
    store(figure, "fitted_log.png")


def store(figure: Figure, name: str) -> None:
    """Store a figure with few colors."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=75)
    Image.open(drawn).convert("RGB").quantize(256).save(DOCS / name, optimize=True)


if __name__ == "__main__":
    for part in sys.argv[1:] or ("flip", "spins", "drift", "fit"):
        {"flip": flip, "spins": spins, "drift": drift, "fit": fit}[part]()
