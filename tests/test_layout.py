"""The layout that a newcomer can rely on: small modules, small folders, few arguments."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(
    path for package in ("usv_kernel", "usv_gym", "twin") for path in (ROOT / package).rglob("*.py")
)
LINES, IN_A_FOLDER, MODULES_OF_TWIN, ARGUMENTS = 600, 14, 8, 8
BUILT_IN = (
    *("Exception", "ValueError", "TypeError", "RuntimeError", "LookupError", "KeyError"),
    *("IndexError", "ArithmeticError", "NotImplementedError"),
)


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def test_modules_are_short():
    long = {
        str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines())
        for path in (*MODULES, *(ROOT / "tests").rglob("*.py"))
    }
    assert not {name: lines for name, lines in long.items() if lines > LINES}


def test_folders_hold_few_modules():
    folders: dict[str, int] = {}
    for path in MODULES:
        if not path.name.startswith("__"):
            folder = str(path.parent.relative_to(ROOT))
            folders[folder] = folders.get(folder, 0) + 1
    assert not {name: count for name, count in folders.items() if count > IN_A_FOLDER}
    assert folders["twin"] <= MODULES_OF_TWIN


def test_every_folder_says_what_lives_there():
    silent = [
        str(path.parent.relative_to(ROOT))
        for path in MODULES
        if path.name == "__init__.py" and not ast.get_docstring(tree(path))
    ]
    assert not silent


def is_command(node: ast.FunctionDef) -> bool:
    """Functions of the command line take one argument for each option."""
    return any("typer.Option" in ast.unparse(a.annotation) for a in node.args.args if a.annotation)


def test_functions_take_few_arguments():
    many = []
    for path in [*MODULES, *sorted((ROOT / "tests").rglob("*.py"))]:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef) and node.name != "__init__":
                positional = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                count = len(positional) - (
                    positional[:1] != [] and positional[0].arg in ("self", "cls", "typing_context")
                )
                if count > ARGUMENTS and not is_command(node):
                    many.append(f"{path.relative_to(ROOT)}: {node.name} takes {count}")
    assert not many


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


def test_arguments_are_written_out():
    """No tuple is taken apart in a call: ``f(*(a, b), *(c, d))``."""
    splatted = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in [*MODULES, *sorted((ROOT / "tests").rglob("*.py"))]
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and any(
            isinstance(a, ast.Starred) and isinstance(a.value, ast.Tuple | ast.List)
            for a in node.args
        )
    ]
    assert not splatted


def test_no_part_of_an_unpacking_is_thrown_away():
    """A tuple of which a part is not wanted should have named fields."""
    thrown = [
        f"{path.relative_to(ROOT)}:{part.lineno}"
        for path in MODULES
        for part in ast.walk(tree(path))
        if isinstance(part, ast.Tuple)
        and isinstance(part.ctx, ast.Store)
        and any(isinstance(e, ast.Name) and e.id == "_" for e in part.elts)
    ]
    assert not thrown


@pytest.mark.parametrize("word", ["perf_counter", "process_time"])
def test_no_test_asserts_a_time(word: str):
    """A busy machine is slow, not wrong."""
    own = Path(__file__).resolve()
    found = [
        f"{path.relative_to(ROOT)}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        if path != own and word in path.read_text(encoding="utf-8")
    ]
    assert not found
