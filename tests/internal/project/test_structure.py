"""The budget of the source tree, and what tests of public behaviour may import."""

import ast
import re
from functools import cache

import pytest

import coadjoint as co
from structure import MAXIMA, ROOT, cycles, figures, imports_by_text, reached, tracked

TESTS = ROOT / "tests"
SPACES = {
    name.removeprefix("co.") for name in re.findall(r"^co\.[a-z]+$", (ROOT / "docs/public_names.txt").read_text(), re.M)
}
SPACES.add("h")  # coadjoint.h, which `coadjoint export` writes
DOCUMENTED = {"_replace", "_asdict", "_fields", "_exit", "_repr_html_", "_idlist"}
IN_TEXT = re.compile(r"\b(?:from|import) coadjoint\.(\w+)(\.\w+)?|^coadjoint\.(\w+)(\.\w+\.)?")


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", MAXIMA)
def test_figures_are_within_the_budget(name):
    """A change that needs more says in `structure.py` what users gain for it."""
    assert all_figures()[name] <= MAXIMA[name]


@cache
def all_figures():
    return figures()


def test_cycles_and_reached_modules():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}, "e": set()}
    assert reached("a", graph) == {"a", "b", "c"} and cycles(graph) == [{"b", "c"}]


def test_calls_by_text_are_imports():
    texts = {"shortcuts": 'X = {"draw": "coadjoint.pictures.a:draw_a"}', "run": 'return shortcut("draw")(self)'}
    assert imports_by_text(texts) == {"shortcuts": set(), "run": {"coadjoint.pictures.a"}}


def inside(text):
    """Yield the internal names in a syntax tree of a test of public behaviour."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            if node.module.startswith("coadjoint."):
                yield node.module
            elif node.module == "coadjoint":
                yield from (alias.name for alias in node.names if alias.name not in dir(co))
        elif isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            yield from (".".join(parts) for parts in names if parts[0] == "coadjoint" and set(parts[1:]) - SPACES)
        elif isinstance(node, ast.Attribute):
            of_package = isinstance(node.value, ast.Name) and node.value.id in ("co", "coadjoint")
            private = node.attr.startswith("_") and not node.attr.startswith("__") and node.attr not in DOCUMENTED
            own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            if (of_package and node.attr not in {*dir(co), "__file__", "__doc__", "__path__"}) or (private and not own):
                yield ast.unparse(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            for first, deeper, patched, further in IN_TEXT.findall(node.value):
                if (first and (first not in SPACES or deeper)) or (patched and (patched not in SPACES or further)):
                    yield node.value[:80]


@cache
def inside_file(path):
    return sorted(set(inside(path.read_text("utf-8"))))


@cache
def imported(path):
    """Return the names of modules, and of what may be one, that a file imports."""
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names = [node.module] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in filter(None, names):
            found += [name, *(f"{name}.{alias.name}" for alias in node.names)]
    return found


def helpers_of(path, modules):
    """Return the helper modules of the tests that a file imports, directly or not."""
    found, pending = {}, [path]
    while pending:
        for one in imported(pending.pop()):
            if one in modules and one not in found:
                found[one] = modules[one]
                pending.append(modules[one])
    return found.values()


@cache
def helper_modules():
    """Return the helper modules by the names by which tests import them."""
    files = [path for path in tracked() if path.is_relative_to(TESTS) and path.suffix == ".py"]
    modules = {path.stem: path for path in files if not path.stem.startswith(("test_", "__init__", "conftest"))}
    packages = {path.parent for path in files if path.name == "__init__.py"}
    modules |= {f"{path.parent.name}.{path.stem}": path for path in files if path.parent in packages}
    return modules


def test_public_tests_use_public_names_alone():
    """`coadjoint` and its documented submodules; so do the helper modules that they import."""
    wrong = {}
    for path in tracked():
        if path.is_relative_to(TESTS / "public") and path.suffix == ".py":
            for one in (path, *helpers_of(path, helper_modules())):
                if found := inside_file(one):
                    wrong[str(one.relative_to(TESTS))] = found
    assert wrong == {}


@pytest.mark.parametrize(
    "text",
    [
        "from coadjoint.runs.run import Run",
        "from coadjoint import runs",
        "import coadjoint.runs",
        "co.kernels.library",
        "sol._record",
        "monkeypatch.setattr('coadjoint.runs.run.Run.advance', None)",
        "run('import coadjoint.cli as cli')",
    ],
)
def test_internal_names_are_found(text):
    assert list(inside(text)) != []


@pytest.mark.parametrize(
    "text",
    [
        "from coadjoint import Splitting, jax",
        "import coadjoint.methods",
        "co.systems.rigid_body; self._own; row._replace(a=1)",
        "run('from coadjoint.jax import solution; import coadjoint as co')",
        "'a text about coadjoint.methods'",
    ],
)
def test_public_names_are_not_found(text):
    assert list(inside(text)) == []


def test_each_class_name_has_one_meaning():
    """Modules of the package define no two classes of one name; tables have the names of their structures in C++."""
    names = [
        node.name
        for path in tracked(ROOT)
        if path.suffix == ".py" and path.is_relative_to(ROOT / "src") and path.parent.name != "tables"
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef)
    ]
    assert sorted({name for name in names if names.count(name) > 1}) == []
