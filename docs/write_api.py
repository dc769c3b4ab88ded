"""Write `docs/api.md`, every public name with the first sentence of its text, and what editors and reviewers read.

That are the names of systems, `docs/configuration.schema.json`, what `coadjoint schema` prints, and
`docs/public_names.txt`, every public name with its parameters. ``python docs/write_api.py`` writes all four.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import coadjoint as co
from coadjoint import commands
from coadjoint.analysis.certificates.certificate import Row
from coadjoint.analysis.energy_paths import EnergyPath
from coadjoint.analysis.hysteresis import Hysteresis
from coadjoint.analysis.thermal_averages import Estimate, ThermalAverages
from coadjoint.files import ovf
from coadjoint.files.configuration.schema import schema
from coadjoint.files.crystals.magnetic_structure import MagneticStructure
from coadjoint.runs.results.quantities import Drift
from coadjoint.runs.stepper import Stepper
from coadjoint.systems.lattices.bonds import Bond, Site
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.crystals import Crystal
from coadjoint.systems.lattices.declared_spins import ExchangeTable
from coadjoint.systems.lattices.spin_model import SpinModel

PAGE = Path(__file__).with_name("api.md")
SCHEMA = Path(__file__).with_name("configuration.schema.json")
SIGNATURES = Path(__file__).with_name("public_names.txt")
PACKAGE = Path(co.__file__).parent
SYSTEMS = PACKAGE / "systems" / "__init__.pyi"
MEMBERS_OF = (
    (
        "A Lie algebra",
        co.LieAlgebra,
        "basis bracket casimirs closure coadjoint dim from_brackets from_matrices generic_rank name representation "
        "structure_matrix",
    ),
    (
        "A polynomial",
        co.Polynomial,
        "degree derivative dim gradient hessian monomials to_latex to_sympy variable",
    ),
    (
        "A system",
        co.System,
        "energy exact hamiltonian_field jacobian parameters power shape structure_matrix unforced "
        "vector_field with_forces",
    ),
    ("A system of matrices, in addition", co.MatrixSystem, "from_vector in_numbers spectrum stream_of to_vector"),
    ("An algebra of matrices", co.MatrixAlgebra, "basis bracket dim pairing projected shape"),
    ("A force", co.forces.Force, "check describe_to field flow parameters"),
    (
        "A scheme",
        co.methods.Method,
        "examples explicit flow_table order properties step symmetric tangent work",
    ),
    ("A splitting, in addition", co.Splitting, "describe processor sweeps tuned"),
    ("A crystal", Crystal, "bonds site subcrystal"),
    ("A bond of a crystal", Bond, "exchange"),
    ("A field of vectors in a file", ovf.OvfField, "spins"),
    ("A magnetic structure", MagneticStructure, "state"),
    ("A site of a crystal", Site, "single_ion"),
    ("A table of exchange", ExchangeTable, ""),
    (
        "A spin model on a crystal",
        SpinModel,
        "biquadratic cells dipolar dzyaloshinskii_moriya exchange field moments periodic positions single_ion sites "
        "size spin substitute twist units vacancies",
    ),
    (
        "A spin model of SU(N), in addition",
        CoherentSpinModel,
        "biquadratic coherent dipoles expectation from_amplitudes pair_coupling random single_ion",
    ),
    (
        "A spin model of SU(N), in addition",
        CoherentSpinModel,
        "biquadratic coherent dipoles expectation from_amplitudes pair_coupling random single_ion",
    ),
    ("Mass properties", co.bodies.MassProperties, "about axes moments"),
    (
        "A solution",
        co.Solution,
        "at balance change drift error_estimate modified_energy movie plot rotation spectrum step_error to_ovf "
        "to_pandas to_xarray",
    ),
    ("A drift", Drift, "growth"),
    ("A prepared run", co.PreparedRun, "end jvp parameters run vjp"),
    ("A stepper", Stepper, "both group tangent tangent_by"),
    ("A choice", co.Choice, ""),
    ("Frequencies", co.Frequencies, "combinations"),
    ("Thermal states", co.ThermalStates, ""),
    ("Thermal averages", ThermalAverages, ""),
    ("An average with its error", Estimate, ""),
    ("A hysteresis loop", Hysteresis, "coercive_fields switching_fields"),
    ("A path of minimum energy", EnergyPath, ""),
    ("A structure factor", co.spectra.StructureFactor, "broadened density energies integrated plot"),
    ("Linear modes", co.spectra.LinearModes, "energies plot spectrum stable"),
    ("What neutrons measure", co.spectra.Neutrons, "form_factor"),
    ("An autocorrelation", co.spectra.Autocorrelation, ""),
    ("An orbit", co.orbits.Orbit, "at local_frame local_rate sun sunlight within"),
    ("A log of attitudes", co.attitudes.AttitudeLog, "of t_span"),
    ("A phase drift", co.PhaseDrift, "growth plot"),
    ("A certificate", co.Certificate, "failures passed plot to_json to_mapping"),
    ("A row of a certificate", Row, ""),
    ("A check-case", co.checkcases.CheckCase, "columns compare end reference spread write"),
    ("A comparison with a check-case", co.checkcases.Comparison, "columns passed plot"),
    ("A modified field", co.ModifiedField, "first_error keeps skew_matrix terms values"),
    ("A corrector", co.Corrector, "inverse"),
)
"""Title, class, and the members that users need."""
ATTRIBUTES_NOT_LISTED = (
    co.MatrixSystem,
    co.MatrixAlgebra,
    co.methods.Method,
    co.Splitting,
    co.PreparedRun,
    SpinModel,
    CoherentSpinModel,
)
"""Classes whose annotated attributes are not for users."""
NAMESPACES = (
    ("Ready-made systems, and what systems are made of", "systems"),
    ("Forces ([forces.md](forces.md))", "forces"),
    ("Bodies from files ([body_files.md](body_files.md))", "bodies"),
    ("Schemes of your own ([own_schemes.md](own_schemes.md))", "methods"),
    ("Analysis", "analysis"),
    ("Crystals of spins ([spins.md](spins.md#crystals))", "spins"),
    ("Correlations in space and time ([spins.md](spins.md), [neutrons.md](neutrons.md))", "spectra"),
    ("Check-cases for simulators ([checkcases.md](checkcases.md))", "checkcases"),
    ("Orbits ([orbits.md](orbits.md))", "orbits"),
    ("Logs of attitudes ([orbits.md](orbits.md#logs-of-attitudes))", "attitudes"),
    ("Plotting ([gallery.md](gallery.md))", "plotting"),
    ("Stored results ([files.md](files.md))", "results"),
    ("Functions of JAX ([derivatives.md](derivatives.md#jax))", "jax"),
    ("Functions of PyTorch ([derivatives.md](derivatives.md#pytorch))", "torch"),
)
HEAD = """# Every public name

