"""Small defects of Python sources, drawn in their syntax trees."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator

from mutants.defect import Defect

SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
# Functions whose result is often that of their first argument.
BOUNDING = {
    *("abs", "max", "min", "sorted", "reversed", "copysign", "math.copysign", "round", "tuple", "list"),
    *("np.abs", "np.maximum", "np.minimum", "np.fmax", "np.fmin", "np.clip", "np.nan_to_num", "np.sort"),
}
Made = Iterator[tuple[str, ast.AST, str]]


def _edited(node: ast.AST, **fields: object) -> str:
    """Return the source of a copy of a node with other fields."""
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    text = ast.unparse(ast.fix_missing_locations(other))
    return f"({text})" if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare | ast.UnaryOp | ast.IfExp) else text


def _number(value: object) -> str:
    """Return another number or truth value; empty if the value is neither."""
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    return repr(2.0 * value) if isinstance(value, float) and value else ""


def _signs(node: ast.AST) -> Made:
    if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub):
        yield "sign", node, _edited(node, op=SWAPPED[type(node.op)]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
        yield "sign", node, f"({ast.unparse(node.operand)})"


def _comparisons(node: ast.AST) -> Made:
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            ops = [*node.ops[:k], SWAPPED[type(op)](), *node.ops[k + 1 :]]
            yield "comparison", node, _edited(node, ops=ops)


def _conditions(node: ast.AST) -> Made:
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        yield "condition inverted", node.test, f"(not ({ast.unparse(node.test)}))"
    if isinstance(node, ast.BoolOp):
        yield "condition", node, _edited(node, op=SWAPPED[type(node.op)]())
        for k in range(len(node.values)):
            rest = node.values[:k] + node.values[k + 1 :]
            yield "lost condition", node, f"({ast.unparse(rest[0])})" if len(rest) == 1 else _edited(node, values=rest)
    if isinstance(node, ast.IfExp):
        yield "lost branch", node, f"({ast.unparse(node.body)})"
        yield "lost branch", node, f"({ast.unparse(node.orelse)})"


def _factors(node: ast.AST) -> Made:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div | ast.MatMult):
        yield "dropped factor", node, f"({ast.unparse(node.left)})"
        if isinstance(node.op, ast.Mult):
            yield "dropped factor", node, f"({ast.unparse(node.right)})"


def _indices(node: ast.AST) -> Made:
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Name):
        yield "index 0", node.slice, "0"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range":
        yield "off by one", node.args[-1], f"({ast.unparse(node.args[-1])}) - 1"
    if isinstance(node, ast.Slice):
        for bound in (node.lower, node.upper):
            if bound is not None:
                yield "off by one", bound, f"({ast.unparse(bound)}) + 1"


def _arguments(node: ast.AST) -> Made:
    if not isinstance(node, ast.Call):
        return
    if (
        ast.unparse(node.func) in BOUNDING
        and node.args
        and not isinstance(node.args[0], ast.Starred | ast.GeneratorExp)
    ):
        yield "lost call", node, f"({ast.unparse(node.args[0])})"
    if len(node.args) >= 2 and not any(isinstance(one, ast.Starred) for one in node.args[:2]):
        first, second, *rest = node.args
        if ast.dump(first) != ast.dump(second):
            yield "swapped arguments", node, _edited(node, args=[second, first, *rest])
    for k, keyword in enumerate(node.keywords):
        if keyword.arg is not None:
            yield "lost argument", node, _edited(node, keywords=node.keywords[:k] + node.keywords[k + 1 :])


def _constants(node: ast.AST) -> Made:
    if isinstance(node, ast.Constant) and (other := _number(node.value)):
        yield "constant", node, other
    if isinstance(node, ast.arguments):
        for default in [*node.defaults, *node.kw_defaults]:
            if isinstance(default, ast.Constant) and (other := _number(default.value)):
                yield "default", default, other


def _statements(node: ast.AST) -> Made:
    if isinstance(node, ast.Raise | ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield "lost statement", node, "pass"
    if isinstance(node, ast.AugAssign):
        yield "lost sum", node, f"{ast.unparse(node.target)} = {ast.unparse(node.value)}"
    if isinstance(node, ast.ClassDef) and node.bases:
        for one in node.body:
            if isinstance(one, ast.FunctionDef) and one.decorator_list and len(node.body) > 1:
                yield "lost property", one, "pass"


OPERATORS: tuple[Callable[[ast.AST], Made], ...] = (
    _signs,
    _comparisons,
    _conditions,
    _factors,
    _indices,
    _arguments,
    _constants,
    _statements,
)


def _visited(node: ast.AST, function: str) -> Iterator[tuple[ast.AST, str]]:
    """Yield the nodes that run, with the name of their function; no annotations and no texts of messages."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr | ast.Import | ast.ImportFrom):
                continue
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            inner = function
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inner = f"{function}.{child.name}".lstrip(".")
            yield child, inner
            if not isinstance(child, ast.Raise):
                yield from _visited(child, inner)


def defects_of(file: str, text: str) -> Iterator[Defect]:
    """Yield all defects of one file, each with the number of its kind within its function."""
    starts = [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    counts: dict[tuple[str, str], int] = {}
    for node, function in _visited(ast.parse(text), ""):
        for operator in OPERATORS:
            for kind, place, new in operator(node):
                number = counts[function, kind] = counts.get((function, kind), 0) + 1
                first = place.lineno  # type: ignore[attr-defined]
                if decorators := getattr(place, "decorator_list", None):
                    first = decorators[0].lineno
                    begin = starts[first - 1] + decorators[0].col_offset - 1
                else:
                    begin = starts[first - 1] + place.col_offset  # type: ignore[attr-defined]
                end = starts[place.end_lineno - 1] + place.end_col_offset  # type: ignore[attr-defined]
                last = place.end_lineno  # type: ignore[attr-defined]
                yield Defect(file, function, kind, number, begin, end, new, first, last)
