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

    For untested machines, compilers and package versions. All schemes of the library are tried on seven systems; no
    optional package is required, and checks that need one are skipped with the reason.

    Yields
    ------
    Finding
        One per check; `Finding.passed` is the verdict.

    Examples
    --------
    >>> from itertools import islice
    >>> all(found.passed for found in islice(selftest(), 3))
    True
    """
    for check in CHECKS:
        found: list[Finding] = []
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found.extend(check())
        except Exception as error:
            # A check that raises an error has failed; the others still run.
            found.append(Finding(f"{check.__name__} ended", 1.0, 0.0, in_one_line(f"{type(error).__name__}: {error}")))
        yield from found
