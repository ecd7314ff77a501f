"""Answers that many people ask for: made once, never older than the record, and not too many of them."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from pydantic import BaseModel

from services.api.answers import MOST_ANSWERS, Answers
from services.api.known import KnownStudies
from services.errors import BadInput, UnknownStudy
from tests.record import Record, spec


class Count(BaseModel):
    """How often it was made, and something that takes room."""

    made: int
    text: str = ""


class Maker:
    """Makes answers that tell how often they were made.

    Args:
        text: part of each.
    """

    def __init__(self, text=""):
        self.made = 0
        self.text = text

    def __call__(self):
        self.made += 1
        return Count(made=self.made, text=self.text)


def finished(coroutine):
    """Its result, from a thread of its own: a browser of other tests may keep a loop running in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, coroutine).result()


def asked(answers, question, work):
    return Count.model_validate_json(finished(answers.json(question, work)).body).made


@pytest.fixture
def answers(store):
    return Answers(store)


def test_an_answer_is_made_once_as_long_as_nothing_happens(answers, record):
    make = Maker()
    assert [asked(answers, "how many", make) for _ in range(3)] == [1, 1, 1]
    assert asked(answers, "how many others", make) == 2


def test_a_commit_between_two_requests_is_seen(answers, record):
    make = Maker()
    assert asked(answers, "how many", make) == 1
    record.propose()
    assert asked(answers, "how many", make) == 2


def test_a_commit_while_an_answer_is_made_is_seen_by_who_asks_after_it(answers, record):
    """The first answer is still on its way when the second is asked for: it may not know of the commit between."""
    reading, go_on = threading.Event(), threading.Event()
    make = Maker()

    def slow():
        reading.set()
        go_on.wait(10)
        return make()

    async def both():
        first = asyncio.create_task(answers.json("how many", slow))
        await asyncio.to_thread(reading.wait, 10)
        await asyncio.to_thread(record.propose)
        second = await answers.json("how many", make)
        go_on.set()
        return await first, second, await answers.json("how many", make)

    first, second, third = (Count.model_validate_json(one.body).made for one in finished(both()))
    # Made later, the slow one is of an older record all the same: it doesn't take the newer one's place.
    assert (second, first, third) == (1, 2, 1)


def test_a_hundred_who_ask_at_the_same_time_get_one_answer(answers, record):
    gate = threading.Event()
    make = Maker()

    def slow():
        gate.wait(10)
        return make()

    async def crowd():
        asking = [asyncio.create_task(answers.json("how many", slow)) for _ in range(100)]
        while len(answers._coming) == 0:
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.05)
        gate.set()
        return [one.body for one in await asyncio.gather(*asking)]

    assert set(finished(crowd())) == {Count(made=1).model_dump_json().encode()}


def test_who_asked_first_may_leave_without_taking_the_answer_from_the_others(answers, record):
    gate = threading.Event()
    make = Maker()

    def slow():
        gate.wait(10)
        return make()

    async def two():
        first = asyncio.create_task(answers.json("how many", slow))
        while not answers._coming:
            await asyncio.sleep(0.001)
        second = asyncio.create_task(answers.json("how many", slow))
        await asyncio.sleep(0.05)
        first.cancel()
        gate.set()
        return await second

    assert Count.model_validate_json(finished(two()).body).made == 1


def test_what_went_wrong_is_told_and_not_kept(answers, record):
    def wrong():
        raise BadInput("expected something else")

    with pytest.raises(BadInput, match="expected something else"):
        asked(answers, "how many", wrong)
    assert asked(answers, "how many", Maker()) == 1


def test_no_more_is_kept_than_there_is_room_for(store, record):
    answers = Answers(store, most_bytes=1000)
    makers = [Maker("x" * 400) for _ in range(3)]
    for question, make in enumerate(makers):
        asked(answers, question, make)
        assert answers.size <= 1000
    # The one not asked for longest made room.
    assert [asked(answers, question, make) for question, make in list(enumerate(makers))[::-1]] == [1, 1, 2]
    # Too large for any room: given, and not kept.
    large = Maker("x" * 2000)
    assert [asked(answers, "large", large) for _ in range(2)] == [1, 2]
    assert answers.size <= 1000


def test_a_newer_answer_takes_the_room_of_the_older_one(answers, record):
    make = Maker("x" * 400)
    asked(answers, "how many", make)
    once = answers.size
    for _ in range(20):
        record.propose()
        asked(answers, "how many", make)
    assert answers.size < once + 10


def test_a_study_is_counted_once_as_long_as_nothing_happens_and_anew_when_something_did(store, record):
    studies = KnownStudies(store)
    record.one(value=0.5)
    before = studies.study("jump")
    assert before == store.study("jump")
    assert studies.study("jump") is before
    record.propose()
    assert studies.study("jump") == store.study("jump")
    assert studies.study("jump").counts["queued"] == 1
    with pytest.raises(UnknownStudy):
        studies.study("nobody")


@pytest.mark.parametrize("part", ["strategies", "window", "table"])
def test_what_was_committed_is_in_the_next_answer(client, record, part):
    before = client.get(f"/api/v1/studies/jump/{part}").json()
    assert client.get(f"/api/v1/studies/jump/{part}").json() == before
    record.one(value=0.5, features=(0.0,))
    after = client.get(f"/api/v1/studies/jump/{part}").json()
    assert after["cursor"] > before["cursor"]
    shown = {"strategies": "strategies", "window": "trials", "table": "numbers"}[part]
    assert len(after[shown]) == len(before[shown]) + 1


def test_studies_and_their_filters_have_answers_of_their_own(client, store, artifacts, record):
    Record(store, artifacts, "other").begin().one(value=0.25)
    record.one(value=0.5)
    record.one(value=0.75)

    def values(study, **query):
        found = client.get(f"/api/v1/studies/{study}/window", params=query).json()
        return [trial["value"] for trial in found["trials"]]

    for _ in range(2):
        assert values("other") == [0.25]
        assert values("jump", sort="-value") == [0.75, 0.5]
        assert values("jump", where="value<0.6") == [0.5]
        assert values("jump", sort="-value", limit=1) == [0.75]
        assert values("jump", sort="-value", limit=1, offset=1) == [0.5]


def test_a_kept_answer_is_for_those_who_may_ask(anyone, client, record):
    path = "/api/v1/studies/jump/table"
    assert client.get(path).status_code == 200
    assert client.get(path, headers={"authorization": "Bearer wrong"}).status_code == 401


def test_the_answer_of_a_deleted_study_is_forgotten_with_it(client, store, artifacts):
    with store.transaction() as change:
        change.create_study("brief", spec("brief"), seed=1, target_trials=1)
    path = "/api/v1/studies/brief/table"
    assert client.get(path).status_code == 200
    with store.transaction() as change:
        change.ask("brief", "cancel")
        change.delete_study("brief")
    assert client.get(path).status_code == 404


def test_many_small_answers_do_not_pile_up(answers, record):
    for number in range(MOST_ANSWERS + 5):
        asked(answers, number, Maker("x"))
    one = len(Count(made=1, text="x").model_dump_json())
    assert answers.size == MOST_ANSWERS * one
