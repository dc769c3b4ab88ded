"""One name, one scheme: those of this package, of other packages, and registered ones."""

import dataclasses
import importlib.metadata
from types import SimpleNamespace

import pytest

import coadjoint as co
from coadjoint.methods import registry
from own_schemes import OwnKahan
from refusals import refused


def named(name, module="another_package", path=None):
    """Return a scheme that is a dataclass with this name, as if defined elsewhere."""
    found = dataclasses.make_dataclass(name, [], bases=(OwnKahan,), frozen=True)
    found.__module__, found.__qualname__ = module, path or name
    return found


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """Give each test a registry of its own, without other packages."""
    monkeypatch.setattr(registry, "_registered", {})
    monkeypatch.setattr(registry, "_loaded", {})
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [])
    registry._entry_point_schemes.cache_clear()
    yield
    registry._entry_point_schemes.cache_clear()


def packages(monkeypatch, **schemes):
    """Install packages whose entry points are these schemes."""
    points = [SimpleNamespace(name=key, value=f"{key}:it", load=lambda it=it: it) for key, it in schemes.items()]
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: points if group == "coadjoint.methods" else []
    )


def described():
    """Return the class of every scheme by its name."""
    return {name: registry.scheme(name) for name in registry.names()}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", co.methods.names())
def test_a_name_of_the_package_is_taken(name):
    """Whichever of module and place in it another class shares; the own class may be registered again."""
    before = described()
    own = before[name]
    for other in (named(name), named(name, own.__module__, f"made.<locals>.{name}")):
        with refused(ValueError, name, own.__module__):
            co.methods.register(other)
        assert described() == before
        with refused(ValueError, f"'{name}'"):
            registry.forget(name)
    assert co.methods.register(own) is own and described() == before


def test_a_registered_name_is_taken_until_it_is_forgotten():
    before, first = described(), named("Third")
    co.methods.register(first)
    for other in (named("Third", "a_third_package"), named("Third", path="made.<locals>.Third")):
        with refused(ValueError, "Third", "another_package"):
            co.methods.register(other)
        assert described() == {**before, "Third": first}
    again = named("Third")  # the same definition, as after a change in a notebook
    co.methods.register(again)
    assert described() == {**before, "Third": again} and type(co.methods.get("Third")) is again
    registry.forget("Third")
    assert described() == before
    other = named("Third", "a_third_package")
    co.methods.register(other)
    assert described() == {**before, "Third": other}


def test_names_of_packages_and_registered_ones_exclude_each_other(monkeypatch):
    """The first of two stays: a package that comes second is skipped with a warning."""
    before, own, theirs = described(), named("Mine"), named("Theirs")
    co.methods.register(own)
    second = {name: named(name, "a_second_package") for name in ("Theirs", "Mine", "Splitting")}
    packages(monkeypatch, a=theirs, b=second["Theirs"], c=second["Mine"], d=second["Splitting"])
    registry._entry_point_schemes.cache_clear()
    with pytest.warns(RuntimeWarning, match="is skipped: there is another scheme") as warned:
        found = described()
    assert found == {**before, "Mine": own, "Theirs": theirs}
    skipped = [str(warning.message).split()[2] for warning in warned]
    assert skipped == ["b", "c", "d"]
    with refused(ValueError, "Theirs", "another_package"):
        co.methods.register(named("Theirs", "a_third_package"))
    assert described() == found
    with refused(ValueError, "'Theirs'"):
        registry.forget("Theirs")


def test_a_registered_scheme_is_described_and_made_by_name():
    assert co.methods.register(OwnKahan) is OwnKahan
    assert "OwnKahan" in co.methods.names() and co.methods.get("OwnKahan") == OwnKahan()
    composition = co.Composition(OwnKahan(), (0.5, 0.5))
    assert registry.from_description(registry.description_of(composition)) == composition
    registry.forget("OwnKahan")
    with refused(ValueError, "'OwnKahan'"):
        co.methods.get("OwnKahan")


@pytest.mark.parametrize("given", [int, co.methods.StepMethod])
def test_what_is_no_scheme_is_not_registered(given):
    before = described()
    with refused(TypeError, "int" if given is int else "StepMethod"):
        co.methods.register(given)
    assert described() == before
