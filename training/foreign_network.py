"""Networks of other tools, told from a damaged checkpoint by their content."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

_ONNX_FIELD = b"\x08"  # a ModelProto begins with its ir_version, field 1 as a varint
_MAX_IR_VERSION = 32  # far above today's 10 to 13
_SCRIPT = "constants.pkl"  # of an archive of torch.jit.save
ONLY_OURS = (
    "Only networks that `alula train` wrote can be flown: scaling, inputs, history and vehicle are kept beside the "
    "weights. Train the architecture by `alula train` on the same flights."
)


def kind_of_file(path: Path) -> str:
    """Name of another tool's kind of network, for people; empty for a file that is none."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
        if (
            head.startswith(_ONNX_FIELD)
            and len(head) > 2
            and head[1] < _MAX_IR_VERSION
            and head[2:3] in (b"\x12", b":")
        ):
            return "an ONNX network"
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                if any(Path(name).name == _SCRIPT for name in archive.namelist()):
                    return "a TorchScript network"
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):  # what a zip's damaged directory raises
        return ""
    return ""


def is_state_dict(content: Mapping[str, Any]) -> bool:
    """Whether a dictionary is the weights of a torch module and nothing else."""
    return bool(content) and all(isinstance(value, torch.Tensor) for value in content.values())
