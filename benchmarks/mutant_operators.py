"""The small faults that mutation testing puts into a file, one at a time.

An operator, a constant, a choice between two functions, a negation or a returned value becomes
another. Left alone: what stands outside of functions (tables, defaults), texts and what is raised
(messages), annotations, decorators, `strict=` of zip, the -1 of a reshape, and what only type
checkers read.
"""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

_COMPARE: dict[type[ast.cmpop], type[ast.cmpop]] = {
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
_BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
_PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("any", "all"),
    ("floor", "ceil"),
    ("argmin", "argmax"),
    ("zeros", "ones"),
    ("zeros_like", "ones_like"),
)
_NAMES = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])}


@dataclass(frozen=True)
class Mutant:
    """One fault.

    path: of the file, from the root of the repository
    line: first and last line of the statement's part that changes
    index: among the faults of the file
    key: file, function, old and new text, which stay when lines move
    """

    path: str
    line: int
    last: int
    index: int
    key: str


@dataclass
class _Site:
    """A node that can change: what it is now, what it becomes, and how to change it."""

    node: ast.expr | ast.stmt
    old: str
    new: str
    change: Callable[[], None]


def mutants(path: str) -> list[Mutant]:
    """Every fault of a file, from first line to last."""
    seen: Counter[str] = Counter()
    found = []
    tree = ast.parse((ROOT / path).read_text("utf-8"))
    for index, (site, function) in enumerate(_sites(tree)):
        if not function:
            continue
        key = f"{path} {function}: `{site.old}` → `{site.new}`"
        seen[key] += 1
        key += f" ({seen[key]})" if seen[key] > 1 else ""
        node = site.node
        found.append(Mutant(path, node.lineno, node.end_lineno or 0, index, key))
    return found


def mutated(mutant: Mutant) -> ast.Module:
    """The file with the fault."""
    tree = ast.parse((ROOT / mutant.path).read_text("utf-8"))
    sites = [site for site, _ in _sites(tree)]
    sites[mutant.index].change()
    return ast.fix_missing_locations(tree)


def _sites(tree: ast.Module) -> list[tuple[_Site, str]]:
    return [
        (site, function)
        for parent, field, index, node, function in _walk(tree, "", ())
        for site in _changes(parent, field, index, node)
    ]


Place = tuple[ast.AST, str, int | None, ast.AST, str]
_SCOPES = (ast.FunctionDef, ast.ClassDef)


def _walk(node: ast.AST, function: str, names: tuple[str, ...]) -> Iterator[Place]:
    """Every node that can change, with its parent's field, and the function that it is in."""
    for field, value in ast.iter_fields(node):
        if field in ("decorator_list", "annotation", "returns", "bases", "type_comment"):
            continue
        for index, child in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(child, ast.AST) or _left_alone(child) or _free_axis(node, child):
                continue
            inner, name = names, function
            if isinstance(child, _SCOPES):
                inner = (*names, child.name)
                name = ".".join(inner) if isinstance(child, ast.FunctionDef) else function
            # defaults of arguments are computed where the function is defined
            here = "" if isinstance(node, ast.FunctionDef) and field == "args" else name
            yield node, field, index if isinstance(value, list) else None, child, here
            yield from _walk(child, here, inner)


def _left_alone(node: ast.AST) -> bool:
    match node:
        case ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom():
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.keyword(arg="strict"):
            return True
        # names of types: aliases, fields, casts
        case ast.Subscript(value=ast.Name(id="Literal" | "Callable" | "Mapping" | "Sequence")):
            return True
        case ast.Call(func=ast.Name(id="field" | "TypeVar" | "cast" | "NewType")):
            return True
    return False


def _free_axis(parent: ast.AST, node: ast.AST) -> bool:
    """The -1 of a reshape: to NumPy any number below 0 means the same."""
    match parent:
        case ast.Call(func=ast.Attribute(attr="reshape")):
            return ast.unparse(node) == "-1"
    return False


def _changes(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> Iterator[_Site]:
    def swap(new: ast.expr) -> _Site:
        def change() -> None:
            if index is None:
                setattr(parent, field, new)
            else:
                getattr(parent, field)[index] = new

        return _Site(node, ast.unparse(node), ast.unparse(new), change)  # type: ignore[arg-type]

    match node:
        case ast.Compare():
            for at, operator in enumerate(node.ops):
                operators = [*node.ops[:at], _COMPARE[type(operator)](), *node.ops[at + 1 :]]
                yield swap(ast.Compare(node.left, operators, node.comparators))
        case ast.BinOp() if type(node.op) in _BINARY and not _is_text(node):
            yield swap(ast.BinOp(node.left, _BINARY[type(node.op)](), node.right))
        case ast.AugAssign() if type(node.op) in _BINARY and not _is_text(node.value):
            operator = _BINARY[type(node.op)]()
            new = ast.unparse(ast.AugAssign(node.target, operator, node.value))
            yield _Site(node, ast.unparse(node), new, lambda: setattr(node, "op", operator))
        case ast.BoolOp():
            other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield swap(ast.BoolOp(other, node.values))
        case ast.UnaryOp() if not isinstance(node.op, ast.UAdd):
            yield swap(node.operand)
        case ast.Constant(value=bool()):
            yield swap(ast.Constant(not node.value))
        case ast.Constant(value=int() | float()):
            yield swap(ast.Constant(node.value + 1))
            yield swap(ast.Constant(node.value - 1))
        case ast.Name() if node.id in _NAMES and isinstance(node.ctx, ast.Load):
            yield swap(ast.Name(_NAMES[node.id], ast.Load()))
        case ast.Attribute() if node.attr in _NAMES and isinstance(node.ctx, ast.Load):
            yield swap(ast.Attribute(node.value, _NAMES[node.attr], ast.Load()))
        case ast.Return(value=ast.expr() as value) if not _is_text(value):
            if not (isinstance(value, ast.Constant) and value.value is None):
                nothing = ast.Constant(None)
                change = lambda: setattr(node, "value", nothing)  # noqa: E731
                yield _Site(node, ast.unparse(node), "return None", change)


def _is_text(node: ast.AST) -> bool:
    """Whether it is made of text, which is for people."""
    match node:
        case ast.JoinedStr() | ast.Constant(value=str()):
            return True
        case ast.BinOp():
            return _is_text(node.left) or _is_text(node.right)
    return False
