"""Runs that are the same to the bit."""

import numpy as np


def check_same(found, expected):
    """Compare datasets, deviations, first values and work of two runs, bit for bit."""
    actual = found.to_xarray().load()
    for name, values in expected.to_xarray().variables.items():
        np.testing.assert_array_equal(actual[name].values, values.values, err_msg=name)
    for name, drift in expected.change().items():
        np.testing.assert_array_equal(found.change()[name].tenths, drift.tenths)
        np.testing.assert_array_equal(found.initial[name], expected.initial[name])
    assert (found.stats.steps, found.stats.evaluations) == (expected.stats.steps, expected.stats.evaluations)
