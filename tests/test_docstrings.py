"""Everything public says what it is: in its own words, or in those of what it overrides."""

import importlib
import inspect
import pkgutil

import pytest

import coadjoint


def modules():
    names = [name for _, name, _ in pkgutil.walk_packages(coadjoint.__path__, "coadjoint.")]
    return [name for name in names if not name.rpartition(".")[2].startswith("_")]


@pytest.mark.parametrize("name", modules())
def test_every_public_name_has_a_docstring(name):
    module = importlib.import_module(name)
    assert module.__doc__
    for label, item in vars(module).items():
        if label.startswith("_") or getattr(item, "__module__", None) != name or not callable(item):
            continue
        assert inspect.getdoc(item) or (not inspect.isroutine(item) and not inspect.isclass(item)), f"{name}.{label}"
        if not inspect.isclass(item):
            continue
        for member, value in vars(item).items():
            said = isinstance(value, property | classmethod | staticmethod) or inspect.isfunction(value)
            if said and not member.startswith("_"):
                assert inspect.getdoc(getattr(item, member)), f"{name}.{label}.{member}"
