"""A file with several mistakes is refused once, with all of them, in one line."""

import pytest

from coadjoint.errors import in_one_line
from coadjoint.files.configuration import ConfigurationError, load
from coadjoint.files.several_errors import LETTERS, told_together

FILE = """
[system]
name = "{name}"
[initial]
x = {x}
[method]
name = "{method}"
[run]
t_span = [0.0, {end}]
{step} = 0.125
"""
RIGHT = {"name": "rigid_body", "x": "[1.0, 0.1, 0.5]", "method": "Splitting", "end": "1.0", "step": "step"}
SAID = {
    "name": ("rigid_bodi", "system: unknown system"),
    "x": ("[1.0, 0.1]", "initial.x: x0 has the shape (2,)"),
    "method": ("Spliting", "method: unknown method"),
    "end": ("1.01", "run: "),
}


def refused(tmp_path, **wrong):
    path = tmp_path / "run.toml"
    path.write_text(FILE.format(**{**RIGHT, **wrong}))
    with pytest.raises(ConfigurationError) as error:
        load(path)
    return str(error.value)


def test_three_wrong_keys_and_values_are_told_at_once(tmp_path):
    said = refused(tmp_path, step="stepp", x='[1.0, "a", 0.5]', end='"late"')
    assert "run.stepp: unknown key; did you mean 'step'?" in said
    assert "initial.x: " in said and "run.t_span: must be a list of numbers, not [0.0, 'late']" in said
    assert "run.step: is missing" not in said and "\n" not in said and said.count("; and ") == 2


def test_a_misspelled_key_is_not_told_as_missing_too(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(FILE.format(**RIGHT).replace("t_span", "t_spam"))
    with pytest.raises(ConfigurationError) as error:
        load(path)
    assert str(error.value) == f"{path}: run.t_spam: unknown key; did you mean 't_span'?"


def test_a_wrong_system_is_told_beside_wrong_keys(tmp_path):
    said = refused(tmp_path, name="rigid_bodi", step="stepp", end='"late"')
    assert "system: unknown system 'rigid_bodi'; did you mean 'rigid_body'?" in said
    assert "run.stepp: " in said and "run.t_span: " in said


@pytest.mark.parametrize("wrong", [("x", "method", "end"), ("x", "end"), ("method", "end"), ("x", "method")])
def test_what_the_system_refuses_is_told_at_once(tmp_path, wrong):
    said = refused(tmp_path, **{key: SAID[key][0] for key in wrong})
    assert all(SAID[key][1] in said for key in wrong) and said.count("; and ") == len(wrong) - 1


@pytest.mark.parametrize("wrong", SAID)
def test_one_mistake_is_told_as_it_is(tmp_path, wrong):
    said = refused(tmp_path, **{wrong: SAID[wrong][0]})
    assert SAID[wrong][1] in said and "; and " not in said


def test_many_and_long_ones_stay_in_one_line():
    said = told_together([f"key{k}: " + "long " * 100 for k in range(7)])
    assert len(said) <= LETTERS + 30 and said.endswith("; and 3 more") and all(f"key{k}" in said for k in range(4))
    assert in_one_line(said) == said
    assert told_together(["a", "a"]) == "a"
