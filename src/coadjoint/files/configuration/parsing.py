"""Reading of configuration files: TOML, validation by the models, systems, and errors with key and reason."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from coadjoint import systems
from coadjoint.algebra.exact.numbers import parse_decimal
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import ConfigurationError, in_one_line, nearest
from coadjoint.files.configuration.models import File
from coadjoint.files.configuration.tables import MAX_SHOWN_LENGTH, wrong_keys
from coadjoint.files.records.reconstruction import polynomial_of
from coadjoint.keyword_hints import vocabulary
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import declared_names
from coadjoint.systems.forces import registry as described
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems
from coadjoint.systems.system import System
from coadjoint.validation import from_description, read_choice

MAX_LENGTH = 2**28  # characters of a file; longer ensembles are given in Python
MAX_PARTS = 64
# tomllib needs cubic time in the number of parts of a dotted key.
_LONG_KEY = re.compile(rf"(?<![\w.])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{MAX_PARTS}}}")
MAX_REASON = 300  # characters of a reason, some lines of a terminal
MAX_LINES = 20  # lines of errors that the command prints: one screen
SYSTEM_KEYS = frozenset({"name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces"})


def read_utf8(path: str | Path) -> str:
    """Read a file as UTF-8 with normalized line ends, without a byte-order mark."""
    with section(path, ""):
        with open(path, encoding="utf-8-sig") as file:
            # Devices may be endless, and a dataset given by mistake may be huge.
            text = file.read(MAX_LENGTH + 1)
        if len(text) > MAX_LENGTH:
            raise ValueError(f"is longer than {MAX_LENGTH} characters; give long ensembles in Python")
        return text


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Parse TOML, the file of this name, with decimal numbers that float64 can represent."""

    def number(literal: str) -> float:
        # Numbers that are not finite are refused by their keys.
        return parse_decimal(literal) if math.isfinite(float(literal)) else float(literal)

    with section(name, ""):
        if (long_key := _LONG_KEY.search(text)) is not None:
            raise ValueError(f"the key {short(long_key[0], MAX_SHOWN_LENGTH)} has more than {MAX_PARTS} parts")
        return tomllib.loads(text, parse_float=number)


@contextmanager
def section(name: str | Path, key: str) -> Iterator[None]:
    """Convert errors inside the context to `ConfigurationError` with the file `name` and the dotted `key`."""
    cause: Exception
    try:
        yield
        return
    except ConfigurationError:
        raise
    except (ValueError, TypeError) as reason:
        problem, cause = str(reason), reason
    except OSError as reason:
        problem, cause = f"cannot be read ({reason.strerror or reason}: {reason.filename})", reason
    except (ArithmeticError, RecursionError, MemoryError) as reason:
        problem, cause = f"is too large, or nested too deeply: {type(reason).__name__}, {reason}", reason
    raise ConfigurationError(f"{name}: {_line(key, problem)}") from cause


def _line(key: str, reason: str) -> str:
    return (f"{in_one_line(key, 80)}: " if key else "") + in_one_line(reason, MAX_REASON)


