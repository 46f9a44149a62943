"""The sizes that keep the tree readable."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MAX_FILE = 400
"""Lines of a file."""

MAX_FUNCTION = 40
"""Lines of code of a function, without docstring, comments and blank lines."""

MAX_TOTAL = 21_477
"""Lines of all three packages together."""

SOURCES = sorted(
    file for name in ("irl_dal", "expert", "shield") for file in (ROOT / name).rglob("*.py")
)


def code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef, lines: list[str]) -> int:
    """Of a function with its signature, without docstring, comments and blank lines."""
    assert function.end_lineno is not None
    skipped: set[int] = set()
    if ast.get_docstring(function) is not None:
        text = function.body[0]
        assert text.end_lineno is not None
        skipped = set(range(text.lineno, text.end_lineno + 1))
    return sum(
        1
        for number in range(function.lineno, function.end_lineno + 1)
        if number not in skipped and lines[number - 1].split("#")[0].strip()
    )


def test_files_and_functions_are_short() -> None:
    """Nobody has to scroll far: 400 lines and 40 lines."""
    long = []
    for file in SOURCES:
        lines = file.read_text().splitlines()
        if len(lines) > MAX_FILE:
            long.append(f"{file}: {len(lines)} lines")
        for node in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                if (length := code_lines(node, lines)) > MAX_FUNCTION:
                    long.append(f"{file}:{node.lineno} {node.name}: {length} lines")
    assert long == []


def test_the_source_does_not_grow() -> None:
    """More has to be done by less."""
    assert sum(len(file.read_text().splitlines()) for file in SOURCES) <= MAX_TOTAL
