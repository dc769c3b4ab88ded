"""Language of the sources: standard terms, no questions in module docstrings, and a bounded number of public names."""

import io
import re
import tokenize
from pathlib import Path

import coadjoint

ROOT = Path(__file__).parents[1]
SOURCES = sorted(Path(coadjoint.__file__).parent.rglob("*.py"))
PUBLIC_NAMES = 301

SHARED = {("arrays.py", "remembered"), ("step_tables.py", "kept")}
"""Fields of structures that the compiled loops read under the same name."""

# Words of which standard terms exist. `tell` is a method of files.
NAMES = re.compile(
    r"(?:^|_)(?:said|says?|telling|told|foretold|foretell|foresight|kin|dear|dearer|crews?|room|remembered|"
    r"kept|whose|looked|looks)(?:_|$)"
)
PROSE = re.compile(
    r"\b(?:foretells?|foretold|foresight|kin|dear(?:er|est)?|crews?|made ready|goes on|no fewer than|so many as|"
    r"is told|are told|was told|be told|is said|are said|speaks? for|of which nobody|asks for|has enough)\b",
    re.IGNORECASE,
)


def tokens(path):
    """Yield kind, text and line number of the names, strings and comments of a file."""
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(io.StringIO(file.read()).readline):
            if token.type in (tokenize.NAME, tokenize.STRING, tokenize.COMMENT):
                yield token.type, token.string, token.start[0]


def dialect(path):
    """Yield the places at which a file uses a word of the dialect."""
    for kind, text, line in tokens(path):
        pattern = NAMES if kind == tokenize.NAME else PROSE
        if (path.name, text) in SHARED:
            continue
        for match in pattern.finditer(text.lower() if kind == tokenize.NAME else text):
            yield f"{path.name}:{line}: {match[0]} in {text.splitlines()[0][:60]}"


def test_sources_use_standard_terms():
    assert [place for path in SOURCES for place in dialect(path)] == []


def test_module_docstrings_ask_no_questions():
    first = re.compile(r'(?:\s|#[^\n]*\n)*r?"""([^"]*)"""')
    texts = {path.name: first.match(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert [name for name, text in texts.items() if text and "?" in text[1]] == []
    assert sum(text is not None for text in texts.values()) > 0.9 * len(texts)


def test_words_of_the_dialect_are_found(tmp_path):
    """A name, a comment and a docstring each; the standard terms beside them are not."""
    path = tmp_path / "file.py"
    path.write_text(
        '"""Is told once."""\ntold_of = 1  # the crew\nthreshold, kinetic, skin = 1, 2, 3\n', encoding="utf-8"
    )
    assert [place.split(": ")[1].split(" in ")[0] for place in dialect(path)] == ["Is told", "told_", "crew"]


def test_number_of_public_names():
    listed = re.findall(r"^\| `", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert 100 < len(listed) <= PUBLIC_NAMES
