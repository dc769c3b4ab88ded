"""Every decision of the library is probed on both sides of its threshold."""

import pytest

from thresholds import (  # noqa: F401
    probes_of_files,
    probes_of_methods,
)
from thresholds.probing import PROBES


@pytest.mark.thinned(24)
@pytest.mark.parametrize("probe", PROBES.values(), ids=lambda probe: probe.name)
def test_a_decision_on_both_sides_of_its_threshold(probe):
    assert probe.decision(probe.below), f"not so for {probe.below}"
    assert not probe.decision(probe.above), f"so for {probe.above} as well"
