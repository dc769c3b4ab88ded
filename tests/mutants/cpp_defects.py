"""Small defects of C++ sources, drawn in their tokens."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from mutants.defect import Defect

TOKEN = re.compile(
    r'(?P<skip>//[^\n]*|/\*.*?\*/|^[ \t]*\#[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'|static_assert\([^;]*;)'
    r"|(?P<number>(?:0x[0-9a-fA-F.]+(?:p[+-]?\d+)?|\d+\.?\d*(?:[eE][+-]?\d+)?)\w*)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>\+\+|--|->|<<=|>>=|<=|>=|==|!=|&&|\|\||\+=|-=|\*=|/=|<<|::|[^\s])",
    re.DOTALL | re.MULTILINE,
)
# Written with blanks around them: those of templates, pointers and references are not.
SPACED = {
    **{one: ("sign", other) for one, other in ("+-", "-+", ("+=", "-="), ("-=", "+="))},
    **{one: ("comparison", one.removesuffix("=") if "=" in one else f"{one}=") for one in ("<", "<=", ">", ">=")},
    "==": ("comparison", "!="),
    "!=": ("comparison", "=="),
    "&&": ("condition", "||"),
    "||": ("condition", "&&"),
    "/": ("factor", "*"),
}
WORDS = {"true": "false", "false": "true", "smaller": "larger", "larger": "smaller"}
CONTROL = {"if", "for", "while", "switch", "catch", "return", "sizeof", "decltype", "alignas", "requires"}


def _closing(tokens: Sequence[re.Match[str]], start: int) -> int:
    """Return the index of the bracket that closes the one at `start`."""
    depth = 0
    for k in range(start, len(tokens)):
        depth += (tokens[k][0] in "([{") - (tokens[k][0] in ")]}")
        if depth == 0:
            return k
    return len(tokens) - 1


def _comma(tokens: Sequence[re.Match[str]], start: int) -> int:
    """Return where the first argument of a call ends; 0 if it is the only one."""
    k = start
    while tokens[k][0] not in ",)":
        k = _closing(tokens, k) + 1 if tokens[k][0] in "([{" else k + 1
    return tokens[k].start() if tokens[k][0] == "," else 0


def _functions(tokens: Sequence[re.Match[str]]) -> list[str]:
    """Return for each token the name of the outermost function that contains it."""
    names, k = [""] * len(tokens), 0
    while k < len(tokens):
        if tokens[k]["name"] and tokens[k][0] not in CONTROL and k + 1 < len(tokens) and tokens[k + 1][0] == "(":
            body = _closing(tokens, k + 1) + 1
            while body < len(tokens) and tokens[body][0] in ("const", "noexcept", "override"):
                body += 1
            if body < len(tokens) and tokens[body][0] == "{":
                end = _closing(tokens, body)
                names[k : end + 1] = [tokens[k][0]] * (end + 1 - k)
                k = end
        k += 1
    return names


def _made(text: str, tokens: Sequence[re.Match[str]], k: int) -> Iterator[tuple[str, int, int, str]]:
    """Yield kind, begin, end and new text of the defects at one token."""
    token = tokens[k]
    word, begin, end = token[0], token.start(), token.end()
    spaced = text[begin - 1].isspace() and text[end : end + 1].isspace()
    if word == "&&" and spaced:
        last = k + 1
        while last < len(tokens) and tokens[last][0] not in (")", "]", ";", "&&", "||", "?", ",", ":"):
            last = _closing(tokens, last) + 1 if tokens[last][0] in "([{" else last + 1
        yield "lost condition", begin, tokens[last - 1].end(), ""
    if token["sign"] and word in SPACED and spaced:
        yield SPACED[word][0], begin, end, SPACED[word][1]
    elif word == "*" and spaced and k + 1 < len(tokens):
        last = k + 1
        while last + 1 < len(tokens) and tokens[last + 1][0] in "([" and tokens[last + 1].start() == tokens[last].end():
            last = _closing(tokens, last + 1)
        yield "dropped factor", begin, tokens[last].end(), ""
    elif word in WORDS:
        yield "constant", begin, end, WORDS[word]
        if k + 1 < len(tokens) and tokens[k + 1][0] == "(" and (comma := _comma(tokens, k + 2)):
            yield "lost call", begin, tokens[_closing(tokens, k + 1)].end(), text[tokens[k + 2].start() : comma]
    elif token["number"] and word.isdigit():
        yield "constant", begin, end, str(int(word) + 1)
    elif token["number"] and "." in word and "x" not in word and word.strip("0."):
        yield "constant", begin, end, f"2.0 * {word}"
    elif word == "if" and tokens[k + 1][0] == "(":
        close = _closing(tokens, k + 1)
        condition = text[tokens[k + 1].end() : tokens[close].start()]
        if ";" not in condition and "const" not in condition:
            yield "condition inverted", tokens[k + 1].end(), tokens[close].start(), f"!({condition})"
    elif word == "[" and k + 2 < len(tokens) and tokens[k + 2][0] == "]" and tokens[k + 1]["name"]:
        if k and (tokens[k - 1]["name"] or tokens[k - 1][0] == "]") and text[begin - 1] != " ":
            yield "index 0", tokens[k + 1].start(), tokens[k + 1].end(), "0"
    elif token["name"] and k + 5 < len(tokens) and tokens[k + 1][0] == "(":
        one, comma, two, after = tokens[k + 2 : k + 6]
        if one["name"] and comma[0] == "," and two["name"] and after[0] in ",)" and one[0] != two[0]:
            yield "swapped arguments", one.start(), two.end(), f"{two[0]}, {one[0]}"


def defects_of(file: str, text: str) -> Iterator[Defect]:
    """Yield all defects of the functions of one file."""
    tokens = [token for token in TOKEN.finditer(text) if not token["skip"]]
    functions = _functions(tokens)
    counts: dict[tuple[str, str], int] = {}
    for k, function in enumerate(functions):
        if not function:
            continue
        for kind, begin, end, new in _made(text, tokens, k):
            number = counts[function, kind] = counts.get((function, kind), 0) + 1
            lines = text.count("\n", 0, begin) + 1, text.count("\n", 0, end) + 1
            byte = len(text[:begin].encode()), len(text[:end].encode())
            yield Defect(file, function, kind, number, *byte, new, *lines)
