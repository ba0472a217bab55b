"""Texts of unknown origin as data: TOML and JSON, each with one kind of error whatever is wrong with the text.

The libraries below raise further ones that nothing documents: for a number of more digits than Python converts, for
brackets that nest deeper than the stack, for bytes that are no UTF-8. Everything that reads a file, a recording or a
message goes through here.
"""

from __future__ import annotations

import tomllib
from typing import Any, TypeVar, overload

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError

Kind = TypeVar("Kind")
TOO_DEEP = "brackets nest too deeply"


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text. Raises tomllib.TOMLDecodeError and nothing else."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError(TOO_DEEP) from None
    except (ValueError, OverflowError) as error:
        raise tomllib.TOMLDecodeError(str(error)) from None


def parse_toml_bytes(content: bytes) -> dict[str, Any]:
    """The table of a TOML file. Raises tomllib.TOMLDecodeError, also for one that is not UTF-8."""
    try:
        return parse_toml(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise tomllib.TOMLDecodeError(str(error)) from None


def editable_toml(text: str) -> tomlkit.TOMLDocument:
    """The document of a TOML text, with its layout and comments. Raises tomllib.TOMLDecodeError and nothing else.

    What `parse_toml` refuses is refused first: that parser is the one that decides what a file says.
    """
    parse_toml(text)
    try:
        return tomlkit.parse(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError(TOO_DEEP) from None
    except (TOMLKitError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise tomllib.TOMLDecodeError(str(error)) from None


@overload
def decode_json(content: bytes | str) -> Any: ...
@overload
def decode_json(content: bytes | str, kind: type[Kind]) -> Kind: ...
def decode_json(content: bytes | str, kind: Any = Any) -> Any:
    """The value of a JSON text, of a kind. Raises msgspec.MsgspecError and nothing else."""
    try:
        return msgspec.json.decode(content, type=kind)
    except RecursionError:
        raise msgspec.DecodeError(TOO_DEEP) from None
    except (UnicodeError, ValueError, OverflowError) as error:  # a struct's own check is a ValidationError already
        if isinstance(error, msgspec.MsgspecError):
            raise
        raise msgspec.DecodeError(str(error)) from None
