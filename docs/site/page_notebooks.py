"""Pages of the documentation as notebooks: their text, and their code without the results that it shows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

CODE = re.compile(r"^```python\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
PLACE = "<!-- notebook -->"
"""In a page, where the site links to its notebook."""


def page_cells(text: str) -> list[tuple[str, str]]:
    """Return the cells of a page as pairs of a kind, "markdown" or "code", and the source."""
    pieces = CODE.split(text.replace(PLACE, ""))
    found = []
    for k, piece in enumerate(pieces):
        lines = piece.splitlines()
        if k % 2:
            lines = [line[4:] for line in lines if line.startswith((">>>", "..."))]
        source = "\n".join(lines).strip()
        if source:
            found.append(("code" if k % 2 else "markdown", source))
    return found


def write_page_notebooks(folder: Path, pages: dict[str, str]) -> None:
    """Write the notebook of each page that links to it, and the links into the pages."""
    import nbformat
    from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, Any] = {"markdown": new_markdown_cell, "code": new_code_cell}
    for path in [path for path, text in pages.items() if PLACE in text]:
        name = Path(path).with_suffix(".ipynb").name
        # Numbers in place of random identifiers, so that a notebook is the same each time.
        cells = [made[kind](source, id=str(k)) for k, (kind, source) in enumerate(page_cells(pages[path]))]
        nbformat.write(new_notebook(cells=cells, metadata={"figures": 0}), folder / name)
        pages[path] = pages[path].replace(PLACE, f"{{download}}`This page as a notebook <{name}>`")
