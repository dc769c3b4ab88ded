"""Messages of CCSDS in the notation of keywords and values (KVN), and the lines of text files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import TIME_SYSTEMS, Epoch, leap_seconds
from coadjoint.validation import read_path

Floats = NDArray[np.float64]

MAX_BYTES = 1 << 30
"""Of a text file that is read."""
MEMORY_PER_BYTE = 24  # of the lines and numbers of a text file
BLOCKS = "META", "DATA", "COVARIANCE"


class TextLine(NamedTuple):
    """A line of a file: its number from 1 on, and its text without spaces around it; tabs are cells of a table."""

    number: int
    text: str


class MessageSegment(NamedTuple):
    """A block of metadata by keyword, the lines of data after it, and the number of its first line."""

    metadata: dict[str, str]
    data: list[TextLine]
    number: int


def lines_of(path: Any) -> tuple[Path, list[TextLine]]:
    """Return the lines of a text file that are not empty; ValueError for one that is too large or no text."""
    file = read_path(path, "path")
    content = content_of(file, MAX_BYTES, "a text", MEMORY_PER_BYTE, "; divide it")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise ValueError(f"{file} is no text: byte {reason.start} is not UTF-8") from None
    lines = [TextLine(k, line.strip(" ")) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise ValueError(f"{file} is empty")
    return file, lines


def messages_of(file: Path, lines: Sequence[TextLine], kind: str) -> tuple[str, list[MessageSegment]]:
    """Return the version and the segments of a message of a kind, "OEM" or "AEM"; ValueError with file and line."""
    keyword = f"CCSDS_{kind}_VERS"
    if lines[0].text.startswith("<"):
        raise ValueError(f"{file} is XML; give the {kind} in the notation of keywords and values (KVN)")
    name, _, version = (part.strip() for part in lines[0].text.partition("="))
    if name != keyword or version not in ("1.0", "2.0", "3.0"):
        raise ValueError(
            f"{file}, line {lines[0].number}: {short(lines[0].text)}; the first line of an {kind} is {keyword} = 2.0"
        )
    segments: list[MessageSegment] = []
    block = "header"
    for line in lines[1:]:
        text = line.text.strip()
        if text.startswith("COMMENT"):
            continue
        begin, _, end = text.rpartition("_")
        if begin in BLOCKS and end in ("START", "STOP"):
            if end == "START" and begin == "META":
                segments.append(MessageSegment({}, [], line.number))
            elif not segments:
                raise ValueError(f"{file}, line {line.number}: {text} comes before META_START")
            block = begin if end == "START" else "DATA" if begin == "META" else "outside"
            if begin == "COVARIANCE" and end == "STOP":
                block = "DATA"
        elif block == "META":
            name, sign, value = (part.strip() for part in text.partition("="))
            if not sign or name in segments[-1].metadata:
                why = "is given twice" if sign else "is no keyword with a value"
                raise ValueError(f"{file}, line {line.number}: {short(text)} {why}")
            segments[-1].metadata[name] = value
        elif block == "DATA":
            segments[-1].data.append(line)
        elif block == "outside":
            raise ValueError(f"{file}, line {line.number}: {short(text)} stands outside of the blocks of data")
    if block == "META":
        raise ValueError(f"{file}: the metadata of line {segments[-1].number} have no META_STOP; the file is cut")
    if not segments:
        raise ValueError(f"{file} has no META_START, and so no segment")
    return version, segments


def segment_of(file: Path, segments: Sequence[MessageSegment], chosen: Any) -> MessageSegment:
    """Return the only segment, or that of a number from 0 on."""
    if chosen is None and len(segments) == 1:
        return segments[0]
    if type(chosen) is int and 0 <= chosen < len(segments):
        return segments[chosen]
    spans = "; ".join(
        f"{k}: {one.metadata.get('START_TIME', '?')} to {one.metadata.get('STOP_TIME', '?')}"
        for k, one in enumerate(segments[:8])
    )
    given = "segment was not given" if chosen is None else f"segment is {short(chosen)}"
    raise ValueError(f"{file} has {len(segments)} segments ({spans}), and {given}; give segment=0 or the next ones")


def required(file: Path, segment: MessageSegment, *names: str) -> list[str]:
    """Return the values of keywords; ValueError if one is missing."""
    missing = [name for name in names if not segment.metadata.get(name)]
    if missing:
        raise ValueError(f"{file}: the metadata of line {segment.number} have no {missing[0]}")
    return [segment.metadata[name] for name in names]


def time_system_of(file: Path, segment: MessageSegment) -> str:
    """Return the time system of a segment; ValueError for one that is not known."""
    (name,) = required(file, segment, "TIME_SYSTEM")
    if name not in TIME_SYSTEMS:
        raise ValueError(f"{file}: TIME_SYSTEM is {short(name)}; it must be one of {', '.join(TIME_SYSTEMS)}")
    return name


def dated(text: str, what: str) -> tuple[datetime, float]:
    """Return the whole seconds of a date, and the fraction, which has more digits than that of a datetime."""
    whole, point, fraction = text.rstrip("Z").partition(".")
    date = Epoch.read(whole, what).date
    if point and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(f"{what} is {short(text)}, which is no date")
    return date, float(f"0.{fraction or 0}")


def elapsed(text: str, epoch: Epoch, what: str) -> float:
    """Return the seconds from an epoch to a date of its time system, with the leap seconds of UTC."""
    date, fraction = dated(text, what)
    seconds = (date - epoch.date.replace(microsecond=0)) / timedelta(seconds=1)
    if epoch.system == "UTC":
        seconds += leap_seconds(date) - leap_seconds(epoch.date)
    return seconds + (fraction - epoch.date.microsecond * 1e-6)


def table_of(
    file: Path, data: Sequence[TextLine], epoch: Epoch, counts: Mapping[int, Any] | Sequence[int]
) -> tuple[Floats, Floats]:
    """Return the times since an epoch and the numbers of lines of data, each with as many as the first one."""
    if not data:
        raise ValueError(f"{file} has no lines of data")
    times, rows = np.zeros(len(data)), list[list[float]]()
    for k, line in enumerate(data):
        where = f"{file}, line {line.number}"
        date, *numbers = line.text.split()
        times[k] = elapsed(date, epoch, f"{where}: the date")
        rows.append(numbers_of(numbers, where))
        if len(rows[k]) not in counts or len(rows[k]) != len(rows[0]):
            wanted = len(rows[0]) if k else " or ".join(map(str, counts))
            raise ValueError(f"{where}: {len(rows[k])} numbers after the date; there must be {wanted}")
    return times, np.array(rows)


def numbers_of(texts: Sequence[str], where: str) -> list[float]:
    """Return texts as finite numbers; ValueError with the place of one that is none."""
    found = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            number = float("nan")
        if not np.isfinite(number) or "_" in text:
            raise ValueError(f"{where}: {short(text)} is no finite number; leave out rows without one")
        found.append(number)
    return found


def ascending(times: Floats, where: Callable[[int], str]) -> None:
    """Raise ValueError unless times ascend; `where` names the place of one."""
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(wrong):
        raise ValueError(
            f"{where(int(wrong[0]) + 1)}: the time is not after that of the line before; times must ascend"
        )
