"""One process that reads mutated inputs and reports on each; it may crash, hang or ask for memory: its parent watches.

    python -m tests.fuzz.worker GROUP '{"TARGET": [FIRST, END], ..}'

A line of JSON for every input that begins and for every one that ended comes out of the standard output as it was at
the start. What anything else prints, into descriptors 1 and 2, is a find.
"""

from __future__ import annotations

import gc
import json
import os
import random
import resource
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.mutation import Parts, mutated
from tests.fuzz.target import Target

MEMORY = 1 << 30  # bytes of address space beyond what the process has when its seeds were read
ROOT = Path(__file__).parents[2]
CORPUS = Path(__file__).parent / "corpus"
Report = Callable[..., None]


def main() -> None:
    """Read the inputs FIRST to END, exclusive, of targets; before these the seeds of all and each one's corpus."""
    group, plan = sys.argv[1], json.loads(sys.argv[2])
    report = _reporter()
    with tempfile.TemporaryDirectory(prefix="alula-fuzz-") as folder:
        os.environ["XDG_CONFIG_HOME"] = str(Path(folder, "config"))
        from tests.fuzz.targets import targets_of

        targets = targets_of(group)
        seeds = {name: _seeds(targets[name], Path(folder), report) for name in plan}
        refuse_compilation()
        limit_memory()
        for name, (first, end) in plan.items():
            _run(targets[name], seeds[name], range(first, end), Path(folder), report)


def _seeds(target: Target, folder: Path, report: Report) -> list[Parts]:
    (folder / target.name).mkdir()
    seeds = target.seeds(folder / target.name)
    assert seeds, f"{target.name} has no seed"
    for number, parts in enumerate(seeds):
        _read(target, f"seed {number}", lambda place, parts=parts: target.assemble(parts, place), folder, report)
    return seeds


def _run(target: Target, seeds: list[Parts], numbers: range, folder: Path, report: Report) -> None:
    for path in sorted((CORPUS / target.name).glob("*")):
        _read(target, f"corpus {path.name}", lambda place, path=path: _copied(path, place), folder, report)
    for number in numbers:
        parts = made(target, seeds, number)
        _read(target, str(number), lambda place, parts=parts: target.assemble(parts, place), folder, report)


def made(target: Target, seeds: list[Parts], number: int) -> dict[str, bytes]:
    """The input of a number."""
    rng = random.Random(f"{target.name} {number}")
    return mutated(rng.choice(seeds), rng, others=seeds)


def _copied(path: Path, place: Path) -> Path:
    copy = shutil.copytree if path.is_dir() else shutil.copy
    return Path(copy(path, place / path.name))


def _read(target: Target, number: str, assemble: Callable[[Path], Path], folder: Path, report: Report) -> None:
    place = folder / "place"
    place.mkdir()
    try:
        path = assemble(place)
    except Exception as error:
        report(end=number, target=target.name, outcome="harness", text=repr(error), trace=_trace(error))
        shutil.rmtree(place)
        return
    report(begin=number, target=target.name, path=str(path))
    before = _printed()
    outcome = _outcome(target, path)
    sys.stdout.flush()
    sys.stderr.flush()
    if outcome["outcome"] in ("read", "refused") and (printed := _printed()[len(before) :]):
        outcome = {"outcome": "printed", "text": printed[-500:].decode(errors="replace")}
    report(end=number, target=target.name, **outcome)
    shutil.rmtree(place)


def _outcome(target: Target, path: Path) -> dict[str, Any]:
    from dynamics.errors import AlulaError

    try:
        target.read(path)
    except AlulaError as error:
        if not str(error).strip() or not error.exit_code > 0:
            return {"outcome": "no message", "text": repr(error)}
        return {"outcome": "refused", "text": str(error)[:200]}
    except MemoryError as error:
        return {"outcome": "memory", "text": repr(error), "trace": _trace(error)}
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return {"outcome": "exception", "text": repr(error)[:500], "trace": _trace(error)}
    finally:
        gc.collect(0)
    return {"outcome": "read"}


def _trace(error: BaseException) -> list[str]:
    """The places of this repository that it came through, and the innermost ones of all, last."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [f"{frame.filename.removeprefix(f'{ROOT}/')}:{frame.lineno} {frame.name}" for frame in frames]
    return [line for line in lines[:-4] if not line.startswith(("/", "<"))][-20:] + lines[-4:]


def refuse_compilation() -> None:
    """An input may ask for a kernel that was never compiled; the compiler's time says nothing about the reader."""
    from dynamics import codegen
    from dynamics.errors import RequestError

    def refuse(*_: object) -> None:
        raise RequestError("nothing is compiled here. Give an input of a known kernel.")

    codegen._compile = refuse


def limit_memory() -> None:
    """Let the process have so much more than it has now; ignores what a larger limit of before allowed."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


_capture = Path()


def _reporter() -> Report:
    """Take standard output for reports, and let everything else that prints write into a file."""
    global _capture  # noqa: PLW0603
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    descriptor, name = tempfile.mkstemp(prefix="alula-fuzz-printed-")
    _capture = Path(name)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)

    def report(**fields: object) -> None:
        channel.write(json.dumps(fields) + "\n")
        channel.flush()

    import atexit

    atexit.register(_capture.unlink, missing_ok=True)
    return report


def _printed() -> bytes:
    return _capture.read_bytes()


if __name__ == "__main__":
    main()
