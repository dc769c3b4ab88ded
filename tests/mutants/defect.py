"""A defect: one small change of a source, addressed by its function."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Defect:
    """The bytes from `begin` to `end` of a file are replaced; lines count from 1."""

    file: str
    function: str
    kind: str
    number: int
    begin: int
    end: int
    new: str
    first_line: int
    last_line: int

    @property
    def address(self) -> str:
        """The file, the function, the kind, and the number of this kind within the function."""
        return f"{self.file}::{self.function or '(module)'}: {self.kind} {self.number}"

    def planted(self, text: bytes) -> bytes:
        """Return the source with the defect."""
        return text[: self.begin] + self.new.encode() + text[self.end :]

    def shown(self, text: bytes) -> str:
        """Return ten lines of the source around the defect, and what is written in place of what."""
        lines = text.decode().splitlines()
        first = max(0, self.first_line - 5)
        around = [f"{n + 1:5} {lines[n]}" for n in range(first, min(len(lines), first + 10))]
        old = text[self.begin : self.end].decode()
        return "\n".join([*around, f"      {' '.join(old.split())[:100]}  ->  {self.new[:100]}"])
