"""List the pages of benchmarks/results that are older than the code that they measure. A listing, never a failure.

A page's commit is the one in its head; where it names none, or was made with uncommitted changes, the one that
brought the page's line with date and command. Packages and files that it measures are those of
`benchmarks/catalogue.py`.

    python .ci/result_ages.py
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS = "benchmarks/results"
MADE_BY = re.compile(r"^\d{4}-\d\d-\d\d, .*Command: `", re.MULTILINE)
STATED = re.compile(r"^\d{4}-\d\d-\d\d, commit ([0-9a-f]{7,40}), ")
HISTORY = "**History.**"  # at the head of a page whose measurement is gone, with the commit that has it
Commits = Mapping[str, frozenset[str]]


def git(*words: str, root: Path = ROOT) -> str:
    """Output of a git command. Raises subprocess.CalledProcessError, or OSError without git."""
    return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True).stdout


def touched_files(root: Path) -> Commits:
    """Files that each commit of the history changed."""
    commits = {}
    for entry in git("log", "--format=%x00%H", "--name-only", root=root).split("\0")[1:]:
        name, *files = entry.split("\n")
        commits[name] = frozenset(filter(None, files))
    return commits


def commit_of(page: Path, root: Path) -> str:
    """The commit that a page's figures were measured on."""
    lines = page.read_text(encoding="utf-8").splitlines()
    number, line = next((n, text) for n, text in enumerate(lines, 1) if MADE_BY.match(text))
    if stated := STATED.match(line):
        return git("rev-parse", stated[1], root=root).strip()
    name = page.relative_to(root).as_posix()
    return git("blame", "--porcelain", "-L", f"{number},{number}", "HEAD", "--", name, root=root).split()[0]


def is_of(file: str, code: Iterable[str]) -> bool:
    """Whether a file is one of the files, or in one of the packages."""
    return any(file == path or file.startswith(f"{path}/") for path in code)


def age(page: Path, code: Iterable[str], commits: Commits, root: Path) -> str:
    """Remark on a page, empty where the code is as it was."""
    try:
        made = commit_of(page, root)
    except StopIteration:
        return "does not say when and by which command it was made"
    except subprocess.CalledProcessError:
        return "its commit is not in this repository, or it is not committed"
    later = git("rev-list", f"{made}..HEAD", root=root).split()
    later_commits = [name for name in later if any(is_of(file, code) for file in commits.get(name, ()))]
    if not later_commits:
        return ""
    last = git("show", "--no-patch", "--format=%h of %as", later_commits[0], root=root).strip()
    return f"{len(later_commits)} commits on {', '.join(code)} since {made[:7]}, the last {last}"


def listing(measured: Mapping[str, tuple[str, ...]], root: Path = ROOT) -> list[str]:
    """A line for each page that is older than its code, and one that counts them."""
    try:
        if git("rev-parse", "--is-shallow-repository", root=root).strip() == "true":
            return ["ages of results: not known, this clone has no history (git fetch --unshallow)"]
        commits = touched_files(root)
    except (OSError, subprocess.CalledProcessError):
        return ["ages of results: not known without git and a repository"]
    written = sorted((root / RESULTS).glob("*.md"))
    pages = [page for page in written if HISTORY not in page.read_text(encoding="utf-8")]
    lines = []
    for page in pages:
        code = measured.get(page.stem)
        remark = age(page, code, commits, root) if code else "no measurement in benchmarks/catalogue.py writes it"
        if remark:
            lines.append(f"{RESULTS}/{page.name}: {remark}")
    return [*lines, f"{len(lines)} of {len(pages)} pages of results are older than the code that they measure"]


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    from benchmarks.catalogue import measured_code

    print("\n".join(listing(measured_code())))
