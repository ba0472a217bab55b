"""What is installed is what is locked, and the bill of materials says so."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "requirements"
EXTRAS: dict[str, tuple[str, ...]] = {
    "flight_computer": (), "workbench": ("workbench",), "development": ("workbench", "test", "lint"),
}  # fmt: skip
TORCH = "torch"


@pytest.fixture
def licences(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("licences")


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def entries(lock: str) -> dict[str, tuple[str, list[str]]]:
    """Version and hashes by name."""
    text = (FOLDER / f"{lock}.lock").read_text()
    pairs = re.findall(r"^(\S+)==(\S+)((?:.*\\\n)(?: +--hash=\S+.*\n)+)", text, re.MULTILINE)
    return {name: (version, re.findall(r"--hash=sha256:([0-9a-f]{64})\b", rest)) for name, version, rest in pairs}


CONSTRAINTS = {
    canonical(name): version
    for name, version in re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
}


@pytest.mark.parametrize("lock", list(EXTRAS))
def test_every_locked_version_has_hashes_and_is_that_of_the_constraints(lock: str) -> None:
    locked = entries(lock)
    assert len(locked) == sum(
        "==" in line for line in (FOLDER / f"{lock}.lock").read_text().splitlines() if line[0] != "#"
    )
    assert all(hashes for _, hashes in locked.values())
    wrong = {
        name: version for name, (version, _) in locked.items() if CONSTRAINTS.get(canonical(name), version) != version
    }
    assert wrong == {}


@pytest.mark.parametrize("lock", list(EXTRAS))
def test_what_is_required_is_locked(lock: str) -> None:
    """With `--no-deps` pip would not notice that something is missing."""
    tables = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = tables["project"]
    waiting = [*project["dependencies"], *(text for e in EXTRAS[lock] for text in project["optional-dependencies"][e])]
    waiting += tables["build-system"]["requires"] if EXTRAS[lock] else []  # a flight computer gets a wheel
    there, visited = {canonical(name) for name in entries(lock)} | {TORCH}, set[str]()
    while waiting:
        text = waiting.pop()
        name, extras = re.match(r"([\w.-]+)\s*(?:\[([^\]]*)\])?", text).groups()  # type: ignore[union-attr]
        if (key := canonical(name)) in visited or not _is_for_here(text):
            continue
        visited.add(key)
        assert key in there, f"{text} is not in {lock}.lock: run make licences"
        chosen = {extra.strip() for extra in (extras or "").split(",")}
        for required in metadata.requires(name) or []:
            of_extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", required)
            if of_extra is None or of_extra[1] in chosen:
                waiting.append(required)


def _is_for_here(requirement: str) -> bool:
    """Whether its package is installed here: a marker may leave it out."""
    name = re.match(r"[\w.-]+", requirement)
    assert name is not None
    try:
        metadata.version(name[0])
    except metadata.PackageNotFoundError:
        return ";" not in requirement
    return True


def test_the_make_file_installs_by_hash_without_resolving() -> None:
    text = (ROOT / "Makefile").read_text()
    assert re.search(r"^LOCKED := .*--require-hashes --no-deps", text, re.MULTILINE)
    recipe = text[text.index(".venv/workbench.stamp:") : text.index(".venv/docs.stamp:")]
    installs = [line for line in recipe.splitlines() if "$(PIP)" in line or "$(LOCKED)" in line]
    unlocked = [line for line in installs if "$(LOCKED)" not in line and "--no-deps --no-build-isolation" not in line]
    assert len(installs) == 4
    assert len(unlocked) == 1
    assert re.search(r"--constraint constraints.txt torch==[\d.]+$", unlocked[0])  # see docs/supply_chain.md


def test_every_licence_is_known_or_of_a_package_that_is_not_here(licences: ModuleType) -> None:
    unknown = [item.name for item in licences.locked("development") if item.licence == licences.UNKNOWN]
    assert unknown == []


def test_the_bill_of_materials_has_cyclonedx_shape(tmp_path: Path) -> None:
    wheel = tmp_path / "alula-0.1.0-py3-none-any.whl"
    wheel.write_bytes(b"wheel")
    command = [sys.executable, "requirements/sbom.py", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = tmp_path.glob("*.cdx.json")
    bill = json.loads(path.read_text())
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f-]{36}", bill["serialNumber"])
    root = bill["metadata"]["component"]
    components = bill["components"]
    references = [root["bom-ref"], *(component["bom-ref"] for component in components)]
    assert len(set(references)) == len(references)
    for component in components:
        assert component["type"] in ("library", "file")
        assert component["name"]
        if component["type"] == "library":
            assert component["version"]
            for licence in component.get("licenses", []):
                assert set(licence) in ({"license"}, {"expression"})
    for dependency in bill["dependencies"]:
        assert {dependency["ref"], *dependency["dependsOn"]} <= set(references)
    (file,) = (component for component in components if component["type"] == "file")
    assert file["name"] == wheel.name
    scopes = {component["name"]: component.get("scope") for component in components}
    assert scopes["numpy"] == scopes["msgspec"] == scopes["mavlink-messages"] == "required"
    assert scopes["torch"] == scopes["casadi"] == "optional"
    assert not {"pytest", "hpipm", "blasfeo"} & set(scopes)


def test_what_builds_a_wheel_is_locked_as_for_the_workbench() -> None:
    required = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert set(entries("build")) == {re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in required}
    assert entries("build").items() <= entries("workbench").items()


def test_a_flight_computer_gets_the_workbenchs_versions_and_less() -> None:
    assert entries("flight_computer").items() < entries("workbench").items()
