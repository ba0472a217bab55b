"""Refuse identifiers of words that docs/glossary.md replaces by the field's terms, and docstrings that name nothing.

Checks what a file defines (names, arguments, functions, classes, attributes, the file's own name), not what it uses;
of C every identifier, since there is no parser here that knows which are defined. The first words of a docstring name
the thing: `OPENINGS` refer to something else, or begin with a relative clause. Tests' docstrings are left out.

    python .ci/identifiers.py [PATH ...]
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IMPOSED = frozenset({"tell"})  # by Python's file objects
PARTS, NAMES = "## Words that no part of an identifier is", "## Words that are no name by themselves"
OPENINGS = ("What ", "The same", "That of ", "Those ")
TESTS = "tests/"
NOT_CODE = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"', re.DOTALL)  # comments and strings of C


def refused_words() -> tuple[frozenset[str], frozenset[str]]:
    """Words refused as a part of an identifier, and words refused as a whole one, from the glossary."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    parts, names_refused = text[text.index(PARTS) : text.index(NAMES)], text[text.index(NAMES) :]
    return frozenset(re.findall(r"`(\w+)`", parts)), frozenset(re.findall(r"`(\w+)`", names_refused))


def defined_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, name) of everything that a module defines; the sentences that name tests are left out."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr
            case ast.arg():
                yield node.lineno, node.arg
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef() if not node.name.startswith("test_"):
                yield node.lineno, node.name


def names_in_c(text: str) -> Iterator[tuple[int, str]]:
    """(line, name) of each identifier of a C file, where it first stands; comments and strings are left out."""
    code = NOT_CODE.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), text)
    seen_names: set[str] = set()
    for number, line in enumerate(code.splitlines(), 1):
        for name in re.findall(r"[A-Za-z_]\w*", line):
            if name not in seen_names:
                seen_names.add(name)
                yield number, name


def parts_of(name: str) -> set[str]:
    """The words of a snake_case or CamelCase name: constants stay upper case, all else is lower case."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return {word if word.isupper() and len(word) > 1 else word.lower() for word in words}


def refused_names(names: Iterator[tuple[int, str]], *, of_python: bool = True) -> Iterator[tuple[int, str]]:
    """(line, complaint) of each refused name. of_python: words that are no name by themselves count, too."""
    parts, names_refused = refused_words()
    refused_parts = parts | {word.upper() for word in parts}
    for line, name in names:
        words = parts_of(name) & refused_parts
        if of_python and name.strip("_").lower() in names_refused:
            words.add(name)
        if words and name not in IMPOSED and not name.startswith("test_"):
            yield line, f"{name}: {', '.join(sorted(words))} is replaced in docs/glossary.md"


def unnamed_docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, complaint) of each docstring whose first words do not name what it describes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text and text.startswith(OPENINGS):
                opening = next(opening for opening in OPENINGS if text.startswith(opening))
                yield node.body[0].lineno, f"a docstring begins with {opening.strip()!r}: name the thing first"


def unnamed_comments(text: str) -> Iterator[tuple[int, str]]:
    """(line, complaint) of each comment of a C file that begins as no docstring may."""
    for match in re.finditer(r"/\*\s+(" + "|".join(OPENINGS) + ")", text):
        line = text.count("\n", 0, match.start()) + 1
        yield line, f"a comment begins with {match[1].strip()!r}: name the thing first"


def complaints(path: str, text: str) -> Iterator[tuple[int, str]]:
    """(line, complaint) of a file of Python or C. path: in the repository, with forward slashes."""
    if not path.endswith(".py"):
        yield from refused_names(names_in_c(text), of_python=False)
        yield from unnamed_comments(text)
        return
    tree = ast.parse(text)
    yield from refused_names(iter([(1, Path(path).stem), *defined_names(tree)]))
    if not path.startswith(TESTS):
        yield from unnamed_docstrings(tree)


def main() -> int:
    """Print every complaint. Returns the exit code."""
    command = ["git", "ls-files", "*.py", "*.c", "*.h"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    below = tuple(sys.argv[1:])
    count = 0
    for path in listed.stdout.split():
        if path.startswith("tests/data/") or (below and not path.startswith(below)) or not (ROOT / path).exists():
            continue
        for line, complaint in complaints(path, (ROOT / path).read_text(encoding="utf-8")):
            count += 1
            print(f"{path}:{line}: {complaint}")
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
