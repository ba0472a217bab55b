"""Mutants of a Python source: one comparison, operator, constant or returned value changed in each.

Strings, annotations and decorators are left alone. A mutant is known by its function, its line and the changed
expression, so that another version of the source has the same one wherever that line is unchanged.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
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
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
}
UNCHANGED = ("annotation", "returns", "decorator_list", "type_comment")  # fields of nodes in which nothing is mutated
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
Key = tuple[str, str, str, str, int]  # function, line, expression, what it becomes, which of several that are equal


def mutants(source: str) -> dict[Key, str]:
    """The mutated sources, by what is changed."""
    lines = source.encode().splitlines(keepends=True)
    begins = [0]
    for line in lines:
        begins.append(begins[-1] + len(line))
    code, mutated, number_of_equals = source.encode(), dict[Key, str](), Counter[tuple[str, str, str, str]]()
    for scope, node, replacement in _replacements(ast.parse(source), ""):
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start, stop = begins[node.lineno - 1] + node.col_offset, begins[node.end_lineno - 1] + node.end_col_offset
        place = scope, lines[node.lineno - 1].decode().strip(), ast.unparse(node), replacement
        mutated[*place, number_of_equals[place]] = (code[:start] + replacement.encode() + code[stop:]).decode()
        number_of_equals[place] += 1
    return mutated


def _replacements(node: ast.AST, scope: str) -> Iterator[tuple[str, ast.expr | ast.stmt, str]]:
    """(function, expression or statement, text in its place) of each mutant within a node."""
    if isinstance(node, ast.JoinedStr):  # in Python 3.11 its parts have no places
        return
    if isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield scope, node, "return None"
    elif isinstance(node, ast.expr) and (changed := _changed(node)) is not None:
        yield scope, node, f"({ast.unparse(changed)})"
    inner = f"{scope}.{node.name}" if isinstance(node, SCOPES) else scope
    for field, value in ast.iter_fields(node):
        if field not in UNCHANGED:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _replacements(child, inner)


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _changed(node: ast.expr) -> ast.expr | None:
    """The expression with one operator or constant changed, None for all that is not mutated."""
    match node:
        case ast.Compare(left, [operator], comparators):
            return ast.Compare(left, [COMPARISONS[type(operator)]()], comparators)
        case ast.BinOp(left, operator, right) if type(operator) in OPERATORS:
            return ast.BinOp(left, OPERATORS[type(operator)](), right)
        case ast.BoolOp(operator, values):
            return ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            return operand
        case ast.Constant(bool(value)):
            return ast.Constant(not value)
        case ast.Constant(int(value)):
            return ast.Constant(value + 1)
        case ast.Constant(float(value)):
            return ast.Constant(2 * value if value else 1.0)
    return None
