"""Events, live: one poller of the trial database for all sockets.

A *frame* says "this is all that happened between cursor `from` and cursor `to`", together with the rows as they are
now. A client that knows everything up to its own cursor applies a frame whose `from` is not beyond it, and asks
again for what lies between otherwise; so nothing is lost between rendering a page, fetching its data and
subscribing, and nothing stays stale. Event ids of a study have gaps (other studies' events lie between), which is why
frames carry the range and clients don't count.

A message is a frame or a list of frames, in order. The poller runs only while somebody listens. Rows are read, and
frames encoded, once for all listeners of a study.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import pydantic_core
from starlette.concurrency import run_in_threadpool

from services.api.models import EventOut, StudySummary, TrialOut
from services.errors import UnknownStudy, UnknownTrial
from services.store.port import EventRow, Store, TrialRow

log = logging.getLogger(__name__)

POLL_SECONDS = 0.05
"""Half of this is what polling adds to the median time from commit to screen."""
SUMMARY_SECONDS = 0.25
"""Least time between two summaries of one study: they count its trials, which costs more than the events do."""
SUMMARY_SHARE = 0.02
"""Share of a core that the summaries of one study may take: those of a very long one come more rarely."""
HISTORY_SECONDS = 1.0
BATCH = 1000
"""Events of one frame at most."""
CATCH_UP = 5000
"""A client that missed more than this is told to load everything again, which is cheaper by then."""
QUEUE = 256
"""Frames a slow client may be behind before it is told the same."""

Topic = str | None
"""A study's name, or None for everything."""


def encode(frame: dict[str, object]) -> str:
    """JSON text of a frame."""
    return pydantic_core.to_json(frame).decode()


def study_of(event: EventRow) -> str | None:
    """The study's name; that of a deleted one is only in the event that says so."""
    if event.study is None and event.kind == "deleted":
        return str(event.payload.get("study"))
    return event.study


def trials_of(event: EventRow) -> list[int]:
    """Numbers of the trials whose rows an event changed; a proposal names those it made."""
    if event.trial is not None:
        return [event.trial]
    made = event.payload.get("trials")
    return [int(number) for number in made] if event.kind == "proposed" and isinstance(made, list) else []


def joined(frames: Iterable[tuple[Topic, str]]) -> dict[Topic, str]:
    """One message for each topic: its frame, or the list of them. A message costs more than what is in it."""
    by_topic: dict[Topic, list[str]] = {}
    for topic, frame in frames:
        by_topic.setdefault(topic, []).append(frame)
    return {topic: each[0] if len(each) == 1 else f"[{','.join(each)}]" for topic, each in by_topic.items()}


RESET = encode({"type": "reset"})


def _say_why(task: asyncio.Task[None]) -> None:
    """Name what stopped the poller, unless it was sent to rest."""
    if not task.cancelled() and (error := task.exception()) is not None:
        log.warning("the event poller stopped: %s: %s", type(error).__name__, error)


@dataclass(eq=False)
class Subscription:
    """One listener's queue.

    Args:
        topic: what it listens to.
    """

    topic: Topic
    frames: asyncio.Queue[str | None] = field(default_factory=lambda: asyncio.Queue(QUEUE))

    def put(self, frame: str) -> None:
        """Hand a frame over; one that can't keep up loses its queue and is told to start again."""
        try:
            self.frames.put_nowait(frame)
        except asyncio.QueueFull:
            while not self.frames.empty():
                self.frames.get_nowait()
            self.frames.put_nowait(RESET)

    def end(self) -> None:
        """Let the listener go: the poller has stopped."""
        while not self.frames.empty():
            self.frames.get_nowait()
        self.frames.put_nowait(None)


