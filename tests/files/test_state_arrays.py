"""States in files: vectors, matrices and layers, real and complex, of one member and of several; damaged ones."""

import numpy as np
import pytest
import xarray

from coadjoint.files.datasets.state_arrays import STATE_DIMENSIONS, split_complex, state_dimensions, state_of

SHAPES = {"component": (3,), "matrix": (2, 4), "layers": (3, 2, 4)}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("members", [None, 1, 5])
@pytest.mark.parametrize("kind", [float, complex])
def test_a_state_is_read_as_it_was(shape, members, kind):
    rng, member = np.random.default_rng(2), () if members is None else (members,)
    states = rng.standard_normal((*member, *SHAPES[shape])).astype(kind)
    if kind is complex:
        states += 1j * rng.standard_normal(states.shape)
    dims = (*("member",)[: len(member)], *state_dimensions(states, len(member)))
    dataset = xarray.Dataset({"x0": (dims, split_complex(states))})
    assert dims[-1:] == ("part",) * (kind is complex) or kind is float
    found = state_of(dataset, "x0", STATE_DIMENSIONS)
    assert found.dtype == states.dtype and found.tobytes() == states.tobytes() and found.shape == states.shape


def test_whole_numbers_become_floats():
    found = state_of(xarray.Dataset({"x0": ("component", np.arange(3))}), "x0", STATE_DIMENSIONS)
    assert found.dtype == np.float64 and found.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("dims", "values", "said"),
    [
        (("time",), np.zeros(3), "x0 is over .*; it must be over"),
        (("component", "member"), np.zeros((3, 2)), "x0 is over"),
        (("member",), np.zeros(2), "x0 is over"),
        (("part",), np.zeros(2), "x0 is over"),
        (("row", "column", "part", "more"), np.zeros((2, 2, 2, 1)), "x0 is over"),
        (("component",), np.zeros(0), "x0 is over"),
        (("member", "component"), np.zeros((0, 3)), "x0 is over"),
        (("component",), np.array(["a", "b"]), "values that are not finite numbers"),
        (("component",), np.array([True, False]), "values that are not finite numbers"),
        (("component",), np.array([1.0, np.nan]), "values that are not finite numbers"),
        (("member", "component"), np.array([[1.0, 2.0], [np.inf, 0.0]]), "values that are not finite numbers"),
        (("component", "part"), np.zeros((3, 1)), "x0 has 1 parts; complex numbers have 2"),
        (("component", "part"), np.zeros((3, 3)), "x0 has 3 parts; complex numbers have 2"),
    ],
)
def test_damaged_states_are_refused(dims, values, said):
    with pytest.raises(ValueError, match=said):
        state_of(xarray.Dataset({"x0": (dims, values)}), "x0", STATE_DIMENSIONS)
    with pytest.raises(ValueError, match="no variable 'x1'"):
        state_of(xarray.Dataset({"x0": (dims, values)}), "x1", STATE_DIMENSIONS)
