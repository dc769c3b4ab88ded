"""Checks of the installed package, on all schemes and seven systems; each yields measurements with their bounds."""

from __future__ import annotations

import importlib.resources
import json
import math
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra import catalogue
from coadjoint.analysis.certificates.certificate import HOLDS, Row
from coadjoint.analysis.certificates.certify import certify
from coadjoint.errors import in_one_line
from coadjoint.methods import registry
from coadjoint.methods.forced import check_supports
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.isospectral_gauss import IsospectralGauss
from coadjoint.methods.protocol.method import Method
from coadjoint.optional_packages import EXTRAS, installed
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems

Array = NDArray[Any]

SYSTEM_NAMES = {
    "so(3)": "rigid_body",
    "se(3)": "heavy_top",
    "so(4)": "so_n_body",
    "A3,7": "paper_a37",
    "su(3)": "",
    "so(5)": "matrix_body",
    "torus": "torus_euler",
}


@cache
def systems() -> Mapping[str, Any]:
    """Return the systems by the name of their algebra: bodies, a top, a solvable algebra, matrices."""
    factories = ready_made_systems()
    result = {key: factories[name]() for key, name in SYSTEM_NAMES.items() if name not in ("", "torus_euler")}
    result["su(3)"] = LiePoissonSystem(catalogue.get("su(3)"), Quadratic(np.linspace(0.5, 2.25, 8)), name="su(3)")
    result["torus"] = factories["torus_euler"](N=5)
    return {key: result[key] for key in SYSTEM_NAMES}


def state_of(system: Any, number: int = 0) -> Array:
    """Return a state of cosines of 1 + `number`, 2 + `number`, ...; a random one for complex matrices."""
    if not system.has_matrices:
        return np.cos(1.0 + number + np.arange(system.dim))
    if system.complex:
        return np.asarray(system.random(1 + number, degrees=(1, 2)))  # type: ignore[attr-defined]
    return as_matrix(np.cos(1.0 + number + np.arange(10)), 5)


def as_matrix(entries: Array, n: int) -> Array:
    """Return the skew matrix with the given entries below the diagonal, row by row."""
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n, -1)] = entries
    return matrix - matrix.T


@cache
def references() -> Mapping[str, Array]:
    """Return reference states at t = 1, computed with 40 digits; the torus has none."""
    file = importlib.resources.files(__package__) / "selftest_references.json"
    states = json.loads(file.read_text(encoding="utf-8"))["states"]
    return {key: as_matrix(np.array(state), 5) if key == "so(5)" else np.array(state) for key, state in states.items()}


def schemes(index: int = 0) -> list[Method]:
    """Return one example of every scheme of the library, by default the first."""
    kinds = [registry.scheme(name) for name in registry.names()]
    return [kind.examples()[index] for kind in kinds if kind.__module__.startswith("coadjoint.")]


def more_schemes() -> list[Method]:
    """Return the first and last example of every scheme, such as one of a higher order."""
    return list(dict.fromkeys([*schemes(), *schemes(-1)]))


def supported_systems(method: Method) -> dict[str, Any]:
    """Return the systems that a scheme supports, by name."""
    supported = {}
    for key, system in systems().items():
        try:
            check_supports(system, method)
        except (TypeError, ValueError):
            continue
        supported[key] = system
    return supported


STEP = 1 / 16  # a power of two, so that sums of times are exact
ORDER_TOLERANCE = 0.5
"""Allowed deficit of the order measured from two finite steps."""
CERTIFIED_STEPS = 100  # enough for a drift to show beside rounding, in a second for all schemes
MAX_NAME_LENGTH = 32  # characters of the name of a scheme
CHECK_DESCRIPTIONS = {
    "symmetry": "a step back undoes a step",
    "reversibility": "reversibility",
    "poisson": "Poisson bracket",
    "energy": "energy",
    "casimir": "Casimirs",
    "group": "group elements off the group",
    "spatial momentum": "spatial momentum",
    "reference": "off the limit of small steps",
    "attitude": "off the limit of group elements",
}
"""Reported properties of certificates, by the beginning of their row keys."""


