"""Answers that many people ask for, worked out once for all of them.

A hundred people who watch one study ask for the same parts of it. An answer is kept as the bytes that were sent,
together with the state of the record that it was made from: the database's history and its newest event. Every
request looks at the record first. An answer made from that very state is given again, one that is being made from it
is waited for, and anything else is made anew: so an answer holds everything that was committed before it was asked
for, and is never older than the event that made somebody ask.

Who may ask is decided before, for each request (`services.api.guard`).
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import pydantic_core
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.store.port import Store

MOST_BYTES = 16 * 2**20
"""Of all answers that are kept. All trials of a study of 50,000 are 11 MB."""

MOST_ANSWERS = 500
"""That are kept: of small ones (a pulse holds for a second) what is around them would take more room than they do."""

Revision = tuple[str, int]
"""Identity of the database's history, and its newest event."""


@dataclass(frozen=True, slots=True)
class _Kept:
    revision: Revision
    body: bytes


class Answers:
    """The answers last given. Belongs to one event loop, like the sockets.

    Args:
        store: the trial database.
        most_bytes: that are kept; of two questions the one not asked for longer is forgotten first.
    """

    def __init__(self, store: Store, *, most_bytes: int = MOST_BYTES) -> None:
        self._store = store
        self._most_bytes = most_bytes
        self._kept: OrderedDict[Hashable, _Kept] = OrderedDict()
        self._bytes = 0
        self._coming: dict[tuple[Revision, Hashable], asyncio.Task[bytes]] = {}

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        return self._bytes

    async def json(self, question: Hashable, work: Callable[[], BaseModel]) -> Response:
        """The answer to a question, as JSON.

        Args:
            question: all that the answer depends on besides the record.
            work: reads the record and makes the answer; runs in a thread. What it raises is raised to all who wait
                for it, and not kept.
        """
        revision = await run_in_threadpool(self._revision)
        known = self._kept.get(question)
        if known is not None and known.revision == revision:
            self._kept.move_to_end(question)
            return _response(known.body)
        key = (revision, question)
        task = self._coming.get(key)
        if task is None or task.get_loop() is not asyncio.get_running_loop():
            task = self._coming[key] = asyncio.create_task(self._make(key, work))
        # Whoever asked first may leave before the answer is there; the others still want it.
        return _response(await asyncio.shield(task))

    async def _make(self, key: tuple[Revision, Hashable], work: Callable[[], BaseModel]) -> bytes:
        revision, question = key
        try:
            body = await run_in_threadpool(lambda: pydantic_core.to_json(work()))
        finally:
            self._coming.pop(key, None)
        self._keep(question, _Kept(revision, body))
        return body

    def _revision(self) -> Revision:
        # The event last: what is committed after this line is not promised, what was before is.
        return self._store.history_id(), self._store.last_event()

    def _keep(self, question: Hashable, made: _Kept) -> None:
        old = self._kept.get(question)
        if old is not None and old.revision[0] == made.revision[0] and old.revision[1] > made.revision[1]:
            return
        self._forget(question)
        if len(made.body) > self._most_bytes:
            return
        self._kept[question] = made
        self._bytes += len(made.body)
        while self._bytes > self._most_bytes or len(self._kept) > MOST_ANSWERS:
            self._forget(next(iter(self._kept)))

    def _forget(self, question: Hashable) -> None:
        old = self._kept.pop(question, None)
        if old is not None:
            self._bytes -= len(old.body)


def _response(body: bytes) -> Response:
    return Response(body, media_type="application/json")
