"""The processes that train together: one, or as many as torchrun started.

Each renders and detects its share of every batch; what travels is the gradient of the colours, L x 3 floats a step.
"""

import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor
from torch.distributed.rendezvous import rendezvous

from cloak_core.core.surroundings import usable_device
from cloak_core.files.errors import InputError

TIMEOUT = timedelta(minutes=10)
"""Silence after which a process counts as dead; one that ends is noticed at once."""
T = TypeVar("T")


class LostProcess(Exception):
    """Another process of this run ended or fell silent."""


@dataclass(frozen=True)
class World:
    """This process among `size`; rank 0 writes the run folder."""

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def sum(self, tensor: Tensor) -> Tensor:
        """Sum over all processes, in place."""
        if self.size > 1:
            with _noticing():
                dist.all_reduce(tensor)
        return tensor

    def agree(self, reason: str, device: torch.device) -> str:
        """Agree on the first non-empty `reason` among the processes; "" when all are empty."""
        if self.size == 1:
            return reason
        flag = torch.tensor([float(bool(reason))], device=device)
        return (reason or "stopped elsewhere") if self.sum(flag).item() else ""

    def on_rank0(self, work: Callable[[], T]) -> T | None:
        """Do `work` on rank 0; an InputError of it is raised everywhere, with the same message."""
        if self.size == 1:
            return work()
        result = None
        message = ""
        if self.is_first:
            try:
                result = work()
            except InputError as error:
                message = str(error) or "bad input"
        message = self.broadcast(message.encode()).decode()
        if message:
            raise InputError(message)
        return result

    def broadcast(self, data: bytes) -> bytes:
        """Send rank 0's bytes everywhere."""
        if self.size == 1:
            return data
        device = torch.device("cuda", torch.cuda.current_device()) if dist.get_backend() == "nccl" else "cpu"
        with _noticing():
            length = torch.tensor([len(data)], device=device)
            dist.broadcast(length, 0)
            buffer = torch.zeros(int(length), dtype=torch.uint8, device=device)
            if self.is_first and data:
                buffer.copy_(torch.frombuffer(bytearray(data), dtype=torch.uint8))
            dist.broadcast(buffer, 0)
        return buffer.cpu().numpy().tobytes()


ALONE = World()


@contextlib.contextmanager
def join_world(device: torch.device, alone: bool = False) -> Iterator[World]:
    """Join the world that torchrun describes in the environment; a world of one without it, or `alone`."""
    size = 1 if alone else int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        yield ALONE
        return
    if device.type == "cuda":
        torch.cuda.set_device(device)
    store, rank, size = next(rendezvous("env://", timeout=TIMEOUT))
    # After torchrun's restart its store may still hold the addresses of the processes that are gone.
    store = dist.PrefixStore(f"start {os.environ.get('TORCHELASTIC_RESTART_COUNT', '0')}", store)
    backend = "nccl" if device.type == "cuda" else "gloo"
    dist.init_process_group(backend, store=store, rank=rank, world_size=size, timeout=TIMEOUT)
    try:
        yield World(dist.get_rank(), dist.get_world_size())
    finally:
        with contextlib.suppress(RuntimeError):  # a group that lost a member may refuse to be taken apart
            dist.destroy_process_group()


def local_device(name: str) -> torch.device:
    """Find the device of this process: under torchrun "cuda" is the GPU of its local rank.

    InputError: there is none.
    """
    rank = os.environ.get("LOCAL_RANK")
    return usable_device(f"cuda:{rank}" if name == "cuda" and rank else name)


@contextlib.contextmanager
def _noticing() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        raise LostProcess(str(error).splitlines()[0]) from None
