"""The mapping file in which a user keeps the repairs of a log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import tomlkit
from tomlkit.items import AoT

from dynamics.decoding import editable_toml
from dynamics.errors import RequestError
from dynamics.files import write_whole
from flights.hypotheses.hypothesis import Hypothesis
from flights.mapping import read_repairs
from flights.stream_repair import StreamRepair


def write_repairs(hypotheses: Sequence[Hypothesis], path: Path, *, log: Path, mapping: Path | None = None) -> Path:
    """Write a mapping file: a mapping with the repairs of hypotheses after its own, or the repairs alone.

    log: for which they were found. mapping: the file that its columns were read by, which is left as it is.

    Raises RequestError where the file exists already, where it cannot be written, or for a mapping as `read_repairs`.
    """
    if path.exists():
        raise RequestError(f"{path} exists already, and a mapping is not written over. Give another name to --repair.")
    if mapping is None:
        document, repairs = tomlkit.document(), []
        document["name"] = path.stem
    else:
        repairs = [_table(repair) for repair in read_repairs(mapping)[1]]
        document = editable_toml(mapping.read_text(encoding="utf-8"))
        document.pop("repairs", None)
    for one in hypotheses:
        tables = [_table(repair) for repair in one.repairs]
        tables[0].comment(f"in {log.name!a}: {one.text}, {one.evidence}")
        repairs += tables
    document["repairs"] = AoT(repairs)
    text = tomlkit.dumps(document)
    return write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), advice="Give --repair another path.")


def _table(repair: StreamRepair) -> tomlkit.items.Table:
    table = tomlkit.table()
    table.update(msgspec.to_builtins(repair))
    return table
