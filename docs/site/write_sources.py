"""Write the sources of the documentation site: ``python write_sources.py [--explorer BUILT] [--blank] FOLDER``.

The Markdown pages are copied with links to source files made absolute. Pages of names, systems, schemes and kinds of
pictures are written from the registries and docstrings, and the pictures are drawn by the code that the pages show.
With ``--blank``, for a check of the text, each picture is one pixel and no experiment of the paper runs. The explorer,
given the folder where it is built, is part of the site, and pages link to it where they have the comment
``<!-- explorer: TEXT -->`` or, with a choice, ``<!-- explorer#system=toda_ring: TEXT -->``. Lists of pages get the
first sentence of each page, and ``<!-- systems: FOLDER -->`` the thumbnails of the systems of a folder.
"""

from __future__ import annotations

import argparse
import base64
import importlib.metadata
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

SITE = Path(__file__).resolve().parent
DOCS, ROOT = SITE.parent, SITE.parent.parent
sys.path.append(str(DOCS))

URLS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get("urls", {})
ELSEWHERE = re.compile(r"(?<=\]\()\.\./[\w/]+\.(?:png|gif|svg)(?=\))")
"""Pictures outside the folder of the pages: the site has copies beside its pages."""
SYSTEMS = re.compile("<!-- systems: (.*?) -->")
CASES = "<!-- check-cases -->"
"""In a page, where the site links to the files of the check-cases."""
PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNoAAAAggCBd81ytgAAAABJRU5ErkJggg==")
"""A picture in the format PNG."""
MATHJAX = "tex-chtml.js", "output/chtml/fonts/woff-v2"


def write(folder: Path, explorer: Path | None) -> None:
    """Write all sources into a folder; pictures that are newer than the library are not drawn again."""
    from page_notebooks import write_page_notebooks
    from paper_page import paper_page
    from picture_pages import draw_kinds, picture_pages
    from reference_pages import reference_pages
    from scheme_pages import scheme_pages
    from system_pages import draw_pictures, system_pages, thumbnails, write_notebooks

    pages = {page.name: published(page) for page in [*DOCS.glob("*.md"), *SITE.glob("*.md")]}
    library = max(file.stat().st_mtime for file in (ROOT / "src").rglob("*.py"))
    pages["paper.md"] = paper_page(folder / "paper", library)
    pages |= system_pages() | scheme_pages() | picture_pages()
    reference, targets = reference_pages({path.removesuffix(".md") for path in pages})
    pages |= reference
    pages["api.md"] = linked(pages["api.md"], targets)
    pages["schemes.md"] = with_schemes(pages["schemes.md"], set(pages))
    for page in SITE.glob("*.md"):
        pages[page.name] = with_sentences(pages[page.name], pages)
    for path, text in pages.items():
        pages[path] = SYSTEMS.sub(lambda comment: "\n".join(thumbnails(comment[1], "systems/")), text)
    pages["checkcases.md"] = pages["checkcases.md"].replace(CASES, links_of_check_cases())
    write_page_notebooks(folder, pages)
    for path, text in pages.items():
        write_if_changed(folder / path, with_explorer(text, path) if explorer else text)
    copy_explorer(explorer, folder / "extra")
    write_check_cases(folder / "extra" / "checkcases")
    for old in {*folder.rglob("*.md"), *folder.rglob("*.rst")} - {folder / path for path in pages}:
        old.unlink()
    for file in [file for kind in ("png", "gif", "svg", "json") for file in DOCS.glob(f"*.{kind}")]:
        shutil.copy2(file, folder)
    for page in DOCS.glob("*.md"):
        for path in ELSEWHERE.findall(page.read_text(encoding="utf-8")):
            shutil.copy2(DOCS / path, folder)
    shutil.copy2(SITE / "conf.py", folder)
    shutil.copytree(SITE / "_static", folder / "_static", dirs_exist_ok=True)
    copy_mathjax(folder / "_static" / "mathjax")
    draw_pictures(folder / "systems", library)
    draw_kinds(folder / "pictures", library)
    write_notebooks(folder / "systems")


def write_blank_pictures(folder: Path) -> None:
    """Write a pixel in place of each picture that is drawn, newer than the library, and a table without statements."""
    from paper_page import FIGURES
    from picture_pages import file_name

    import coadjoint as co
    from coadjoint.experiments.reich1993.statements import Statement
    from coadjoint.pictures.register import kinds

    names = [f"systems/{name}{small}" for name in co.systems.names() for small in ("", "_small")]
    names += [f"pictures/{file_name(kind)}" for kind in kinds()] + [f"paper/{name}" for name in FIGURES]
    for name in names:
        path = folder / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(PIXEL)
    (folder / "paper/table.csv").write_text(",".join(Statement._fields), encoding="utf-8")


def with_explorer(text: str, path: str) -> str:
    """Return a page with links to the explorer in place of comments."""
    root = "../" * path.count("/")
    return re.sub(r"<!-- explorer(#\S+)?: (.*?) -->", rf'<a href="{root}explorer/index.html\1">\2</a>', text)


