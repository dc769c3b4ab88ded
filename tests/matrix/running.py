"""Runs the checks of a case; a failure shows lines of Python that repeat it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import coadjoint as co

from .cases import Case, Refused, accepted, execute, refusals, supported
from .checks import BY_DIFFERENCES, CHECKS, NEARER, Check
from .options import Options

AGAIN = 3
AGREE = "assert_agree(found, expected, allowed)\n"


class Disagreement(AssertionError):
    """A check that fails, with the lines that were executed."""


def check_case(case: Case, space: dict[str, Any], checks: Iterable[Check] = CHECKS) -> int:
    """Execute every check of a case; return how many there were."""
    count = 0
    for check in checks:
        for lines in check(case, space):
            count += 1
            try:
                try:
                    execute(lines + AGREE, space)
                except AssertionError:
                    # The differences may reach a kink, as where a plate turns edge-on; nearer ones then do not.
                    if BY_DIFFERENCES[0] not in lines:
                        raise
                    execute(lines.replace(BY_DIFFERENCES[0], NEARER) + AGREE, space)
            except co.IntegrationError:
                raise
            except Exception as error:
                raise Disagreement(
                    f"{check.__name__} of {case}\n{type(error).__name__}: {error}\n\n{case.lines}{lines}{AGREE}"
                ) from error
    return count


def check_refusal(refused: Refused, method: str, system: str) -> None:
    """Check that a refusal is one line that names the scheme, the system, a force or an option."""
    text = str(refused.__cause__)
    names = [method.replace("(", ".").split(".")[1], system.replace("(", ".").split(".")[2], *co.forces.names()]
    names += ["attitude", "group element", "representation", "inputs", "t_eval", "batch", "event", "own force"]
    names.append("Lie algebra")
    if "\n" in text or not any(name in text for name in names):
        raise Disagreement(f"refused without a name: {text!r}\n\n{refused.args[0].lines}") from refused.__cause__


def check_drawn(cases: Iterable[tuple[str, str, Options, int]]) -> list[Case]:
    """Check drawn cases; return those that could be run."""
    found = []
    for method, system, options, first in cases:
        for again in range(AGAIN + 1):
            try:
                case, space, refused_options = accepted(method, system, options, first + 1000 * again)
                check_case(case, space)
            except co.IntegrationError:
                # A motion that ends soon, or for which the step is too large: other states are drawn.
                if again == AGAIN and system.startswith("co.systems."):
                    raise
                continue
            for refused in refused_options:
                check_refusal(refused, method, system)
            found.append(case)
            break
    return found


def is_refused(method: str, system: str) -> bool:
    """Return whether a scheme refuses a system, in its declaration or in runs, with a line that names one."""
    for text in refusals(method, system):
        name = method.replace("(", ".").split(".")[1]
        if "\n" in text or not (name in text or "use " in text or "take " in text):
            raise Disagreement(f"{text!r} of {method} on {system} names no scheme")
    return not supported(method, system)
