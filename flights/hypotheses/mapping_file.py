"""The mapping file in which a user keeps the repairs of a log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dynamics.errors import RequestError
from dynamics.files import write_whole
from flights.hypotheses.hypothesis import Hypothesis


def write_repairs(hypotheses: Sequence[Hypothesis], path: Path, *, log: Path, mapping: Path | None = None) -> Path:
    """Write a mapping file: a mapping with the repairs of hypotheses after its own lines, or the repairs alone.

    log: for which they were found. mapping: the file that its columns were read by, which is left as it is.

    Raises RequestError where the file exists already or cannot be written.
    """
    if path.exists():
        raise RequestError(f"{path} exists already, and a mapping is not written over. Give another name to --repair.")
    head = f'name = "{path.stem}"\n' if mapping is None else mapping.read_text(encoding="utf-8").rstrip() + "\n"
    blocks = [f"# {one.text}\n# {one.evidence}\n" + "\n\n".join(map(str, one.repairs)) for one in hypotheses]
    text = (
        "\n".join([head, f"# found in {log.name}, each as the ones before it leave the log", "\n\n".join(blocks)])
        + "\n"
    )
    return write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), advice="Give --repair another path.")
