"""Language of the sources: standard terms, no questions in module docstrings, and a bounded number of public names."""

import ast
import io
import re
import tokenize
from pathlib import Path

import coadjoint

ROOT = Path(__file__).parents[1]
FOLDER = Path(coadjoint.__file__).parent
SOURCES = sorted([*FOLDER.rglob("*.py"), *FOLDER.rglob("*.[ch]pp")])
PUBLIC_NAMES = 331

FORMER = {("step_scheme.hpp", "Hearing"), ("step_scheme.hpp", "Field_Room"), ("cost_model.py", "in_a_crowd")}
"""Former names that code of users may contain."""

# Words of which standard terms exist. `tell` is a method of files.
WORDS = (
    r"(?:said|says?|telling|told|foretold|foretell|foresight|kin|dear|dearer|crews?|crowds?|hearing|"
    r"room|remembered|kept|whose|looked|looks)"
)
NAMES = re.compile(rf"(?:^|_){WORDS}(?:_|$)")
ANY_NAME = re.compile(rf"(?:\b|_){WORDS}(?:\b|_)")
PROSE = re.compile(
    r"\b(?:foretells?|foretold|foresight|kin|dear(?:er|est)?|crews?|crowds?|made ready|goes on|no fewer than|"
    r"so many as|is told|are told|was told|be told|is said|are said|speaks? for|of which nobody|asks for|has enough)\b",
    re.IGNORECASE,
)


CPP_TOKEN = re.compile(r'(?P<comment>//[^\n]*)|(?P<string>"(?:\\.|[^"\\\n])*")|(?P<name>[A-Za-z_]\w*)')


def cpp_tokens(text):
    """Yield kind, text and line number of the names, strings and comments of C++; CrewSize as Crew_Size."""
    for token in CPP_TOKEN.finditer(text):
        name, line = token["name"], text.count("\n", 0, token.start()) + 1
        if name:
            yield tokenize.NAME, re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name), line
        else:
            yield tokenize.COMMENT if token["comment"] else tokenize.STRING, token[0], line


def tokens(path):
    """Yield kind, text and line number of the names, strings and comments of a file."""
    if path.suffix != ".py":
        yield from cpp_tokens(path.read_text(encoding="utf-8"))
        return
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(io.StringIO(file.read()).readline):
            if token.type in (tokenize.NAME, tokenize.STRING, tokenize.COMMENT):
                yield token.type, token.string, token.start[0]


def dialect(path):
    """Yield the places at which a file uses a word of the dialect."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py" and not (ANY_NAME.search(text.lower()) or PROSE.search(text)):
        return  # without reading its tokens, which takes most of the time
    for kind, text, line in tokens(path):
        pattern = NAMES if kind == tokenize.NAME else PROSE
        if (path.name, text) in FORMER:
            continue
        for match in pattern.finditer(text.lower() if kind == tokenize.NAME else text):
            yield f"{path.name}:{line}: {match[0]} in {text.splitlines()[0][:60]}"


def test_sources_use_standard_terms():
    assert [place for path in SOURCES for place in dialect(path)] == []


def test_module_docstrings_ask_no_questions():
    files = {path: path.read_text(encoding="utf-8") for path in SOURCES if path.suffix == ".py"}
    # Only files that contain one are parsed.
    texts = {path: ast.get_docstring(ast.parse(text)) or "" for path, text in files.items() if "?" in text}
    assert [path for path, text in texts.items() if "?" in text] == []


def test_words_of_the_dialect_are_found(tmp_path):
    """A name, a comment and a docstring each; the standard terms beside them are not."""
    path = tmp_path / "file.py"
    path.write_text(
        '"""Is told once."""\ntold_of = 1  # the crew\nthreshold, kinetic, skin = 1, 2, 3\n', encoding="utf-8"
    )
    assert [place.split(": ")[1].split(" in ")[0] for place in dialect(path)] == ["Is told", "told_", "crew"]
    path = tmp_path / "file.cpp"
    path.write_text('#include "roomy.hpp"\nint CrewSize = 1;  // goes on\n', encoding="utf-8")
    assert [place.split(": ")[1].split(" in ")[0] for place in dialect(path)] == ["crew_", "goes on"]


def test_number_of_public_names():
    listed = re.findall(r"^\| `", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert 100 < len(listed) <= PUBLIC_NAMES
