"""Formulas of docstrings as mathematics: plain text between double backticks, as `help` shows it, becomes LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

GREEK = set(
    "alpha beta gamma delta epsilon lambda mu nu omega phi pi psi rho sigma tau theta Lambda Omega Theta Phi".split()
)
FUNCTIONS = {name: f"\\{name}" for name in "cos cosh exp log sin sinh tan tanh".split()}
FUNCTIONS |= {name: f"\\operatorname{{{name}}}" for name in ("Re", "atan2", "hat", "tr")} | {"sqrt": "\\sqrt"}
OPERATORS = {
    "cross": "\\times", "o": "\\circ", "grad": "\\nabla", "Laplacian": "\\Delta", "integral": "\\int", "sum": "\\sum",
    "of": "",
}  # fmt: skip
SIGNS = {
    "->": "\\to", "!=": "\\ne", "<=": "\\le",
    "+=": "\\mathrel{+}=", "...": "\\ldots", "{": "\\{", "}": "\\}", "*": "", "·": "\\cdot",
    "⟨": "\\langle ", "⟩": "\\rangle",
}  # fmt: skip

CODE = re.compile(
    r"""["`:@#%\\&$]|\*\*|\(\)|=[\w)]|\w=|=$|[A-Za-z_]\.[A-Za-z]|[\w\]]\[|^\.[a-z]|, \*|_<|^\(\w+, d[A-Z]"""
)
"""What formulas do not contain: quotes, keywords, attributes and indices in brackets."""
CALL = re.compile(r"([A-Za-z]{2,})\w*(?:\([^()]*\))?")
"""A name or a call of one word."""
MATH = re.compile(
    r"""\w'|\^|[|]|[A-Za-z]_[a-z0-9(]|\b(?:grad|cross|sum|hat|tr|exp|log|sqrt|sin|cos)\b|[ ]\.[ ]|⟨"""
    r"""|(?:^|[ (\[{-])[A-Za-z][ ][A-Za-z](?=[ ,)}*'(]|$)|^[A-Z][ ][a-z]+$|^\w+[ ]=[ ].*[ ][+-][ ]"""
)
"""What code does not contain."""
WORD = r"[A-Za-z]+\d*"
SUBSCRIPT = r"_(?:\{[^{}]*\}|\([^()]*\)(?:\([^()]*\))?|[A-Za-z0-9]+(?:,[a-z](?![a-z]))?)"
POWER = r"\^(?:\([^()]*\)|-?\w+)"
TOKEN = re.compile(
    r"(?P<space>\s+)|(?P<prose>\b(?:the|axial)\b(?: [a-z]+)*)|(?P<argument>(?!sum_)[a-z]{3,}_[a-z]{3,}\b)"
    rf"|(?P<name>{WORD})(?P<indices>(?:{SUBSCRIPT})*)(?P<primes>'*)(?P<tilde>~?)(?P<power>(?:{POWER})?)"
    r"(?P<star>(?:\*(?=[ ,)]|$))?)"
    rf"|(?P<number>\d+(?:\.\d+)?)(?P<exponent>(?:{POWER})?)|(?P<close>[\])|])(?P<below>(?:{SUBSCRIPT})?)(?P<raised>(?:{POWER})?)"
    r"|(?P<sign>\.\.\.|->|\+=|!=|<=|.)"
)
# In text between marks, words that may belong to a formula, and what a formula has.
MARKED = re.compile(r"(:math:`[^`]*`|``[^`]+``|`[^`]+`_?)")
SYMBOL = (
    rf"(?:(?:[A-Za-z]|{'|'.join(sorted(GREEK))}|sum|exp|tr|Re)\d{{0,2}}(?:_(?:[a-z0-9]{{1,2}}|new"
    rf"|\([^()]*\)(?:\([^()]*\))?))*'*~?(?:{POWER})?\*?|\d+(?:{POWER})?|\.\.\.)"
)
SYMBOLS = re.compile(
    rf"[-(\[{{|]*(?:{SYMBOL})(?:[(/|]+-?{SYMBOL}[)|]*(?:{POWER})?)*[)\]}}|]*(?:{POWER})?'*[.,;:]?|\.\.\.\.?"
)
OPERATIONS = {"=", "+", "-", "/", "<", ">", "<=", "!=", "cross", "grad", ".", "..."}
NEVER_FIRST = {"a", "I", "...", "....", *OPERATIONS} - {"-", "grad"}
NEVER_LAST = {"a", *OPERATIONS} - {"..."}
INDEXED = re.compile(r"[A-Za-z0-9)|]\^|\b[A-Za-z]+_[a-z0-9({]|' = .*\b(?:grad|J)\b")
FACTORS = re.compile(r"[\w)|] [\w(|]")
LITERAL = re.compile(r"``([^`]+)``")
LONGEST, LONGEST_INSIDE, LONGEST_PRODUCT, LEAST = 14, 20, 26, 8
"""Characters of a piece before a line may break: outside and inside of parentheses, and between factors. The last piece
has at least some."""


