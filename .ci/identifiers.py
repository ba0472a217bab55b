"""Refuse identifiers made of words that docs/glossary.md replaces by the field's terms.

Checks what a file defines (names, arguments, functions, classes, attributes, the file's own name), not what it uses.

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


def parts_of(name: str) -> set[str]:
    """The words of a snake_case or CamelCase name: constants stay upper case, all else is lower case."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return {word if word.isupper() and len(word) > 1 else word.lower() for word in words}


def main() -> int:
    """Print every refused identifier. Returns the exit code."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    below = tuple(sys.argv[1:])
    parts, names_refused = refused_words()
    refused_parts = parts | {word.upper() for word in parts}
    count = 0
    for path in listed.stdout.split():
        if path.startswith("tests/data/") or (below and not path.startswith(below)) or not (ROOT / path).exists():
            continue
        names = [(1, Path(path).stem), *defined_names(ast.parse((ROOT / path).read_text(encoding="utf-8")))]
        for line, name in names:
            words = parts_of(name) & refused_parts
            if name.strip("_").lower() in names_refused:
                words.add(name)
            if words and name not in IMPOSED and not name.startswith("test_"):
                count += 1
                print(f"{path}:{line}: {name}: {', '.join(sorted(words))} is replaced in docs/glossary.md")
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
