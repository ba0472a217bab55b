"""Follows README or a tutorial of docs/tutorials as a reader does: in order, in a folder of its own.

A comment `# shorter: COMMAND` below a command, which readers see as well, is what runs in its place. A block of text
that follows shows lines of the output, compared as `shown_lines` says; a block of `console` is not run: it installs.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from tests.support.shown_lines import Shown, blocks_of, missing

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
SHORTER = "# shorter: "
NOT_RUN = ("", "console")  # drawings, and what installs
PATIENCE = 280.0  # s for one block


def blocks(page: Path) -> list[tuple[str, str, list[Shown]]]:
    """Language, text and shown output of each block of a page that is run."""
    steps: list[tuple[str, str, list[Shown]]] = []
    for language, text, tolerance in blocks_of(page.read_text(encoding="utf-8")):
        if language == "text":
            steps[-1][2].extend(Shown(line, tolerance) for line in text.splitlines())
        elif language not in NOT_RUN:
            steps.append((language, text, []))
    return steps


def needs_clock(text: str) -> bool:
    """Whether a block flies against the clock."""
    return "alula mock" in text


def prepare(folder: Path) -> None:
    """What a reader has: the repository."""
    for name in ("tests", "vehicles", "examples"):
        (folder / name).symlink_to(ROOT / name)


def follow(page: Path, folder: Path, *, against_clock: bool, port: int | None = None) -> None:
    """Run the blocks that fly against the clock, or all others; fails where a command or a line of output differs.

    port: of the link between mock and controller in place of the usual one, which another test may have.
    """
    for language, text, shown in blocks(page):
        if needs_clock(text) == against_clock:
            output = run(language, text if port is None else on_port(text, port), folder)
            others = missing(shown, output)
            assert others == [], f"{page.name} shows {others}, which is not in:\n{output}"


def on_port(text: str, port: int) -> str:
    """Commands whose mock and controller meet at another port of this machine."""
    for command, kind in (("alula mock", "udpout"), ("alula fly", "udpin")):
        text = text.replace(f"{command} ", f"{command} --link {kind}:127.0.0.1:{port} ")
    return text


def run(language: str, text: str, folder: Path) -> str:
    """Output of a block. What it starts in the background ends with it."""
    script = "\n".join(shortened(text.splitlines()))
    command = [sys.executable, "-c", script] if language == "python" else ["bash", "-ec", script]
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "COLUMNS": "240", "OMP_NUM_THREADS": "1"}
    log = folder / "output.txt"
    with log.open("wb") as output:
        # a group, but no session: between sessions the kernel shares the processors whatever their nice values
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, process_group=0
        )
        try:
            code = process.wait(PATIENCE)
        finally:
            with suppress(ProcessLookupError):  # nothing runs in the background
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    printed = log.read_text(encoding="utf-8")
    assert code == 0, f"{script}\nended with {code}:\n{printed}"
    return printed


def shortened(lines: list[str]) -> Iterator[str]:
    """Commands, the shorter one where there are two."""
    for place, line in enumerate(lines):
        following = lines[place + 1] if place + 1 < len(lines) else ""
        if not following.startswith(SHORTER):
            yield line.removeprefix(SHORTER)
