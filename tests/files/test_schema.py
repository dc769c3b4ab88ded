"""The JSON Schema of configuration files accepts every file that runs."""

import dataclasses
import re
import tomllib
import warnings
from pathlib import Path

import jsonschema
import pytest
from configuration_files import OWN, READY_MADE

import coadjoint as co
from coadjoint import algebras, cli, forces, systems
from coadjoint.files.configuration.configuration import Configuration
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.configuration.schema import schema
from coadjoint.methods import registry
from fuzz.configurations import bases, draw

SCHEMA = Path(__file__).parents[2] / "docs" / "configuration.schema.json"
EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
DRAWN = 400


@pytest.fixture(scope="module")
def validator():
    found = schema()
    jsonschema.Draft202012Validator.check_schema(found)
    return jsonschema.Draft202012Validator(found)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_schema_accepts_the_examples(validator, example):
    text = example.read_text(encoding="utf-8")
    validator.validate(tomllib.loads(text))
    named = text.partition("\n")[0].removeprefix("#:schema ")
    assert (example.parent / named).samefile(SCHEMA)


def test_schema_accepts_other_configurations(validator):
    for table in (tomllib.loads(OWN), tomllib.loads(READY_MADE), *bases()):
        validator.validate(table)


WRONG = {
    "a key": READY_MADE.replace("step", "stpe"),
    "a key that is missing": READY_MADE.replace("step = 0.1", ""),
    "a step of zero": READY_MADE.replace("step = 0.1", "step = 0"),
    "a step as text": READY_MADE.replace("step = 0.1", "step = '0.1'"),
    "three times": READY_MADE.replace("[0, 1]", "[0, 1, 2]"),
    "a system": READY_MADE.replace('"rigid_body"', '"rigid_bodi"'),
    "a parameter": READY_MADE.replace("inertia", "inertias"),
    "the type of a parameter": READY_MADE.replace("[1.0, 2.0, 2.5]", "'heavy'"),
    "a scheme": READY_MADE.replace('"Splitting"', '"Splittings"'),
    "a scheme without a name": READY_MADE.replace('name = "Splitting"', ""),
    "the order of a scheme": READY_MADE.replace("order = 4", "order = 3"),
    "a parameter of a scheme": READY_MADE.replace("order = 4", "stages = 4"),
    "a scheme inside": READY_MADE.replace('"Splitting"\norder = 4', '"Projected"\nbase = {name = "Splitting", s = 1}'),
    "what a scheme needs": READY_MADE.replace('"Splitting"\norder = 4', '"Projected"'),
    "a force": READY_MADE + '[[forces]]\nname = "Damping"\n',
    "what a force needs": READY_MADE + '[[forces]]\nname = "LinearDamping"\n',
    "a force that is a function": READY_MADE + '[[forces]]\nname = "OwnForce"\nfunction = "abs"\n',
    "a sign beside a system": "sign = 1\n" + READY_MADE,
    "two systems": OWN + "[system]\nname = 'rigid_body'\n",
    "a sign": OWN.replace("sign = -1", "sign = 0"),
    "no energy": OWN.replace("[hamiltonian]\nM = [1.0, 0.5, 0.25]", ""),
    "no dimension": OWN.replace("dim = 3\n", ""),
    "an algebra": OWN.replace("dim = 3", "name = 'so(x)'").replace("brackets", "#"),
    "what an algebra needs": OWN.replace("dim = 3", "name = 'A3,7'").replace("brackets", "#"),
    "a ragged matrix": OWN.replace("[1.0, 0.5, 0.25]", "[[[1.0]]]"),
    "no state": OWN.replace("x = [1.0, 0.1, 0.5]", "attitude = true"),
    "a state and its kind": OWN.replace("x = [1.0, 0.1, 0.5]", "x = [1.0, 0.1, 0.5]\nkind = 'random'"),
    "a file of states": OWN.replace("[1.0, 0.1, 0.5]", "'states.csv'"),
    "an attitude": OWN.replace("x = [1.0, 0.1, 0.5]", "x = [1.0, 0.1, 0.5]\nattitude = [1.0]"),
    "a direction": OWN + "[events]\nturn = {g = 'x1', direction = 2}\n",
    "the format of a file": OWN + "[output]\nfile = 'run.csv'\n",
}


@pytest.mark.parametrize("error", WRONG)
def test_invalid_files_are_refused_by_schema_and_command(validator, error, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Configuration, "integrate", lambda *args, **kwargs: pytest.fail("it ran"))
    assert WRONG[error] not in (OWN, READY_MADE)
    (tmp_path / "run.toml").write_text(WRONG[error])
    assert not validator.is_valid(tomllib.loads(WRONG[error]))
    assert cli.main(["run", "run.toml"]) == 2
    assert capsys.readouterr().err.startswith("run.toml: ")


@pytest.mark.long
def test_schema_refuses_only_invalid_files(validator, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = 0
    for seed in range(DRAWN):
        text = draw(seed)
        try:
            table = tomllib.loads(text.decode())
            table.pop("output", None)  # checked by commands, not by `load`
            fits = validator.is_valid(table)
        except (ValueError, RecursionError):
            continue  # invalid TOML, or a number with too many digits for Python
        refused += not fits
        (tmp_path / "run.toml").write_bytes(text)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                load("run.toml")
        except ConfigurationError:
            continue
        assert fits, (seed, next(validator.iter_errors(table)).message[:300])
    assert refused > DRAWN / 4


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


def test_every_key_has_a_description(validator):
    found = dict(keys_of(validator.schema))
    assert len(found) > 300
    own = validator.schema["$defs"]
    tables = {place for place, entry in found.items() if "$ref" in entry and own[entry["$ref"][8:]].get("description")}
    assert [place for place in found.keys() - tables if not found[place].get("description")] == []


def test_schema_contains_all_names(validator):
    tables = validator.schema["$defs"]

    def named(table):
        return {name for option in tables[table]["anyOf"] for name in of_option(option["properties"].get("name", {}))}

    def of_option(name):
        return name.get("enum", [name.get("const", name.get("pattern", ""))])

    assert named("SystemTable") == set(systems.names())
    assert named("MethodTable") == set(registry.names())
    assert named("ForceTable") == set(forces.names()) - {"OwnForce"}
    known = named("AlgebraTable")
    (pattern,) = (text for text in known if text.startswith("^("))
    assert [name for name in algebras.names() if name not in known and not re.match(pattern, name)] == []


def test_names_with_spaces_are_accepted(validator):
    table = tomllib.loads(OWN) | {"algebra": {"name": "A3, 7", "parameters": {"a": 2.0}}}
    validator.validate(table)
    table["algebra"] = {"name": "A3,7", "parameters": {"a": 2.0}}
    validator.validate(table)


def test_schema_contains_registered_schemes():
    @co.methods.register
    @dataclasses.dataclass(frozen=True)
    class Still(co.methods.StepMethod):
        """Nothing moves."""

        order, explicit, symmetric = 1, True, True
        factor: float = 1.0

        def properties(self, system):
            return co.methods.Properties(poisson=True, energy=True, casimirs="all", attitude="none")

        def step(self, system, x, t, h):
            return x

    try:
        tables = {one["description"]: one for one in schema()["$defs"]["MethodTable"]["anyOf"]}
    finally:
        registry.forget("Still")
    assert tables["Nothing moves."]["properties"]["factor"]["type"] == "number"
