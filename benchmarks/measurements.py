"""Write docs/measurements.md from the stored outputs of the benchmarks, ``report/NAME.md``; nothing is measured.

python benchmarks/measurements.py
"""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent
REPORT, PAGE = HERE / "report", HERE.parent / "docs" / "measurements.md"
SUBJECTS = {
    "Single trajectories": {
        "one_trajectory": "One trajectory",
        "large_trajectories": "Large systems",
        "spins": "Spins",
        "spin_models": "Spin models on crystals and of SU(N)",
        "dipoles": "Dipoles by FFT",
        "spins_more": "Spins on other machines",
        "molecules": "Rigid molecules",
        "first_run_of_a_lattice": "First runs of lattices",
        "fluids": "Fluids",
        "fluids_of_two_fields": "Fluids with two fields and layers",
        "fluids_of_higher_order": "Fluids by schemes of higher order",
        "fluids_more": "Fluids on more threads",
        "heat_baths": "Heat baths",
        "gauss_legendre": "Gauss-Legendre",
        "round_off": "Round-off",
        "lyapunov": "Tangent vectors",
    },
    "Many trajectories": {
        "ensembles": "Ensembles",
        "batches": "Batches beside ensembles",
        "members_of_series": "Ensembles by Taylor series",
        "members_with_forces": "Ensembles with forces",
        "families": "Families of runs",
        "dispersions": "Satellites with dispersed numbers",
        "archives": "Archives and workers",
    },
    "Accuracy beside other solvers": {
        "work_against_precision": "Work against precision",
        "work_precision_more": "Further systems",
        "two_bodies": "Two asteroids beside Runge-Kutta methods",
        "systems": "The ready-made systems",
    },
    "Parts of splittings": {
        "automatic_parts": "Automatic parts",
        "fit_cost_model": "Weights of the cost model",
        "free_body": "Free bodies as parts",
        "bonds": "Bonds of spins",
    },
    "Derivatives": {
        "derivatives": "Derivatives of runs",
        "derivatives_with_forces": "Derivatives of runs with forces",
        "derivatives_beside": "Gradients beside other solvers",
    },
    "Exported code, JAX and the browser": {
        "exported_body": "The exported header of free bodies",
        "exported_run": "Exported runs",
        "exported_sizes": "Size and accuracy of exported code",
        "jax_free_body": "Free bodies in JAX",
        "explorer": "The explorer",
    },
    "Calls and preparation": {
        "first_result": "The first result",
        "attitude": "The attitude in short calls",
        "short_calls": "Inputs in short calls",
        "large_calls": "Preparation and calls in many dimensions",
        "cost_curves": "Cost curves",
        "large_algebras": "Large algebras",
        "own_schemes": "Schemes of users",
    },
    "Rules and the build": {
        "rules": "How the rules were tried",
        "coverage": "Coverage of standard errors",
        "building": "Building the kernels",
    },
}
"""Title of each stored section by its name: that of the benchmark that prints it, or of a text kept by hand."""
DETAILS = "<!-- details -->"
"""What a stored output has after this line is not on the page."""
INTRODUCTION = """\
This page collects the measured figures of the documentation: times, ratios to other programs, and how the rules of
the library were tried. [benchmarks](../benchmarks/README.md) describes each measurement. `make bench` measures again
and writes this page; `python benchmarks/measurements.py` writes it from the stored outputs in `benchmarks/report`.
Unless a section says otherwise, the machine was an AMD EPYC of 2023 with two cores, and the programs of a row ran in
turns. Times of loaded machines are processor times.
"""
NEXT = "Next: [User-defined systems, Hamiltonians and forces](extending.md)."


def section(name: str, title: str) -> str:
    """Return a stored section, which begins with a date, with the command that prints it."""
    stored = (REPORT / f"{name}.md").read_text(encoding="utf-8").strip()
    shown, _, details = stored.partition(f"\n\n{DETAILS}")
    command = f"`python benchmarks/{name}.py`, " if (HERE / f"{name}.py").exists() else ""
    more = f"\n\n`benchmarks/report/{name}.md` has the details." if details else ""
    return f"### {title}\n\n{command}{shown}{more}"


def page() -> str:
    """Return the page of all stored sections."""
    parts = ["# Measurements", INTRODUCTION.strip()]
    for subject, sections in SUBJECTS.items():
        stored = {name: title for name, title in sections.items() if (REPORT / f"{name}.md").exists()}
        parts += [f"## {subject}", *(section(name, title) for name, title in stored.items())]
    return "\n\n".join([*parts, NEXT]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
