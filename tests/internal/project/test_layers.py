"""Import order of the layers of the library, as in `docs/architecture.md`."""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

import coadjoint
from coadjoint.shortcuts import SHORTCUTS, shortcut

PACKAGE = Path(coadjoint.__file__).parent
DOCS = Path(__file__).parents[3] / "docs"
BACKENDS = "jax", "torch"


@pytest.fixture(scope="module")
def drawn():
    specification = importlib.util.spec_from_file_location("draw_layers", DOCS / "draw_layers.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def imports(path):
    """Yield the layers and single files of the package that a file imports from, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            package, _, rest = name.partition(".")
            if package == "coadjoint" and rest:
                yield rest.partition(".")[0]


def test_every_folder_is_a_layer(drawn):
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert folders == {*drawn.LAYERS, *BACKENDS}
    table = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert all(f"| `{layer}/` | " in table for layer in drawn.LAYERS)


def test_layers_import_earlier_layers_only(drawn):
    # Layers in the same column of the figure are independent; the first six are in a row.
    along = {layer: x for layer, (_, x, _) in drawn.LAYERS.items()}
    wrong = [
        f"{path.relative_to(PACKAGE)} imports from {other}"
        for layer in drawn.LAYERS
        for path in sorted((PACKAGE / layer).rglob("*.py"))
        for other in imports(path)
        if other in BACKENDS or (other in along and other != layer and along[other] >= along[layer])
    ]
    assert wrong == []


def test_shortcuts_are_those_of_the_picture(drawn):
    """Each name that a layer calls through `coadjoint.shortcuts` is registered, used, and drawn as a dashed arrow."""
    used = {}
    for layer in drawn.LAYERS:
        for path in (PACKAGE / layer).rglob("*.py"):
            for name in re.findall(r'\bshortcut\("(\w+)"\)', path.read_text(encoding="utf-8")):
                used.setdefault(name, set()).add(layer)
    assert set(used) == set(SHORTCUTS)
    assert all(callable(shortcut(name)) for name in SHORTCUTS)
    arrows = {(layer, SHORTCUTS[name].split(".")[1]) for name, layers in used.items() for layer in layers}
    assert arrows == {("runs", layer) for layer in drawn.SHORTCUTS} | set(drawn.NEIGHBOURS)


def test_layer_figure_is_drawn(drawn, tmp_path):
    drawn.draw().savefig(tmp_path / "layers.svg")
    assert (DOCS / "layers.svg").stat().st_size > 10_000 and (tmp_path / "layers.svg").stat().st_size > 10_000