class Hub:
    """The poller and its listeners. Belongs to one event loop.

    Args:
        store: the trial database.
        poll_seconds: time between two looks.
    """

    def __init__(self, store: Store, *, poll_seconds: float = POLL_SECONDS) -> None:
        self.boot = secrets.token_hex(8)
        self._store = store
        self._poll_seconds = poll_seconds
        self._listeners: set[Subscription] = set()
        self._task: asyncio.Task[None] | None = None
        self._cursor = 0
        self._history = ""
        self._starting = asyncio.Lock()
        self._due: dict[str, float] = {}
        """When a study's next summary may be sent."""
        self._ids: dict[str, int] = {}
        """Row ids of studies by name: asking for a study counts its trials, which 20 looks a second need not."""
        self._changed: set[str] = set()
        """Studies whose summary has to be sent."""

    @property
    def listeners(self) -> int:
        """How many sockets listen."""
        return len(self._listeners)

    @asynccontextmanager
    async def listen(self, topic: Topic, after: int) -> AsyncIterator[AsyncIterator[str]]:
        """Frames of a topic beyond a cursor, beginning with a `hello`. Ends when the poller fails."""
        async with self._starting:
            if self._task is None or self._task.done():
                self._cursor, self._history = await run_in_threadpool(self._where)
                self._task = asyncio.create_task(self._poll(), name="halma event poller")
                self._task.add_done_callback(_say_why)
        subscription = Subscription(topic)
        # From here on, every frame beyond this cursor lies in the queue; what is before is fetched below.
        now, history = self._cursor, self._history
        self._listeners.add(subscription)
        try:
            yield self._frames(subscription, after, now, history)
        finally:
            self._listeners.discard(subscription)
            if not self._listeners and self._task is not None:
                self._task.cancel()
                self._task = None

    async def _frames(self, subscription: Subscription, after: int, now: int, history: str) -> AsyncIterator[str]:
        yield encode({"type": "hello", "boot": self.boot, "history": history, "cursor": now})
        if after > now and after > await run_in_threadpool(self._store.last_event):
            # A cursor from the future is one of another history, whatever its id says.
            yield RESET
        elif after < now:
            for frame in await run_in_threadpool(self._missed, subscription.topic, after, now):
                yield frame
        while (news := await subscription.frames.get()) is not None:
            yield news

    def _where(self) -> tuple[int, str]:
        return self._store.last_event(), self._store.history_id()

    async def _poll(self) -> None:
        """Look, tell, sleep. An error ends it and lets all listeners go; the next one to come starts it again."""
        checked = time.monotonic()
        try:
            while True:
                await asyncio.sleep(self._poll_seconds)
                topics = {listener.topic for listener in self._listeners}
                check = time.monotonic() - checked >= HISTORY_SECONDS
                checked = time.monotonic() if check else checked
                news = joined(await run_in_threadpool(self._look, topics, check_history=check))
                for listener in self._listeners:
                    if listener.topic in news:
                        listener.put(news[listener.topic])
        finally:
            for listener in list(self._listeners):
                listener.end()

    def _look(self, topics: set[Topic], *, check_history: bool) -> list[tuple[Topic, str]]:
        """What to tell each topic. Runs in a thread; only one look at a time."""
        last = self._store.last_event()
        if (check_history and self._store.history_id() != self._history) or last < self._cursor:
            self._cursor, self._history = self._where()
            self._ids.clear()
            return [(topic, RESET) for topic in topics]
        frames: list[tuple[Topic, str]] = []
        if last > self._cursor:
            events = self._store.events(after=self._cursor, limit=BATCH)
            for event in events:
                if event.kind == "deleted":
                    self._ids.pop(study_of(event) or "", None)
            # More may have happened between the two reads.
            to = max(event.id for event in events) if events else last
            frames += [(topic, self._frame(topic, self._cursor, to, events)) for topic in topics]
            self._changed |= {name for event in events if (name := study_of(event)) is not None}
            self._cursor = to
        return frames + self._due_summaries(topics)

    def _frame(self, topic: Topic, start: int, to: int, events: Iterable[EventRow]) -> str:
        mine = [event for event in events if topic is None or study_of(event) == topic]
        frame: dict[str, object] = {
            "type": "events",
            "from": start,
            "to": to,
            "events": [EventOut.of(event) for event in mine],
        }
        if topic is not None:
            numbers = sorted({number for event in mine for number in trials_of(event)})
            frame["trials"] = [TrialOut.of(row) for row in self._rows(topic, numbers)]
        return encode(frame)

    def _rows(self, name: str, numbers: list[int]) -> list[TrialRow]:
        """The trials of these numbers as they are now; none where the study is gone."""
        if not numbers:
            return []
        try:
            study = self._id(name)
            if numbers[-1] - numbers[0] < 4 * len(numbers):
                rows = self._store.trials(study, after=numbers[0] - 1, limit=numbers[-1] - numbers[0] + 1)
                wanted = set(numbers)
                return [row for row in rows if row.number in wanted]
            return [self._store.trial(study, number) for number in numbers]
        except (UnknownStudy, UnknownTrial):
            return []

    def _id(self, name: str) -> int:
        """A study's row id. Raises `UnknownStudy`."""
        known = self._ids.get(name)
        if known is None:
            known = self._ids[name] = self._store.study(name).id
        return known

    def _due_summaries(self, topics: set[Topic]) -> list[tuple[Topic, str]]:
        now = time.monotonic()
        due = {name for name in self._changed if now >= self._due.get(name, 0.0)}
        if None not in topics:
            self._changed &= {topic for topic in topics if topic is not None}
            due &= self._changed
        frames: list[tuple[Topic, str]] = []
        for name in sorted(due):
            began = time.monotonic()
            frame = self._summary(name)
            cost = time.monotonic() - began
            self._due[name] = now + max(SUMMARY_SECONDS, cost / SUMMARY_SHARE)
            frames += [(topic, frame) for topic in (None, name) if topic in topics]
        self._changed -= due
        return frames

    def _summary(self, name: str) -> str:
        try:
            study = self._store.study(name)
        except UnknownStudy:
            return encode({"type": "deleted", "name": name})
        return encode({"type": "study", "study": StudySummary.of(study)})

    def _missed(self, topic: Topic, after: int, now: int) -> list[str]:
        """Frames of a range that lies behind, or a reset where it is too long."""
        if now - after > CATCH_UP:
            return [RESET]
        study_id = None
        if topic is not None:
            try:
                study_id = self._store.study(topic).id
            except UnknownStudy:
                return [encode({"type": "deleted", "name": topic})]
        frames = []
        while after < now:
            events = self._store.events(after=after, study_id=study_id, limit=BATCH)
            events = [event for event in events if event.id <= now]
            to = events[-1].id if len(events) == BATCH else now
            frames.append(self._frame(topic, after, to, events))
            after = to
        return frames + ([] if topic is None else [self._summary(topic)])