def latex(text: str) -> list[str] | None:
    r"""Return the LaTeX of a formula, in pieces between which a line may break; None if the text is code.

    Examples
    --------
    >>> print(*latex("x_i' = -rate grad H(x)^2 / 2"))
    x_{i}' = -\mathtt{rate} \,\nabla H(x)^{2} / 2
    >>> latex("exact(x0, t)") is None
    True
    """
    text = re.sub(r"<([A-Za-z][^<>]*)>", r"⟨\1⟩", " ".join(text.split()))
    if CODE.search(text.replace("⟨", "<")) or _is_name(text) or not (MATH.search(text) or _is_equation(text)):
        return None
    text = re.sub(r"\bsum over (\w+) and (\w+) of\b", r"sum_{\1,\2}", text)
    text = re.sub(r"\bsum over (\w+) of\b", r"sum_{\1}", text)
    text = re.sub(r"(?<= )\.(?= )", "·", text)
    pieces, length, depth = [""], 0, 0
    for token, written in _translated(text):
        sign, left = token["sign"], len(text) - token.start()
        limit = LONGEST_INSIDE if depth else LONGEST
        may_break = left > LEAST and _is_closed(pieces[-1])
        is_binary = text[token.start() - 1 : token.end() + 1] in (" = ", " + ", " - ")
        if may_break and is_binary and length > limit:
            pieces.append("{} ")
            length = 0
        pieces[-1] += written
        length += len(token[0])
        depth += (sign in ("(", "[", "⟨")) - (token["close"] in (")", "]") or sign == "⟩")
        is_product = token["space"] and not depth and FACTORS.fullmatch(text[token.start() - 1 : token.end() + 1])
        if (
            may_break
            and length > (LONGEST if sign == "," and not depth else LONGEST_PRODUCT)
            and (sign == "," or is_product)
        ):
            pieces.append("")
            length = 0
    return [re.sub(r"  +", " ", piece).strip() for piece in pieces]


def _is_name(text: str) -> bool:
    """Whether a text is a name, an operator, or a call of a function of Python."""
    if text in FUNCTIONS or not any(map(str.isalnum, text)):
        return True
    call = CALL.fullmatch(text)
    return call is not None and call[1] not in {*GREEK, *FUNCTIONS, "sum"}


def _is_equation(text: str) -> bool:
    """Whether a text is an equation or a list of symbols, without words."""
    return (" = " in text or ", ..." in text) and set(re.findall(r"[A-Za-z]{2,}", text)) <= {*GREEK, *OPERATORS}


def _is_closed(piece: str) -> bool:
    return piece.count("{") == piece.count("}")


def _translated(text: str) -> Iterator[tuple[re.Match[str], str]]:
    """Yield the tokens of a formula with their LaTeX."""
    roots: list[int] = []  # depths of the parentheses of roots
    depth, before, after_root = 0, "", False
    for token in TOKEN.finditer(text):
        if token["sign"] in ("(", "["):
            depth += 1
        written = _written(token)
        if after_root and token["sign"] == "(":
            roots.append(depth)
            written = "{"
        if token["close"] in (")", "]"):
            if roots and roots[-1] == depth:
                roots.pop()
                written = "}"
            depth -= 1
        is_word = "\\mathtt" in written
        if text[token.start() - 1 : token.start()] == " " and (is_word or "\\mathtt" in before):
            operands = token["name"] or token["argument"] or token["number"] or token["sign"] == "("
            if operands and re.search(r"[\w})|\]']$", before) and before.partition("_")[0] not in OPERATORS.values():
                written = f"\\,{written}"
        after_root = token["name"] == "sqrt"
        before = before if token["space"] else written
        yield token, written


def _written(token: re.Match[str]) -> str:
    """Return the LaTeX of one token."""
    if token["space"]:
        return " "
    if token["prose"]:
        return f"\\text{{{token['prose']} }}"
    if token["argument"]:
        return f"\\mathtt{{{token['argument']}}}".replace("_", "\\_")
    if token["name"]:
        return _named(token)
    if token["number"]:
        return token["number"] + _raised(token["exponent"])
    if token["close"]:
        below = f"_{{{_index(token['below'])}}}" if token["below"] else ""
        return token["close"] + below + _raised(token["raised"])
    return SIGNS.get(token["sign"], token["sign"])