@dataclass(frozen=True)
class Finding:
    """Result of one check, with its value, its bound (a lower one if `least`), and the subject nearest to failing."""

    what: str
    measured: float = math.nan
    allowed: float = math.nan
    where: str = ""
    least: bool = False
    skipped: str = ""

    @property
    def passed(self) -> bool:
        if self.skipped:
            return True
        return self.measured >= self.allowed if self.least else self.measured <= self.allowed

    def __str__(self) -> str:
        if self.skipped:
            return f"skip  {self.what:42}  {self.skipped}"
        verdict, bound = "ok" if self.passed else "FAIL", "at least" if self.least else "at most"
        numbers = f"{self.measured:9.3g}   {bound:8}  {self.allowed:7.2g}"
        return f"{verdict:4}  {self.what:42}  {numbers}  {self.where}".rstrip()


def rounding(system: Any, steps: int, work: float) -> float:
    """Return the round-off bound of a state of size one: 4 n u per evaluation of each step (u = 2^-53)."""
    return 4.0 * float(system.dim) * UNIT_ROUNDOFF * steps * (work + 1.0)


def motions() -> Iterator[Finding]:
    """Compare a high-order scheme with reference states computed with 40 digits."""
    for key, reference in references().items():
        system = systems()[key]
        method: Method = IsospectralGauss(6) if system.has_matrices else GaussLegendre(6)
        solution = integrate(system, state_of(system), (0.0, 1.0), STEP, method)
        allowed = rounding(system, solution.stats.steps, solution.stats.evaluations / solution.stats.steps)
        yield Finding(f"motion on {key}", float(abs(solution.x[-1] - reference).max()), allowed, str(method))


def orders() -> Iterator[Finding]:
    """Measure the order of every constant-step scheme from two steps, against reference states of 40 digits."""
    for method in more_schemes():
        if method.own_steps:  # their lengths do not follow from the step
            continue
        slopes = {}
        for key, system in supported_systems(method).items():
            if key not in references():
                continue
            errors, floor = [], 0.0
            for step in (STEP, STEP / 2):
                solution = integrate(system, state_of(system), (0.0, 1.0), step, method)
                errors.append(float(abs(solution.x[-1] - references()[key]).max()))
                work = solution.stats.evaluations / solution.stats.steps
                floor = max(floor, rounding(system, solution.stats.steps, work))
            # Errors at the round-off floor have no slope.
            slopes[key] = math.inf if errors[1] <= floor else math.log2(errors[0] / errors[1])
        measurable = [key for key, slope in slopes.items() if slope < math.inf]
        if measurable:
            worst = min(measurable, key=lambda key: slopes[key])
            yield Finding(
                f"order of {_scheme_name(method)}", slopes[worst], method.order - ORDER_TOLERANCE, worst, least=True
            )
        elif slopes:
            exact = "within rounding at the smaller step"
            yield Finding(
                f"order of {_scheme_name(method)}", math.inf, method.order - ORDER_TOLERANCE, exact, least=True
            )


def certificates() -> Iterator[Finding]:
    """Certify schemes on every supported system; yield for each property the case nearest to failing.

    Schemes that choose their own steps are omitted: their certificates take half a minute.
    """
    rows: dict[str, list[tuple[str, Row]]] = {}
    failing, count = [], 0
    for method in (each for each in schemes() if not each.own_steps):
        for key, system in supported_systems(method).items():
            certificate = certify(system, method, state_of(system), STEP / 2, steps=CERTIFIED_STEPS)
            count += 1
            for row in certificate.table:
                if row.claimed and row.verdict != HOLDS:
                    failing.append(f"{_scheme_name(method)} on {key}: {row.what}")
                kind = next((kind for kind in CHECK_DESCRIPTIONS if row.key.startswith(kind)), None)
                if kind and row.claimed and row.value is not None and row.bound:
                    rows.setdefault(kind, []).append((f"{_scheme_name(method)} on {key}", row))
    for kind, description in CHECK_DESCRIPTIONS.items():
        if kind in rows:
            where, row = max(rows[kind], key=lambda entry: _bound_ratio(entry[1]))
            yield Finding(f"{description}, {len(rows[kind])} times", row.value or 0.0, row.bound or 0.0, where)
    yield Finding(f"of {count} certificates fail", float(len(failing)), 0.0, "; ".join(failing)[:200])


def _scheme_name(method: Method) -> str:
    return in_one_line(str(method), MAX_NAME_LENGTH)


