"""Run all checks of the installed package."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

from coadjoint.errors import in_one_line
from coadjoint.experiments.selftest.checks import certificates, interpreted_steps, motions, orders, resumed, same_bits
from coadjoint.experiments.selftest.findings import Finding

CHECKS = (motions, orders, certificates, same_bits, interpreted_steps, resumed)


def selftest() -> Iterator[Finding]:
    """Check the installed package on this machine; yield each measurement with its bound.

    All schemes of the library run on seven systems. Checks that need an optional package are skipped, with the reason.

    Examples
    --------
    >>> from itertools import islice
    >>> all(found.passed for found in islice(selftest(), 3))
    True
    """
    for check in CHECKS:
        findings: list[Finding] = []
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                findings.extend(check())
        except Exception as error:
            # A check that raises an error has failed; the others still run.
            findings.append(
                Finding(f"{check.__name__} ended", 1.0, 0.0, in_one_line(f"{type(error).__name__}: {error}"))
            )
        yield from findings
