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
            message = isinstance(value, property | classmethod | staticmethod) or inspect.isfunction(value)
            if message and not member.startswith("_"):
                assert inspect.getdoc(getattr(item, member)), f"{name}.{label}.{member}"


def overridden(kind, member):
    """Return the docstring of what a member of a class overrides, in the nearest of our classes that has one."""
    bases = (base for base in kind.__mro__[1:] if base.__module__.startswith("coadjoint."))
    found = (vars(base)[member] for base in bases if member in vars(base))
    return next((inspect.cleandoc(text) for one in found if (text := written(one))), None)


def written(value):
    value = value.fget if isinstance(value, property) else getattr(value, "__func__", getattr(value, "func", value))
    return value.__doc__ if inspect.isfunction(value) else None


@pytest.mark.parametrize("name", modules())
def test_overrides_inherit_what_they_do_not_say_otherwise(name):
    for label, kind in vars(importlib.import_module(name)).items():
        if not inspect.isclass(kind) or kind.__module__ != name:
            continue
        for member, value in vars(kind).items():
            own, base = written(value), overridden(kind, member)
            if own and base:
                summary = inspect.cleandoc(own).split("\n\n")[0].rstrip(".")
                assert not base.startswith(summary), f"{name}.{label}.{member} repeats: {summary}"
