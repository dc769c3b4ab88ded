"""XML of others: elements with their lines, without document types, entities or network, and bounded in size."""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from pathlib import Path
from typing import Any, NoReturn

from coadjoint.regular_files import content_of
from coadjoint.short_repr import short

MAX_XML_BYTES = 2**26
"""Largest file of XML (bytes): some hundred times those of the largest robots."""
MAX_DEPTH = 256
"""Largest depth of nested elements: kinematic trees of MJCF nest a body in each."""
MAX_ELEMENTS = 200_000
"""Largest number of elements in a file, which take about 100 MB."""
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class Element:
    """An element of an XML file: tag, attributes, children, text, and its place in messages."""

    __slots__ = ("attributes", "children", "file", "line", "parent", "pieces", "tag")

    def __init__(self, tag: str, attributes: dict[str, str], file: str, line: int, parent: Element | None) -> None:
        self.tag, self.attributes, self.file, self.line, self.parent = tag, attributes, file, line, parent
        self.children: list[Element] = []
        self.pieces: list[str] = []

    @property
    def text(self) -> str:
        """The text between its tags, without that of its children."""
        return "".join(self.pieces)

    def all(self, *tags: str) -> list[Element]:
        """Return the children with one of these tags."""
        return [child for child in self.children if child.tag in tags]

    def one(self, tag: str) -> Element | None:
        """Return the child with a tag, or None; ValueError if there are several."""
        found = self.all(tag)
        if len(found) > 1:
            found[1].refuse(f"is the second in its <{self.tag}>; give one")
        return found[0] if found else None

    def needed(self, tag: str) -> Element:
        """Return the child with a tag; ValueError without one."""
        found = self.one(tag)
        return self.refuse(f"has no <{tag}>; write it") if found is None else found

    @property
    def shown(self) -> str:
        """The element as it is named in messages: its file, line, tag and name."""
        name = self.attributes.get("name")
        return f"{self.file}, line {self.line}: <{self.tag}{'' if name is None else f' name={short(name, 60)}'}>"

    def refuse(self, reason: str) -> NoReturn:
        """Raise the ValueError about this element."""
        raise ValueError(f"{self.shown} {reason}")

    def attribute(self, name: str) -> str:
        """Return an attribute; ValueError without it."""
        if name not in self.attributes:
            self.refuse(f"has no attribute {name}; write it")
        return self.attributes[name]

    def numbers(self, name: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """Return the finite numbers of an attribute; ValueError unless there are `count`."""
        if name not in self.attributes and default is not None:
            return default
        return self._numbers_in(self.attribute(name), f"{name}=", count)

    def number(self, name: str, default: float | None = None) -> float:
        """Return the finite number of an attribute."""
        return self.numbers(name, 1, None if default is None else (default,))[0]

    def content(self, *counts: int) -> tuple[float, ...]:
        """Return the finite numbers between the tags; ValueError unless there are as many as one of `counts`."""
        return self._numbers_in(self.text, "", *counts)

    def flag(self, name: str) -> bool:
        """Return an attribute that is true or false, which is its default."""
        text = self.attributes.get(name, "false").strip().lower()
        if text not in ("true", "false", "1", "0"):
            self.refuse(f"has {name}={short(text, 40)}; write true or false")
        return text in ("true", "1")

    def _numbers_in(self, text: str, what: str, *counts: int) -> tuple[float, ...]:
        words = text.split()
        shown = f"{what}{short(text.strip(), 60)}"
        if any("$" in word or "{" in word for word in words):
            self.refuse(f"has {shown}, an expression of xacro; expand the file first, with: xacro FILE > FILE.urdf")
        if not all(map(NUMBER.fullmatch, words)) or len(words) not in counts:
            wanted = " or ".join(map(str, counts))
            self.refuse(f"has {shown}; write {wanted} finite number{'' if wanted == '1' else 's'}")
        values = tuple(map(float, words))
        if not all(map(math.isfinite, values)):
            self.refuse(f"has {shown}, which is too large for float64")
        return values


def elements_of(path: Path, what: str = "an XML file of a body", limit: int = MAX_XML_BYTES) -> Element:
    """Return the root element of a file; ValueError for a document type, or what is no XML."""
    content = content_of(path, limit, what, factor=4)
    parser = xml.parsers.expat.ParserCreate()
    root: list[Element] = []
    count = 0
    open_elements: list[Element] = []
    file = str(path)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise ValueError(f"{file} has more than {MAX_ELEMENTS} elements, which are not read")
        if len(open_elements) == MAX_DEPTH:
            raise ValueError(f"{file}, line {parser.CurrentLineNumber}: elements are nested deeper than {MAX_DEPTH}")
        parent = open_elements[-1] if open_elements else None
        element = Element(tag, attributes, file, parser.CurrentLineNumber, parent)
        (root if parent is None else parent.children).append(element)
        open_elements.append(element)

    def end(tag: str) -> None:
        open_elements.pop()

    def text(data: str) -> None:
        open_elements[-1].pieces.append(data)

    def refuse_doctype(*declared: Any) -> None:
        raise ValueError(
            f"{file}, line {parser.CurrentLineNumber}: has a document type (DOCTYPE), whose entities are not read; "
            "remove it"
        )

    # Without a document type nothing declares entities, and nothing outside of the file is read.
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    parser.buffer_text = True
    try:
        parser.Parse(content, True)
    except xml.parsers.expat.ExpatError as error:
        raise ValueError(f"{file} is no XML: {error}") from None
    return root[0]
