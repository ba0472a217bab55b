"""Pages and files outside docs/ that the site needs, as pages link to them.

README.md becomes the start page, and measurements.md lists what benchmarks/results holds. A link that leaves docs/
takes its target along: a page becomes a page of the site, any other file is copied, a folder stays text. Lists may
follow a paragraph without an empty line, as everywhere but in Python-Markdown.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).parents[2]
START = "README.md"
IN_MENU = (START, "CONTRIBUTING.md", "CHANGELOG.md", "examples/paper_bags.md")  # by mkdocs.yml
RESULTS = "benchmarks/results"
MEASUREMENTS = """# Measurements

Every figure in these pages was measured by a script in `benchmarks/`, which wrote the page that it names;
`python -m benchmarks` lists them, and `make benchmarks/THEME/NAME.py` measures again. Each page says with which date,
commit, machine, versions and command it was made; older ones say so below, without a commit.

"""
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s:]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"^\s*```")
FENCED = re.compile(r"(^\s*```.*?^\s*```[^\n]*$)", re.MULTILINE | re.DOTALL)
ITEM = re.compile(r"^ {0,3}([-*]|\d+\.) ")


def place_of(source: str) -> str:
    """Where a file of the repository lies in the site; source and answer with forward slashes."""
    if source == START:
        return "index.md"
    return source.removeprefix("docs/")


def target_of(page: str, link: str) -> str | None:
    """The file of the repository that a link of a page leads to, or None for one that is not there.

    page: of the repository. link: relative to it, without anchor.
    """
    target = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
    return target if not target.startswith("..") and (ROOT / target).exists() else None


def linked_files(pages: list[str]) -> list[str]:
    """All files outside docs/ that the pages link to, and those that these link to."""
    outside: list[str] = []
    waiting = list(pages)
    while waiting:
        page = waiting.pop()
        for *_, link, _anchor in LINK.findall((ROOT / page).read_text(encoding="utf-8")):
            target = target_of(page, link)
            if target is None or target.startswith("docs/") or target in outside or (ROOT / target).is_dir():
                continue
            outside.append(target)
            if target.endswith(".md"):
                waiting.append(target)
    return outside


def on_files(files: Files, config: Any) -> Files:
    """Add what pages link to outside of docs/."""
    results = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / RESULTS).glob("*.md"))
    always = [*IN_MENU, *results]
    pages = [f"docs/{file.src_uri}" for file in files.documentation_pages()]
    for source in dict.fromkeys([*always, *linked_files([*pages, *always])]):
        file = File.generated(config, place_of(source), abs_src_path=str(ROOT / source))
        file.inclusion = InclusionLevel.INCLUDED if source in IN_MENU else InclusionLevel.NOT_IN_NAV
        files.append(file)
    listed = "".join(f"- [{title_of(source)}]({source})\n" for source in results)
    files.append(File.generated(config, "measurements.md", content=MEASUREMENTS + listed))
    return files


def title_of(source: str) -> str:
    """The first line of a page of the repository, without its mark."""
    return (ROOT / source).read_text(encoding="utf-8").splitlines()[0].lstrip("# ")


def source_of(page: str) -> str:
    """The file of the repository behind a page of the site."""
    if page == "index.md":
        return START
    return f"docs/{page}" if (ROOT / "docs" / page).exists() else page


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Links lead to places of the site, and lists have an empty line before them."""
    source = source_of(page.file.src_uri)
    here = posixpath.dirname(page.file.src_uri)

    def link(match: re.Match[str]) -> str:
        mark, text, address, anchor = match.groups()
        target = target_of(source, address)
        if target is None:
            return match.group()
        if (ROOT / target).is_dir():
            return text
        return f"{mark}[{text}]({posixpath.relpath(place_of(target), here or '.')}{anchor or ''})"

    lines, fenced = [], False
    for line in markdown.splitlines():
        if FENCE.match(line):
            fenced = not fenced
        before = lines[-1] if lines else ""
        starts = ITEM.match(line) and before.strip() and not ITEM.match(before) and not before.startswith((" ", "#"))
        if starts and not fenced:
            lines.append("")
        lines.append(line)
    parts = FENCED.split("\n".join(lines))  # a link may go from one line to the next
    return "".join(part if number % 2 else LINK.sub(link, part) for number, part in enumerate(parts))
