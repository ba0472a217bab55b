"""Training on several processes at once, as torchrun starts them: each takes its share of every batch."""

from __future__ import annotations

import os

import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

from dynamics.errors import RequestError


def join_group(device: torch.device) -> tuple[int, int]:
    """(rank, number of processes); joins the others when torchrun has started this process, else (0, 1)."""
    if "WORLD_SIZE" not in os.environ or int(os.environ["WORLD_SIZE"]) < 2:
        return 0, 1
    if not distributed.is_initialized():
        distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    return distributed.get_rank(), distributed.get_world_size()


def leave_group() -> None:
    """Leave the group that `join_group` joined."""
    if distributed.is_initialized():
        distributed.destroy_process_group()


def wait_for_all() -> None:
    """Block until every process has called this."""
    if distributed.is_initialized():
        distributed.barrier()


def shared(network: nn.Module, size: int) -> nn.Module:
    """The network with its gradients averaged over all processes."""
    return DistributedDataParallel(network) if size > 1 else network


def find_device(name: str) -> torch.device:
    """The device of a name: cpu, cuda, cuda:1; under torchrun "cuda" is each process's own.

    Raises RequestError when this machine has none such.
    """
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise RequestError(f"unknown device {name!r}. Give cpu, cuda or cuda:0.") from error
    if device.type not in ("cpu", "cuda"):
        raise RequestError(f"--device {name}: networks train on a CPU or a CUDA GPU. Give cpu, cuda or cuda:0.")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise RequestError(f"--device {name}: torch finds no GPU. Give --device cpu, or install torch with CUDA.")
    if device.index is not None and device.type == "cuda" and device.index >= torch.cuda.device_count():
        raise RequestError(f"--device {name}: this machine has {torch.cuda.device_count()} GPUs, numbered from 0.")
    if name == "cuda":
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
    return device