This page lists the functions, classes, members and commands that are promised to users, each with the first sentence of
its docstring and its file. Other names may change at any time. In Python, `help(co.integrate)` shows the whole
docstring: parameters with their shapes, what is returned, what is refused, examples. [terms.md](terms.md) explains the
words.

`python docs/write_api.py` writes this page, and a test checks that it is up to date.
"""


def written_schema() -> str:
    """Return the text of the schema of configuration files."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def page() -> str:
    """Return the text of the page."""
    return "\n".join([HEAD, *_sections()]) + "\n"


def signatures() -> str:
    """Return every public name with its parameters and their defaults, a line for each, sorted."""
    lines: set[str] = set()
    for module in ("", *(f".{name}" for name in ("algebras", *(name for _, name in NAMESPACES)))):
        space = getattr(co, module[1:]) if module else co
        lines |= {_signed(name, value) for name, value in _names_of(f"co{module}", space)}
    lines |= {f"co.algebras.get({name!r})" for name in co.algebras.names()}
    for _, kind, members in MEMBERS_OF:
        lines |= {_signed(f"{kind.__name__}.{name}", _member(kind, name)) for name in members.split()}
        if kind not in ATTRIBUTES_NOT_LISTED:
            lines |= {f"{kind.__name__}.{name}" for name in _attributes(kind) - set(members.split())}
    for name, command in commands.commands.commands.items():
        options = (option for parameter in command.params for option in parameter.opts)
        lines.add(" ".join([f"coadjoint {name}", *sorted(options)]))
    return "\n".join(sorted(lines)) + "\n"


