"""Import order of the layers of the library, as in `docs/architecture.md`."""

import ast
import importlib.util
from pathlib import Path

import pytest

import coadjoint

PACKAGE = Path(coadjoint.__file__).parent
DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def drawn():
    specification = importlib.util.spec_from_file_location("draw_layers", DOCS / "draw_layers.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def imports(path):
    """Yield the layers and files that a file imports from, and whether the import is inside a function."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
    }
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            package, _, rest = name.partition(".")
            if package == "coadjoint" and rest:
                yield rest.partition(".")[0], id(node) in inside


def test_every_folder_is_a_layer(drawn):
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert folders == set(drawn.LAYERS)
    table = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert all(f"| `{layer}/` | " in table for layer in drawn.LAYERS)


def test_layers_import_earlier_layers_only(drawn):
    order = list(drawn.LAYERS)
    # Layers in the same column of the figure are independent; the first six are in a row.
    along = {layer: x for layer, (_, x, _) in drawn.LAYERS.items()}
    wrong, late, neighbours = [], set(), set()
    for layer in order:
        for path in sorted((PACKAGE / layer).rglob("*.py")):
            for other, deferred in imports(path):
                if other not in along or other == layer or along[other] < along[layer]:
                    continue
                if layer == "runs" and other in drawn.IMPORTED_LATE and deferred:
                    late.add(other)
                elif (layer, other) in drawn.NEIGHBOURS and deferred:
                    neighbours.add((layer, other))
                else:
                    wrong.append(f"{path.relative_to(PACKAGE)} imports from {other}")
    assert wrong == []
    assert late == set(drawn.IMPORTED_LATE)
    assert neighbours == set(drawn.NEIGHBOURS)


def test_layer_figure_is_drawn(drawn, tmp_path):
    drawn.draw().savefig(tmp_path / "layers.svg")
    assert (DOCS / "layers.svg").stat().st_size > 10_000 and (tmp_path / "layers.svg").stat().st_size > 10_000
