"""A wrong field is named in the words of the file's author, not in those of the parser."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.vehicle_file import parse_vehicle, read_vehicle, vehicle_toml
from vehicles import FOLDER

PARSER_WORDS = re.compile(r"\$|Object |Expected `|`")


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    mass: Annotated[float, msgspec.Meta(gt=0)]
    count: int = 1
    axes: tuple[float, float, float] = (0.0, 0.0, 0.0)
    names: Annotated[list[str], msgspec.Meta(min_length=1)] = msgspec.field(default_factory=lambda: ["a"])
    kind: Literal["x", "y"] = "x"
    values: dict[str, float] = {}
    maybe: int | None = None


class Outer(msgspec.Struct):
    name: str
    body: Inner
    parts: list[Inner] = []


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({}, "'mass' is missing in [body]"),
        ({"mass": "heavy"}, "body.mass holds a text; wanted is a number"),
        ({"mass": -1.0}, "body.mass must be a number above 0.0"),
        ({"mass": 1.0, "count": 2.5}, "body.count holds a number; wanted is a whole number"),
        ({"mass": 1.0, "axes": [1.0]}, "body.axes holds 1; wanted is a list of 3 entries"),
        ({"mass": 1.0, "axes": [1.0, "b", 2.0]}, "body.axes[1] holds a text; wanted is a number"),
        ({"mass": 1.0, "names": []}, "body.names must be a list of at least 1 entries"),
        ({"mass": 1.0, "kind": "z"}, "body.kind is 'z', which is none of its choices"),
        ({"mass": 1.0, "values": {"a": "b"}}, "an entry of body.values holds a text; wanted is a number"),
        ({"mass": 1.0, "values": {3: 1.0}}, "a key of body.values holds a whole number; wanted is a text"),
        ({"mass": 1.0, "maybe": "b"}, "body.maybe holds a text; wanted is a whole number or nothing"),
        ({"mass": 1.0, "more": 1}, "unknown key 'more' in [body]"),
        ([], "body holds a list; wanted is a table"),
    ],
)
def test_a_wrong_field_is_named_with_what_it_holds_and_what_belongs_there(body: Any, words: str) -> None:
    with pytest.raises(msgspec.ValidationError) as caught:
        msgspec.convert({"name": "n", "body": body}, Outer)
    assert described(caught.value) == words


def test_other_errors_keep_their_words() -> None:
    assert described(ValueError("a cost of $5 - at the door.")) == "a cost of $5 - at the door"
    with pytest.raises(msgspec.ValidationError) as caught:
        msgspec.convert({}, Outer)
    assert described(caught.value) == "'name' is missing"


def _without_or_wrong(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Copies of a table: each lacks one key, or has a text, a list or a table in its place."""
    copies = []
    for key, value in table.items():
        copies.append({k: v for k, v in table.items() if k != key})
        copies += [{**table, key: wrong} for wrong in ("text", [], {}, True) if type(wrong) is not type(value)]
        if isinstance(value, dict):
            copies += [{**table, key: inner} for inner in _without_or_wrong(value)]
    return copies


def test_no_wrong_vehicle_file_speaks_in_the_words_of_the_parser() -> None:
    import tomllib

    import tomli_w

    table = tomllib.loads(vehicle_toml(read_vehicle(FOLDER / "arpl_250g.toml")))
    refused: list[str] = []
    for wrong in _without_or_wrong(table):
        try:
            parse_vehicle(tomli_w.dumps(wrong))
        except RequestError as error:
            refused.append(str(error))
    assert len(refused) > 30
    assert not [text for text in refused if PARSER_WORDS.search(text)]
