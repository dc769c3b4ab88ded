"""Numeric thresholds in the sources: named constants, and literals in comparisons and tolerances.

What is found is a superset: numbers that decide nothing (codes, coefficients of formulas) are listed as such.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import coadjoint

SOURCES = Path(coadjoint.__file__).parent
CPP = SOURCES / "kernels" / "source"
ROUND_OFF = {"UNIT_ROUNDOFF", "roundoff", "_u"}
LOCAL_ROUND_OFF = {"u", "unit"}  # names of the round-off of a number type, in the files that ask for it
TINY, HUGE, FEW = 1e-5, 1e5, 9
CAPITALS = re.compile(r"_?[A-Z][A-Z0-9_]*")
NUMBER = r"[-+]?(?:0x[0-9a-fA-F.]+p[-+]?\d+|(?:\d[\d']*\.?\d*|\.\d+)(?:e[-+]?\d+)?)"
CALLS_OF_LIMITS = {"read_integer", "read_number"}


@cache
def thresholds() -> dict[str, frozenset[str]]:
    """Keys of the thresholds of each file, by its path below the package (C++: below the folder of the kernels)."""
    found = {path.relative_to(SOURCES).as_posix(): in_python(path.read_text("utf-8")) for path in SOURCES.rglob("*.py")}
    found |= {path.relative_to(CPP).as_posix(): in_cpp(path.read_text("utf-8")) for path in CPP.rglob("*.[hc]pp")}
    return {name: keys for name, keys in sorted(found.items()) if keys}


def in_python(text: str) -> frozenset[str]:
    """Names of constants in capitals whose value is a number, and expressions with a threshold."""
    tree, keys = ast.parse(text), set[str]()
    small = ROUND_OFF | LOCAL_ROUND_OFF if re.search(r"roundoff|\b_u\b", text, re.IGNORECASE) else set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            keys.update(_constants(node.body))
        if isinstance(node, ast.FunctionDef):
            for default in (*node.args.defaults, *node.args.kw_defaults):
                if default is not None and any(map(is_tolerance, literals(default))):
                    keys.add(f"default of {node.name}: {ast.unparse(default)}")
            for statement in node.body:
                keys.update(ast.unparse(found) for found in _expressions(statement, small))
    return frozenset(keys)


def _constants(body: list[ast.stmt]) -> Iterator[str]:
    for statement in body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        value = getattr(statement, "value", None)
        for target in targets:
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=True))
            for name, own in pairs:
                if isinstance(name, ast.Name) and CAPITALS.fullmatch(name.id) and own is not None and _is_number(own):
                    yield name.id


def _is_number(node: ast.AST) -> bool:
    """Whether a value is a number or a tuple of numbers, perhaps by way of other constants."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.Tuple(elts=parts):
            return bool(parts) and all(map(_is_number, parts))
        case ast.BinOp(left=left, right=right):
            return _is_number(left) and _is_number(right)
        case ast.UnaryOp(operand=operand):
            return _is_number(operand)
        case ast.Call(func=function, args=arguments):
            return ast.unparse(function) in ("Fraction", "float", "int", "np.sqrt") and all(map(_is_number, arguments))
        case ast.Name(id=name):
            return bool(CAPITALS.fullmatch(name))
    return False


def _expressions(node: ast.AST, small: set[str]) -> Iterator[ast.AST]:
    """The outermost comparisons, products and calls of a statement that contain a threshold."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return
    numbers = literals(node) if isinstance(node, ast.Compare | ast.BinOp) else []
    rounding = isinstance(node, ast.Compare | ast.BinOp) and bool(small) and bool(_names(node) & small)
    if isinstance(node, ast.Compare):
        sides = [n for side in (node.left, *node.comparators) for n in _factors(side)]
        found = (rounding and bool(numbers or _names(node) & ROUND_OFF)) or any(map(is_limit, sides))
    else:
        found = rounding and bool(numbers)
    if isinstance(node, ast.Call):
        given = [folded(value) for value in (*node.args, *(keyword.value for keyword in node.keywords))]
        limits = ast.unparse(node.func) in CALLS_OF_LIMITS
        found = any(n is not None and (is_tolerance(n) or (limits and is_limit(n))) for n in given)
    if found or any(map(is_tolerance, numbers)):
        yield node
        return
    for child in ast.iter_child_nodes(node):
        yield from _expressions(child, small)


def is_tolerance(number: float) -> bool:
    return 0 < abs(number) <= TINY or HUGE <= abs(number) < float("inf")


def is_limit(number: float) -> bool:
    """Whether a literal beside a comparison sign is a threshold: small whole numbers and 1/2 are not."""
    return is_tolerance(number) or (abs(number) > FEW if number == int(number) else abs(number) not in (0.5, 1.5))


def literals(node: ast.AST) -> list[float]:
    """Numeric literals in an expression; powers and shifts of literals count as one number."""
    value = folded(node)
    if value is not None:
        return [value]
    return [number for child in ast.iter_child_nodes(node) for number in literals(child)]


def folded(node: ast.AST) -> float | None:
    """Value of an expression of literals alone, else None."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return node.value
    if isinstance(node, ast.UnaryOp | ast.BinOp) and all(
        isinstance(part, ast.Constant | ast.UnaryOp | ast.BinOp | ast.operator | ast.unaryop) for part in ast.walk(node)
    ):
        try:
            value = ast.literal_eval(node)
        except ValueError:
            value = eval(ast.unparse(node), {"__builtins__": {}})
        return value if isinstance(value, int | float) else None
    return None


def _factors(node: ast.AST) -> list[float]:
    """Literals of a side of a comparison, without those in subscripts and arguments."""
    value = folded(node)
    if value is not None:
        return [value]
    if isinstance(node, ast.BinOp):
        return _factors(node.left) + _factors(node.right)
    return _factors(node.operand) if isinstance(node, ast.UnaryOp) else []


def _names(node: ast.AST) -> set[str]:
    return {getattr(part, "id", getattr(part, "attr", "")) for part in ast.walk(node)}


def in_cpp(text: str) -> frozenset[str]:
    """Names of constexpr constants in capitals with a number, comparisons with literals, multiples of the round-off."""
    text, keys = re.sub(r"//[^\n]*", "", text), set[str]()
    for declared in re.finditer(r"\bconstexpr\s+[\w:]+\s+([A-Z][^;{}]*?=[^;{}]*);", text):
        for name, value in re.findall(r"\b([A-Z][A-Z0-9_]+)\s*=\s*([^,;]+)", declared[1]):
            if re.search(r"\d|[A-Z]{3}", value):
                keys.add(name)
    for name, value in re.findall(r"\b_\(([A-Z][A-Z0-9_]+), (\d+)\)", text):
        if int(value) > FEW:
            keys.add(name)
    for compared in re.finditer(rf"([\w\])]+)\s*([<>]=?)\s*({NUMBER})(?![\w.(])(\s*\*\s*[\w.]+)*", text):
        number = float.fromhex(compared[3]) if "x" in compared[3] else float(compared[3].replace("'", ""))
        if number not in (0.0, 1.0) and (number > FEW or number != int(number)):
            keys.add(" ".join(compared[0].split()))
    for multiple in re.finditer(r"[\w.]+(?:\([\w.]+\))?\s*\*\s*(?:double\(\w+\)\s*\*\s*)?UNIT_ROUNDOFF\b", text):
        keys.add(" ".join(multiple[0].split()))
    return frozenset(keys)