class Problems:
    """Errors of a file, collected so that they are reported together."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.lines: list[str] = []

    def add(self, key: str, reason: str) -> None:
        """Add an error: key and reason."""
        self.lines.append(f"{self.name}: {_line(key, reason)}")

    @contextmanager
    def at(self, key: str) -> Iterator[None]:
        """Collect an error that is raised inside, and continue."""
        try:
            with section(self.name, key):
                yield
        except ConfigurationError as error:
            self.lines += error.error_lines or (str(error),)

    def check(self) -> None:
        """Raise the collected errors as one, with a line for each."""
        if not self.lines:
            return
        lines = list(dict.fromkeys(self.lines))
        error = ConfigurationError("; ".join([lines[0], *(line.removeprefix(f"{self.name}: ") for line in lines[1:])]))
        omitted = [f"{self.name}: {len(lines) - MAX_LINES} more"] if len(lines) > MAX_LINES else []
        error.error_lines = (*lines[:MAX_LINES], *omitted)
        raise error


def parse_tables(raw: Mapping[str, Any], problems: Problems, only: Sequence[str] = ()) -> File:
    """Validate the tables of a file one by one, or `only` some; `model_fields_set` of the result has the valid ones."""
    file = File.model_construct()
    for key in () if only else wrong_keys(File, raw.keys()):
        problems.add(key, wrong_key(key, File))
    for key in only or File.model_fields:
        if key in raw:
            try:
                setattr(file, key, raw[key])
            except ValidationError as error:
                for path, reason in _errors_in(error):
                    problems.add(path, reason)
    return file


def _errors_in(error: ValidationError) -> Iterator[tuple[str, str]]:
    """Yield dotted key and reason of each error of a table."""
    for entry in error.errors(include_url=False):
        # Variants of tables have tags in brackets, and pydantic appends "[key]" for an invalid key of a table.
        parts = [part for part in entry["loc"] if isinstance(part, int) or part[:1] not in ("<", "[")]
        path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")
        context: Any = entry.get("ctx", {})
        if entry["type"] == "wrong_keys":
            yield from ((f"{path}.{key}".lstrip("."), wrong_key(key, context["table"])) for key in context["keys"])
        elif entry["type"] == "value_error":
            yield path, str(context["error"])
        else:
            rule = "must be a table" if entry["type"] in ("model_type", "dict_type") else entry["msg"]
            rule = rule.replace("Input should", "must").replace("must be a valid", "must be a")
            yield path, f"{rule[:1].lower()}{rule[1:]}; it is {short(entry['input'], MAX_SHOWN_LENGTH)}"


def wrong_key(key: str, table: type[BaseModel]) -> str:
    """Describe a missing key, or an unknown one with its table, the key that is meant, or all known ones."""
    if key in table.model_fields:
        return f"is missing; give it: {table.model_fields[key].description}"
    tables = {name: list(_tables_in(field.annotation)) for name, field in File.model_fields.items()}
    near, known = nearest(key, table.model_fields), ", ".join(sorted(table.model_fields))
    if any(table in variants and any(key in one.model_fields for one in variants) for variants in tables.values()):
        return f"unknown key beside the others; known with them: {known}"
    usual = (vocabulary(kind).get(key, "") for kind in ("keys of files", "arguments"))
    for meant in (key, *(text.partition("=")[0] for text in usual)):
        meant = "x" if meant == "x0" else meant
        if meant in table.model_fields:
            return f"unknown key; did you mean {meant!r}?"
        for name, variants in tables.items():
            if meant == name or any(meant in one.model_fields for one in variants):
                return f"unknown key; give [{name}]{'' if meant == name else f' {meant}'}"
    return f"unknown key; did you mean {near!r}?" if near else f"unknown key; known here: {known}"


def _tables_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _tables_in(argument)


def system_of_file(name: str, file: File) -> System:
    """Return the system of the tables of a file, with its forces."""
    system, forces = _system_without_forces(name, file), []
    for k, description in enumerate(file.forces):
        with section(name, f"forces[{k}]"):
            forces.append(from_description("force", described.kinds(), description))
    with section(name, "forces"):
        return system.with_forces(*forces) if forces else system


def _system_without_forces(name: str, file: File) -> System:
    if file.system is not None:
        others = [key for key in SYSTEM_KEYS - {"system", "forces"} if getattr(file, key) is not None]
        with section(name, min(others, default="system")):
            if others:
                raise ValueError(f"belongs to [algebra]; the system {file.system.name!r} has its own")
            return systems.get(read_choice(file.system.name, "system", ready_made_systems()), **file.system.parameters)
    if file.algebra is None or file.hamiltonian is None:
        raise ConfigurationError(f"{name}: give either [system], a ready-made one, or [algebra] with [hamiltonian]")
    with section(name, "algebra"):
        algebra = file.algebra.algebra()
    names = declared_names(file.name, algebra, algebra.dim)
    with section(name, "hamiltonian"):
        hamiltonian = file.hamiltonian.energy(algebra, names)
    casimirs: dict[str, Polynomial] | None = None if file.casimirs is None else {}
    for key, polynomial in (file.casimirs or {}).items():
        assert casimirs is not None
        with section(name, f"casimirs.{key}"):
            casimirs[key] = polynomial_of(polynomial, algebra.dim, names)
    with section(name, "casimirs"):
        LiePoissonSystem(algebra, 0 * Polynomial.variable(0, algebra.dim), casimirs=casimirs)
    with section(name, "hamiltonian"):
        sign = 1 if file.sign is None else file.sign
        return LiePoissonSystem(algebra, hamiltonian, sign=sign, casimirs=casimirs, name=file.name)
