"""A software bill of materials in CycloneDX 1.6 JSON, for the wheels of a folder.

    python requirements/sbom.py dist

Required are the dependencies of the flight computer's install and what these require; optional is what the workbench
adds. Versions are the locked ones: what an install from the wheel gets is for pip to decide, within pyproject.toml.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tomllib
import uuid
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from licences import HERE, UNKNOWN, Locked, canonical, licence_of, locked, torch

FORMAT, VERSION = "CycloneDX", "1.6"
NAME = re.compile(r"[A-Za-z0-9._-]+")
LICENCE_ID = re.compile(r"[A-Za-z0-9.+-]+")
# Code of others in the wheel itself: (name, package that it comes from, licence).
CARRIED = (("mavlink-messages", "pymavlink", "MIT"),)


def main() -> None:
    """Write FOLDER/alula-VERSION.cdx.json."""
    folder = Path(sys.argv[1])
    path = folder / f"alula-{project()['version']}.cdx.json"
    text = json.dumps(bill(sorted(folder.glob("alula-*.whl"))), indent=1, sort_keys=True)
    path.write_text(text + "\n", encoding="utf-8")
    print(path)


def project() -> dict[str, Any]:
    """The table [project] of pyproject.toml."""
    table = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    return dict(table["project"])


def bill(wheels: Iterable[Path]) -> dict[str, Any]:
    """The bill of materials of these wheels."""
    about = project()
    entries = {canonical(item.name): item for item in (*locked("workbench"), torch())}
    required = closure(about["dependencies"], entries)
    own = f"pkg:pypi/alula@{about['version']}"
    components = [_component(entries[name], "required" if name in required else "optional") for name in sorted(entries)]
    components += [_carried(*part, entries) for part in CARRIED]
    listing = [*components, *(_file(path) for path in wheels)]
    serial = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(listing, sort_keys=True))
    return {
        "bomFormat": FORMAT,
        "specVersion": VERSION,
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application", "bom-ref": own, "name": "alula", "version": about["version"], "purl": own,
                "licenses": [{"license": {"id": about["license"]}}],
            }
        },
        "components": listing,
        "dependencies": list(_dependencies(own, about["dependencies"], entries)),
    }  # fmt: skip


def closure(requirements: Iterable[str], entries: dict[str, Locked]) -> set[str]:
    """Names of the locked packages that requirements bring, by the metadata of what is installed."""
    reached: set[str] = set()
    waiting = list(names_in(requirements))
    while waiting:
        name = waiting.pop()
        if name in entries and name not in reached:
            reached.add(name)
            waiting += names_in(_requirements(name))
    return reached


def names_in(requirements: Iterable[str]) -> Iterator[str]:
    """Names of requirements that no extra asks for."""
    for text in requirements:
        if "extra ==" not in text and (match := NAME.match(text)):
            yield canonical(match[0])


def _requirements(name: str) -> list[str]:
    try:
        return metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return []


def _reference(item: Locked) -> str:
    return f"pkg:pypi/{canonical(item.name)}@{item.version}"


def _component(item: Locked, scope: str) -> dict[str, Any]:
    reference = _reference(item)
    return {
        "type": "library", "bom-ref": reference, "name": item.name, "version": item.version, "purl": reference,
        "scope": scope, **_licences(licence_of(item.name)),
    }  # fmt: skip


def _carried(name: str, package: str, licence: str, entries: dict[str, Locked]) -> dict[str, Any]:
    item = entries[package]
    return {
        "type": "library", "bom-ref": f"{_reference(item)}#{name}", "name": name,
        "version": f"{package}-{item.version}", "scope": "required",
        "description": f"carried in the wheel, as {package} {item.version} has it",
        **_licences(licence),
    }  # fmt: skip


def _licences(expression: str) -> dict[str, Any]:
    if expression == UNKNOWN:
        return {}
    if " " in expression or expression == "any-OSI":
        name = {"expression": expression} if " " in expression else {"license": {"name": expression}}
        return {"licenses": [name]}
    return {"licenses": [{"license": {"id" if LICENCE_ID.fullmatch(expression) else "name": expression}}]}


def _file(path: Path) -> dict[str, Any]:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return {
        "type": "file", "bom-ref": path.name, "name": path.name, "hashes": [{"alg": "SHA-256", "content": digest}],
    }  # fmt: skip


def _dependencies(own: str, direct: Iterable[str], entries: dict[str, Locked]) -> Iterator[dict[str, Any]]:
    def references(names: Iterable[str]) -> list[str]:
        return sorted({_reference(entries[name]) for name in names if name in entries})

    yield {"ref": own, "dependsOn": references(names_in(direct))}
    for name, item in sorted(entries.items()):
        yield {"ref": _reference(item), "dependsOn": references(names_in(_requirements(name)))}


if __name__ == "__main__":
    main()
