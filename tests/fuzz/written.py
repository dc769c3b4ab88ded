"""TOML text of tables with any values."""

from __future__ import annotations

import datetime
import json
import math


def toml(table):
    """Return the TOML text of a table, one key per line, inner tables inline."""
    return "".join(f"{quoted(key)} = {value(entry)}\n" for key, entry in table.items())


def value(entry):
    if isinstance(entry, bool):
        return str(entry).lower()
    if isinstance(entry, float):
        return "nan" if math.isnan(entry) else f"{'-' if entry < 0 else ''}inf" if math.isinf(entry) else repr(entry)
    if isinstance(entry, int):
        return str(entry) if abs(entry) < 10**4000 else f"0x{entry:x}"
    if isinstance(entry, str):
        return quoted(entry)
    if isinstance(entry, datetime.date):
        return entry.isoformat()
    if isinstance(entry, list):
        return f"[{', '.join(map(value, entry))}]"
    return f"{{{', '.join(f'{quoted(key)} = {value(one)}' for key, one in entry.items())}}}"


def quoted(text):
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
