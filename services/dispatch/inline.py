"""Runs trials one after the other in the caller's own thread: no Ray, no processes, a debugger steps right in."""

from __future__ import annotations

import contextlib
import time
from collections import deque

from services.artifacts.port import ArtifactStore
from services.dispatch.port import Assignment, Deliver, Message
from services.dispatch.runtime import Attempt
from services.errors import StorageUnavailable

IDLE_SECONDS = 0.02
"""How long a poll with nothing to run waits, so that a caller in a loop doesn't spin."""


class InlineDispatcher:
    """The `Dispatcher` without workers. A trial runs inside `poll`, and its messages are delivered as they arise."""

    def __init__(self, artifacts: ArtifactStore, pools: dict[str, int] | None = None) -> None:
        self._artifacts = artifacts
        self._pools = dict(pools or {"default": 1})
        self._waiting: deque[Assignment] = deque()
        self._running: Attempt | None = None
        self._stopped: set[int] = set()

    def pools(self) -> dict[str, int]:
        return dict(self._pools)

    def rooms(self, pool: str) -> dict[str, float]:
        taken = sum(assignment.cpus for assignment in self._waiting if assignment.pool == pool)
        return {"inline": self._pools.get(pool, 0) - taken}

    def sizes(self, pool: str) -> dict[str, float]:
        return {"inline": self._pools[pool]} if self._pools.get(pool) else {}

    def where(self, attempt: int) -> str | None:
        running = [] if self._running is None else [self._running.assignment]
        return "inline" if any(each.attempt == attempt for each in [*running, *self._waiting]) else None

    def open(self, study_key: str, task: str) -> None:
        """The code is in this process already."""

    def start(self, assignment: Assignment) -> str:
        self._waiting.append(assignment)
        return "inline"

    def stop(self, attempt: int) -> None:
        if self._running is not None and self._running.assignment.attempt == attempt:
            self._running.stop()
        else:
            self._stopped.add(attempt)

    def kill(self, attempt: int) -> None:
        self._waiting = deque(waiting for waiting in self._waiting if waiting.attempt != attempt)
        self.stop(attempt)

    def poll(self, deliver: Deliver, timeout: float) -> None:
        if not self._waiting:
            time.sleep(min(timeout, IDLE_SECONDS))
            return
        assignment = self._waiting.popleft()

        def send(message: Message) -> None:
            deliver([message])

        self._running = Attempt(assignment, self._artifacts, send, beats=False)
        if assignment.attempt in self._stopped:
            self._stopped.discard(assignment.attempt)
            self._running.stop()
        try:
            self._running.run()
        finally:
            self._running = None

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        with contextlib.suppress(StorageUnavailable):  # `halma gc` will find them
            self._artifacts.drop_checkpoints(study_key, trial)

    def close(self) -> None:
        self._waiting.clear()
