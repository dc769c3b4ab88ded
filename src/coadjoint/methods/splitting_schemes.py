"""Coefficients of the splitting schemes: fractions of the step for a second-order symmetric map, first half of a
palindrome.
"""

from __future__ import annotations

from typing import NamedTuple


class SplittingScheme(NamedTuple):
    """A symmetric composition of the second-order splitting.

    Parameters
    ----------
    order : int
        Order of the composition.
    half : tuple of str
        The first half of its palindromic coefficients and the middle one, to 50 digits.
    source : str
        Where it was published.
    """

    order: int
    half: tuple[str, ...]
    source: str


SCHEMES = {
    "strang": SplittingScheme(2, ("1",), "Strang 1968; Lemma 4.1 of Reich 1993"),
    "yoshida4": SplittingScheme(
        4,
        (
            "1.3512071919596576340476878089714608269219993762171",
            "-1.7024143839193152680953756179429216538439987524343",
        ),
        "Creutz and Gocksch 1989, Forest and Ruth 1990, Suzuki 1990, Yoshida 1990; section 4 of Reich 1993",
    ),
    "suzuki4": SplittingScheme(
        4,
        (
            "0.41449077179437573714235406286076149571177460401671",
            "0.41449077179437573714235406286076149571177460401671",
            "-0.65796308717750294856941625144304598284709841606683",
        ),
        "Suzuki 1990",
    ),
}

# Smallest error at equal cost on the rigid body among the schemes of that order.
DEFAULT_SCHEMES = {2: "strang", 4: "suzuki4"}
