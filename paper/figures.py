"""Draw the figures of the paper: ``python paper/figures.py``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import coadjoint as co

HERE = Path(__file__).parent
X0 = np.array([0.3, 0.1, 1.0, 0.2, -0.1, 0.9])
"""Angular momentum and direction of gravity of a heavy top in its body frame."""
SCHEMES = {
    "splitting, order 2": co.Splitting(order=2),
    "splitting, order 4": co.Splitting(order=4),
    "splitting, order 8": co.Splitting(order=8),
    "Gauss-Legendre, order 6": co.GaussLegendre(3),
    "Taylor, order 16": co.Taylor(16),
}


def heavy_top() -> co.LiePoissonSystem:
    """Return a heavy top without symmetries."""
    return co.systems.heavy_top(inertia=(1.0, 1.6, 2.2), lever=(0.4, 0.2, 1.0))


def conservation(span: float) -> Figure:
    """Draw changes of the energy and of a Casimir over time, beside a general solver."""
    top, times = heavy_top(), np.linspace(0.0, span, 401)
    figure = Figure((7.0, 2.8), layout="constrained")
    energies, casimirs = figure.subplots(1, 2)
    runs = {name: co.integrate(top, X0, (0, span), 0.05, SCHEMES[name], t_eval=times).x for name in list(SCHEMES)[1:4]}
    general = solve_ivp(lambda t, x: top.vector_field(x), (0, span), X0, "DOP853", times, rtol=1e-8, atol=1e-10)
    runs["DOP853 of SciPy, rtol 1e-8"] = general.y.T
    for name, x in runs.items():
        energy = np.array([top.energy(state) for state in x])
        norm = np.sum(x[:, 3:] ** 2, axis=1)  # the Casimir |p|^2
        for axes, values in ((energies, energy), (casimirs, norm)):
            change = np.abs(values / values[0] - 1)
            axes.semilogy(times[1:], np.maximum.accumulate(change)[1:].clip(1e-17), label=name)
    energies.set_ylabel("largest relative change so far")
    for axes, title in ((energies, "energy"), (casimirs, "Casimir |p|²")):
        axes.set(title=title, xlabel="t", ylim=(1e-17, 1e-2))
    energies.legend(fontsize=7)
    return figure


def convergence(span: float) -> Figure:
    """Errors at the end against the steps per unit of time."""
    top, figure = heavy_top(), Figure((4.2, 3.2), layout="constrained")
    axes, counts = figure.subplots(), (2 ** np.arange(3, 8)).tolist()
    reference = co.integrate(top, X0, (0, span), 1 / 128, co.Taylor(24)).x[-1]
    for name, scheme in SCHEMES.items():
        ends = [co.integrate(top, X0, (0, span), 1 / count, scheme, save_every=count).x[-1] for count in counts]
        errors = [float(np.abs(end - reference).max()) for end in ends]
        axes.loglog(counts, np.maximum(errors, 1e-17), "o-", markersize=3, label=name)
    axes.set(xlabel="steps per unit of time", ylabel=f"error at t = {span:g}")
    axes.legend(fontsize=7)
    return figure


def fluid(span: float, size: int = 64) -> Figure:
    """Vorticity of an ideal fluid on the sphere, and its Casimirs."""
    system = co.systems.sphere_euler(N=size)
    start = system.random(seed=1, degrees=(3, 8))
    frames = 8
    every = max(1, round(span / frames / (0.8 / size)))
    step = span / (frames * every)
    solution = co.integrate(system, start, (0, span), step, co.IsospectralGauss(), save_every=every)
    return solution.plot()


def draw(folder: Path, fraction: float = 1.0) -> list[Path]:
    """Write all figures into a folder, of runs over a fraction of their spans; return their files."""
    figures = {
        "conservation": conservation(1000.0 * fraction),
        "convergence": convergence(max(1.0, 16.0 * fraction)),
        "fluid": fluid(40.0 * fraction),
    }
    files = []
    for name, figure in figures.items():
        files.append(folder / f"{name}.png")
        figure.savefig(files[-1], dpi=150 if name != "fluid" else 90)
    return files


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=HERE)
    print(*draw(parser.parse_args().folder), sep="\n")
