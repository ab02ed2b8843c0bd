"""What a newcomer can rely on: folders that say what they hold, and one base of all errors."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(
    path for package in ("usv_kernel", "usv_gym", "twin") for path in (ROOT / package).rglob("*.py")
)
BUILT_IN = (
    *("Exception", "ValueError", "TypeError", "RuntimeError", "LookupError", "KeyError"),
    *("IndexError", "ArithmeticError", "NotImplementedError"),
)


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def test_errors_have_one_base():
    """Neither raised nor made a base: a built-in that ``except UsvTwinError`` would not catch."""
    demanded = {"__reduce_ex__"}  # by Python's protocols, which know their own errors only
    bare = []
    for path in MODULES:
        nodes = list(ast.walk(tree(path)))
        allowed = {
            inner
            for node in nodes
            if isinstance(node, ast.FunctionDef) and node.name in demanded
            for inner in ast.walk(node)
        }
        for node in nodes:
            named = []
            if isinstance(node, ast.Raise) and node.exc is not None and node not in allowed:
                named = [node.exc.func if isinstance(node.exc, ast.Call) else node.exc]
            elif isinstance(node, ast.ClassDef) and node.name != "UsvTwinError":
                named = node.bases[:1]
            if named and ast.unparse(named[0]) in BUILT_IN:
                bare.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not bare
