"""The ready-made systems: by name, from their own parameters, and in which convention."""

import inspect
import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coadjoint import systems

X = np.array([1.0, 2.0, 0.5])
SOURCE = Path(systems.__file__).parents[2]


@pytest.mark.parametrize("name", systems.names())
def test_made_again_from_parameters(name):
    system = systems.get(name)
    assert system.name == name
    again = systems.get(system.name, **system.parameters)
    assert again.parameters == system.parameters
    assert again.algebra == system.algebra
    x = np.cos(np.arange(system.dim))
    np.testing.assert_array_equal(again.vector_field(x), system.vector_field(x))
    if system.closed_form is not None:
        h = 2.0**-17  # the error of the central difference is about h^2, 6e-11, and u / h, 1.5e-11
        slope = (system.exact(x, 1.0 + h) - system.exact(x, 1.0 - h)) / (2 * h)
        np.testing.assert_allclose(slope, system.vector_field(system.exact(x, 1.0)), rtol=0, atol=1e-8)


def other_kind(value):
    """The same numbers as arrays of NumPy, whole ones as integers."""
    if isinstance(value, bool | str) or callable(value) or not np.issubdtype(np.asarray(value).dtype, np.number):
        return value
    array = np.asarray(value)
    whole = array.astype(np.int64)
    array = whole if np.array_equal(whole, array) else array
    return array if array.ndim else array[()]


def assert_plain(value):
    if isinstance(value, tuple):
        for entry in value:
            assert_plain(entry)
    else:
        assert value is None or type(value) in (int, float, bool, str), repr(value)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", systems.names())
def test_parameters_are_plain_numbers_whatever_holds_them(name):
    """So they can be written to a file, and an array that changes later does not change them."""
    wanted = systems.get(name)
    defaults = inspect.signature(getattr(systems, name)).parameters
    given = {key: other_kind(one.default) for key, one in defaults.items()}
    system = systems.get(name, **given)
    for array in given.values():
        if isinstance(array, np.ndarray):
            array[...] = 7
    assert system.parameters == wanted.parameters
    assert set(system.parameters) <= set(defaults)
    for value in system.parameters.values():
        assert_plain(value)
    again = systems.get(name, **json.loads(json.dumps(system.parameters)))
    assert again.parameters == wanted.parameters


def test_names_are_sorted_and_listed():
    assert list(systems.names()) == sorted(set(systems.names()))
    assert {*systems.names(), "get", "names"} <= set(dir(systems)) == set(systems.__all__)
    for name in systems.names():
        assert getattr(systems, name).__name__ == name
    with pytest.raises(AttributeError, match="did you mean 'heavy_top'"):
        systems.heavy_topp  # noqa: B018
    with pytest.raises(ValueError, match="unknown system 3"):
        systems.get(3)


def test_parameters_are_checked():
    with pytest.raises(ValueError, match="did you mean 'rigid_body'"):
        systems.get("rigidbody")
    with pytest.raises(ValueError, match="unknown parameter of rigid_body 'inertias'; did you mean 'inertia'"):
        systems.get("rigid_body", inertias=(1, 2, 3))
    with pytest.raises(ValueError, match="masses"):
        systems.get("paper_rigid_body", masses=(1.0, 2.0))


def test_rigid_body_is_the_body_equation():
    inertia = np.array([1.0, 2.0, 2.5])
    system = systems.rigid_body(inertia)
    np.testing.assert_allclose(system.vector_field(X), np.cross(X, X / inertia), rtol=1e-15)
    paper = systems.paper_rigid_body(1 / inertia)
    np.testing.assert_allclose(paper.vector_field(X), np.cross(X / inertia, X), rtol=1e-15)
    assert (system.sign, paper.sign) == (-1, 1)


def test_full_inertia():
    inertia = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])
    system = systems.rigid_body(inertia)
    expected = np.cross(X, np.linalg.solve(inertia, X))
    np.testing.assert_allclose(system.vector_field(X), expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(system.hamiltonian.hessian(X), system.hamiltonian.hessian(X).T)
    again = systems.get("rigid_body", **system.parameters)
    np.testing.assert_array_equal(again.hamiltonian.hessian(X), system.hamiltonian.hessian(X))


def test_paper_a37_has_the_papers_energy_and_casimir():
    system = systems.paper_a37()
    assert system.energy(np.ones(3)) == pytest.approx(1.505, rel=1e-15)
    casimir = system.casimirs["log C"]
    assert np.array(casimir.gradient(X)) @ system.vector_field(X) == pytest.approx(0.0, abs=1e-14)
    with pytest.raises(TypeError, match="no closed form is known for paper_a37"):
        system.exact(X, 1.0)


@pytest.mark.parametrize(("a", "masses"), [(1.3, (0.7, -0.4, 1.1)), (-0.5, (0.0, 2.0, 0.25)), (0.0, (1.0, 0.5, 2.0))])
def test_paper_a37_by_hand(a, masses):
    """[e1, e3] = a e1 - e2 and [e2, e3] = e1 + a e2: x' = J(x) M x."""
    system, x, y = systems.paper_a37(a, masses), X[0], X[1]
    one, two, three = np.array(masses) * X
    first, second = a * x - y, x + a * y
    wanted = [first * three, second * three, -first * one - second * two]
    np.testing.assert_allclose(system.vector_field(X), wanted, rtol=0, atol=1e-15)
    assert system.energy(X) == pytest.approx(0.5 * np.dot(masses, X**2), rel=1e-15)
    assert system.sign == 1 and system.parameters == {"a": a, "masses": masses}
    if a > 0:
        theta = np.arctan2(y, x)
        assert system.casimirs["log C"](X) == pytest.approx(np.log(x * x + y * y) - 2 * a * theta, rel=1e-13)


def test_systems_can_be_sent_to_another_process():
    system = pickle.loads(pickle.dumps(systems.rigid_body((1.0, 2.0, 3.0))))
    np.testing.assert_array_equal(system.exact(X, 2.0), systems.rigid_body((1.0, 2.0, 3.0)).exact(X, 2.0))


def test_import_is_light():
    heavy = ("scipy", "numba", "xarray", "matplotlib", "pydantic")
    code = (
        f"import sys; sys.path.insert(0, {str(SOURCE)!r}); import coadjoint.systems as s; s.rigid_body(); "
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
