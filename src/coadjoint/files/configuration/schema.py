"""JSON Schema of configuration files, for editors and for programs that write such files."""

from __future__ import annotations

import ast
import inspect
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from inspect import formatannotation
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from coadjoint.algebra import catalogue
from coadjoint.files.configuration.models import File
from coadjoint.methods import registry
from coadjoint.optional_packages import require_packages
from coadjoint.systems.description import documented_parameters, summary_of
from coadjoint.systems.forces.registry import kinds
from coadjoint.systems.registry import ready_made_systems

Schema = dict[str, Any]

NUMBERS = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"$ref": "#/$defs/Numbers"}}]}
JSON_TYPES: dict[str, Schema] = {
    "bool": {"type": "boolean"},
    "float": {"type": "number"},
    "int": {"type": "integer"},
    "str": {"type": "string"},
    "Method": {"$ref": "#/$defs/MethodTable"},
    "npt.ArrayLike": {"$ref": "#/$defs/Numbers"},
    "InertiaLike": {"$ref": "#/$defs/Numbers"},
    "tuple[float, ...]": {"type": "array", "items": {"type": "number"}},
}


class TomlSchema(GenerateJsonSchema):
    """Schemas without what does not apply to TOML: null, and titles derived from keys."""

    def nullable_schema(self, schema: Any) -> Schema:
        """Return the schema of the value, if there is one."""
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> Schema:
        """Return the schema, with its default if that is a number or a truth value."""
        is_shown = isinstance(schema.get("default"), int)
        return super().default_schema(schema) if is_shown else self.generate_inner(schema["schema"])

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Return False: keys have no titles."""
        return False


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
    document = File.model_json_schema(schema_generator=TomlSchema)
    tables = document["$defs"]
    attitude = {"attitude": tables["NamedStateTable"]["properties"]["attitude"]}
    options = {
        "SystemTable": [_option("name", name, one, inline=False) for name, one in sorted(ready_made_systems().items())],
        "CatalogueTable": list(_algebras()),
        "NamedStateTable": [_option("kind", name, one, attitude, subtable=False) for name, one in _states()],
        "MethodTable": [_option("name", name, registry.scheme(name)) for name in registry.names()],
        "ForceTable": [_option("name", name, one) for name, one in sorted(kinds().items()) if name != "OwnForce"],
    }
    values = {"type": "array", "description": "The values themselves.", "minItems": 1}
    for name, option in options.items():
        description = tables.get(name, {"description": ""})["description"]
        tables[name] = {"type": "object", "description": description, "anyOf": option}
    tables |= {"Numbers": NUMBERS, "SettingsTable": {"anyOf": [values, tables["SettingsTable"]]}}
    document["properties"]["method"] |= {"$ref": "#/$defs/MethodTable"}
    document["properties"]["forces"]["items"] = {"$ref": "#/$defs/ForceTable"}
    ready_made = dict.fromkeys(("algebra", "hamiltonian", "casimirs", "name", "sign"), False)
    own = {"required": ["algebra", "hamiltonian"], "properties": {"system": False}}
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        **document,
        "title": "A run of coadjoint",
        "oneOf": [{"required": ["system"], "properties": ready_made}, own],
    }


def _table(properties: Mapping[str, Schema], required: Iterable[str], description: str) -> Schema:
    """Return the schema of a table with no other keys."""
    table = {"type": "object", "properties": dict(properties), "required": [*required], "additionalProperties": False}
    return {**table, "description": description}


def _option(
    key: str,
    name: str,
    function: Callable[..., Any],
    more: Mapping[str, Schema] | None = None,
    inline: bool = True,
    subtable: bool = True,
) -> Schema:
    """Return the schema of a table that names a function, with parameters as further keys or in a subtable."""
    documented, schemas = documented_parameters(function), {}
    named = {key: one for key, one in inspect.signature(function).parameters.items() if key not in ("self", "system")}
    for parameter, one in named.items():
        kind, meaning = (documented.get(parameter, {}).get(part, "") for part in ("kind", "meaning"))
        annotation = one.annotation if isinstance(one.annotation, str) else formatannotation(one.annotation)
        found = dict(JSON_TYPES.get(annotation.removesuffix(" | None"), {}))
        if kind.startswith("{"):
            found = {"enum": list(ast.literal_eval(f"[{kind[1 : kind.index('}')]}]"))}
        elif kind and kind.partition(",")[0] not in JSON_TYPES:
            meaning = f"{kind}: {meaning}"
        default = {"default": one.default} if isinstance(one.default, int | float | str) else {}
        schemas[parameter] = {**found, "description": meaning, **default}
    summary = summary_of(function).removeprefix("Return ")
    required = [parameter for parameter, one in named.items() if one.default is inspect.Parameter.empty]
    properties = {**(schemas if inline else {}), **(more or {}), key: {"const": name, "description": summary}}
    if subtable:
        properties["parameters"] = _table(schemas, (), "The parameters; omitted ones have their defaults.")
    table = _table(properties, [key, *([] if subtable else required)], summary)
    return (
        {**table, "anyOf": [{"required": required}, {"required": ["parameters"]}]} if subtable and required else table
    )


def _states() -> list[tuple[str, Any]]:
    """Return the names and functions of the states that systems provide."""
    families = [typing.get_type_hints(builder)["return"] for _, builder in sorted(ready_made_systems().items())]
    named = [(name, getattr(family, name)) for family in families for name in getattr(family, "states_by_name", ())]
    return list(dict.fromkeys(named))


def _algebras() -> Iterator[Schema]:
    """Yield the tables of the algebras of the catalogue with equal parameters, then of those named by their numbers."""
    by_parameters: dict[tuple[str, ...], list[str]] = {(): ["heisenberg"]}
    known = {name: catalogue.parameters_of(name) for name in catalogue.entries()} | catalogue.families()
    for name, parameters in known.items():
        by_parameters.setdefault(parameters, []).extend(dict.fromkeys([name, name.replace("_", ",")]))
    for parameters, names in by_parameters.items():
        yield _algebra(
            {"enum": names}, parameters, f"An algebra with the parameters {', '.join(parameters) or 'none'}."
        )
    letters = "|".join(sorted({pattern.partition("(")[0] for pattern in catalogue.families()}))
    spaced: Schema = {
        "pattern": rf"^({letters})\([0-9]+(,[0-9]+)?\)$|\s",
        "description": "With numbers, or with spaces.",
    }
    free = {"description": "As of the name without spaces."}
    yield _table({"name": spaced, "parameters": free}, ["name"], 'Such as "so(4)" or "A3, 7".')


def _algebra(name: Schema, parameters: tuple[str, ...], description: str) -> Schema:
    numbers = {key: {"type": "number", "description": "A number without unit."} for key in parameters}
    table = {"name": {**name, "description": description}, "parameters": _table(numbers, parameters, description)}
    return _table(table, ["name", *(["parameters"] if parameters else [])], description)
