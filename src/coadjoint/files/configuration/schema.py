"""JSON Schema of configuration files, for editors and for programs that write such files."""

from __future__ import annotations

import ast
import inspect
import typing
from collections.abc import Callable, Iterator, Mapping
from inspect import formatannotation
from typing import Any

from coadjoint.algebra.catalogue import entries, families, parameters_of
from coadjoint.methods import registry
from coadjoint.optional_packages import require_packages
from coadjoint.systems.description import documented_parameters, summary_of
from coadjoint.systems.forces import registry as described
from coadjoint.systems.registry import ready_made_systems

DIALECT = "https://json-schema.org/draft/2020-12/schema"
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
    >>> document = schema()
    >>> document["properties"]["sign"]["enum"], document["$defs"]["RunTable"]["properties"]["step"]["exclusiveMinimum"]
    ([1, -1], 0)
    """
    require_packages("the schema of configuration files", "pydantic")
    from coadjoint.files.configuration.models import File

    document = _strip_schema(File.model_json_schema())
    definitions = document["$defs"]
    definitions["SystemTable"] = _one_of(definitions["SystemTable"], _systems())
    definitions["AlgebraTable"] = _one_of(
        definitions["AlgebraTable"], _algebras(definitions["AlgebraTable"]["properties"])
    )
    definitions["InitialTable"] = _one_of(
        definitions["InitialTable"], _states(definitions["InitialTable"]["properties"])
    )
    definitions["Numbers"] = NESTED_NUMBERS
    value_list = {"type": "array", "description": "The values themselves.", "minItems": 1}
    definitions["SettingsTable"] = {"anyOf": [value_list, definitions["SettingsTable"]]}
    definitions["MethodTable"] = {"type": "object", "anyOf": list(_schemes())}
    definitions["ForceTable"] = {"type": "object", "anyOf": list(_forces())}
    document["properties"]["method"] |= {"$ref": "#/$defs/MethodTable"}
    document["properties"]["forces"]["items"] = {"$ref": "#/$defs/ForceTable"}
    algebra_keys = ("algebra", "hamiltonian", "casimirs", "name", "sign")
    ready_made = {"required": ["system"], "properties": dict.fromkeys(algebra_keys, False)}
    return {
        "$schema": DIALECT,
        "title": "A run of coadjoint",
        **document,
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
    stripped = {
        key: _strip_schema(entry, names=key in ("properties", "$defs"))
        for key, entry in value.items()
        if key != "title" and not (key == "default" and entry in (None, {}, []))
    }
    options = [option for option in stripped.get("anyOf", ()) if option != {"type": "null"}]
    if len(options) == 1:
        return {**options[0], **{key: entry for key, entry in stripped.items() if key != "anyOf"}}
    return {**stripped, "anyOf": options} if options else stripped


def _one_of(table: Schema, options: Iterator[Schema]) -> Schema:
    return {"type": "object", "description": table["description"], "anyOf": list(options)}


def _named_table(
    name: Schema, description: str, properties: Mapping[str, Schema], required: tuple[str, ...] = ()
) -> Schema:
    """Return the schema of a table with a name and no other keys than these."""
    return {
        "type": "object",
        "description": description,
        "properties": {"name": {**name, "description": description}, **properties},
        "required": ["name", *required],
        "additionalProperties": False,
    }


def _parameters(function: Callable[..., Any]) -> tuple[dict[str, Schema], list[str]]:
    """Return the schemas of the parameters of a callable, and the names of those without default."""
    documented = documented_parameters(function)
    named = inspect.signature(function).parameters.items()
    parameters = {key: parameter for key, parameter in named if key not in ("self", "system")}
    schemas = {}
    for key, parameter in parameters.items():
        kind, meaning = (documented.get(key, {}).get(part, "") for part in ("kind", "meaning"))
        annotation = (
            parameter.annotation if isinstance(parameter.annotation, str) else formatannotation(parameter.annotation)
        )
        of_type = _type(annotation, kind)
        shape = "" if kind.partition(",")[0] in ("", *JSON_TYPES) or kind.startswith("{") else f"{kind}: "
        schemas[key] = {**of_type, "description": shape + meaning}
        if isinstance(parameter.default, bool | int | float | str):
            schemas[key]["default"] = parameter.default
    return schemas, [key for key, parameter in parameters.items() if parameter.default is inspect.Parameter.empty]


def _summary(function: Callable[..., Any]) -> str:
    summary = summary_of(function).removeprefix("Return ")
    return summary[:1].upper() + summary[1:]


def _type(annotation: str, kind: str) -> Schema:
    """Return the schema implied by an annotation and the kind in the docstring; often empty."""
    if kind.startswith("{"):
        return {"enum": list(ast.literal_eval(f"[{kind[1 : kind.index('}')]}]"))}
    return dict(JSON_TYPES.get(annotation.removesuffix(" | None"), {}))


def _systems() -> Iterator[Schema]:
    for name, builder in sorted(ready_made_systems().items()):
        properties, required = _parameters(builder)
        yield _named_table({"const": name}, _summary(builder), {"parameters": _table(properties, required)})


def _table(properties: Mapping[str, Schema], required: list[str]) -> Schema:
    missing = {"required": required} if required else {}
    return {
        "type": "object",
        "description": "The parameters; those that are left out have their defaults.",
        "properties": dict(properties),
        "additionalProperties": False,
        **missing,
    }


def _table_of_callable(name: str, function: Callable[..., Any]) -> Schema:
    """Return the schema of a table with a name and parameters, which may also be in a subtable."""
    properties, required = _parameters(function)
    subtable = _table(properties, [])
    inline = {key: value for key, value in properties.items() if key != "name"}
    schema_of_table = _named_table({"const": name}, _summary(function), {**inline, "parameters": subtable})
    return (
        {**schema_of_table, "anyOf": [{"required": required}, {"required": ["parameters"]}]}
        if required
        else schema_of_table
    )


def _schemes() -> Iterator[Schema]:
    for name in registry.names():
        yield _table_of_callable(name, registry.scheme(name))


def _forces() -> Iterator[Schema]:
    for name in described.names():
        parameters = inspect.signature(described.kinds()[name]).parameters.values()
        if not any(str(parameter.annotation).startswith("Callable") for parameter in parameters):
            yield _table_of_callable(name, described.kinds()[name])


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
            function = getattr(family, kind)
            if function in seen:
                continue
            seen.add(function)
            properties, required = _parameters(function)
            table = _table(
                {"kind": {"const": kind, "description": _summary(function)}, **properties}, ["kind", *required]
            )
            yield {**table, "description": _summary(function), "properties": table["properties"] | _attitude(keys)}


def _attitude(keys: Mapping[str, Schema]) -> dict[str, Schema]:
    return {"attitude": keys["attitude"]}


def _algebras(keys: Mapping[str, Schema]) -> Iterator[Schema]:
    keys_of_brackets = ("dim", "basis", "brackets")
    yield {
        "type": "object",
        "description": "An algebra of your own, by its brackets.",
        "properties": {**{key: keys[key] for key in keys_of_brackets}, "parameters": EMPTY_TABLE},
        "required": ["brackets"],
        "anyOf": [{"required": ["dim"]}, {"required": ["basis"]}],
        "additionalProperties": False,
    }
    yield {
        "type": "object",
        "description": "An algebra of your own, by matrices.",
        "properties": {**{key: keys[key] for key in ("dim", "basis", "matrices")}, "parameters": EMPTY_TABLE},
        "required": ["matrices"],
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
    pattern_text = rf"^({letters})\([0-9]{{1,4000}}(,[0-9]{{1,4000}})?\)$"
    yield _algebra(
        {"type": "string", "pattern": pattern_text}, 'A member of a family, such as "so(4)" or "so(3,1)".', ()
    )
    description = "Any of these names with spaces, which are ignored."
    yield _named_table({"type": "string", "pattern": r"\s"}, description, {"parameters": keys["parameters"]})


def _algebra(name: Schema, description: str, parameters: tuple[str, ...], kind: str = "number") -> Schema:
    parameter_table = _table(
        {key: {"type": kind, "description": "A number without unit."} for key in parameters}, [*parameters]
    )
    return _named_table(name, description, {"parameters": parameter_table}, ("parameters",) if parameters else ())


def _extend_parameters(parameters: tuple[str, ...]) -> str:
    return f"with the parameters {', '.join(parameters)}" if parameters else "without parameters"
