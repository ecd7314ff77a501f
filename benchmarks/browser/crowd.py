"""A hundred people who have a study's page open, without a hundred browsers."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable, Sequence

import httpx
import websockets

from benchmarks.browser.servers import TOKEN, Server

HEADERS = {"authorization": f"Bearer {TOKEN}"}


async def _repeat(work: Callable[[], None], rate: float, seconds: float) -> None:
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        work()
        await asyncio.sleep(1 / rate)


async def watched(
    server: Server,
    *,
    listen: str,
    opening: Sequence[str],
    asked: Sequence[tuple[float, str]],
    span: float,
    count: int,
    write: Callable[[], None],
    rate: float,
    seconds: float,
) -> tuple[float, int, int]:
    """CPU share of the server while so many watch it, the frames they got, and the requests they made.

    Args:
        server: the server.
        listen: path of the events' socket.
        opening: what one page asked for when it was opened; each viewer asks for it once, before the measurement, so
            that the memory which it takes counts.
        asked: what one page asked for by itself in `span` seconds; each viewer does the same over and over, beginning
            at a moment of its own.
        span: how long that was watched.
        count: viewers.
        write: one more trial, begun and ended.
        rate: trials a second.
        seconds: how long is measured.
    """
    frames = requests = 0

    async def hear() -> None:
        nonlocal frames
        address = server.url.replace("http", "ws") + listen
        async with websockets.connect(address, additional_headers=HEADERS, compression=None) as opened:
            async for _ in opened:
                frames += 1

    async def ask(client: httpx.AsyncClient, phase: float) -> None:
        nonlocal requests
        start = time.perf_counter()
        lap = -phase
        while asked:
            for offset, path in asked:
                await asyncio.sleep(max(0.0, start + lap + offset - time.perf_counter()))
                if lap + offset >= 0:
                    (await client.get(server.url + path, headers=HEADERS)).raise_for_status()
                    requests += 1
            lap += span

    async def open_page(client: httpx.AsyncClient) -> None:
        for path in opening:
            (await client.get(server.url + path, headers=HEADERS)).raise_for_status()

    phases = random.Random(1)
    async with httpx.AsyncClient(timeout=60) as client:
        await asyncio.gather(*(open_page(client) for _ in range(count)))
        tasks = [asyncio.create_task(hear()) for _ in range(count)]
        tasks += [asyncio.create_task(ask(client, phases.uniform(0, span))) for _ in range(count)]
        await asyncio.sleep(3)
        frames = requests = 0
        before, start = server.cpu_seconds(), time.perf_counter()
        await _repeat(write, rate, seconds)
        share = (server.cpu_seconds() - before) / (time.perf_counter() - start)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return share, frames, requests


async def polled(
    server: Server,
    *,
    path: Callable[[], str],
    every: float,
    count: int,
    write: Callable[[], None],
    rate: float,
    seconds: float,
) -> tuple[float, int]:
    """CPU share of a server that is polled by so many viewers, each once in `every` seconds, and their requests."""
    requests = 0

    async def poll(client: httpx.AsyncClient, phase: float) -> None:
        nonlocal requests
        await asyncio.sleep(phase)
        while True:
            began = time.perf_counter()
            await client.get(server.url + path())
            requests += 1
            await asyncio.sleep(max(0.0, every - (time.perf_counter() - began)))

    phases = random.Random(1)
    async with httpx.AsyncClient(timeout=120) as client:
        tasks = [asyncio.create_task(poll(client, phases.uniform(0, every))) for _ in range(count)]
        await asyncio.sleep(3)
        requests = 0
        before, start = server.cpu_seconds(), time.perf_counter()
        await _repeat(write, rate, seconds)
        share = (server.cpu_seconds() - before) / (time.perf_counter() - start)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return share, requests
