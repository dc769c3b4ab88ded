"""A scheme is one file, and outside `methods/` none is named: other layers ask for schemes by a purpose."""

import ast
import inspect
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.methods import registry
from served import served

SOURCE = Path(co.__file__).parent
# What other schemes, candidates and references are made of, in `methods/`.
BUILT_ON = {"Splitting", "Composition", "GaussLegendre", "Taylor", "ExplicitRungeKutta"}
BESIDE = sorted(set(registry.names()) - BUILT_ON)


def names_in(path):
    """Names that the code of a file uses; those in texts, which advise a reader, are none."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names)


@pytest.fixture(scope="module")
def used():
    skipped = SOURCE / "experiments"
    return {
        path: set(names_in(path))
        for path in SOURCE.rglob("*.py")
        if skipped not in path.parents and path.name[0] != "_"
    }


@pytest.mark.parametrize("name", BESIDE)
def test_no_other_file_names_it(name, used):
    own = Path(inspect.getfile(registry.scheme(name)))
    assert {path for path, names in used.items() if name in names} <= {own}


@pytest.mark.parametrize("name", sorted(BUILT_ON))
def test_no_file_of_another_layer_names_it(name, used):
    assert {path for path, names in used.items() if name in names and SOURCE / "methods" not in path.parents} == set()


def test_the_search_finds_what_is_named(used):
    found = {path for path, names in used.items() if "Taylor" in names}
    assert found == {SOURCE / "methods" / name for name in ("taylor.py", "suggested_scheme.py")}
    assert len(BESIDE) >= 7


@pytest.mark.parametrize("name", registry.names())
def test_a_scheme_says_what_a_new_one_must(name):
    """Examples are of its own kind, equal what their description says, and refuse or serve in one sentence."""
    for method in registry.scheme(name).examples():
        assert type(method).__name__ == name and isinstance(method.order, int) and method.order >= 1
        assert registry.from_description(registry.description_of(method)) == method
        assert method.work(served(method)[0]).cost(1.0, 1.0) > 0