def _bound_ratio(row: Row) -> float:
    return (row.value or 0.0) / (row.bound or 1.0)


def same_bits() -> Iterator[Finding]:
    """Run members alone, in ensembles, on threads, saved and watched or not; count those whose bits differ."""
    differing_members, differing_output, count = [], [], 0
    for method in more_schemes():
        for key, system in supported_systems(method).items():
            x0 = np.array([state_of(system, number) for number in range(5)])
            together = integrate(system, x0, (0.0, 1.0), STEP, method, threads=1)
            reversed_members = integrate(system, x0[::-1], (0.0, 1.0), STEP, method, threads=2)
            single = integrate(system, x0[3], (0.0, 1.0), STEP, method)
            sparse = integrate(system, x0[3], (0.0, 1.0), STEP, method, save_every=5, watch=False)
            count += 1
            if not (_same(together.x, reversed_members.x[:, ::-1]) and _same(together.x[:, 3], single.x)):
                differing_members.append(f"{_scheme_name(method)} on {key}")
            if not _same(sparse.x[-1], single.x[-1]):
                differing_output.append(f"{_scheme_name(method)} on {key}")
    yield Finding(
        f"bits alone, in ensembles, on threads: {count}",
        float(len(differing_members)),
        0.0,
        "; ".join(differing_members)[:200],
    )
    yield Finding(
        f"bits saved and watched or not: {count}", float(len(differing_output)), 0.0, "; ".join(differing_output)[:200]
    )


def _same(first: Any, second: Any) -> bool:
    return np.ascontiguousarray(first).tobytes() == np.ascontiguousarray(second).tobytes()


def interpreted_steps() -> Iterator[Finding]:
    """Compare a step of the compiled kernels with one in Python; yield the scheme with the largest difference."""
    worst, count = (0.0, 1.0, ""), 0
    for method in more_schemes():
        for key, system in supported_systems(method).items():
            x = state_of(system)
            solution = integrate(system, x, (0.0, STEP), STEP, method)
            plain = np.asarray(method.step(system, x, 0.0, STEP))
            error = float(abs(solution.x[-1] - plain).max())
            allowed = rounding(system, 1, max(1.0, float(solution.stats.evaluations)))
            count += 1
            if error / allowed >= worst[0] / worst[1]:
                worst = error, allowed, f"{_scheme_name(method)} on {key}"
    yield Finding(f"compiled steps beside Python: {count}", *worst)


def resumed() -> Iterator[Finding]:
    """Interrupt runs and resume their archives; count those whose bits differ from the uninterrupted run."""
    missing = [name for name in ("xarray", "zarr") if not installed(name)]
    if missing:
        extra = EXTRAS[missing[0]]
        yield Finding("cut and resumed", skipped=f'{missing[0]} is not installed: pip install "coadjoint[{extra}]"')
        return
    from coadjoint.files.archives.resume import resume

    differing, count = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for method in schemes():
            key, system = next(iter(supported_systems(method).items()))
            x0 = np.array([state_of(system, number) for number in range(2)])
            uninterrupted = integrate(system, x0, (0.0, 1.0), STEP, method)
            path = Path(folder, f"{count}.zarr")
            integrate(system, x0, (0.0, 5 * STEP), STEP, method, archive=path)
            count += 1
            if not _same(np.asarray(resume(path, t_end=1.0).x), uninterrupted.x):
                differing.append(f"{_scheme_name(method)} on {key}")
    yield Finding(f"cut and resumed: {count}", float(len(differing)), 0.0, "; ".join(differing)[:200])


CHECKS = (motions, orders, certificates, same_bits, interpreted_steps, resumed)


def selftest() -> Iterator[Finding]:
    """Check the installed package on this machine; yield each measurement with its bound.

    All schemes run on seven systems; checks that need a missing optional package are skipped, with the reason.

    >>> from itertools import islice
    >>> all(found.passed for found in islice(selftest(), 3))
    True
    """
    for check in CHECKS:
        findings: list[Finding] = []
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                findings.extend(check())
        except Exception as error:
            # A check that raises an error has failed; the others still run.
            findings.append(
                Finding(f"{check.__name__} ended", 1.0, 0.0, in_one_line(f"{type(error).__name__}: {error}"))
            )
        yield from findings
