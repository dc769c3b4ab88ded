"""Write `docs/api.md`, every public name with the first sentence of its text, and what editors read.

That are the names of systems, and `docs/configuration.schema.json`, what `coadjoint schema` prints.
``python docs/write_api.py`` writes all three.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import coadjoint as co
from coadjoint import commands
from coadjoint.analysis.certificates.certificate import Row
from coadjoint.files.configuration.schema import schema
from coadjoint.runs.run_record import Drift
from coadjoint.runs.stepper import Stepper
from coadjoint.systems.forced import ForcedSystem

PAGE = Path(__file__).with_name("api.md")
SCHEMA = Path(__file__).with_name("configuration.schema.json")
PACKAGE = Path(co.__file__).parent
SYSTEMS = PACKAGE / "systems" / "__init__.pyi"
MEMBERS_OF = (
    ("A Lie algebra", co.LieAlgebra),
    ("A polynomial", co.Polynomial),
    ("A system", co.LiePoissonSystem),
    ("A system without an algebra", co.PoissonSystem),
    ("A system of matrices", co.MatrixSystem),
    ("An algebra of matrices", co.MatrixAlgebra),
    ("A system with forces", ForcedSystem),
    ("A force", co.forces.Force),
    ("A scheme", co.methods.Method),
    ("A splitting, in addition", co.Splitting),
    ("A solution", co.Solution),
    ("A drift", Drift),
    ("A prepared run", co.PreparedRun),
    ("A stepper", Stepper),
    ("A choice", co.Choice),
    ("Frequencies", co.Frequencies),
    ("A phase drift", co.PhaseDrift),
    ("A certificate", co.Certificate),
    ("A row of a certificate", Row),
    ("A modified field", co.ModifiedField),
    ("A corrector", co.Corrector),
)
USED = {
    "analysis.checks.growth": ("growth", "Growth"),
    "analysis.checks.slope": ("slope", "Slope"),
    "analysis.frequencies": ("Combinations",),
    "analysis.line_drift": ("line_drift",),
    "analysis.order": ("fit_order", "OrderFit"),
    "analysis.periods": ("period", "Period"),
    "analysis.phase": ("phase_error",),
    "analysis.phase_drift": ("drift_of_series",),
    "analysis.poisson_defect": ("poisson_defect", "defect_of_tangent", "PoissonDefect"),
    "analysis.predicted_drift": ("PredictedDrift",),
    "analysis.rotations": ("attitude_angle", "precession_error", "twist"),
    "analysis.round_off": ("round_off", "random_walk", "orthogonality", "spatial_momentum", "RandomWalk"),
    "analysis.backward_error.field_of_step": ("field_of_series", "field_at"),
    "analysis.backward_error.exact_field": ("ExactField",),
    "analysis.backward_error.field_at_points": ("FieldAtPoints",),
    "experiments.selftest.findings": ("Finding",),
    "experiments.selftest.run": ("selftest",),
    "files.configuration.configuration": ("load", "Configuration"),
    "files.datasets.export": ("dataset_of", "rebuild", "solution_inputs", "mark_failed"),
    "files.configuration.schema": ("schema",),
    "files.output.output_files": ("write_dataset", "write_figure", "write_page", "write_text"),
    "methods.registry": ("forget", "scheme", "parameters_of", "from_description", "description_of"),
    "methods.suggested_scheme": ("suggested_scheme",),
    "pictures.certificate": ("draw_certificate",),
    "pictures.gallery": ("gallery", "piece"),
    "pictures.level_surface": ("level_surface",),
    "pictures.phase_drift": ("draw_phase_drift",),
    "pictures.register": ("CannotShow", "kind", "kinds", "read_picture"),
    "pictures.solution": ("draw_solution",),
    "program.table": ("Program",),
    "runs.system_summary": ("system_text", "summarize_system"),
    "runs.example_run": ("run_example",),
    "systems.description": ("description",),
    "systems.forces.registry": ("from_description",),
    "systems.bodies.goryachev_chaplygin_top": ("goryachev_chaplygin_integral",),
    "systems.hamiltonians.hamiltonian": ("HamiltonianLike",),
    "systems.matrices.function_stream": ("FunctionStream",),
    "systems.matrices.streams": ("Circulants", "DiagonalSolve", "Weights"),
    "systems.registry": ("ready_made", "gallery_entry_of", "gallery_systems"),
    "systems.gallery_entry": ("Picture", "GalleryEntry"),
    "systems.hamiltonians.terms": ("QuadraticTerm", "PolynomialTerm", "FunctionTerm"),
}
"""What users call that no short name leads to."""
HEAD = """# Every public name

This page is for people who look for a function, a class or a command. It lists each with the first sentence of its
docstring, and the file in which it is. In Python, `help(co.integrate)` shows the whole docstring: parameters with their
shapes, what is returned, what is refused, examples. [terms.md](terms.md) explains the words.

`python docs/write_api.py` writes this page, and a test checks that it is up to date.
"""


def written_schema() -> str:
    """Return the text of the schema of configuration files."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def page() -> str:
    """Return the text of the page."""
    return "\n".join([HEAD, *_sections()]) + "\n"


