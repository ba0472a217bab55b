"""Write docs/api.md from the docstrings of everything that `alula` exports.

python docs/make_api.py            # write the page
python docs/make_api.py --check    # end with 1 where the page differs from what it would be
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("api.md")
ROOMS = (
    "vehicles",
    "flights",
    "diagnosis",
    "fleet",
    "learning",
    "planning",
    "trusting",
    "flying",
)  # of alula.api, in the order of the loop
REPORTS = (  # that functions return as they are
    ("flights.quality.inspection", "Inspection"),
    ("flights.health.answer", "Health"),
    ("flights.health.answer", "Statement"),
    ("flights.health.answer", "Evidence"),
    ("flights.health.answer", "HealthEvent"),
    ("dynamics.vehicle_draft", "Draft"),
    ("diagnosis.vehicle_from_logs", "LogVehicle"),
    ("diagnosis.vehicle_identification", "Identification"),
    ("diagnosis.vehicle_check", "VehicleCheck"),
    ("diagnosis.hover_trim", "TrimComparison"),
    ("diagnosis.experiment.planning", "PlannedFlight"),
    ("diagnosis.experiment.expectation", "ExpectedInterval"),
    ("studies.fleet.summary", "FleetReport"),
    ("studies.fleet.summary", "VehicleSummary"),
    ("studies.fleet.summary", "Drift"),
    ("studies.fleet.summary", "Outlier"),
    ("studies.fleet.flight", "FleetFlight"),
    ("diagnosis.flight_addition", "FlightAdditionReport"),
    ("diagnosis.flight_addition", "LeftOut"),
    ("flights.followed", "FollowedFlight"),
    ("diagnosis.proof", "Proof"),
    ("simulation.versions_in_flight", "VersionsInFlight"),
    ("simulation.trial_flight", "TrialFlight"),
    ("simulation.lockstep", "FlownReference"),
    ("runtime.flight_request", "FlightReport"),
)
TYPES = ("Vehicle", "EffectUse", "Effect", "Flight", "Log")
ERRORS = ("AlulaError", "RequestError", "DataError", "VehicleError")
OTHERS = ("read_log", "read_folder", "write_vehicle")
WIDTH = 100


def page() -> str:
    """The whole page."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    parts = ["# Python API", "Made from the docstrings by `python docs/make_api.py`. " + _text(_module("alula.api"))]
    for room in ROOMS:
        module = _module(f"alula.api.{room}")
        parts += [f"## {_text(module).rstrip('.')}", *_functions(module)]
    parts += ["## Results", *_classes(_module("alula.api.results"))]
    for place, name in REPORTS:
        parts += _classes(_module(place), name)
    parts += ["## Types, readers and errors", "\n".join(_lines())]
    return "\n\n".join(parts) + "\n"


def _module(name: str) -> Any:
    return importlib.import_module(name)


def _text(thing: Any) -> str:
    """A docstring without spaces around it."""
    return (inspect.getdoc(thing) or "").strip()


def _functions(module: Any) -> Iterator[str]:
    tree = ast.parse(inspect.getsource(module))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield f"### `alula.{node.name}`"
            yield f"```text\n{_signature(node)}\n```"
            yield _described(inspect.cleandoc(ast.get_docstring(node) or ""))


def _signature(node: ast.FunctionDef) -> str:
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    written = re.sub(r"(?<=\S)=(?=\S)", " = ", ast.unparse(node.args))
    line = f"{node.name}({written}){returns}"
    if len(line) <= WIDTH:
        return line
    arguments = textwrap.indent(written.replace(", ", ",\n"), "    ")
    return f"{node.name}(\n{_joined_brackets(arguments)},\n){returns}"


def _joined_brackets(text: str) -> str:
    """Lines that were cut inside of brackets, joined again."""
    lines: list[str] = []
    for line in text.splitlines():
        if lines and lines[-1].count("[") > lines[-1].count("]"):
            lines[-1] += " " + line.strip()
        else:
            lines.append(line)
    return "\n".join(lines)


def _described(docstring: str) -> str:
    """A docstring as Markdown: `name: text` lines as a list, the example as code."""
    text, _, example = docstring.partition("\nExample:\n")
    blocks = [_block(block) for block in text.strip().split("\n\n")]
    if example:
        blocks.append(f"```python\nimport alula\n\n{textwrap.dedent(example).strip()}\n```")
    return "\n\n".join(blocks)


def _block(block: str) -> str:
    """A paragraph, or a list where its lines are `name: text`."""
    entries: list[str] = []
    for line in block.splitlines():
        name, colon, text = line.partition(": ")
        if line.startswith(" ") and entries:
            entries[-1] += " " + line.strip()
        elif colon and all(word.strip("`").isidentifier() for word in name.split(", ")):
            entries.append(f"- `{name}`: {text}")
        else:
            entries.append(f"\n{line}" if line.startswith("Raises") else line)
    return "\n".join(entries).strip()


def _classes(module: Any, only: str = "") -> Iterator[str]:
    """The public classes of a module, or one: fields from the docstring, methods by their first paragraph."""
    for node in ast.parse(inspect.getsource(module)).body:
        if not isinstance(node, ast.ClassDef) or only not in ("", node.name):
            continue
        yield f"### `{node.name}`"
        yield _described(inspect.cleandoc(ast.get_docstring(node) or ""))
        methods = (item for item in node.body if isinstance(item, ast.FunctionDef) and not item.name.startswith("_"))
        listed = [f"- `.{_method(item)}`: {_first(ast.get_docstring(item) or '')}" for item in methods]
        if listed:
            yield "\n".join(listed)


def _method(node: ast.FunctionDef) -> str:
    if any(isinstance(item, ast.Name) and item.id == "property" for item in node.decorator_list):
        return node.name
    return f"{node.name}({ast.unparse(node.args).removeprefix('self').removeprefix(', ')})"


def _first(docstring: str) -> str:
    return " ".join(docstring.split("\n\n")[0].split())


def _lines() -> Iterator[str]:
    alula: Any = _module("alula")
    for name in (*OTHERS, *TYPES, *ERRORS):
        thing: Callable[..., Any] = getattr(alula, name)
        yield f"- `alula.{name}`: {_first(inspect.getdoc(thing) or '')}"


def main() -> int:
    """Write the page or check it. Returns the exit code."""
    text = page()
    if sys.argv[1:] == ["--check"]:
        return int(not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
