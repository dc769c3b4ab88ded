"""Write the tables of the explorer: ``python docs/write_explorer.py FOLDER`` writes ``tables.json``.

For every system and scheme the tables that the compiled loops read, and the watched invariants, at the first values of
the sliders; and for every entry that depends on them, the coefficient of the energy that it is a multiple of, which the
tables record, as a formula of the sliders. All are compared with the tables of the library at other values, bit for
bit.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from explorer_formulas import energy_formulas, evaluate
from explorer_systems import SHOWN, Shown, Values

import coadjoint as co
from coadjoint.kernels.interface import interface_text
from coadjoint.runs.loops.loops import loops_of_system

VERSION = 3
# Name in the page, code of the scheme, and its title.
SCHEMES = (
    ("splitting2", "co.Splitting(order=2)", "Splitting, order 2"),
    ("splitting4", "co.Splitting(order=4)", "Splitting, order 4"),
    ("rk4", "co.ExplicitRungeKutta()", "Runge-Kutta, order 4"),
    ("gauss", "co.GaussLegendre(stages=2)", "Gauss-Legendre, order 4"),
    ("taylor", "co.Taylor()", "Taylor, order 16"),
)
OF_MATRICES = (
    ("isospectral2", "co.IsospectralGauss()", "Isospectral midpoint, order 2"),
    ("isospectral4", "co.IsospectralGauss(stages=2)", "Isospectral Gauss, order 4"),
)
# Fields with the brackets of the algebra.
BRACKETS = (".state.constants", ".field.constant")
CHECKED = 12  # values of the sliders at which all tables are compared
STEPS = (1.0, 0.37)


def flat(table: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the fields of a table and of the tables inside of it, by path."""
    for name, value in zip(table._fields, table, strict=True):
        if hasattr(value, "_fields"):
            yield from flat(value, f"{path}{name}.")
        else:
            yield path + name, value


def tables_of(shown: Shown, scheme: str, values: Values, h: float) -> tuple[dict[str, Any], Any]:
    """Return the loop of a scheme, its tables and the watched invariants, by path, and the loops."""
    system = shown.build(values)
    loops = loops_of_system(system, eval(scheme, {"co": co}), h, shown.attitude or None)
    found = {f"tables.{path}": value for path, value in flat(loops.compiled[0].tables)}
    found |= {f"watch.{path}": value for path, value in flat(loops.watches[0].tables)}
    if "tables.step" in found and isinstance(found["tables.step"], np.ndarray):
        found["tables.step"] = np.array(
            [int(bool(shown.start))]
        )  # the Taylor or the isospectral one, for an address here
    return found, loops


def trial(shown: Shown, random: np.random.Generator) -> Values:
    """Return values within the ranges of the sliders, with ten random bits: their squares are exact."""
    return {slider.name: round(random.uniform(slider.low, slider.high) * 1024) / 1024 for slider in shown.sliders}


def on_grid(shown: Shown, random: np.random.Generator) -> Values:
    """Return values that the sliders of the page can have."""
    found = {}
    for slider in shown.sliders:
        count = round((slider.high - slider.low) / slider.step)
        found[slider.name] = float(format(slider.low + slider.step * random.integers(count + 1), ".6g"))
    return found


def code_of(scheme: str, shown: Shown) -> str:
    """Return the code of a scheme for a system, whose splittings may have parts of their own."""
    with_parts = shown.parts and scheme.startswith("co.Splitting(")
    return f"{scheme[:-1]}, parts={shown.parts})" if with_parts else scheme


def first_values(shown: Shown) -> Values:
    """Return the first values of the sliders."""
    return {slider.name: slider.value for slider in shown.sliders}


def schemes_of(shown: Shown) -> tuple[tuple[str, str, str], ...]:
    """Return the schemes of a system."""
    return OF_MATRICES if shown.start else SCHEMES


def planet_entry(shown: Shown) -> dict[str, Any]:
    """Return the modes of a flow on a sphere, and its schemes without the numbers that the page computes."""
    system, schemes = shown.build(first_values(shown)), {}
    for name, scheme, _ in OF_MATRICES:
        base, loops = tables_of(shown, scheme, first_values(shown), STEPS[0])
        # The numbers of the scheme are followed by a constant, of two numbers for each entry, and by two tables.
        base["tables.tables.coefficients"] = base["tables.tables.coefficients"][: -4 * system.algebra.N**2]
        base["tables.tables.whole"][6:9] = 0  # addresses here
        base["tables.tables.field.first"] = np.zeros(1)
        base |= {path: 0 * value for path, value in base.items() if path.startswith("watch.")}
        fields = {path: written(value) for path, value in base.items()}
        schemes[name] = {"code": scheme, "loop": loops.compiled[0].name, "fields": fields, "moves": {}}
    modes = system.mode_array(shown.initial(system))
    rows = [[int(l), int(m), modes[l, m].real, modes[l, m].imag] for l, m in np.argwhere(np.abs(modes) > 1e-9)]
    return {"start": shown.start, "modes": rows, "schemes": schemes}