def names_of_systems() -> str:
    """Return what type checkers and editors read of `co.systems`, whose functions are found when it is imported."""
    functions = {name: getattr(co.systems, name).__module__ for name in co.systems.names()}
    lines = sorted(f"from {module} import {name} as {name}" for name, module in functions.items())
    kinds = ("lie_poisson", "LiePoissonSystem"), ("poisson", "PoissonSystem")
    imports = sorted([*lines, *(f"from coadjoint.systems.{file} import {name}" for file, name in kinds)])
    listed = "\n".join(f'    "{name}",' for name in co.systems.__all__)
    return f"""# For type checkers and editors; docs/write_api.py writes it: a system is one file, and registers itself.

from typing import Any

{chr(10).join(imports)}

__all__ = [
{listed}
]

def names() -> tuple[str, ...]: ...
def get(name: str, **parameters: Any) -> LiePoissonSystem | PoissonSystem: ...
"""


def _sections() -> Iterator[str]:
    yield _table("The package", [(f"co.{name}", getattr(co, name)) for name in co.__all__])
    algebras = co.algebras
    yield _table("Algebras", [(f"co.algebras.{name}", getattr(algebras, name)) for name in algebras.__all__])
    families = ", ".join(f"`{name}`" for name in algebras.names() if not name.startswith("A"))
    real = ", ".join(f"`{name}`" for name in algebras.names() if name.startswith("A"))
    yield f"`co.algebras.get` knows the families {families}, and the real algebras of dimension 2 to 5: {real}.\n"
    systems = [*co.systems.names(), "get", "names"]
    yield _table("Ready-made systems", [(f"co.systems.{name}", getattr(co.systems, name)) for name in systems])
    forces = co.forces
    yield _table(
        "Forces ([forces.md](forces.md))", [(f"co.forces.{name}", getattr(forces, name)) for name in forces.__all__]
    )
    yield _table(
        "Schemes of your own ([own_schemes.md](own_schemes.md))",
        [(f"co.methods.{name}", getattr(co.methods, name)) for name in co.methods.__all__],
    )
    for title, kind in MEMBERS_OF:
        yield _table(title, list(_members(kind)))
        if attributes := ", ".join(f"`{name}`" for name in sorted(_attributes(kind))):
            yield f"Attributes of a `{kind.__name__}`: {attributes}.\n"
    yield "## Further names\n\nThese come from their files: `from coadjoint.analysis.order import fit_order`.\n"
    rows = [
        (f"coadjoint.{module}.{name}", getattr(importlib.import_module(f"coadjoint.{module}"), name))
        for module, names in USED.items()
        for name in names
    ]
    yield _table("", rows)
    lines = [
        f"| `coadjoint {name}` | {_sentence(command.help or '')} |"
        for name, command in sorted(commands.commands.commands.items())
    ]
    yield "\n".join(["## The command\n", "| command | |", "|---|---|", *lines])
    yield "\n`coadjoint COMMAND --help` shows the options. [files.md](files.md) describes configuration files."


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield what a class says itself, and what it has of the classes of its own file or folder."""
    beyond = co.methods.Method if kind is co.Splitting else None
    for name in sorted(dir(kind)):
        value = inspect.getattr_static(kind, name)
        told = inspect.isfunction(value) or isinstance(value, property | classmethod | staticmethod)
        told = told or type(value).__name__ == "cached_property"
        if name.startswith("_") or not told or (beyond is not None and hasattr(beyond, name)):
            continue
        yield f"{kind.__name__}.{name}", getattr(kind, name) if not isinstance(value, property) else value


def _attributes(kind: type) -> set[str]:
    """Return the names that a class and those it derives from annotate."""
    named = {name for base in kind.__mro__ for name in inspect.get_annotations(base) if not name.startswith("_")}
    return named - {name.rpartition(".")[2] for name, _ in _members(kind)}


def _table(title: str, rows: Iterable[tuple[str, Any]]) -> str:
    lines = [f"| `{name}` | {_summary(value)} | {_place(value)} |" for name, value in rows]
    head = ["| name | | text |", "|---|---|---|"] if lines else []
    return "\n".join([*([f"## {title}\n"] if title else []), *head, *lines, *([""] if lines else [])])


def _summary(value: Any) -> str:
    if isinstance(value, str):
        return "The version."
    return _sentence(inspect.getdoc(value) or "")


def _sentence(text: str) -> str:
    """Return the first sentence of a docstring in one line."""
    paragraph = " ".join(text.partition("\n\n")[0].split()).replace("``", "`")
    return re.split(r"(?<=[\w)`\]][.])\s+(?=[A-Z`])", paragraph)[0].replace("|", "\\|")


def _place(value: Any) -> str:
    if isinstance(value, str):
        value = co
    plain = getattr(value, "fget", None) or getattr(value, "func", None) or value
    try:
        file = inspect.getsourcefile(inspect.unwrap(plain)) or ""
    except TypeError:
        file = ""
    if not file:
        return ""
    found = Path(file).resolve().relative_to(PACKAGE.resolve()).as_posix()
    return f"[{found}](../src/coadjoint/{found})"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    SYSTEMS.write_text(names_of_systems(), encoding="utf-8")
    SCHEMA.write_text(written_schema(), encoding="utf-8")
