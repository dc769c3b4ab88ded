"""JSON Schema of configuration files, for editors and for programs that write such files."""

from __future__ import annotations

import ast
import inspect
import typing
from collections.abc import Callable, Iterator, Mapping
from inspect import formatannotation
from typing import Any

from coadjoint.algebra.catalogue import families
from coadjoint.algebra.families.low_dimensional import entries, parameters_of
from coadjoint.methods import registry
from coadjoint.optional_packages import need
from coadjoint.systems.description import documented_parameters, summary_of
from coadjoint.systems.forces import registry as described
from coadjoint.systems.registry import ready_made_systems

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCHEMA_URL = "https://raw.githubusercontent.com/coadjoint/coadjoint/main/docs/configuration.schema.json"
EMPTY_TABLE = {"type": "object", "description": "None: there are none here.", "maxProperties": 0}
NESTED_NUMBERS = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"$ref": "#/$defs/Numbers"}}]}
JSON_TYPES: dict[str, dict[str, Any]] = {
    "bool": {"type": "boolean"},
    "float": {"type": "number"},
    "int": {"type": "integer"},
    "str": {"type": "string"},
    "Method": {"$ref": "#/$defs/MethodTable"},
    "npt.ArrayLike": {"$ref": "#/$defs/Numbers"},
    "tuple[float, ...]": {"type": "array", "items": {"type": "number"}},
}
Schema = dict[str, Any]


def schema() -> Schema:
    """Return the JSON Schema of configuration files, draft 2020-12.

    It is generated from the models that validate files, and from the registered names of systems, algebras, forces,
    initial states, and schemes, including your own. Every file that it rejects is rejected by `load` or the command;
    they also reject others, for instance if the step does not divide the span.

    Returns
    -------
    dict
        The schema, serializable by `json`.

    Raises
    ------
    MissingPackageError
        pydantic is not installed.

    Examples
    --------
    >>> found = schema()
    >>> found["properties"]["sign"]["enum"], found["$defs"]["RunTable"]["properties"]["step"]["exclusiveMinimum"]
    ([1, -1], 0)
    """
    need("the schema of configuration files", "pydantic")
    from coadjoint.files.configuration.models import File

    found = _strip_schema(File.model_json_schema())
    tables = found["$defs"]
    tables["SystemTable"] = _one_of(tables["SystemTable"], _systems())
    tables["AlgebraTable"] = _one_of(tables["AlgebraTable"], _algebras(tables["AlgebraTable"]["properties"]))
    tables["InitialTable"] = _one_of(tables["InitialTable"], _states(tables["InitialTable"]["properties"]))
    tables["Numbers"] = NESTED_NUMBERS
    listed = {"type": "array", "description": "The values themselves.", "minItems": 1}
    tables["SettingsTable"] = {"anyOf": [listed, tables["SettingsTable"]]}
    tables["MethodTable"] = {"type": "object", "anyOf": list(_schemes())}
    tables["ForceTable"] = {"type": "object", "anyOf": list(_forces())}
    found["properties"]["method"] |= {"$ref": "#/$defs/MethodTable"}
    found["properties"]["forces"]["items"] = {"$ref": "#/$defs/ForceTable"}
    own = ("algebra", "hamiltonian", "casimirs", "name", "sign")
    ready_made = {"required": ["system"], "properties": dict.fromkeys(own, False)}
    return {
        "$schema": DIALECT,
        "$id": SCHEMA_URL,
        "title": "A run of coadjoint",
        **found,
        "oneOf": [ready_made, {"required": ["algebra", "hamiltonian"], "properties": {"system": False}}],
    }


def _strip_schema(value: Any, *, names: bool = False) -> Any:
    """Remove parts of a schema that do not apply to TOML: titles derived from keys, and null."""
    if isinstance(value, list):
        return [_strip_schema(entry) for entry in value]
    if not isinstance(value, dict):
        return value
    if names:  # keys are names
        return {key: _strip_schema(entry) for key, entry in value.items()}
    kept = {
        key: _strip_schema(entry, names=key in ("properties", "$defs"))
        for key, entry in value.items()
        if key != "title" and not (key == "default" and entry in (None, {}, []))
    }
    options = [option for option in kept.get("anyOf", ()) if option != {"type": "null"}]
    if len(options) == 1:
        return {**options[0], **{key: entry for key, entry in kept.items() if key != "anyOf"}}
    return {**kept, "anyOf": options} if options else kept


def _one_of(table: Schema, options: Iterator[Schema]) -> Schema:
    return {"type": "object", "description": table["description"], "anyOf": list(options)}


def _named_table(
    name: str | Schema, said: str, properties: Mapping[str, Schema], required: tuple[str, ...] = ()
) -> Schema:
    """Return the schema of a table with a name and no other keys than these."""
    called = {"const": name} if isinstance(name, str) else name
    return {
        "type": "object",
        "description": said,
        "properties": {"name": {**called, "description": said}, **properties},
        "required": ["name", *required],
        "additionalProperties": False,
    }


