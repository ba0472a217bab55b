"""The container files fit the tree: no builder is needed to see that a file is missing or a version differs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "containers").glob("*.Dockerfile"))
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())


def instructions(path: Path) -> list[tuple[str, str]]:
    """Each instruction's name and arguments, continued lines joined, comments left out."""
    lines = [line for line in path.read_text().splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    return [(name, rest) for line in joined.splitlines() if line for name, _, rest in [line.partition(" ")]]


def copied(path: Path) -> list[str]:
    """Sources of the build's context."""
    of_context = [rest for name, rest in instructions(path) if name == "COPY" and "--from=" not in rest]
    return [source for rest in of_context for source in rest.split()[:-1]]


def sent_to_builder() -> list[str]:
    """What .dockerignore lets through."""
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert "*" in lines
    return [line[1:] for line in lines if line.startswith("!")]


def test_there_is_one_for_the_workbench_and_one_for_the_flight_computer() -> None:
    assert [path.stem for path in FILES] == ["flight_computer", "workbench"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_everything_that_is_copied_is_there_and_reaches_the_builder(path: Path) -> None:
    assert copied(path)
    for source in copied(path):
        assert (ROOT / source).exists(), source
        assert any(Path(source).match(pattern) for pattern in sent_to_builder()), source


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_package_of_the_wheel_is_copied(path: Path) -> None:
    rooms = {pattern.rstrip("*") for pattern in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]}
    assert rooms <= set(copied(path))
    assert {PROJECT["project"]["readme"], *PROJECT["project"]["license-files"], "setup.py"} <= set(copied(path))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_everything_is_installed_by_hash_or_is_ours_or_torch(path: Path) -> None:
    torch = next(line for line in (ROOT / "constraints.txt").read_text().splitlines() if line.startswith("torch=="))
    installs = [part for _, rest in instructions(path) for part in rest.split("&&") if "pip install" in part]
    assert installs
    for part in installs:
        words = part.split()
        if torch in words:
            assert words[words.index("--constraint") + 1] == "/tmp/constraints.txt"
            continue
        assert "--no-deps" in words
        by_hash = "--require-hashes" in words and Path(words[words.index("--requirement") + 1]).suffix == ".lock"
        assert by_hash or "/tmp/wheels/*.whl" in words, part
    assert (torch in path.read_text()) == (path.stem == "workbench")
    assert f"requirements/{path.stem}.lock" in copied(path)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_python_is_one_that_the_project_supports_and_the_user_is_not_root(path: Path) -> None:
    bases = {rest.split()[0] for name, rest in instructions(path) if name == "FROM"}
    (base,) = bases
    version = re.fullmatch(r"python:(3\.\d+)-slim-bookworm", base)
    assert version is not None
    assert f"Programming Language :: Python :: {version[1]}" in PROJECT["project"]["classifiers"]
    users = [rest for name, rest in instructions(path) if name == "USER"]
    assert users
    assert users[-1] not in ("root", "0")
    names = [name for name, _ in instructions(path)]
    assert "RUN" not in names[len(names) - names[::-1].index("USER") :], "what runs after USER runs as that user"


def test_the_flight_computer_has_neither_compiler_nor_workbench() -> None:
    text = (ROOT / "containers" / "flight_computer.Dockerfile").read_text()
    assert "apt-get" not in text
    assert "workbench.lock" not in text
