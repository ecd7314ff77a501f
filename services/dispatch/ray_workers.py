"""Runs trials in Ray worker processes: one long-lived actor a slot, messages back to the coordinator's mailbox.

Text goes over the wire (see `services.dispatch.port`); Ray only carries it. A worker process is kept between trials
because importing the physics and torch costs seconds; it is ended when a trial is ended by force. The coordinator
decides which host a worker runs on, so that it knows what fits; hosts may join and leave (`services.dispatch.hosts`).
"""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from services.artifacts.open import open_artifacts
from services.dispatch.hosts import DEFAULT_POOL, Hosts, best_fit, pool_resource
from services.dispatch.port import (
    Assignment,
    Began,
    Deliver,
    Message,
    Stopped,
    Vanished,
    decode,
    decode_assignment,
    encode,
    encode_assignment,
)
from services.dispatch.relay import Keeper, artifacts_here, start_keeper
from services.dispatch.runtime import Attempt
from services.dispatch.sweeper import Sweeper
from services.shipping import Bundle, collect, unpack

Mailbox = Any
"""An actor handle with a method `receive(texts)`."""

BATCH = 256
"""At most so many messages share a commit, so that a flood doesn't hold the write lock for long."""


BEGAN_SECONDS = 0.05
"""So long the news that an attempt has been taken up waits for company: of a short training one message tells all."""


class Outbox:
    """Sends messages to the mailbox, in order; each costs both sides more than most of what it says.

    Args:
        mailbox: who is told.
    """

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox
        self._held: list[str] = []
        self._lock = threading.Lock()

    def send(self, message: Message) -> None:
        """Send it now, or `Began` with what comes next. From any thread."""
        with self._lock:
            self._held.append(encode(message))
            if not isinstance(message, Began):
                self._flush()
                return
        later = threading.Timer(BEGAN_SECONDS, self.flush)
        later.daemon = True
        later.start()

    def flush(self) -> None:
        """Send what is held back."""
        with self._lock:
            self._flush()

    def _flush(self) -> None:
        held, self._held = self._held, []
        if held:
            self._mailbox.receive.remote(held)


class Worker:
    """A worker process, as a Ray actor. One attempt at a time; `stop` gets through while it runs.

    Args:
        artifact_root: where trials leave their files, as the head calls it.
        identity: of that root.
        keeper: carries files to the head for a worker on another host; None on the head's own.
        code: users' own task modules, for a worker on another host.
        directory: the submitter's working directory, where a worker on the head's host finds them.
        mailbox: who is told.
    """

    def __init__(
        self,
        artifact_root: str,
        identity: str,
        keeper: Keeper | None,
        code: tuple[str, bytes] | None,
        directory: str,
        mailbox: Mailbox,
    ) -> None:
        places = [directory] if keeper is None else [str(unpack(Bundle(*code)))] if code is not None else []
        sys.path[:0] = [place for place in places if place not in sys.path]
        self._artifacts = artifacts_here(artifact_root, identity, keeper)
        self._outbox = Outbox(mailbox)
        self._running: Attempt | None = None
        self._stopped: int | None = None

    def ready(self) -> int:
        """The process id, once the process is up."""
        return os.getpid()

    def run(self, text: str) -> None:
        """Run an attempt to its end; all that is to be known goes to the mailbox."""
        assignment = decode_assignment(text)
        attempt = self._running = Attempt(assignment, self._artifacts, self._outbox.send)
        if self._stopped == assignment.attempt:
            attempt.stop()
        try:
            attempt.run()
        finally:
            # Its end has been told, so the next one may have begun in the other thread.
            if self._running is attempt:
                self._running = None

    def stop(self, attempt: int) -> None:
        """Ask the attempt to stop at its next checkpoint, also where `run` has not been reached yet."""
        self._stopped = attempt
        running = self._running
        if running is not None and running.assignment.attempt == attempt:
            running.stop()


@cache
def _remote_worker() -> Any:
    """The actor class. Made once: Ray reads the class through, for a third of a second, each time that it is made."""
    return ray.remote(Worker)


@dataclass(frozen=True, slots=True)
class _Shape:
    """What makes one worker process as good as another: its pool, its cores, the code it has imported."""

    pool: str
    cpus: float
    code: str


@dataclass(slots=True)
class _Slot:
    """A worker actor and what it holds."""

    actor: Any
    shape: _Shape
    host: str
    assignment: Assignment | None = None


