"""Descriptions of ready-made systems: the formulas are those of the system, in the names of its coordinates."""

import inspect
import json
import re

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.description import MAX_FORMULA_LENGTH, description
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

NAMES = co.systems.names()


def value_of(formula, names, x):
    """Evaluate a formula in named coordinates; any other word in it is an error."""
    longest_first = sorted(range(len(names)), key=lambda k: -len(names[k]))
    pattern = "|".join(re.escape(names[k]) for k in longest_first)
    places = {name: k for k, name in enumerate(names)}
    # A name that ends with a digit must not be followed by another one.
    code = re.sub(rf"({pattern})(?!\d)", lambda found: f"x[{places[found[1]]}]", formula).replace("^", "**")
    return eval(code, {"__builtins__": {}}, {"x": x})


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_formulas_are_those_of_the_system(name):
    system, found = co.systems.get(name), description(name)
    names = found["coordinates"]
    assert len(names) == len(set(names)) == system.dim == found["dimension"]
    x = np.cos(1.0 + np.arange(system.dim))
    for kind in ("casimirs", "integrals"):
        known = getattr(system, kind, {})
        assert list(found[kind]) == list(known)
        for key, formula in found[kind].items():
            F = known[key]
            polynomial = isinstance(F, co.Polynomial) or (isinstance(F, co.Quadratic) and F.dim <= 64)
            assert (formula is not None) == polynomial, key
            if formula is not None and formula.endswith("..."):
                # Cut between two terms or signs, as late as possible.
                text = str(F.to_polynomial() if hasattr(F, "to_polynomial") else F)
                whole = re.sub(r"x(\d+)", lambda found, names=names: names[int(found[1]) - 1], text)
                cut = formula[:-3]
                assert whole.startswith(cut + " ") and len(cut) <= MAX_FORMULA_LENGTH
                assert len(cut) + len(whole[len(cut) :].split()[0]) >= MAX_FORMULA_LENGTH - 1
            elif formula is not None:
                wanted = float(getattr(F, "value", F)(x))
                # Sums of at most some hundred products of numbers below one, with coefficients of six digits.
                assert value_of(formula, names, x) == pytest.approx(wanted, rel=1e-4, abs=1e-4), (key, formula)


def assert_sections_are_those_of_the_docstring(made, found):
    """The words of each section in order, from the first line below its heading to the next heading."""
    lines = inspect.getdoc(made).splitlines()
    headings = [k for k in range(len(lines) - 1) if lines[k] and set(lines[k + 1]) == {"-"}]

    def section(heading):
        (start,) = [k for k in headings if lines[k] == heading] or [len(lines)]
        return lines[start + 2 : min([k for k in headings if k > start], default=len(lines))]

    def words(text):
        return " ".join(text).replace("`", "").split()

    summary = lines[: lines.index("")]
    assert found["summary"].split() == words(summary)
    assert words(found["equations"]) == words(lines[lines.index("") : headings[0]])
    # The first line of Returns names the type.
    assert found["state"].split() == words(section("Returns")[1:])
    assert found["source"].split() == words(section("Notes"))
    documented, names = {}, []
    for line in section("Parameters"):
        if line.startswith(" "):
            for name in names:
                documented[name]["meaning"] += words([line])
        elif line:
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            documented.update({name: {"kind": line.partition(" : ")[2], "meaning": []} for name in names})
    for key, value in found["parameters"].items():
        assert {"kind": value["kind"], "meaning": value["meaning"].split()} == documented[key], key


@pytest.mark.parametrize("name", NAMES)
def test_what_it_says_of_the_system(name):
    system, found = co.systems.get(name), description(name)
    assert json.loads(json.dumps(found)) == found
    assert found["name"] == name and found["sign"] == system.sign
    assert found["exact"] == (system.closed_form is not None)
    signature = inspect.signature(ready_made_systems()[name]).parameters
    assert list(found["parameters"]) == list(signature)
    for key, told in found["parameters"].items():
        assert told["kind"] and told["meaning"], key
        default = np.asarray(signature[key].default, dtype=object)
        assert np.array_equal(np.asarray(told["default"], dtype=object), default)
    assert found["summary"].endswith(".") and "`" not in found["summary"]
    assert_sections_are_those_of_the_docstring(ready_made_systems()[name], found)
    gallery_entry = gallery_entry_of(name)
    assert found["gallery"] == {
        "caption": gallery_entry.caption,
        "t_span": list(gallery_entry.t_span),
        "step": gallery_entry.step,
    }
    assert found["coordinates"] == list(coordinate_names(system))
    if system.algebra is None:
        assert found["algebra"] is None and found["attitude"] == "none"
    elif hasattr(system.algebra, "triples"):
        assert found["attitude"] == ("coadjoint" if system.representation is None else "representation")
        x = np.random.default_rng(2).standard_normal(system.dim)
        assert found["rank"] == np.linalg.matrix_rank(system.structure_matrix(x), tol=1e-9)
    else:
        assert found["attitude"] == "matrices"
