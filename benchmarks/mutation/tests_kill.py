"""Mutants that the tests of every change kill, in two revisions of this repository."""

from __future__ import annotations

import ast
import itertools
import json
import os
import random
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmarks.measurement import ROOT, Page, finished, keep, options_of, paragraph_of
from benchmarks.mutation.mutants import Key, mutants
from dynamics.errors import RequestError

BEFORE = "66f16dd"  # the last commit before `make test` was made shorter
ROOMS = {"runtime/flight": 4, "dynamics": 3, "flights": 3}  # files that are drawn from each
LEFT_OUT = (
    "flights/parallel.py",  # it ends processes; a mutant might end others
    *("flights/delays.py", "flights/exclusion.py"),  # their tests take 24 s of the processor, for each mutant
)
PER_FILE, SEED = 12, 37
MIN_MUTANTS, MAX_TEST_FILES = 30, 2
LIMIT, TIMES = 30, 4  # s of the processor for a mutant's tests: so many, and so many times what they take without one


@dataclass(frozen=True)
class Tree:
    """Files of one commit in a folder of their own."""

    commit: str
    folder: Path

    @classmethod
    def of(cls, commit: str, folder: Path) -> Tree:
        """The commit's files, written to a folder of its name."""
        command = ["git", "rev-parse", "--short=10", f"{commit}^{{commit}}"]
        resolved = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if resolved.returncode:
            raise RequestError(f"{commit} is no commit of this clone. Wanted one: fetch the whole history.")
        name = resolved.stdout.strip()
        tree = cls(name, folder / name)
        tree.folder.mkdir(parents=True, exist_ok=True)
        packed = subprocess.run(["git", "archive", name], cwd=ROOT, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x"], cwd=tree.folder, input=packed, check=True)  # mutants of a run cut off go
        return tree

    def read(self, file: str) -> str:
        """A file as the commit has it."""
        return subprocess.run(
            ["git", "show", f"{self.commit}:{file}"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout

    def files_of_tests(self, file: str) -> list[str]:
        """Test files that import a module, or what its package takes from it, among those of its room."""
        room, module = Path(file).parts[0], _module(file)
        package = module.rpartition(".")[0]
        taken = imported_modules((self.folder / file).with_name("__init__.py").read_text())
        names = {module, *(name.replace(module, package) for name in taken if name.startswith(f"{module}."))}
        return [test for test, used in self._imported.items() if used & names and Path(test).parts[1] == room]

    @cached_property
    def _imported(self) -> dict[str, set[str]]:
        """Modules that each test file imports."""
        files = sorted(self.folder.glob("tests/*/**/test_*.py"))
        return {str(path.relative_to(self.folder)): imported_modules(path.read_text()) for path in files}

    @cached_property
    def _worker(self) -> subprocess.Popen[str]:
        """The process that runs tests in this tree."""
        outside = {"PYTHONPATH": str(self.folder), "XDG_CACHE_HOME": str(self.folder / "build" / "cache")}
        return subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("tree_worker.py"))],
            cwd=self.folder,
            env={**os.environ, **outside, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, file: str, limit: int, mutant: str | None = None) -> tuple[int, float]:
        """(exit code of the tests, s of the processor), with a mutant in place of a file, which is put back."""
        path, original = self.folder / file, self.read(file)
        tests = {"module": _module(file), "tests": self.files_of_tests(file)}
        request = {**tests, "limit": limit, "writes_bytecode": mutant is None}
        if mutant is not None:
            path.write_text(mutant)
        try:
            assert self._worker.stdin is not None
            assert self._worker.stdout is not None
            print(json.dumps(request), file=self._worker.stdin, flush=True)
            code, seconds = json.loads(self._worker.stdout.readline())
        finally:
            if mutant is not None:
                path.write_text(original)
        if code == 99:
            raise RequestError(f"{file} was imported from outside of {self.folder}.")
        return code, seconds


def _module(file: str) -> str:
    return file.removesuffix(".py").replace("/", ".")


def imported_modules(source: str) -> set[str]:
    """Names of modules, and of what is taken from them, that a source imports anywhere."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def drawn_mutants(trees: Sequence[Tree]) -> dict[str, list[Key]]:
    """Files, and keys of the mutants of each, that all trees have: drawn by SEED."""
    draw, chosen = random.Random(SEED), dict[str, list[Key]]()
    for room, count in ROOMS.items():
        names = sorted(
            str(path.relative_to(trees[0].folder))
            for path in (trees[0].folder / room).glob("*.py")
            if all((tree.folder / room / path.name).exists() for tree in trees)
        )
        draw.shuffle(names)
        for name in names:
            common = set.intersection(*(set(mutants(tree.read(name))) for tree in trees))
            tested = all(1 <= len(tree.files_of_tests(name)) <= MAX_TEST_FILES for tree in trees)
            if tested and len(common) >= MIN_MUTANTS and name not in LEFT_OUT:
                chosen[name] = draw.sample(sorted(common), PER_FILE)
            if sum(file.rpartition("/")[0] == room for file in chosen) == count:
                break
    return chosen


class Run:
    """Tests of mutants in all trees, as far as results are not kept already."""

    def __init__(self, trees: Mapping[str, Tree], results: Path) -> None:
        self._trees, self._results, self._done = trees, results, finished(results)

    def follow(self, file: str, key: Key) -> None:
        """Run the tests of one mutant and keep which trees' tests killed it."""
        written = _written(self._trees, file, key)
        if written in self._done:
            return
        with ThreadPoolExecutor(len(self._trees)) as threads:
            codes = dict(threads.map(lambda name: (name, self._exit_code(name, file, key)), self._trees))
        result = {"key": written, **{name: code != 0 for name, code in codes.items()}}
        keep(self._results, result, line=f"{file} {codes} {key[2]} -> {key[3]}")

    def _exit_code(self, name: str, file: str, key: Key) -> int:
        tree = self._trees[name]
        seconds = self._seconds_without_mutant(tree, file)
        return tree.run(file, round(LIMIT + TIMES * seconds), mutants(tree.read(file))[key])[0]

    def _seconds_without_mutant(self, tree: Tree, file: str) -> float:
        """Seconds of the processor that a file's tests take."""
        written = json.dumps([tree.commit, file])
        if written not in self._done:
            code, seconds = tree.run(file, 100 * LIMIT)
            if code:
                raise RequestError(f"{' '.join(tree.files_of_tests(file))} fail in {tree.folder} (exit code {code}).")
            self._done[written] = {"key": written, "seconds": seconds}
            keep(self._results, self._done[written], line=f"{file} {tree.commit}: {seconds:.0f} s without a mutant")
        return float(self._done[written]["seconds"])


def _written(trees: Mapping[str, Tree], file: str, key: Key) -> str:
    """A mutant's key in the file of results, which may have those of other commits."""
    return json.dumps([*(tree.commit for tree in trees.values()), file, *key])


def _page(drawn: Mapping[str, list[Key]], results: Mapping[str, Mapping[str, Any]], trees: Mapping[str, Tree]) -> str:
    """The table, and the mutants that live longer than before."""
    rows, lost, total = [], [], [0, 0, 0]
    for file, keys in drawn.items():
        of_file = [results[k] for key in keys if (k := _written(trees, file, key)) in results]
        counts = [len(of_file), sum(r["before"] for r in of_file), sum(r["after"] for r in of_file)]
        total = [a + b for a, b in zip(total, counts, strict=True)]
        tests = ["/".join(str(len(tree.files_of_tests(file))) for tree in trees.values())]
        rows.append(f"| `{file}` | {' | '.join(map(str, [*tests, *counts]))} |")
        lost += [r["key"] for r in of_file if r["before"] and not r["after"]]
    count, before, after = total
    shares = [f"{killed / max(1, count):.0%}" for killed in (before, after)]
    survivors = [
        f"- `{file}` in `{scope[1:]}`: `{was}` becomes `{now}`"
        for _, _, file, scope, _, was, now, _ in map(json.loads, lost)
    ]
    return "\n".join(
        [
            f"Killed before ({trees['before'].commit}): {before} of {count}, {shares[0]}. "
            f"Killed after ({trees['after'].commit}): {after} of {count}, {shares[1]}.",
            "",
            "| file | test files before/after | mutants | killed before | killed after |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
            "Killed before and not after:" if survivors else "No mutant that was killed before lives now.",
            "",
            *survivors,
        ]
    )


def tests_kill(words: Sequence[str]) -> Page:
    """Share of mutants that tests kill, before and after they were made quicker.

    Mutants of ten files drawn from runtime/flight, dynamics and flights: one comparison, operator, constant or returned
    value changed in each, drawn from those whose lines both commits have. Tests are the files that import the module
    and lie in its room's folder, without those marked slow or realtime, by the same rule in both; files with more than
    two such test files are not drawn, for time. Whole flights and commands are not among them. A
    mutant whose tests fail, or take several times the processor's time that they take without it, is killed.

        python -m benchmarks mutation tests_kill
    """
    parser = options_of(tests_kill.__doc__, resumes="mutation/killed")
    parser.add_argument("--before", default=BEFORE, metavar="COMMIT", help=BEFORE)
    parser.add_argument("--after", default="HEAD", metavar="COMMIT", help="HEAD")
    parser.add_argument("--files", type=int, help="so many of the files alone")
    options = parser.parse_args(list(words))
    folder = ROOT / "build" / "mutation"
    trees = {name: Tree.of(getattr(options, name), folder) for name in ("before", "after")}
    drawn = {f: keys[: options.cases] for f, keys in list(drawn_mutants(list(trees.values())).items())[: options.files]}
    run = Run(trees, options.kept)
    for mutants_of_files in itertools.zip_longest(*drawn.values()):  # a run that is cut off has some of each file
        for file, key in zip(drawn, mutants_of_files, strict=True):
            run.follow(file, key)
    body = paragraph_of(tests_kill.__doc__) + "\n\n" + _page(drawn, finished(options.kept), trees)
    return Page("mutants", "Mutants that the tests kill, before and after the tests were made quicker", body)
