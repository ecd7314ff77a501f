"""A coordinator over a real SQLite store, with a scripted dispatcher in place of workers and a clock that tests set."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from services.admission import admit
from services.coordinator import Coordinator
from services.dispatch.hosts import best_fit
from services.dispatch.port import Assignment, Crashed, Ended, Reported, Stopped, Vanished
from services.proposing import InlineStrategist
from services.spec_check import parse_study
from services.store.open import open_store
from workers.contracts import Cost, Outcome

pair = pytest.mark.parametrize("world", [["search.trials=2"]], indirect=True, ids=["two trials"])
"""As many trials as slots, so that a retry finds its slot free."""

STUDY = """
name: s
task: {name: point_jump}
search: {strategy: random, trials: 3}
training: {budget: {samples: 100}}
resources: {parallel: 2}
retries: {limit: 1, backoff_seconds: 2.0}
stop_after_failures: 2
seed: 5
"""


@dataclass
class Scripted:
    """A dispatcher whose workers do what the test says.

    Args:
        size: cores of the host `host` in the pool `default`.
        more: cores of further pools and hosts.
    """

    size: float = 8
    more: dict[str, dict[str, float]] = field(default_factory=dict)
    given: list[Assignment] = field(default_factory=list)
    inbox: list = field(default_factory=list)
    stopped: list[int] = field(default_factory=list)
    killed: list[int] = field(default_factory=list)
    over: set[int] = field(default_factory=set)
    dropped: list[tuple[str, int]] = field(default_factory=list)
    at: dict[int, str] = field(default_factory=dict)

    def pools(self):
        return {pool: int(sum(self.sizes(pool).values())) for pool in ("default", *self.more)}

    def sizes(self, pool):
        own = {"host": self.size} if pool == "default" and self.size else {}
        return {**own, **self.more.get(pool, {})}

    def rooms(self, pool):
        rooms = self.sizes(pool)
        for given in self.running():
            if given.pool == pool:
                rooms[self.at[given.attempt]] -= given.cpus
        return rooms

    def where(self, attempt):
        return None if attempt in self.over else self.at.get(attempt)

    def running(self):
        return [given for given in self.given if given.attempt not in self.over]

    def open(self, study_key, task):
        pass

    def start(self, assignment):
        host = best_fit(self.rooms(assignment.pool), assignment.cpus)
        assert host is not None, "more was started than there is room for"
        self.at[assignment.attempt] = host
        self.given.append(assignment)
        return "scripted"

    def stop(self, attempt):
        self.stopped.append(attempt)

    def kill(self, attempt):
        self.killed.append(attempt)
        self.over.add(attempt)

    def poll(self, deliver, timeout):
        messages, self.inbox = self.inbox, []
        if messages:
            deliver(messages)
            self.over |= {m.attempt for m in messages if isinstance(m, Ended | Stopped | Crashed | Vanished)}

    def drop_checkpoints(self, study_key, trial):
        self.dropped.append((study_key, trial))

    def close(self):
        pass

    def end(self, assignment, value=1.0, status="complete", **more):
        outcome = Outcome(status, value=value if status == "complete" else None, cost=Cost(10, 1.0), **more)
        self.inbox.append(Ended(assignment.attempt, assignment.token, outcome=outcome.to_json()))

    def halt(self, assignment):
        """It has come to a checkpoint and stopped."""
        self.inbox.append(Stopped(assignment.attempt, assignment.token))

    def report(self, assignment, iteration):
        self.inbox.append(
            Reported(assignment.attempt, assignment.token, iteration, {}, samples=iteration, seconds=0.1 * iteration)
        )


class Clock:
    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class World:
    """One driver over one store."""

    def __init__(self, path, text=STUDY, overrides=()):
        self.store = open_store(path)
        self.clock = Clock()
        self.told = []
        self.dispatcher = Scripted()
        self.row = admit(self.store, parse_study(text, name="s.yaml", overrides=list(overrides)))
        self.coordinator = self.driver()

    def driver(self, dispatcher=None):
        return Coordinator(
            self.store,
            dispatcher or self.dispatcher,
            InlineStrategist(),
            clock=self.clock,
            sleep=self.clock.sleep,
            tell=self.told.append,
        )

    def another(self, name, *overrides):
        """A further study, taken by the same driver."""
        made = admit(self.store, parse_study(STUDY, name="s.yaml", overrides=[f"name={name}", *overrides]))
        self.coordinator.take(name)
        return made

    def steps(self, count=4, seconds=1.0):
        for _ in range(count):
            self.coordinator.step()
            self.clock.now += seconds

    def trials(self):
        return self.store.trials(self.row.id)

    def states(self):
        return [trial.state.value for trial in self.trials()]

    def attempts(self, number):
        return [attempt.state for attempt in self.store.attempts(self.store.trial(self.row.id, number).id)]

    def events(self, kind):
        return [event for event in self.store.events(study_id=self.row.id) if event.kind == kind]