def _named(token: re.Match[str]) -> str:
    """Return a name with its indices, primes and power; digits behind a symbol are an index."""
    word = token["name"]
    letters = word if word in FUNCTIONS else word.rstrip("0123456789")
    symbol = f"\\tilde{{{_symbol(letters)}}}" if token["tilde"] else _symbol(letters)
    indices = [word[len(letters) :], *map(_index, re.findall(SUBSCRIPT, token["indices"]))]
    index = ",".join(filter(None, indices))
    star = "^*" if token["star"] else ""
    return f"{symbol}{f'_{{{index}}}' if index else ''}{token['primes']}{_raised(token['power'])}{star}"


def _symbol(word: str) -> str:
    """Return a word as a symbol; other words are names of arguments."""
    if word in GREEK:
        return f"\\{word}"
    if known := FUNCTIONS.get(word, OPERATORS.get(word)):
        return known
    if len(word) == 1 or word == "kT":
        return word
    if word[0] == "d" and (len(word) == 2 or word[1:] in GREEK):
        return f"d{_symbol(word[1:])}"
    return "" if word in OPERATORS else f"\\mathtt{{{word}}}"


def _index(index: str) -> str:
    inside = index[1:]
    if inside[0] == "{" or (inside[0] == "(" and inside.count("(") == 1):
        inside = inside[1:-1]
        if " " in inside:
            return "".join(written for _, written in _translated(inside))
    return f"\\mathrm{{{inside}}}" if re.fullmatch("(?![i-n]+$)[a-z]{3,}", inside) else inside


def _raised(power: str) -> str:
    inside = power[1:].strip("()")
    return f"^{{{_symbol(inside) if inside.isalpha() else inside}}}" if inside else ""


def in_restructured_text(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with formulas as mathematics, also those of the text around; not in examples."""
    text, heading, examples = "\n".join(lines).partition("\nExamples\n---")
    role = ":math:`{}`".format
    marked = _replaced(text, role, "``{}``".format)
    parts = [part if k % 2 else _of_text(part, role) for k, part in enumerate(MARKED.split(marked))]
    return ("".join(parts) + heading + examples).split("\n")


def in_markdown(text: str) -> str:
    """Return a sentence of a docstring as Markdown with formulas as mathematics, which a table may contain, too."""

    def formula(piece: str) -> str:
        return f"${piece.replace('|', chr(92) + 'vert ')}$"

    marked = _replaced(text, formula, "`{}`".format)
    return "".join(
        part if k % 2 else _of_text(part, formula) for k, part in enumerate(re.split(r"(`[^`]+`|\$[^$]+\$)", marked))
    )


def _replaced(text: str, formula: Callable[[str], str], code: Callable[[str], str]) -> str:
    def replace(found: re.Match[str]) -> str:
        pieces = latex(found[1])
        return code(found[1]) if pieces is None else " ".join(map(formula, pieces))

    return LITERAL.sub(replace, text)


def _of_text(text: str, formula: Callable[[str], str]) -> str:
    """Return text between marks with its formulas: words in sequence that are symbols, with an index or a power."""
    parts = re.split(r"([ ]|\n *)", text)  # words, and between them spaces and ends of lines
    found, position = "", 0
    while position < len(parts):
        stop = _end_of_formula(parts, position)
        first, last = position, stop
        while first < last and (parts[first] in NEVER_FIRST or not parts[first].strip()):
            first += 1
        while last > first and (parts[last - 1] in NEVER_LAST or not parts[last - 1].strip()):
            last -= 1
        run = " ".join("".join(parts[first:last]).split())
        core = re.sub(r"(?:(?<=\.\.\.)|(?<!\.))[.,;:]$", "", run)
        pieces = latex(core) if INDEXED.search(core) and _is_balanced(core) else None
        if pieces is None:
            found += "".join(parts[position : max(stop, position + 1)])
        else:
            found += "".join(parts[position:first]) + " ".join(map(formula, pieces)) + run[len(core) :]
            found += "".join(parts[last:stop])
        position = max(stop, position + 1)
    return found


def _end_of_formula(parts: list[str], position: int) -> int:
    """Return where words end that are symbols; punctuation ends them unless a bracket is open."""
    start = position
    while position < len(parts):
        word = parts[position]
        if "\n" in word and not parts[position + 1 : position + 2]:
            break
        if word.strip() and not (SYMBOLS.fullmatch(word) or word in OPERATIONS):
            break
        if (
            word[-1:] in (",", ";", ":", ".")
            and not word.endswith("...")
            and _is_balanced("".join(parts[start : position + 1]))
        ):
            return position + 1
        position += 1
    return position


def _is_balanced(text: str) -> bool:
    return all(text.count(left) == text.count(right) for left, right in ("()", "[]", "{}")) and text.count("|") % 2 == 0
