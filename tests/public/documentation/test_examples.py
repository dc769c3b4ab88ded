"""Programs in `examples/`, which check their results themselves."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize(
    ("name", "printed"),
    [("least_effort", "1.984321"), pytest.param("learned_network", "is off", marks=pytest.mark.long)],
)
def test_programs_run(name, printed, capsys):
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    assert printed in capsys.readouterr().out
