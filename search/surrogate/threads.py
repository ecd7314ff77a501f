"""One thread for numerics: results to the last bit must not depend on how many cores a machine has to spare."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _controller(torch_loaded: bool) -> ThreadpoolController:  # a cache key: torch brings libraries of its own
    del torch_loaded
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread inside the block, as before outside it."""
    with _controller(False).limit(limits=1):
        yield


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """The same with torch, which counts its threads itself."""
    import torch  # noqa: PLC0415  # two seconds that only the strategies on BoTorch should pay

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with _controller(True).limit(limits=1):
            yield
    finally:
        torch.set_num_threads(before)