def with_sentences(text: str, pages: dict[str, str]) -> str:
    """Return the page of a section with the first sentence of every page beside its link."""

    def described(tree: re.Match[str]) -> str:
        paths = [next(path for path in (f"{name}.md", f"{name}.rst") if path in pages) for name in tree[1].split()]
        rows = (f"- []({path}): {first_sentence(pages[path])}" for path in paths)
        return "\n".join([*rows, "", "```{toctree}", ":hidden:", "", tree[1]]) + "```"

    return re.sub(r"```\{toctree\}\n:maxdepth: 1\n\n(.*?)```", described, text, flags=re.DOTALL)


def first_sentence(text: str) -> str:
    """Return the first sentence below the title of a page."""
    paragraph = " ".join(text.split("\n\n")[1].split())
    return re.split(r"(?<=[.?]) (?=[A-Z`<[])", paragraph)[0]


def copy_explorer(explorer: Path | None, extra: Path) -> None:
    """Copy the explorer to the files that become part of the site as they are."""
    shutil.rmtree(extra, ignore_errors=True)
    extra.mkdir(parents=True)
    if explorer is not None:
        shutil.copytree(explorer, extra / "explorer")


def links_of_check_cases() -> str:
    """Return a list of the check-cases with their files."""
    import coadjoint as co

    links = {
        name: " ".join(f'<a href="checkcases/{name}.{kind}" download>{kind.upper()}</a>' for kind in ("csv", "json"))
        for name in co.checkcases.names()
    }
    return "\n".join(f"- `{name}`: {files}" for name, files in links.items())


def write_check_cases(folder: Path) -> None:
    """Write the files of the check-cases, which are part of the site as they are."""
    import coadjoint as co

    folder.mkdir(parents=True)
    for name in co.checkcases.names():
        case = co.checkcases.get(name)
        for kind in ("csv", "json"):
            case.write(folder / f"{name}.{kind}")


def published(page: Path) -> str:
    """Return the text of a page with links as the site has them: titles of pages in place of names of files."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^(?!#)(.*)$", _titled, text, flags=re.MULTILINE)
    if page.parent == DOCS:
        text = ELSEWHERE.sub(lambda path: Path(path[0]).name, text)
        if "Source" in URLS:
            return re.sub(r"\]\(\.\./(?=\w)", f"]({URLS['Source']}/blob/main/", text)
        return re.sub(r"\[([^]\n]*)\]\(\.\./\w[^)\n]*\)", r"\1", text)  # files without a page, by their names
    return text.replace("](../", "](")


def _titled(line: re.Match[str]) -> str:
    """Return a line whose links named by their files have no text, which Sphinx replaces by titles."""
    return re.sub(r"\[(\w+\.md)\](?=\(\1[#)])", "[]", line[0])


def linked(text: str, targets: dict[str, str]) -> str:
    """Return the list of public names with a link from each to its page, in place of the link to its file."""

    def link(match: re.Match[str]) -> str:
        name = match[1]
        page = targets.get(name) or targets.get(name.partition(".")[0])
        return f"| [`{name}`]({page}) |" if page else match[0]

    text = text.replace("| name | what it is | file |\n|---|---|---|", "| name | what it is |\n|---|---|")
    text = re.sub(r"\| \[[^|]*\]\([^|]*\) \|$", "|", text, flags=re.MULTILINE)
    described = re.compile(r"^(\| `[\w.]+` \| )((?:[^|\n]|(?<=\\)\|)*?)(?= \|)", re.MULTILINE)
    text = described.sub(lambda row: row[1] + _described(row[2]), text)
    return re.sub(r"^\| `([\w.]+)` \|", link, text, flags=re.MULTILINE)


def _described(cell: str) -> str:
    """Return a description in a table with its formulas as mathematics."""
    from formulas import in_markdown

    return in_markdown(cell.replace("\\|", "|").replace("`", "``")).replace("|", "\\|")


def with_schemes(text: str, pages: set[str]) -> str:
    """Return the tables of schemes with links from each to its page."""

    def link(code: re.Match[str]) -> str:
        page = f"schemes/{code[1]}.md"
        return f"[{code[0]}]({page})" if page in pages else code[0]

    lines = text.split("\n")
    return "\n".join(re.sub(r"`(\w+)(?:\([^`]*\))?`", link, line) if line.startswith("|") else line for line in lines)


def write_if_changed(path: Path, text: str) -> None:
    """Write a page unless it has this text, so that Sphinx reads again only what has changed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def copy_mathjax(folder: Path) -> None:
    """Copy the part of MathJax that sets formulas from the package that contains it."""
    package = importlib.metadata.distribution("sphinx-mathjax-offline")
    source = Path(str(package.locate_file("sphinx-mathjax-offline/static/mathjax")))
    for name in MATHJAX:
        for file in _files(source / name):
            target = folder / file.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, target)


def _files(path: Path) -> Iterator[Path]:
    yield from sorted(path.iterdir()) if path.is_dir() else [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--explorer", type=Path)
    parser.add_argument("--blank", action="store_true")
    given = parser.parse_args()
    if given.blank:
        write_blank_pictures(given.folder)
    write(given.folder, given.explorer)