@dataclass(slots=True)
class RayDispatcher:
    """The `Dispatcher` on a Ray cluster.

    Args:
        artifact_root: where trials leave their files, as the head calls it.
        identity: of that root.
        directory: the submitter's working directory.
        hosts: where workers may run.
        head: the host of this process.
        mailbox: actor handle whose `receive` ends in `put`.
    """

    artifact_root: str
    identity: str
    directory: str
    hosts: Hosts
    head: str
    mailbox: Mailbox
    _inbox: queue.SimpleQueue[Message | None] = field(default_factory=queue.SimpleQueue)
    _busy: dict[int, _Slot] = field(default_factory=dict)
    _idle: dict[_Shape, list[_Slot]] = field(default_factory=lambda: defaultdict(list))
    _code: dict[str, Bundle | None] = field(default_factory=dict)
    _sent: dict[str, Any] = field(default_factory=dict)
    """Bundles in the object store, by hash."""
    _keeper: Keeper | None = None
    _sweeper: Sweeper | None = None

    def put(self, texts: Sequence[str]) -> None:
        """Messages have arrived. Called from the mailbox's thread."""
        for text in texts:
            self._inbox.put(decode(text))

    def wake(self) -> None:
        """Make a waiting `poll` return: something else has become ready."""
        self._inbox.put(None)

    def pools(self) -> dict[str, int]:
        return self.hosts.pools()

    def rooms(self, pool: str) -> dict[str, float]:
        return self.hosts.rooms(pool, self._cores(pool, self._busy.values()))

    def sizes(self, pool: str) -> dict[str, float]:
        return self.hosts.sizes(pool)

    def where(self, attempt: int) -> str | None:
        slot = self._busy.get(attempt)
        return None if slot is None else slot.host

    @staticmethod
    def _cores(pool: str, slots: Iterable[_Slot]) -> dict[str, float]:
        """Cores of a pool that these hold on each host."""
        cores: dict[str, float] = defaultdict(float)
        for slot in slots:
            if slot.shape.pool == pool:
                cores[slot.host] += slot.shape.cpus
        return cores

    def open(self, study_key: str, task: str) -> None:
        self._code[study_key] = collect(Path(self.directory), task)

    def start(self, assignment: Assignment) -> str:
        slot = self._slot(assignment)
        if slot is None:
            # The host that had room has just left: back into the queue, and no retry counted.
            self._inbox.put(Stopped(assignment.attempt, assignment.token))
            return assignment.pool
        slot.assignment = assignment
        self._busy[assignment.attempt] = slot
        reference = slot.actor.run.remote(encode_assignment(assignment))
        reference.future().add_done_callback(self._when_over(assignment))
        return assignment.pool

    def _slot(self, assignment: Assignment) -> _Slot | None:
        """A worker for the assignment: one that waits, or a new one on the host where it fits best."""
        bundle = self._code.get(assignment.study_key)
        shape = _Shape(assignment.pool, assignment.cpus, "" if bundle is None else bundle.sha256)
        rooms = self.rooms(shape.pool)
        idle = self._idle[shape]
        while idle:
            slot = idle.pop()
            if rooms.get(slot.host, 0.0) >= shape.cpus:
                return slot
            ray.kill(slot.actor)  # its host has left, or has less room than it had
        host = best_fit(rooms, shape.cpus)
        if host is None:
            return None
        self._make_room(host, shape)
        return self._new_slot(host, shape, bundle)

    def _make_room(self, host: str, shape: _Shape) -> None:
        """End idle workers of other shapes that hold the cores that this one needs."""
        pool = shape.pool
        others = [slot for slots in self._idle.values() for slot in slots if slot.host == host]
        others = [slot for slot in others if slot.shape.pool == pool]
        room = self.hosts.size(host, pool) - self._cores(pool, self._busy.values()).get(host, 0.0)
        room -= sum(slot.shape.cpus for slot in others)
        for slot in others:
            if room >= shape.cpus:
                return
            self._idle[slot.shape].remove(slot)
            ray.kill(slot.actor)
            room += slot.shape.cpus

    def _new_slot(self, host: str, shape: _Shape, bundle: Bundle | None) -> _Slot:
        resources = {} if shape.pool == DEFAULT_POOL else {pool_resource(shape.pool): shape.cpus}
        # Two threads, so that `stop` gets through while `run` runs.
        shaped = _remote_worker().options(
            num_cpus=shape.cpus,
            resources=resources,
            max_concurrency=2,
            max_restarts=0,
            max_task_retries=0,
            scheduling_strategy=NodeAffinitySchedulingStrategy(host, soft=False),
        )
        keeper = code = None
        if host != self.head:
            keeper = self._keeper = self._keeper or start_keeper(self.artifact_root, self.head)
            if bundle is not None:
                if bundle.sha256 not in self._sent:
                    self._sent[bundle.sha256] = ray.put((bundle.sha256, bundle.data))
                code = self._sent[bundle.sha256]
        actor = shaped.remote(self.artifact_root, self.identity, keeper, code, self.directory, self.mailbox)
        return _Slot(actor, shape, host)

    def _when_over(self, assignment: Assignment) -> Callable[[Future[None]], None]:
        """`run` says everything by messages; only its failure to return says something more: the process is gone."""

        def over(future: Future[None]) -> None:
            error = future.exception()
            if error is not None:
                reason = f"its worker process ended ({type(error).__name__})"
                self._inbox.put(Vanished(assignment.attempt, assignment.token, reason))

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
            self._idle[slot.shape].append(slot)
            return
        # A connection that broke looks the same from here: what goes on behind it must not keep the cores.
        ray.kill(slot.actor)
        if slot.host != self.head:
            self.hosts.doubt(slot.host)

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        if self._sweeper is None:
            self._sweeper = Sweeper(open_artifacts(self.artifact_root))
        self._sweeper.drop(study_key, trial)

    def close(self) -> None:
        self.hosts.close()
        if self._sweeper is not None:
            self._sweeper.close()
        for slot in [*self._busy.values(), *(slot for slots in self._idle.values() for slot in slots)]:
            ray.kill(slot.actor)
        self._busy.clear()
        self._idle.clear()
