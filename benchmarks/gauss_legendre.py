"""Gauss-Legendre methods: coadjoint beside C written for the free rigid body, without and with care about round-off.

python benchmarks/gauss_legendre.py [--rounds R]
"""

from __future__ import annotations

import argparse
import statistics
from typing import Any, NamedTuple

import numpy as np
from c_programs import build, run

import coadjoint as co

UNIT_ROUNDOFF = 2.0**-53
CHECKED_STEPS = 1000
START = (1.0, 10.0, 1.0)
STEPS = {2: 0.01, 4: 0.05, 6: 0.1, 8: 0.1, 12: 0.25}  # by the number of stages: some 7 to 12 iterations each
C_STEPS = 20_000
SECONDS = 0.02  # what a run of coadjoint alone should take
FLAGS = ("-ffp-contract=fast",)
CHAIN = 100_000


class Run(NamedTuple):
    """What one run took, and the state at its end."""

    nanoseconds: float
    iterations: float
    end: np.ndarray
    drift: float = float("nan")


class Body:
    """The paper's rigid body by a Gauss-Legendre method of s stages, in C and here."""

    def __init__(self, stages: int) -> None:
        self.stages, self.step, self.method = stages, STEPS[stages], co.GaussLegendre(stages)
        self.system = co.systems.paper_rigid_body()
        self.programs = [
            build("gauss_legendre", *FLAGS, f"-DSTAGES={stages}", f"-DCAREFUL={careful}", target=f"gauss_{name}")
            for careful, name in enumerate((f"careless_{stages}", f"careful_{stages}"))
        ]

    def in_c(self, careful: bool, steps: int, x0: tuple[float, ...] = START) -> Run:
        """Run the C program: with a_ij = mu_ij b_j, rounded, or with mu_ij, which are what coadjoint takes."""
        _, weights, mix, _ = self.method.coefficients()
        scale = 1.0 if careful else weights
        tables = [mix * scale, self.method.forecast(1.0) * scale]
        masses = np.diag(self.system.hamiltonian.hessian(np.array(x0)))
        numbers = np.concatenate([[self.step], masses, x0, weights, *(table.ravel() for table in tables)])
        nanoseconds, found = run(self.programs[careful], [str(steps), *(repr(float(number)) for number in numbers)])
        return Run(nanoseconds, found[3], found[:3], found[4])

    def here(self, steps: int) -> Run:
        return solve(self.system, np.array(START), self.step, steps, self.method)

    def check_same_steps(self) -> None:
        """Compare the ends of a short run; they may differ by what round-off can have grown to.

        A step rounds a component some 16 times (the careless one stops 9 roundings before it must); every such error
        is taken to grow as a change of the start grows over the whole run, measured in C coordinate by coordinate.
        """
        expected = self.in_c(True, CHECKED_STEPS).end
        growth, size = 1.0, float(np.max(np.abs(expected)))
        for i, value in enumerate(START):
            moved = list(START)
            moved[i] = value + 2.0**-26
            change = self.in_c(True, CHECKED_STEPS, tuple(moved)).end - expected
            growth = max(growth, float(np.max(np.abs(change))) / (moved[i] - value))
        tolerance = 16 * UNIT_ROUNDOFF * CHECKED_STEPS * growth * size
        for name, found in (
            ("coadjoint", self.here(CHECKED_STEPS)),
            ("C without care", self.in_c(False, CHECKED_STEPS)),
        ):
            difference = float(np.max(np.abs(found.end - expected)))
            if not difference <= tolerance:
                raise SystemExit(
                    f"{self.stages} stages: after {CHECKED_STEPS} steps {name} and C differ by {difference:.2g}, "
                    f"but round-off explains only {tolerance:.2g}; they do not take the same steps"
                )


def solve(system: Any, x0: np.ndarray, step: float, steps: int, method: Any) -> Run:
    """Take the steps in coadjoint on one thread; the numbers are those of one member and step."""
    span = (0.0, steps * step)
    solution = co.integrate(system, x0, span, step, method, save_every=steps, watch=False, threads=1)
    each = steps * (len(x0) if x0.ndim == 2 else 1)
    return Run(1e9 * solution.stats.seconds / each, solution.stats.iterations / each, solution.x[-1])


def least_and_median(measured: list[Run], reference: list[Run]) -> str:
    """Return the ratio of the least times, and the median of the rounds' ratios."""
    ratios = [ours.nanoseconds / theirs.nanoseconds for ours, theirs in zip(measured, reference, strict=True)]
    least = min(each.nanoseconds for each in measured) / min(each.nanoseconds for each in reference)
    return f"{least:.2f} ({statistics.median(ratios):.2f})"


