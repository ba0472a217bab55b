"""Licences of everything that the locks name, as SPDX expressions, from the metadata of what is installed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
ENTRY = re.compile(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)(?: ; ([^\\]+?))? \\$", re.MULTILINE)
CLASSIFIERS = {
    "MIT License": "MIT",
    "BSD License": "BSD-3-Clause",
    "Apache Software License": "Apache-2.0",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0-only",
    "ISC License (ISCL)": "ISC",
    "Python Software Foundation License": "PSF-2.0",
}
TEXTS = {
    "MIT": "MIT", "MIT License": "MIT", "The MIT License (MIT)": "MIT", "BSD-3-Clause": "BSD-3-Clause",
    "BSD 3-Clause License": "BSD-3-Clause", "3-Clause BSD License": "BSD-3-Clause", "BSD": "BSD-3-Clause",
    "BSD-2-Clause": "BSD-2-Clause", "BSD 2-Clause License": "BSD-2-Clause", "Apache-2.0": "Apache-2.0",
    "MPL-2.0 AND MIT": "MPL-2.0 AND MIT", "MIT OR AFL-2.1": "MIT OR AFL-2.1", "MPL-2.0": "MPL-2.0",
}  # fmt: skip
# Where the metadata names none, or none that SPDX knows: read in the licence file that the package brings.
READ = {
    "apsw": "any-OSI",
    "axe-playwright-python": "MIT",
    "casadi": "LGPL-3.0-or-later",
    "colorama": "BSD-3-Clause",
    "cvxopt": "GPL-3.0-or-later",
    "stoppy": "MIT",
    "timed-count": "MIT",
}
UNKNOWN = "NOASSERTION"


@dataclass(frozen=True)
class Locked:
    """A requirement of a lock. marker: where it is installed, empty for everywhere. licence: an SPDX expression."""

    name: str
    version: str
    marker: str
    licence: str


def locked(name: str) -> tuple[Locked, ...]:
    """The requirements of a lock."""
    entries = ENTRY.findall((HERE / f"{name}.lock").read_text(encoding="utf-8"))
    return tuple(Locked(package, version, marker, licence_of(package)) for package, version, marker in entries)


def torch() -> Locked:
    """torch, which no lock has: the version that constraints.txt pins."""
    text = (HERE.parent / "constraints.txt").read_text(encoding="utf-8")
    match = re.search(r"^torch==(\S+)$", text, re.MULTILINE)
    assert match is not None
    return Locked("torch", match[1], "", licence_of("torch"))


def canonical(name: str) -> str:
    """A package's name as indexes normalise it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def licence_of(package: str) -> str:
    """The licence of a package, NOASSERTION where nothing says it."""
    name = canonical(package)
    if name in READ:
        return READ[name]
    try:
        fields = metadata.metadata(package)
    except metadata.PackageNotFoundError:
        return UNKNOWN
    if expression := fields.get("License-Expression"):
        return str(expression)
    if (text := (fields.get("License") or "").strip().partition("\n")[0].strip()) in TEXTS:
        return TEXTS[text]
    endings = [str(line).rpartition(" :: ")[2] for line in fields.get_all("Classifier") or []]
    return next((CLASSIFIERS[ending] for ending in endings if ending in CLASSIFIERS), UNKNOWN)
