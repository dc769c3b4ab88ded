"""Failures of parts of steps whose whole steps succeed."""

import numpy as np

from coadjoint.kernels.interface import codes
from coadjoint.runs.partial_steps import PartialSteps


def failing_parts(monkeypatch, member, start):
    """Let parts of one step of a member fail."""
    attempt = PartialSteps.attempt

    def some_fail(self, momenta, groups, times, lengths, owners=None, watched=False):
        found = attempt(self, momenta, groups, times, lengths, owners, watched)
        own = np.arange(len(times)) if owners is None else owners
        failed = (own == member) & (times == start) & (lengths != 0.0)
        for array in found[:4]:
            array[failed] = np.nan
        found.status[failed], found.residual[failed] = codes("Status")["NOT_CONVERGED"], 0.25
        return found

    monkeypatch.setattr(PartialSteps, "attempt", some_fail)