def cost(runs: list[Run]) -> str:
    least = min(each.nanoseconds for each in runs)
    return f"{least:.0f} = {runs[0].iterations:.2f} x {least / runs[0].iterations:.1f}"


def against_c(rounds: int) -> str:
    lines = [
        "| stages, h | C without care, ns/step = iterations x ns | C with care | coadjoint | coadjoint over C without "
        "care | C with care over without | coadjoint over C with care | drift in C without care | with care |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for stages, step in STEPS.items():
        body = Body(stages)
        body.check_same_steps()
        careless, careful, ours = [], [], []
        for _ in range(rounds):
            careless.append(body.in_c(False, C_STEPS))
            careful.append(body.in_c(True, C_STEPS))
            ours.append(body.here(C_STEPS))
        lines.append(
            f"| {stages}, {step:g} | {cost(careless)} | {cost(careful)} | {cost(ours)} "
            f"| {least_and_median(ours, careless)} | {least_and_median(careful, careless)} "
            f"| {least_and_median(ours, careful)} | {careless[0].drift:.0e} | {careful[0].drift:.0e} |"
        )
    return "\n".join(lines)


def coupled_spins(spins: int, links: Any) -> Any:
    """Return Heisenberg's classical spins, S_k' = S_k x (the sum of the spins that k is linked to)."""
    import scipy.sparse as sparse

    M = sparse.kron(links, sparse.identity(3), format="csr")
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), spins), co.Quadratic(M), sign=-1, casimirs={})


def unit_spins(spins: int) -> np.ndarray:
    x = np.random.default_rng(32).normal(size=(spins, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


def others() -> dict[str, tuple[Any, np.ndarray, float]]:
    """Return further systems: each with its initial state or states, and the step."""
    ring = np.roll(np.eye(32), 1, axis=0)
    top = co.Quadratic([1.0, 0.8, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.2, 0.1, 1.0])
    start = np.random.default_rng(5).normal(size=(64, 6))
    return {
        "heavy top, e(3)": (co.LiePoissonSystem(co.algebras.get("e(3)"), top), start[0], 0.2),
        "so(4), diagonal M": (
            co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.linspace(0.6, 1.6, 6))),
            start[1],
            0.2,
        ),
        "ring of 32 spins": (coupled_spins(32, ring + ring.T), unit_spins(32), 0.2),
        "rigid body, 64 members": (co.systems.paper_rigid_body(), 5.0 * start[:, :3], 0.1),
        "heavy top, 64 members": (co.LiePoissonSystem(co.algebras.get("e(3)"), top), start, 0.2),
    }


def alone(rounds: int) -> str:
    lines = [
        "| coadjoint alone, a step of one member | h | 4 stages, ns/step = iterations x ns | 8 stages |",
        "|---|---|---|---|",
    ]
    for title, (system, x0, step) in others().items():
        cells = []
        for stages in (4, 8):
            method = co.GaussLegendre(stages)
            first = solve(system, x0, step, 100, method)
            each = first.nanoseconds * (len(x0) if x0.ndim == 2 else 1)
            steps = max(100, int(1e9 * SECONDS / each))
            cells.append(cost([solve(system, x0, step, steps, method) for _ in range(rounds)]))
        lines.append(f"| {title} | {step:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def chain(rounds: int) -> str:
    import scipy.sparse as sparse

    links = sparse.diags_array([np.ones(CHAIN - 1)] * 2, offsets=[-1, 1])
    system, method = coupled_spins(CHAIN, links), co.GaussLegendre(2)
    runs = [solve(system, unit_spins(CHAIN), 0.05, 10, method) for _ in range(min(rounds, 3))]
    least = min(each.nanoseconds for each in runs)
    found = f"{1e-6 * least:.1f} | {runs[0].iterations:.1f} | {least / runs[0].iterations / CHAIN:.1f}"
    return "\n".join(
        [
            "| coadjoint alone | ms/step | iterations/step | ns a spin and iteration |",
            "|---|---|---|---|",
            f"| chain of {CHAIN} spins, 2 stages, h = 0.05 | {found} |",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Gauss-Legendre methods: coadjoint and hand-written C")
    parser.add_argument("--rounds", type=int, default=21)
    given = parser.parse_args()
    print(against_c(given.rounds), "<!-- details -->", alone(given.rounds), chain(given.rounds), sep="\n\n")


if __name__ == "__main__":
    main()
