"""The accuracy of a run in its file: the same choice, and the same bits, as in Python."""

import numpy as np
import pytest
from configuration_files import READY_MADE

import coadjoint as co
from coadjoint.files.configuration.configuration import ConfigurationError, load

CHOSEN = READY_MADE.replace("step = 0.1", "accuracy = 1e-8")
BODY, X0 = co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.1, 0.5)


@pytest.fixture
def written(tmp_path):
    def write(text):
        (tmp_path / "run.toml").write_text(text, encoding="utf-8")
        return tmp_path / "run.toml"

    return write


@pytest.mark.parametrize("method", [None, co.Splitting(order=4)])
@pytest.mark.parametrize("span", [(0, 1), (1, -2)])
def test_the_same_as_in_python(written, method, span):
    text = CHOSEN.replace("[0, 1]", str(list(span)))
    if method is None:
        text = text.replace('[method]\nname = "Splitting"\norder = 4\n', "")
    found = load(written(text))
    sol, right = found.integrate(), co.integrate(BODY, X0, span, accuracy=1e-8, method=method)
    assert (found.step, found.method) == (right.step, right.method) and sol.choice == right.choice
    assert sol.x.tobytes() == right.x.tobytes()
    exact = BODY.exact(X0, float(span[1] - span[0]))
    assert np.linalg.norm(sol.x[-1] - exact) < 1e-8


def test_into_an_archive_too(written, tmp_path):
    found = load(written(CHOSEN))
    sol = found.integrate(archive=tmp_path / "run.zarr")
    assert np.asarray(sol.x).tobytes() == found.integrate().x.tobytes() and sol.choice is found.choice is not None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (READY_MADE.replace("step = 0.1", ""), "run: step is missing; give step, or accuracy"),
        (READY_MADE.replace("step = 0.1", "step = 0.1\naccuracy = 1e-8"), "run: step and accuracy are both given"),
        (CHOSEN.replace("1e-8", "1.5"), "run.accuracy: "),
        (CHOSEN.replace("1e-8", "1e-19"), "run.accuracy: "),
        (CHOSEN.replace("1e-8", "1e-8\nt_eval = [2.0]"), "run: "),
        (
            CHOSEN + '[sweep.over]\n"system.parameters.inertia[2]" = [2.5, 3.0]\n',
            "run.accuracy: accuracy chooses the step for one system, and this is a batch; choose for a member",
        ),
    ],
)
def test_refused_by_key(written, text, said):
    with pytest.raises(ConfigurationError) as raised:
        load(written(text))
    assert said in str(raised.value)