def moved(shown: Shown, system: Any, loops: Any, base: dict[str, Any]) -> dict[str, Any]:
    """Return by path the entries that depend on the sliders, each with a factor and a formula."""
    terms, energy = system.hamiltonian.terms(), energy_formulas(shown)
    formulas: list[tuple[str, float] | None] = []
    for term in terms:
        form = term.form
        keys = [(i,) for i in range(system.dim)] + [
            (min(i, j), max(i, j)) for i, j in zip(form.rows, form.indices, strict=True)
        ]
        formulas += [(energy[key], 2.0 if len({*key}) < len(key) else 1.0) if key in energy else None for key in keys]
    formulas.append((energy[()], 1.0) if () in energy else None)
    found: dict[str, Any] = {}
    for name, loop in (("tables.", loops.compiled[0]), ("watch.", loops.watches[0])):
        for path, multiples in loop.sources().within(name).multiples.items():
            for index, number, factor in zip(*map(np.ndarray.tolist, multiples), strict=True):
                if (formula := formulas[number]) is not None:
                    found.setdefault(path, []).append([index, formula[0], factor * formula[1]])
    if shown.brackets:
        unit = evaluate(shown.brackets, first_values(shown))
        for path in (path for path in base if path.endswith(BRACKETS)):
            at = np.flatnonzero(base[path]).tolist()
            found[path] = [[index, shown.brackets, base[path][index] / unit] for index in at]
    return found


def check(shown: Shown, scheme: str, base: dict[str, Any], moves: dict[str, Any], values: Values) -> None:
    """Raise ValueError if the moved tables are not those of the library."""
    expected, _ = tables_of(shown, scheme, values, STEPS[1])
    for path, value in base.items():
        if path == "tables.tau":
            value = value * STEPS[1]  # the base has the step 1
        elif path == "tables.step" and not isinstance(value, np.ndarray):
            value = STEPS[1]
        value = np.array(value)
        for index, formula, factor in moves.get(path, ()):
            value[index] = factor * evaluate(formula, values)
        if not np.array_equal(value, expected[path]):
            raise ValueError(f"{shown.name}, {scheme}: {path} is {value}, not {expected[path]}, for {values}")


def written(value: Any) -> Any:
    """Return a field for JSON; a float that is a whole number becomes an integer."""
    if isinstance(value, np.ndarray):
        return [int(x) if x == int(x) else x for x in value.tolist()]
    return int(value) if value == int(value) else value


def entry(shown: Shown, random: np.random.Generator) -> dict[str, Any]:
    """Return everything that the page needs of a system."""
    schemes: dict[str, Any] = {}
    invariants: list[str] = []
    sources: dict[str, int] = {}
    system = shown.build(first_values(shown))
    for name, scheme, _ in () if shown.start else SCHEMES:
        scheme = code_of(scheme, shown)
        base, loops = tables_of(shown, scheme, first_values(shown), STEPS[0])
        moves = moved(shown, system, loops, base)
        for k in range(CHECKED):
            check(shown, scheme, base, moves, on_grid(shown, random) if k % 2 else trial(shown, random))
        fields = {path: written(value) for path, value in base.items()}
        schemes[name] = {"code": scheme, "loop": loops.compiled[0].name}
        numbered = {
            path: [[index, sources.setdefault(formula, len(sources)), factor] for index, formula, factor in entries]
            for path, entries in moves.items()
        }
        schemes[name] |= {"fields": fields, "moves": numbered}
        invariants = loops.names
    return {
        "title": shown.title,
        "text": shown.text,
        "code": shown.code,
        "sliders": [vars(slider) for slider in shown.sliders],
        "sources": list(sources),
        "x0": shown.x0,
        "coordinates": shown.coordinates,
        "invariants": invariants,
        "view": shown.view,
        "step": shown.step,
        "schemes": schemes,
        **(planet_entry(shown) if shown.start else {}),
    }


def rows_of_parts() -> dict[str, list[dict[str, Any]]]:
    """Return the flows of splittings into one to three coordinates, for an algebra that is typed in the page."""
    found: dict[str, list[dict[str, Any]]] = {}
    for name, scheme, _ in SCHEMES:
        if not scheme.startswith("co.Splitting"):
            continue
        method = eval(f"{scheme[:-1]}, parts='coordinates')", {"co": co})
        for count in (1, 2, 3):
            energy = co.Quadratic([1.0] * count + [0.0] * (3 - count))
            loops = loops_of_system(co.LiePoissonSystem(co.algebras.so(3), energy), method, STEPS[0])
            tables = loops.compiled[0].tables
            rows = {path: written(getattr(tables, path)) for path in ("part", "tau", "moment", "section")}
            found.setdefault(name, []).append(rows)
    return found


def shared(entries: dict[str, Any]) -> dict[str, Any]:
    """Return the systems with equal lists of fields replaced by their number in one list."""
    number: dict[str, int] = {}
    for system in entries.values():
        for scheme in system["schemes"].values():
            for path, value in scheme["fields"].items():
                if isinstance(value, list) and len(value) > 2:
                    scheme["fields"][path] = {"": number.setdefault(json.dumps(value), len(number))}
    return {"arrays": [json.loads(text) for text in number], "systems": entries}


def main() -> None:
    """Write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(1)
    entries = {shown.name: entry(shown, random) for shown in SHOWN}
    data = {
        "version": VERSION,
        "library": co.__version__,
        "interface": interface_text(),
        "schemes": [{"name": name, "code": code, "title": title} for name, code, title in (*SCHEMES, *OF_MATRICES)],
        "rows": rows_of_parts(),
        **shared(entries),
    }
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False)
    (folder / "tables.json").write_text(text + "\n", encoding="utf-8")
    print(f"{len(entries)} systems, {len(text) // 1000} kB")


if __name__ == "__main__":
    main()
