"""A network of another tool is called that, and not a damaged checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from dynamics.errors import RequestError
from training.checkpoint import load


class Residual(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(torch.nn.Linear(13, 8), torch.nn.BatchNorm1d(8), torch.nn.Linear(8, 3))

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return self.layers(state)


@pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")
def test_a_torch_script_is_named(tmp_path: Path) -> None:
    path = tmp_path / "scripted.pt"
    torch.jit.save(torch.jit.trace(Residual().eval(), torch.zeros(1, 13)), str(path))
    with pytest.raises(RequestError, match=r"a TorchScript network of another tool. Only networks that `alula train`"):
        load(path)


def test_weights_alone_are_named(tmp_path: Path) -> None:
    path = tmp_path / "state_dict.pt"
    torch.save(Residual().state_dict(), path)
    with pytest.raises(RequestError, match="the weights of a torch module alone"):
        load(path)


@pytest.mark.parametrize("head", [b"\x08\x0a\x12\x07pytorch\x1a\x052.4.0", b"\x08\x08:\x80\x02\x0a\x0c"])
def test_an_onnx_file_is_named(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "residual.onnx"
    path.write_bytes(head + bytes(64))
    with pytest.raises(RequestError, match="an ONNX network of another tool"):
        load(path)


def test_a_damaged_checkpoint_is_still_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    path.write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(RequestError, match="or a damaged one"):
        load(path)


def test_an_archive_whose_directory_is_damaged_is_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    torch.save({"format": "x"}, path)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"data.pkl", b"data\xffpkl"))  # a name that is no UTF-8
    with pytest.raises(RequestError, match="or a damaged one"):
        load(path)