def _parameters(made: Callable[..., Any]) -> tuple[dict[str, Schema], list[str]]:
    """Return the schemas of the parameters of a callable, and the names of those without default."""
    told = documented_parameters(made)
    known = {key: given for key, given in inspect.signature(made).parameters.items() if key != "system"}
    found = {}
    for key, given in known.items():
        kind, meaning = (told.get(key, {}).get(part, "") for part in ("kind", "meaning"))
        annotation = given.annotation if isinstance(given.annotation, str) else formatannotation(given.annotation)
        of_type = _type(annotation, kind)
        shape = "" if kind.partition(",")[0] in ("", *JSON_TYPES) or kind.startswith("{") else f"{kind}: "
        found[key] = {**of_type, "description": shape + meaning}
        if isinstance(given.default, bool | int | float | str):
            found[key]["default"] = given.default
    return found, [key for key, given in known.items() if given.default is inspect.Parameter.empty]


def _summary(made: Callable[..., Any]) -> str:
    said = summary_of(made).removeprefix("Return ")
    return said[:1].upper() + said[1:]


def _type(annotation: str, kind: str) -> Schema:
    """Return the schema implied by an annotation and the kind in the docstring; often empty."""
    if kind.startswith("{"):
        return {"enum": list(ast.literal_eval(f"[{kind[1 : kind.index('}')]}]"))}
    return dict(JSON_TYPES.get(annotation.removesuffix(" | None"), {}))


def _systems() -> Iterator[Schema]:
    for name, builder in sorted(ready_made_systems().items()):
        properties, required = _parameters(builder)
        yield _named_table(name, _summary(builder), {"parameters": _table(properties, required)})


def _table(properties: Mapping[str, Schema], required: list[str]) -> Schema:
    missing = {"required": required} if required else {}
    return {
        "type": "object",
        "description": "The parameters; those that are left out have their defaults.",
        "properties": dict(properties),
        "additionalProperties": False,
        **missing,
    }


def _table_of_callable(name: str, made: Callable[..., Any]) -> Schema:
    """Return the schema of a table with a name and parameters, which may also be in a subtable."""
    properties, required = _parameters(made)
    inside = _table(properties, [])
    beside = {key: value for key, value in properties.items() if key != "name"}
    found = _named_table(name, _summary(made), {**beside, "parameters": inside})
    return {**found, "anyOf": [{"required": required}, {"required": ["parameters"]}]} if required else found


def _schemes() -> Iterator[Schema]:
    for name in registry.names():
        yield _table_of_callable(name, registry.scheme(name))


def _forces() -> Iterator[Schema]:
    for name in described.names():
        parameters = inspect.signature(described.KINDS[name]).parameters.values()
        if not any(str(given.annotation).startswith("Callable") for given in parameters):
            yield _table_of_callable(name, described.KINDS[name])


def _states(keys: Mapping[str, Schema]) -> Iterator[Schema]:
    yield {
        "type": "object",
        "description": "The initial state, or states, as numbers.",
        "properties": {key: keys[key] for key in ("x", "attitude")} | {"parameters": EMPTY_TABLE},
        "required": ["x"],
        "additionalProperties": False,
    }
    seen = set()
    for _, builder in sorted(ready_made_systems().items()):
        family = typing.get_type_hints(builder)["return"]
        for kind in getattr(family, "states_by_name", ()):
            make = getattr(family, kind)
            if make in seen:
                continue
            seen.add(make)
            found, required = _parameters(make)
            table = _table({"kind": {"const": kind, "description": _summary(make)}, **found}, ["kind", *required])
            yield {**table, "description": _summary(make), "properties": table["properties"] | _attitude(keys)}


def _attitude(keys: Mapping[str, Schema]) -> dict[str, Schema]:
    return {"attitude": keys["attitude"]}


def _algebras(keys: Mapping[str, Schema]) -> Iterator[Schema]:
    own = ("dim", "basis", "brackets")
    yield {
        "type": "object",
        "description": "An algebra of your own, by its brackets.",
        "properties": {**{key: keys[key] for key in own}, "parameters": EMPTY_TABLE},
        "required": ["brackets"],
        "anyOf": [{"required": ["dim"]}, {"required": ["basis"]}],
        "additionalProperties": False,
    }
    by_parameters: dict[tuple[str, ...], list[str]] = {}
    for name in entries():
        by_parameters.setdefault(parameters_of(name), []).extend((name, name.replace("_", ",")))
    for parameters, names in by_parameters.items():
        yield _algebra(
            {"enum": names}, f"A real algebra of dimension 2 to 5 {_extend_parameters(parameters)}.", parameters
        )
    for pattern, numbers in families().items():
        yield _algebra({"const": pattern}, f"The family {pattern} {_extend_parameters(numbers)}.", numbers, "integer")
    yield _algebra({"const": "heisenberg"}, "The Heisenberg algebra of n = 1.", ())
    letters = "|".join(sorted({pattern.partition("(")[0] for pattern in families()}))
    written = rf"^({letters})\([0-9]{{1,4000}}(,[0-9]{{1,4000}})?\)$"
    yield _algebra({"type": "string", "pattern": written}, 'A member of a family, such as "so(4)" or "so(3,1)".', ())
    said = "Any of these names with spaces, which are ignored."
    yield _named_table({"type": "string", "pattern": r"\s"}, said, {"parameters": keys["parameters"]})


def _algebra(name: Schema, said: str, parameters: tuple[str, ...], kind: str = "number") -> Schema:
    inside = _table({key: {"type": kind, "description": "A number without unit."} for key in parameters}, [*parameters])
    return _named_table(name, said, {"parameters": inside}, ("parameters",) if parameters else ())


def _extend_parameters(parameters: tuple[str, ...]) -> str:
    return f"with the parameters {', '.join(parameters)}" if parameters else "without parameters"
