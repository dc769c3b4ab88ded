"""All checks of the installed package, one after the other."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

from coadjoint.errors import in_one_line
from coadjoint.experiments.selftest.checks import certificates, motions, orders, plain_reading, resumed, same_bits
from coadjoint.experiments.selftest.findings import Finding

CHECKS = (motions, orders, certificates, same_bits, plain_reading, resumed)


def selftest() -> Iterator[Finding]:
    """Check the installed package on this machine; return each measurement with its bound.

    For machines, compilers and versions of packages on which nobody has tried it. All schemes of the library are tried,
    on seven systems; nothing that an extra brings is needed, and what is skipped without one says so.

    Yields
    ------
    Finding
        One for each check; `Finding.passed` says whether it holds.

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
            # A check that cannot be made has failed, and the others are still to be made.
            found.append(Finding(f"{check.__name__} ended", 1.0, 0.0, in_one_line(f"{type(error).__name__}: {error}")))
        yield from found
