"""Results of `certify`: certificates and their rows."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from coadjoint.errors import unknown_name
from coadjoint.short_repr import html_table, plain
from coadjoint.shortcuts import shortcut

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOLDS = "holds"
FAILS = "fails"
UNDECLARED_PRESERVED = "kept though not declared"
UNDECLARED_LOST = "not kept, not declared"
INAPPLICABLE = "not applicable"
UNDECIDED = "not decidable here"
VERDICTS = (HOLDS, FAILS, UNDECLARED_PRESERVED, UNDECLARED_LOST, INAPPLICABLE, UNDECIDED)
SCHEMA = 1
"""Version of the mapping of a certificate."""
MAX_WIDTH = 120  # letters of a line of the text
COLUMN_HEADINGS = ("what", "declared", "verdict", "measured")


@dataclass(frozen=True)
class Row:
    """One check of a certificate.

    Parameters
    ----------
    key : str
        Name of the row in the certificate.
    what : str
        The property checked.
    declared : str
        The declaration of the scheme about the property.
    measured : str
        The measurement as text.
    verdict : str
        One of `VERDICTS`.
    claimed : bool
        Whether the property must hold for the certificate to pass.
    value, bound : float or None
        The decisive value, and the bound it was compared with.
    source : str
        Derivation of the bound.
    reason : str
        Why the check is not applicable or not decidable, or a remark.
    evidence : mapping
        Name -> array or number: all measurements.
    """

    key: str
    what: str
    declared: str
    measured: str
    verdict: str
    claimed: bool = False
    value: float | None = None
    bound: float | None = None
    source: str = ""
    reason: str = ""
    evidence: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assert self.verdict in VERDICTS

    def __str__(self) -> str:
        """Format the row in one line."""
        return f"{self.what}: {self.measured} ({self.verdict})"

    def bounded(self, value: float, bound: float, measured: str, **rest: Any) -> Row:
        """Return the row with the verdict on a value, which must be at most its bound."""
        result = verdict(self.claimed, value <= bound)
        return replace(self, verdict=result, value=value, bound=bound, measured=measured, **rest)

    def to_mapping(self) -> dict[str, Any]:
        """Return the row as plain numbers, lists and text."""
        named = {name: _plain(value) for name, value in vars(self).items() if name != "evidence"}
        return {**named, "evidence": {name: _plain(value) for name, value in self.evidence.items()}}


def verdict(claimed: bool, holds: bool | None) -> str:
    """Return the verdict on a property; `holds` is None if the measurement does not decide."""
    if holds is None:
        return UNDECIDED
    return (HOLDS if holds else FAILS) if claimed else (UNDECLARED_PRESERVED if holds else UNDECLARED_LOST)


def declaration(claim: bool | None) -> str:
    """Return the text of a declaration about an invariant or a symmetry."""
    return "nothing" if claim is None else "kept" if claim else "not kept"


def checked(
    key: str, what: str, declared: str, claimed: bool, holds: bool | None, measured: str = "-", **rest: Any
) -> Row:
    """Return the row of a check with its verdict; `holds` is None if the measurement does not decide."""
    return Row(key, what, declared, measured, verdict(claimed, holds), claimed, **rest)


@dataclass(frozen=True, repr=False)
class Certificate:
    """The result of `certify`: a row for each property, and whether every declared property holds.

    Parameters
    ----------
    rows : tuple of Row
        In the order of the checks; ``certificate["order"]`` is the row with this name.
    subject : mapping
        System, scheme, step, states and versions, as plain numbers and text.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> certificate = co.certify(body, co.Splitting(order=2), (0.3, 1.0, 0.2), 0.1, steps=200)
    >>> certificate.passed, certificate["poisson"].verdict, certificate["energy"].verdict
    (True, 'holds', 'not kept, not declared')
    """

    rows: tuple[Row, ...]
    subject: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether the scheme converges to the motion and every declared property holds; undecidable is failed."""
        return all(row.verdict in (HOLDS, INAPPLICABLE) for row in self.rows if row.claimed)

    @property
    def declares(self) -> bool:
        """Whether the scheme declares more than that it converges."""
        return any(row.claimed for row in self.rows if row.key != "reference")

    @property
    def table(self) -> tuple[Row, ...]:
        """The rows."""
        return self.rows

    @property
    def failures(self) -> tuple[Row, ...]:
        """The rows of declared properties that fail or cannot be decided."""
        return tuple(row for row in self.rows if row.claimed and row.verdict not in (HOLDS, INAPPLICABLE))

    def __getitem__(self, key: str) -> Row:
        """Return a row by name, such as ``"order"``, ``"energy"`` or ``"casimir |x|^2"``."""
        for row in self.rows:
            if row.key == key:
                return row
        raise KeyError(str(unknown_name("row", key, [row.key for row in self.rows])))

    def __repr__(self) -> str:
        scheme, system = self.subject["scheme"]["shown"], self.subject["system"]["name"]
        return f"<certificate of {scheme} on {system}: {self._declared_text()}>"

    def __str__(self) -> str:
        """Format the certificate as a table."""
        head = self._head()
        sizes = [max(len(row.what) for row in self.rows), max(len(row.declared) for row in self.rows)]
        sizes = [min(sizes[0], 32), min(sizes[1], 16), max(len(row.verdict) for row in self.rows)]
        lines = []
        for what, declared, result, measured in (COLUMN_HEADINGS, *map(_cells, self.rows)):
            entries = [textwrap.wrap(what, sizes[0]), textwrap.wrap(declared, sizes[1]), [result]]
            entries.append(textwrap.wrap(measured, max(30, MAX_WIDTH - sum(sizes) - 6)))
            for number in range(max(map(len, entries))):
                cells = [entry[number] if number < len(entry) else "" for entry in entries]
                padded = [cell.ljust(size) for cell, size in zip(cells, sizes, strict=False)]
                lines.append("  ".join([*padded, cells[-1]]).rstrip())
        return "\n".join([*head, "", *lines, "", self._declared_text()])

    def _repr_html_(self) -> str:
        first, *rest = COLUMN_HEADINGS
        rows = {first: tuple(rest), **{what: tuple(cells) for what, *cells in map(_cells, self.rows)}}
        return html_table(f"{'; '.join(self._head())}; {self._declared_text()}", rows)

    def _head(self) -> list[str]:
        return [
            f"{self.subject['system']['name']}, {self.subject['scheme']['shown']}, step {self.subject['step']:g}",
            f"{len(self.subject['states'])} states, {self.subject['steps']} steps from each",
        ]

    def _declared_text(self) -> str:
        if self.passed:
            return f"passed: {'every declared property holds' if self.declares else 'converges, nothing was declared'}"
        return "not passed: " + ", ".join(f"{row.what} ({row.verdict})" for row in self.failures)

    def to_mapping(self) -> dict[str, Any]:
        """Return the certificate as plain numbers, lists and text.

        Returns
        -------
        dict
            ``schema``, ``passed``, ``subject`` (system, scheme, step, states, versions) and ``rows``, each with
            ``key``, ``declared``, ``measured``, ``value``, ``bound``, ``source``, ``verdict`` and ``evidence``.
        """
        rows = [row.to_mapping() for row in self.rows]
        return {"schema": SCHEMA, "passed": self.passed, "subject": _plain(self.subject), "rows": rows}

    def to_json(self) -> str:
        """Return `to_mapping` as JSON; non-finite numbers are null."""
        return json.dumps(self.to_mapping(), indent=1, allow_nan=False)

    def plot(self) -> Figure:
        """Return a figure of the evidence: errors over the step, and deviations of the invariants over time.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.
        """
        return shortcut("draw_result")("certificate", self)


def _cells(row: Row) -> tuple[str, str, str, str]:
    measured = row.measured
    if row.bound is not None and row.source:
        measured += f"; bound {row.bound:.2g}: {row.source}"
    return row.what, row.declared, row.verdict, f"{measured}; {row.reason}" if row.reason else measured


def _plain(value: Any) -> Any:
    """Return the plain form of a value, with None in place of numbers that are not finite, which JSON has not."""
    return json.loads(json.dumps(plain(value)), parse_constant=lambda _: None)