def _signed(name: str, value: Any) -> str:
    """Return a name with its parameters, which are those of its construction if it is a class."""
    if not callable(value):
        return name
    try:
        parameters = inspect.signature(value).parameters.values()
    except ValueError:  # without any, as those of classes in C
        return name
    own = [parameter for parameter in parameters if not parameter.name.startswith("_")]
    plain = [p.replace(annotation=p.empty, default=_default(p.default)) for p in own if p.name != "self"]
    return f"{name}{inspect.Signature(plain)}"


class _Shown(str):
    """A text that is its own representation."""

    __repr__ = str.__str__


def _default(value: Any) -> Any:
    """Return a default with a representation that is the same everywhere."""
    if value is inspect.Parameter.empty:
        return value
    return _Shown(getattr(value, "__name__", None) or re.sub(r" at 0x[0-9a-f]+", "", repr(value)))


def names_of_systems() -> str:
    """Return what type checkers and editors read of `co.systems`, whose functions are found when it is imported."""
    functions = {name: getattr(co.systems, name).__module__ for name in co.systems.names()}
    functions |= {block.__name__: block.__module__ for block in co.systems.BUILDING_BLOCKS}
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
    yield _table("The package", list(_names_of("co", co)))
    yield _table("Algebras", list(_names_of("co.algebras", co.algebras)))
    families = ", ".join(f"`{name}`" for name in co.algebras.names() if not name.startswith("A"))
    real = ", ".join(f"`{name}`" for name in co.algebras.names() if name.startswith("A"))
    yield f"`co.algebras.get` knows the families {families}, and the real algebras of dimension 2 to 5: {real}.\n"
    for title, name in NAMESPACES:
        yield _table(title, list(_names_of(f"co.{name}", getattr(co, name))))
    for title, kind, members in MEMBERS_OF:
        yield _table(title, [(f"{kind.__name__}.{name}", _member(kind, name)) for name in sorted(members.split())])
        attributes = _attributes(kind) - set(members.split()) if kind not in ATTRIBUTES_NOT_LISTED else set()
        if attributes:
            yield f"Attributes of a `{kind.__name__}`: {', '.join(f'`{name}`' for name in sorted(attributes))}.\n"
    yield "Systems of the other types have those members of a `LiePoissonSystem` that apply to them.\n"
    lines = [
        f"| `coadjoint {name}` | {_sentence(command.help or '')} |"
        for name, command in sorted(commands.commands.commands.items())
    ]
    yield "\n".join(["## The command\n", "| command | what it does |", "|---|---|", *lines])
    yield "\n`coadjoint COMMAND --help` shows the options. [files.md](files.md) describes configuration files."


def _names_of(shown: str, module: Any) -> Iterator[tuple[str, Any]]:
    """Yield the public names of a module."""
    for name in sorted(dir(module), key=lambda name: (name.lower(), name)):
        yield f"{shown}.{name}", getattr(module, name)


def _member(kind: type, name: str) -> Any:
    value = inspect.getattr_static(kind, name)
    return value if isinstance(value, property) else getattr(kind, name)


def _attributes(kind: type) -> set[str]:
    """Return the public names that a class and those it derives from annotate or compute once, except properties."""
    named = {name for base in kind.__mro__ for name in inspect.get_annotations(base)}
    named |= {name for base in kind.__mro__ for name, value in vars(base).items() if isinstance(value, cached_property)}
    named = {name for name in named if not name.startswith("_")}
    return {name for name in named if not isinstance(inspect.getattr_static(kind, name, None), property)}


def _table(title: str, rows: Iterable[tuple[str, Any]]) -> str:
    lines = [f"| `{name}` | {_summary(value)} | {_place(value)} |" for name, value in rows]
    head = ["| name | what it is | file |", "|---|---|---|"] if lines else []
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
    if isinstance(value, co.orbits.Planet):
        plain = type(value)
    try:
        file = inspect.getsourcefile(inspect.unwrap(plain)) or ""
    except TypeError:
        file = ""
    if not file:
        return ""
    found = Path(file).resolve().relative_to(PACKAGE.resolve()).as_posix()
    return f"[`{found}`](../src/coadjoint/{found})"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    SYSTEMS.write_text(names_of_systems(), encoding="utf-8")
    SCHEMA.write_text(written_schema(), encoding="utf-8")
    SIGNATURES.write_text(signatures(), encoding="utf-8")
