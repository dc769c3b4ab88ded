"""Times at which states are kept, in configurations and datasets."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.configuration import load
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.datasets.export import rebuild

LINES = """
system = {{name = "rigid_body", parameters = {{inertia = [1, 2, 3]}}}}
initial = {{x = [1.0, 0.1, 0.5], attitude = true}}
method = {{name = "Splitting", order = 4}}
run = {{t_span = [0, 10], step = 0.1, {}}}
"""


def written(folder, run):
    path = folder / "body.toml"
    path.write_text(LINES.format(run))
    return str(path)


def test_a_file_asks_for_times(tmp_path):
    found = load(written(tmp_path, "t_eval = [0.25, 3, 9.99]")).integrate()
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    method = co.Splitting(order=4)
    same = co.integrate(body, (1, 0.1, 0.5), (0, 10), 0.1, method, attitude=True, t_eval=[0.25, 3, 9.99])
    assert np.array_equal(found.t, [0.25, 3, 9.99]) and np.array_equal(found.x, same.x)
    assert np.array_equal(found.attitude, same.attitude)


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ("t_eval = [11]", r"run: t_eval\[0\] is 11; it must lie within t_span"),
        ("t_eval = [3, 2]", r"run: t_eval\[1\] is 2 and comes after 3"),
        ("t_eval = [3], save_every = 2", "run: the run was given save_every and t_eval"),
        ("t_eval = 3", "run.t_eval: must be a"),
        ("t_eval = []", "run"),
    ],
)
def test_a_file_that_asks_for_wrong_times_is_refused(tmp_path, run, said):
    with pytest.raises(ConfigurationError, match=said):
        load(written(tmp_path, run))


def test_a_dataset_is_repeated_with_its_times():
    pytest.importorskip("xarray")
    body, times = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([0.33, 0.5, 1.77])
    for x0 in ((1.0, 0.1, 0.5), [(1.0, 0.1, 0.5), (0.1, 1.0, 0.5)]):
        sol = co.integrate(body, x0, (0, 2), 0.1, co.Splitting(order=4), attitude=True, t_eval=times)
        data = sol.to_xarray()
        assert np.array_equal(data["time"], times) and np.array_equal(data["x0"], sol.x0)
        assert np.array_equal(data["attitude0"], sol.attitude0)
        again = rebuild(data)
        assert np.array_equal(again.x, sol.x) and np.array_equal(again.t, times)
        assert np.array_equal(again.attitude, sol.attitude) and again.drift() == sol.drift()
