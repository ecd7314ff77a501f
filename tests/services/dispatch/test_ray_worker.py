"""What runs in a worker process, without Ray: its outbox, and the change from one attempt to the next."""

import sys
import threading

import pytest

from services.dispatch import ray_workers
from services.dispatch.port import Assignment, Beat, Began, Ended, Reported, decode, encode_assignment
from services.dispatch.ray_workers import Outbox, Worker


class Mailbox:
    """Stands in for the coordinator's actor handle."""

    def __init__(self):
        self.letters = []
        self.arrived = threading.Event()
        self.receive = self

    def remote(self, texts):
        self.letters.append([decode(text) for text in texts])
        self.arrived.set()


@pytest.fixture
def mailbox():
    return Mailbox()


BEGAN = Began(4, 1, host="h", pid=5)
ENDED = Ended(4, 1, outcome={"status": "complete", "value": 1.0}, artifacts=())


def test_of_a_short_training_one_letter_tells_all_in_order(mailbox, monkeypatch):
    monkeypatch.setattr(ray_workers, "BEGAN_SECONDS", 60.0)
    outbox = Outbox(mailbox)
    outbox.send(BEGAN)
    assert mailbox.letters == []
    outbox.send(ENDED)
    assert mailbox.letters == [[BEGAN, ENDED]]


def test_a_long_training_is_told_to_have_begun_before_there_is_other_news(mailbox):
    outbox = Outbox(mailbox)
    outbox.send(BEGAN)
    assert mailbox.arrived.wait(20)
    assert mailbox.letters == [[BEGAN]]
    outbox.send(Beat(4, 1))
    assert mailbox.letters[1:] == [[Beat(4, 1)]]


def test_messages_of_two_threads_keep_their_order(mailbox, monkeypatch):
    monkeypatch.setattr(ray_workers, "BEGAN_SECONDS", 0.0)  # the timer's thread races with this one
    outbox = Outbox(mailbox)
    for attempt in range(200):
        outbox.send(Began(attempt, 1, host="h", pid=5))
        outbox.send(Reported(attempt, 1, iteration=1, metrics={}, samples=1, seconds=0.0))
    said = [(message.attempt, type(message).__name__) for letter in mailbox.letters for message in letter]
    assert said == [(attempt, kind) for attempt in range(200) for kind in ("Began", "Reported")]


def test_an_attempt_that_ends_while_the_next_one_begins_leaves_it_to_be_stopped(mailbox, monkeypatch):
    """The end of an attempt is told before its `run` returns, and the other thread may have been given the next one."""
    runs = {1: threading.Event(), 2: threading.Event()}
    may_end = {1: threading.Event(), 2: threading.Event()}
    stopped = []

    class Attempt:
        def __init__(self, assignment, artifacts, send):
            self.assignment = assignment

        def run(self):
            runs[self.assignment.attempt].set()
            assert may_end[self.assignment.attempt].wait(20)

        def stop(self):
            stopped.append(self.assignment.attempt)

    monkeypatch.setattr(sys, "path", list(sys.path))  # a worker puts the submitter's folder in front
    monkeypatch.setattr(ray_workers, "Attempt", Attempt)
    monkeypatch.setattr(ray_workers, "artifacts_here", lambda *_: None)
    worker = Worker("", "", None, None, ".", mailbox)
    threads = {}
    for number in (1, 2):
        text = encode_assignment(Assignment(number, 1, "1-s", 0, "{}"))
        threads[number] = threading.Thread(target=worker.run, args=(text,))
        threads[number].start()
        assert runs[number].wait(20)
    may_end[1].set()
    threads[1].join(20)
    worker.stop(2)
    assert stopped == [2]
    may_end[2].set()
    threads[2].join(20)
