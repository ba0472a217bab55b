"""Lint lists the pages of results that are older than the code that they measure, and does without git."""

import importlib.util
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.pages import ROOT

CODE = {"speed": ("engine", "wheel.py")}
MACHINE = "AMD EPYC, 2 cores, load 0.0 before"


@pytest.fixture(scope="module")
def ages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("result_ages", ROOT / ".ci" / "result_ages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Repository:
    """A repository with an engine, a wheel and a page about both."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "engine").mkdir()
        (root / "benchmarks" / "results").mkdir(parents=True)
        self.git("init", "--quiet", "--initial-branch", "main")
        for file in ("engine/start.py", "wheel.py", "door.py"):
            self.change(file)

    def git(self, *words: str) -> str:
        identity = ("-c", "user.name=A. Nybody", "-c", "user.email=anybody@example.org", "-c", "commit.gpgsign=false")
        return subprocess.run(
            ["git", *identity, *words], cwd=self.root, check=True, capture_output=True, text=True
        ).stdout.strip()

    def change(self, file: str, text: str | None = None) -> str:
        """Commit a change of a file. Returns the commit."""
        path = self.root / file
        path.write_text(text if text is not None else (path.read_text() if path.exists() else "") + "line\n")
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", file)
        return self.git("rev-parse", "HEAD")

    def write_page(self, conditions: str, name: str = "speed") -> None:
        """Commit a page that was made in some conditions."""
        text = f"# Speed\n\n2026-11-27, {conditions}. Command: `python -m benchmarks engine speed`\n\n| a | 1 |\n"
        self.change(f"benchmarks/results/{name}.md", text)


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    return Repository(tmp_path)


def test_a_page_is_older_once_its_code_changes(ages: ModuleType, repository: Repository) -> None:
    commit = repository.git("rev-parse", "--short", "HEAD")
    repository.write_page(f"commit {commit}, {MACHINE}")
    repository.change("door.py")  # which it does not measure
    assert ages.listing(CODE, repository.root) == ["0 of 1 pages of results are older than the code that they measure"]
    repository.change("engine/start.py")
    repository.change("wheel.py")
    line, count = ages.listing(CODE, repository.root)
    assert line.startswith("benchmarks/results/speed.md: 2 commits on engine, wheel.py since ")
    assert count.startswith("1 of 1 ")


def test_the_stated_commit_counts_and_not_the_pages_own(ages: ModuleType, repository: Repository) -> None:
    measured = repository.git("rev-parse", "--short", "HEAD")
    repository.change("engine/start.py")
    repository.write_page(f"commit {measured}, {MACHINE}")
    assert ages.listing(CODE, repository.root)[0].startswith("benchmarks/results/speed.md: 1 commits on")


@pytest.mark.parametrize("uncommitted", [True, False], ids=["uncommitted changes", "no commit"])
def test_a_page_without_its_commit_is_as_old_as_its_line(
    ages: ModuleType, repository: Repository, uncommitted: bool
) -> None:
    measured = repository.git("rev-parse", "--short", "HEAD")
    repository.change("engine/start.py")  # the change that was not committed yet
    repository.write_page(f"commit {measured} and uncommitted changes, {MACHINE}" if uncommitted else MACHINE)
    assert len(ages.listing(CODE, repository.root)) == 1
    page = repository.root / "benchmarks" / "results" / "speed.md"
    repository.change("engine/start.py")
    repository.change("benchmarks/results/speed.md", page.read_text() + "\nA remark of later.\n")
    assert ages.listing(CODE, repository.root)[0].startswith("benchmarks/results/speed.md: 1 commits on")


@pytest.mark.parametrize("name", ["engine_room", "engine.md"])
def test_a_name_that_only_begins_alike_is_other_code(ages: ModuleType, name: str) -> None:
    assert not ages.is_of(name, CODE["speed"])


def test_pages_that_nothing_dates_are_listed(ages: ModuleType, repository: Repository) -> None:
    repository.write_page(MACHINE, name="unknown")
    repository.write_page("commit 0123456789ab, " + MACHINE)
    (repository.root / "benchmarks" / "results" / "bare.md").write_text("# Bare\n")
    lines = ages.listing({**CODE, "bare": ("door.py",)}, repository.root)
    assert lines[:3] == [
        "benchmarks/results/bare.md: does not say when and by which command it was made",
        "benchmarks/results/speed.md: its commit is not in this repository, or it is not committed",
        "benchmarks/results/unknown.md: no measurement in benchmarks/catalogue.py writes it",
    ]


def test_without_a_repository_it_says_so(ages: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert ages.listing(CODE, tmp_path) == ["ages of results: not known without git and a repository"]


def test_without_git_it_says_so(ages: ModuleType, repository: Repository, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(repository.root))
    assert ages.listing(CODE, repository.root) == ["ages of results: not known without git and a repository"]


def test_a_clone_without_history_says_so(ages: ModuleType, repository: Repository, tmp_path: Path) -> None:
    shallow = tmp_path / "shallow"
    repository.git("clone", "--quiet", "--depth", "1", f"file://{repository.root}", str(shallow))
    [line] = ages.listing(CODE, shallow)
    assert "no history" in line
