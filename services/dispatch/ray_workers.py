"""Runs trials in Ray worker processes: one long-lived actor a slot, messages back to the coordinator's mailbox.

Text goes over the wire (see `services.dispatch.port`); Ray only carries it. A worker process is kept between trials
because importing the physics and torch costs seconds; it is ended when a trial is ended by force.
"""

from __future__ import annotations

import os
import queue
import sys
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import ray

from services.artifacts import open_artifacts
from services.dispatch.port import (
    Assignment,
    Deliver,
    Message,
    Vanished,
    decode,
    decode_assignment,
    encode,
    encode_assignment,
)
from services.dispatch.runtime import Attempt

Mailbox = Any
"""An actor handle with a method `receive(text)`."""

BATCH = 256
"""At most so many messages share a commit, so that a flood doesn't hold the write lock for long."""


def pool_resource(pool: str) -> str:
    """Name of the Ray resource that marks the nodes of a pool; the default pool takes any node."""
    return f"pool:{pool}"


class Worker:
    """A worker process, as a Ray actor. One attempt at a time; `stop` gets through while it runs.

    Args:
        artifact_root: where trials leave their files.
        directory: the submitter's working directory: users' own task modules are found there.
        mailbox: who is told.
    """

    def __init__(self, artifact_root: str, directory: str, mailbox: Mailbox) -> None:
        if directory not in sys.path:
            sys.path.insert(0, directory)
        self._artifacts = open_artifacts(artifact_root)
        self._mailbox = mailbox
        self._running: Attempt | None = None
        self._stopped: int | None = None

    def ready(self) -> int:
        """The process id, once the process is up."""
        return os.getpid()

    def run(self, text: str) -> None:
        """Run an attempt to its end; all that is to be known goes to the mailbox."""
        assignment = decode_assignment(text)
        self._running = Attempt(assignment, self._artifacts, self._send)
        if self._stopped == assignment.attempt:
            self._running.stop()
        try:
            self._running.run()
        finally:
            self._running = None

    def stop(self, attempt: int) -> None:
        """Ask the attempt to stop at its next checkpoint, also where `run` has not been reached yet."""
        self._stopped = attempt
        running = self._running
        if running is not None and running.assignment.attempt == attempt:
            running.stop()

    def _send(self, message: Message) -> None:
        self._mailbox.receive.remote(encode(message))


@dataclass(slots=True)
class _Slot:
    """A worker actor and what it holds."""

    actor: Any
    pool: str
    cpus: float
    assignment: Assignment | None = None


@dataclass(slots=True)
class RayDispatcher:
    """The `Dispatcher` on a Ray cluster.

    Args:
        artifact_root: where trials leave their files, as the workers reach it.
        directory: the submitter's working directory.
        sizes: cores of each pool.
        mailbox: actor handle whose `receive` ends in `put`.
    """

    artifact_root: str
    directory: str
    sizes: dict[str, int]
    mailbox: Mailbox
    _inbox: queue.SimpleQueue[Message | None] = field(default_factory=queue.SimpleQueue)
    _busy: dict[int, _Slot] = field(default_factory=dict)
    _idle: dict[tuple[str, float], list[_Slot]] = field(default_factory=lambda: defaultdict(list))

    def put(self, text: str) -> None:
        """A message has arrived. Called from the mailbox's thread."""
        self._inbox.put(decode(text))

    def wake(self) -> None:
        """Make a waiting `poll` return: something else has become ready."""
        self._inbox.put(None)

    def pools(self) -> dict[str, int]:
        return dict(self.sizes)

    def free(self, pool: str) -> float:
        return self.sizes.get(pool, 0) - sum(slot.cpus for slot in self._busy.values() if slot.pool == pool)

    def start(self, assignment: Assignment) -> str:
        slot = self._slot(assignment.pool, assignment.cpus)
        slot.assignment = assignment
        self._busy[assignment.attempt] = slot
        reference = slot.actor.run.remote(encode_assignment(assignment))
        reference.future().add_done_callback(self._when_over(assignment))
        return assignment.pool

    def _slot(self, pool: str, cpus: float) -> _Slot:
        idle = self._idle[pool, cpus]
        if idle:
            return idle.pop()
        # Idle workers of another shape hold cores that this one needs.
        for shape, slots in self._idle.items():
            while shape[0] == pool and slots:
                ray.kill(slots.pop().actor)
        resources = {} if pool == "default" else {pool_resource(pool): cpus}
        # Two threads, so that `stop` gets through while `run` runs.
        shaped = ray.remote(Worker).options(
            num_cpus=cpus, resources=resources, max_concurrency=2, max_restarts=0, max_task_retries=0
        )
        actor = shaped.remote(self.artifact_root, self.directory, self.mailbox)
        return _Slot(actor, pool, cpus)

    def _when_over(self, assignment: Assignment) -> Callable[[Future[None]], None]:
        """`run` says everything by messages; only its failure to return says something more: the process is gone."""

        def over(future: Future[None]) -> None:
            error = future.exception()
            if error is not None:
                reason = f"its worker process ended ({type(error).__name__})"
                self._inbox.put(Vanished(assignment.attempt, assignment.token, reason))
            else:
                self._inbox.put(None)

        return over

    def stop(self, attempt: int) -> None:
        slot = self._busy.get(attempt)
        if slot is not None:
            slot.actor.stop.remote(attempt)

    def kill(self, attempt: int) -> None:
        slot = self._busy.pop(attempt, None)
        if slot is not None:
            ray.kill(slot.actor)

    def poll(self, deliver: Deliver, timeout: float) -> None:
        messages = self._take(timeout)
        if not messages:
            return
        # The slots are free only after delivery: the commit comes first, the next assignment after it.
        deliver(messages)
        for message in messages:
            self._note_end(message)

    def _take(self, timeout: float) -> list[Message]:
        messages: list[Message] = []
        try:
            first = self._inbox.get(timeout=timeout)
        except queue.Empty:
            return messages
        if first is not None:
            messages.append(first)
        while len(messages) < BATCH:
            try:
                more = self._inbox.get_nowait()
            except queue.Empty:
                break
            if more is not None:
                messages.append(more)
        return messages

    def _note_end(self, message: Message) -> None:
        kind = type(message).__name__
        if kind not in {"Ended", "Stopped", "Crashed", "Vanished"}:
            return
        slot = self._busy.get(message.attempt)
        if slot is None or slot.assignment is None or slot.assignment.token != message.token:
            return
        del self._busy[message.attempt]
        slot.assignment = None
        if kind != "Vanished":
            self._idle[slot.pool, slot.cpus].append(slot)

    def close(self) -> None:
        for slot in [*self._busy.values(), *(slot for slots in self._idle.values() for slot in slots)]:
            ray.kill(slot.actor)
        self._busy.clear()
        self._idle.clear()
