"""Live events: nothing is lost, nothing is told twice, and one poller serves everybody."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from starlette.websockets import WebSocketDisconnect

from services.api import live
from services.api.live import Hub, Subscription
from services.states import TrialState
from tests.record import Record


class Listener:
    """What a browser does: applies frames, and notices a gap."""

    def __init__(self, frames, cursor):
        self.frames = frames
        self.cursor = cursor
        self.hello = None
        self.ids = []
        self.trials = {}
        self.studies = []
        self.others = []

    async def until(self, done, timeout=10.0):
        async with asyncio.timeout(timeout):
            while not done(self):
                self.take(json.loads(await anext(self.frames)))

    def take(self, message):
        for frame in message if isinstance(message, list) else [message]:
            self.apply(frame)

    def apply(self, frame):
        if frame["type"] == "hello":
            self.hello = frame
        elif frame["type"] == "events":
            assert frame["from"] <= self.cursor, "something lies between"
            self.ids += [event["id"] for event in frame["events"] if event["id"] > self.cursor]
            self.cursor = max(self.cursor, frame["to"])
            for trial in frame.get("trials", ()):
                self.trials[trial["number"]] = trial["state"]
        elif frame["type"] == "study":
            self.studies.append(frame["study"])
        else:
            self.others.append(frame)


def ids_of(store, record, after):
    return [event.id for event in store.events(after=after, study_id=record.id)]


def run(coroutine):
    # In a thread of its own: the browser that other tests share keeps an event loop running in this one.
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(asyncio.run, coroutine).result()


@pytest.fixture
def other(store, artifacts):
    return Record(store, artifacts, "other").begin()


def test_every_event_of_a_study_arrives_once_in_order_with_its_trial_as_it_is_now(store, record, other):
    start = store.last_event()

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen("jump", start) as frames:
            listener = Listener(frames, start)
            for _ in range(4):
                await asyncio.to_thread(record.one, iterations=3)
                await asyncio.to_thread(other.one, iterations=1)
            last = store.last_event()
            await listener.until(lambda one: one.cursor >= last)
            return listener

    listener = run(scenario())
    assert listener.ids == ids_of(store, record, start)
    assert listener.trials == dict.fromkeys(range(4), "complete")


def test_a_proposal_brings_the_rows_it_made(store, record):
    start = store.last_event()

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen("jump", start) as frames:
            listener = Listener(frames, start)
            await asyncio.to_thread(record.propose, 3)
            await listener.until(lambda one: one.trials)
            return listener.trials

    assert run(scenario()) == {0: "queued", 1: "queued", 2: "queued"}


@pytest.mark.parametrize("topic", ["jump", None])
def test_what_happened_before_subscribing_is_told_first(store, record, topic):
    start = store.last_event()
    record.one(iterations=2)

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen(topic, start) as frames:
            listener = Listener(frames, start)
            await listener.until(lambda one: len(one.ids) >= 5)
            await asyncio.to_thread(record.one, iterations=1)
            last = store.last_event()
            await listener.until(lambda one: one.cursor >= last)
            return listener

    listener = run(scenario())
    assert listener.ids == ids_of(store, record, start)
    assert listener.hello["history"] == store.history_id()


def test_a_page_newer_than_the_poller_is_told_nothing_twice(store, record):
    async def scenario():
        hub = Hub(store, poll_seconds=0.2)
        async with hub.listen(None, 0):
            await asyncio.to_thread(record.one, iterations=1)
            page = store.last_event()
            async with hub.listen("jump", page) as frames:
                listener = Listener(frames, page)
                await asyncio.to_thread(record.propose)
                await listener.until(lambda one: one.ids)
                return page, listener

    page, listener = run(scenario())
    assert listener.ids == ids_of(store, record, page)
    assert listener.others == []


def test_counts_rise_with_the_events(store, record):
    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen(None, store.last_event()) as frames:
            listener = Listener(frames, store.last_event())
            await asyncio.to_thread(record.one, state=TrialState.DIVERGED)
            await listener.until(lambda one: one.studies and one.studies[-1]["trials"] == {"diverged": 1})
            return listener.studies

    assert run(scenario())[-1]["name"] == "jump"


def test_a_summary_that_came_too_soon_is_sent_later_and_not_lost(store, record, monkeypatch):
    monkeypatch.setattr(live, "SUMMARY_SECONDS", 0.3)

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen("jump", store.last_event()) as frames:
            listener = Listener(frames, store.last_event())
            for _ in range(6):
                await asyncio.to_thread(record.one, iterations=1)
            await listener.until(lambda one: one.studies and one.studies[-1]["trials"] == {"complete": 6})
            return len(listener.studies)

    assert run(scenario()) < 6


def test_a_long_absence_is_answered_with_a_fresh_start(store, record, monkeypatch):
    monkeypatch.setattr(live, "CATCH_UP", 3)
    record.one(iterations=5)

    async def scenario():
        async with Hub(store).listen("jump", 1) as frames:
            assert json.loads(await anext(frames))["type"] == "hello"
            return json.loads(await anext(frames))

    assert run(scenario()) == {"type": "reset"}


def test_a_cursor_of_another_history_is_answered_with_a_fresh_start(store, record):
    async def scenario():
        async with Hub(store).listen("jump", 10**6) as frames:
            assert json.loads(await anext(frames))["cursor"] == store.last_event()
            return json.loads(await anext(frames))

    assert run(scenario()) == {"type": "reset"}


def test_a_database_that_was_swapped_is_noticed(store, record, monkeypatch):
    monkeypatch.setattr(live, "HISTORY_SECONDS", 0.0)

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen("jump", store.last_event()) as frames:
            await anext(frames)
            monkeypatch.setattr(store, "history_id", lambda: "another")
            async with asyncio.timeout(5):
                return json.loads(await anext(frames))

    assert run(scenario()) == {"type": "reset"}


@pytest.mark.parametrize("topic", ["jump", None])
def test_a_deleted_study_is_told(store, record, topic):
    record.end()

    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen(topic, store.last_event()) as frames:
            listener = Listener(frames, store.last_event())

            def delete():
                with store.transaction() as change:
                    change.delete_study("jump")

            await asyncio.to_thread(delete)
            await listener.until(lambda one: one.others)
            return listener.others

    assert run(scenario()) == [{"type": "deleted", "name": "jump"}]


def test_listeners_share_one_poller_which_rests_when_they_are_gone(store, record, monkeypatch):
    looks = []
    look = Hub._look

    def counted(hub, topics, **options):
        looks.append(len(topics))
        return look(hub, topics, **options)

    monkeypatch.setattr(Hub, "_look", counted)

    async def scenario():
        hub = Hub(store, poll_seconds=0.01)
        async with asyncio.TaskGroup() as group:
            gone = asyncio.Event()

            async def listen():
                async with hub.listen("jump", store.last_event()) as frames:
                    await anext(frames)
                    await gone.wait()

            for _ in range(20):
                group.create_task(listen())
            while len(looks) < 10:
                await asyncio.sleep(0.01)
            assert hub.listeners == 20
            gone.set()
        count = len(looks)
        await asyncio.sleep(0.1)
        return hub.listeners, len(looks) - count

    assert run(scenario()) == (0, 0)
    # Twenty listeners of one study are one topic of one poller.
    assert set(looks) == {1}


def test_a_database_that_fails_lets_listeners_go_and_the_next_one_starts_again(store, record, monkeypatch, caplog):
    async def scenario():
        hub = Hub(store, poll_seconds=0.005)
        async with hub.listen("jump", store.last_event()) as frames:
            await anext(frames)
            with monkeypatch.context() as broken:
                broken.setattr(store, "last_event", lambda: 1 / 0)
                async with asyncio.timeout(5):
                    assert [frame async for frame in frames] == []
        start = store.last_event()
        async with hub.listen("jump", start) as frames:
            listener = Listener(frames, start)
            await asyncio.to_thread(record.propose)
            await listener.until(lambda one: one.ids)
            return listener.trials

    assert run(scenario()) == {0: "queued"}
    assert "the event poller stopped: ZeroDivisionError" in caplog.text


def test_a_slow_listener_is_told_to_start_again_instead_of_growing(monkeypatch):
    async def scenario():
        slow = Subscription("jump")
        for number in range(live.QUEUE + 1):
            slow.put(str(number))
        return [slow.frames.get_nowait() for _ in range(slow.frames.qsize())]

    assert run(scenario()) == [live.RESET]


class TestSocket:
    def test_it_says_hello_and_tells_what_happens(self, client, store, record):
        start = store.last_event()
        with client.websocket_connect(f"ws://localhost:8642/api/v1/events?study=jump&after={start}") as socket:
            assert socket.receive_json() == {
                "type": "hello",
                "boot": client.get("/api/v1/server").json()["boot"],
                "history": store.history_id(),
                "cursor": start,
            }
            record.propose()
            message = socket.receive_json()
            frame = message[0] if isinstance(message, list) else message
            assert (frame["from"], frame["to"]) == (start, start + 1)
            assert [event["kind"] for event in frame["events"]] == ["proposed"]

    @pytest.mark.parametrize("query", ["after=-1", "after=x", f"after={2**63}"])
    def test_a_cursor_that_is_none_is_refused(self, client, query):
        refused = client.websocket_connect(f"ws://localhost:8642/api/v1/events?{query}")
        with pytest.raises(WebSocketDisconnect), refused:
            pass
