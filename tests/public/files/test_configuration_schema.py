"""The JSON Schema of configuration files accepts every file that runs; what it refuses is in the tests of errors."""

import copy
import json
import random
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from test_configured_runs import CONFIGURED, FLUID

import coadjoint as co
from command import command
from configuration_files import OWN, READY_MADE

ROOT = Path(__file__).parents[3]
SCHEMA = ROOT / "docs" / "configuration.schema.json"
EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))


@pytest.fixture(scope="module")
def schema():
    found = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(found)
    return found


def is_valid(schema, table):
    return jsonschema.Draft202012Validator(schema).is_valid(table)


def test_the_command_prints_the_schema_of_the_documentation(schema, capsys):
    shown = command(capsys, "schema").out
    assert json.loads(shown) == schema and "\\u" not in shown.replace("\\u0000", "")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_valid_and_name_their_schema(schema, example):
    text = example.read_text(encoding="utf-8")
    assert is_valid(schema, tomllib.loads(text))
    assert (example.parent / text.partition("\n")[0].removeprefix("#:schema ")).samefile(SCHEMA)


OTHERS = [text for text, _ in CONFIGURED.values()]
OTHERS += [OWN, READY_MADE, FLUID.format(system="sphere_euler", N=4, initial='kind = "random"\nseed = 1')]


def test_configurations_of_every_key_are_valid(schema):
    named = OWN.replace("[algebra]\ndim = 3", '[algebra]\nname = "A3, 7"\nparameters = {a = 2.0}')
    named = re.sub(r"brackets = .*", "", named)
    for text in (*OTHERS, named, named.replace("A3, 7", "A3,7")):
        assert is_valid(schema, tomllib.loads(text)), text


VALUES = (
    0, 1, -1, 2, 0.5, 1e-3, "x1", "random", "coadjoint", "Taylor", True, [], [0, 1], [1.0, 0.5, 0.25], {}, {"a": 1},
)  # fmt: skip


def leaves(table, path=()):
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))


def toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(entry)}" for key, entry in value.items()) + "}"
    return "[" + ", ".join(map(toml, value)) + "]" if isinstance(value, list) else json.dumps(value)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 8))])
@pytest.mark.filterwarnings("ignore")
def test_files_that_are_accepted_are_valid(files, schema, seed):
    """Configurations with one or two entries replaced, moved or left out at random."""
    rng, accepted = random.Random(seed), 0
    short = [text for text in OTHERS if len(text) < 2000]
    for _ in range(60):
        table = copy.deepcopy(tomllib.loads(rng.choice(short)))
        for _ in range(rng.randint(1, 2)):
            *path, last = rng.choice(list(leaves(table)))
            within = table
            for key in path:
                within = within[key]
            if rng.random() < 0.25:
                del within[last]
            else:
                within[last] = rng.choice(VALUES)
        files.write("".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in table.items()))
        if command(files.capsys, "check", "run.toml").status == 0:
            accepted += 1
            assert is_valid(schema, table), table
    assert 1 <= accepted < 45


def keys_of(value, place=()):
    """Yield the path and the schema of every key."""
    if isinstance(value, dict):
        for key, entry in value.get("properties", {}).items():
            if isinstance(entry, dict):
                yield (*place, key), entry
        for key, entry in value.items():
            yield from keys_of(entry, (*place, key))
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            yield from keys_of(entry, (*place, number))


def test_every_key_has_a_description(schema):
    found, own = dict(keys_of(schema)), schema["$defs"]
    assert len(found) > 300
    tables = {place for place, entry in found.items() if "$ref" in entry and own[entry["$ref"][8:]].get("description")}
    assert [place for place in found.keys() - tables if not found[place].get("description")] == []


def test_the_schema_contains_all_names(schema):
    def named(table):
        options = [option["properties"].get("name", {}) for option in schema["$defs"][table]["anyOf"]]
        return {name for each in options for name in each.get("enum", [each.get("const", each.get("pattern", ""))])}

    assert named("SystemTable") == set(co.systems.names())
    assert named("MethodTable") == set(co.methods.names())
    assert named("ForceTable") == set(co.forces.names()) - {"OwnForce"}
    known = named("CatalogueAlgebra")
    (pattern,) = (text for text in known if text.startswith("^("))
    assert [name for name in co.algebras.names() if name not in known and not re.match(pattern, name)] == []
