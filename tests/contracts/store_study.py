"""A driven study, with the calls that the suites of the trial database repeat."""

from __future__ import annotations

from services.states import TrialState
from services.store.port import Driver, NewTrial, Result

ME = Driver("me", "here", 41, "1234")
OTHER = Driver("other", "there", 42)
DONE = Result(TrialState.COMPLETE, value=1.0, samples=100, seconds=2.5)


class Study:
    """A driven study, with the calls that tests repeat."""

    def __init__(self, store, name="jump", **targets):
        self.store = store
        self.name = name
        with store.transaction() as change:
            self.id = change.create_study(name, {"task": "sphere"}, seed=7, **targets).id
            self.token = change.drive(name, ME)

    def propose(self, count=1, **kwargs):
        with self.store.transaction() as change:
            return change.propose(
                self.id,
                self.token,
                strategy="random",
                history=0,
                pending=[],
                rng_key=[1, 2],
                seconds=0.5,
                trials=[NewTrial({"x": float(i)}, seed=i, **kwargs) for i in range(count)],
            )

    def start(self, trial):
        with self.store.transaction() as change:
            return change.start(trial.id, self.token, worker="w1", host="here", pid=9)

    def running(self):
        (trial,) = self.propose()
        return trial, self.start(trial)

    def do(self, transition, *args, **kwargs):
        with self.store.transaction() as change:
            return getattr(change, transition)(*args, **kwargs)

    def finish(self, attempt, result=DONE):
        return self.do("finish", attempt.id, attempt.token, result)

    def trial(self, number):
        return self.store.trial(self.id, number)

    def row(self):
        return self.store.study(self.name)


def kinds(store, **which):
    return [event.kind for event in store.events(**which)]
