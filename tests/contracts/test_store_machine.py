"""Random interleavings of all transitions, by drivers and workers that may be long fenced, against a simple model.

The model is a few lists and does what the port says. After every step the whole study is compared with it, and the
invariants (one live attempt a trial, tokens that rise, positions without holes) are checked from the rows alone.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

from services.errors import Refused, StudyDriven, WrongState
from services.states import OBSERVED_TRIAL, AttemptState, StudyState, TrialState
from services.store.port import Driver, NewArtifact, NewTrial, Result

_names = itertools.count()
ENDED = {StudyState.COMPLETE, StudyState.CANCELLED, StudyState.FAILED}


@dataclass
class ModelAttempt:
    id: int
    token: int
    state: str = "running"
    beat: int = 0


@dataclass
class ModelTrial:
    id: int
    number: int
    state: str = "queued"
    attempts: list[ModelAttempt] = field(default_factory=list)
    position: int | None = None
    value: float | None = None
    samples: int = 0
    seconds: float = 0.0
    retries: int = 0
    iteration: int = 0
    curve: dict[int, tuple[int, float]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)


class Interleavings(RuleBasedStateMachine):
    """One study, every token that was ever handed out, and the hands that may still hold them."""

    def __init__(self, store):
        super().__init__()
        self.store = store
        self.name = f"study{next(_names)}"
        with store.transaction() as change:
            self.id = change.create_study(self.name, {}, seed=1, target_trials=5).id
        self.state = "queued"
        self.wanted = "run"
        self.driver = None
        self.token = 0
        self.target = 5
        self.trials: list[ModelTrial] = []
        self.finished = 0
        self.drivers = itertools.count()
        self.cursor = store.last_event()
        self.tried = 0

    def late(self):
        """Whether there is some work to be disturbed: what ends a study comes seldom enough that studies get far."""
        return len(self.trials) > 2 and self.tried % 3 == 0

    # Which attempt, trial or token: any that ever was, or one that never was.

    def an_attempt(self, data):
        known = [(trial, attempt) for trial in self.trials for attempt in trial.attempts]
        live = [(trial, attempt) for trial, attempt in known if attempt.state == "running"]
        trial, attempt = data.draw(st.sampled_from(live * 3 + known))
        token = data.draw(st.sampled_from([attempt.token] * 3 + [attempt.token - 1, attempt.token + 1]))
        return trial, attempt, token

    def a_drive_token(self, data):
        return data.draw(st.sampled_from([self.token] * 4 + [self.token - 1, self.token + 1]))

    def drives(self, token):
        return self.driver is not None and token == self.token

    def attempted(self, allowed, transition, *args, error=Refused, **kwargs):
        """Do it and say whether it was allowed, which must be what the model says; a refusal leaves no trace."""
        self.tried += 1
        if allowed:
            with self.store.transaction() as change:
                return getattr(change, transition)(*args, **kwargs)
        before = self.store.last_event()
        with self.store.transaction() as change, pytest.raises(error):
            getattr(change, transition)(*args, **kwargs)
        assert self.store.last_event() == before
        return None

    @precondition(lambda self: self.state == "queued" or self.late())
    @rule()
    def drive(self):
        allowed = self.driver is None and (self.state == "queued" or (self.state == "paused" and self.wanted == "run"))
        me = Driver(f"driver{next(self.drivers)}", "host", 1)
        error = WrongState if self.driver is None else StudyDriven
        token = self.attempted(allowed, "drive", self.name, me, error=error)
        if allowed:
            assert token > self.token
            self.driver, self.token, self.state = me, token, "running"

    @precondition(lambda self: self.driver is not None and self.late())
    @rule(data=st.data())
    def take_over(self, data):
        token = self.a_drive_token(data)
        me = Driver(f"driver{next(self.drivers)}", "host", 1)
        new = self.attempted(
            token == self.token, "drive", self.name, me, take_over_from=token, error=StudyDriven
        )  # fmt: skip
        if new is None:
            return
        assert new > self.token
        self.driver, self.token = me, new
        for trial in self.trials:
            if trial.state == "running":
                trial.state = "queued"
                trial.attempts[-1].state = "lost"

    @precondition(lambda self: self.late())
    @rule(data=st.data(), to=st.sampled_from(["queued", "paused", "complete", "cancelled", "failed"]))
    def release(self, data, to):
        """Also with trials that are running."""
        self.let_go(self.a_drive_token(data), to)

    def let_go(self, token, to):
        running = any(trial.state == "running" for trial in self.trials)
        allowed = self.drives(token) and not running
        self.attempted(allowed, "release_drive", self.id, token, StudyState(to))
        if allowed:
            self.driver, self.state = None, to
            if to == "cancelled":
                self.cancel_queued()

    @precondition(lambda self: self.driver is not None and self.late())
    @rule(to=st.sampled_from(["queued", "paused", "complete", "cancelled", "failed"]))
    def wind_down(self, to):
        """What a driver does before it lets go."""
        for trial in self.trials:
            if trial.state == "running":
                self.end(trial, trial.attempts[-1], trial.attempts[-1].token, "preempt")
        self.let_go(self.token, to)

    def cancel_queued(self):
        for trial in self.trials:
            if trial.state == "queued":
                trial.state = "cancelled"

    @precondition(lambda self: self.driver is None and self.state != "queued")
    @rule()
    def ask_to_go_on(self):
        if self.state == "complete":
            self.extend(1)
        else:
            self.ask("run")

    @precondition(lambda self: self.late())
    @rule(wanted=st.sampled_from(["run", "pause", "cancel"]))
    def ask(self, wanted):
        to = {"run": "queued", "pause": "paused", "cancel": "cancelled"}[wanted]
        if self.driver is not None:
            allowed, to = True, "running"
        elif wanted == "run":
            allowed = self.state != "complete"
        else:
            allowed = self.state not in ENDED or self.state == to
        self.attempted(allowed, "ask", self.name, wanted, error=WrongState)
        if allowed:
            if to == "cancelled":
                self.cancel_queued()
            self.state, self.wanted = to, wanted

    @precondition(lambda self: self.driver is not None)
    @rule(data=st.data(), reason=st.sampled_from(["", "No space left on device"]))
    def remark(self, data, reason):
        token = self.a_drive_token(data)
        self.attempted(self.drives(token), "remark", self.id, token, reason)
        if self.drives(token):
            assert self.store.study(self.name).reason == reason

    @precondition(lambda self: self.late())
    @rule(more=st.integers(1, 3))
    def extend(self, more):
        self.attempted(True, "extend", self.name, trials=more)
        self.target += more
        if self.state == "complete":
            self.state, self.wanted = "queued", "run"

    @rule(priority=st.integers(-2, 2), pool=st.sampled_from(["default", "other"]))
    def amend(self, priority, pool):
        """At any time, whoever drives."""
        row = self.attempted(True, "amend", self.name, {"priority": priority, "resources.pool": pool})
        assert (row.priority, row.pool, row.state, row.target_trials) == (priority, pool, self.state, self.target)
        assert row.spec == {"priority": priority, "resources": {"pool": pool}}

    @precondition(lambda self: self.late() or (self.driver is not None and self.queued() is None))
    @rule(data=st.data(), count=st.integers(1, 3))
    def propose(self, data, count):
        token = self.a_drive_token(data)
        made = self.attempted(
            self.drives(token), "propose", self.id, token, strategy="s", history=self.finished, pending=[],
            rng_key=[1], seconds=0.0, trials=[NewTrial({"x": i}, seed=i) for i in range(count)],
        )  # fmt: skip
        for trial in made or []:
            assert trial.number == len(self.trials)
            self.trials.append(ModelTrial(trial.id, trial.number))

    @precondition(lambda self: self.late())
    @rule(data=st.data())
    def start(self, data):
        self.start_trial(self.a_drive_token(data), data.draw(st.sampled_from(self.trials)))

    @precondition(lambda self: self.driver is not None and self.queued() is not None)
    @rule()
    def start_next(self):
        """What a driver does most of the time."""
        self.start_trial(self.token, self.queued())

    def queued(self):
        return next((trial for trial in self.trials if trial.state == "queued"), None)

    def start_trial(self, token, trial):
        allowed = self.drives(token) and trial.state == "queued"
        attempt = self.attempted(allowed, "start", trial.id, token, worker="w")
        if allowed:
            assert all(attempt.token > old.token for old in trial.attempts)
            assert attempt.first_iteration == trial.iteration
            trial.attempts.append(ModelAttempt(attempt.id, attempt.token))
            trial.state = "running"

    @precondition(lambda self: any(trial.attempts for trial in self.trials))
    @rule(data=st.data())
    def beat(self, data):
        _, attempt, token = self.an_attempt(data)
        allowed = attempt.state == "running" and token == attempt.token
        self.attempted(allowed, "beat", attempt.id, token)
        attempt.beat += allowed

    @precondition(lambda self: any(trial.attempts for trial in self.trials))
    @rule(data=st.data(), iteration=st.integers(1, 4), samples=st.integers(0, 100))
    def report(self, data, iteration, samples):
        trial, attempt, token = self.an_attempt(data)
        allowed = attempt.state == "running" and token == attempt.token
        self.attempted(
            allowed, "report", attempt.id, token, iteration=iteration, metrics={"r": samples}, samples=samples,
            seconds=samples / 4,
        )  # fmt: skip
        if allowed:
            attempt.beat += 1
            trial.iteration, trial.samples, trial.seconds = iteration, samples, samples / 4
            trial.curve[iteration] = (len(trial.attempts), float(samples))

    @precondition(lambda self: any(trial.attempts for trial in self.trials))
    @rule(data=st.data(), state=st.sampled_from(sorted(OBSERVED_TRIAL)), samples=st.integers(0, 2**40))
    def finish(self, data, state, samples):
        trial, attempt, token = self.an_attempt(data)
        allowed = attempt.state == "running" and token == attempt.token
        value = samples / 3 if state == "complete" else None
        digest = f"{attempt.id:064x}"
        result = Result(
            state, value=value, samples=samples, seconds=samples / 8,
            artifacts=[NewArtifact("policy", f"policy-{attempt.id}", digest, 1)],
        )  # fmt: skip
        self.attempted(allowed, "finish", attempt.id, token, result)
        if allowed:
            attempt.state = state.value
            self.close(trial, state.value)
            trial.value, trial.samples, trial.seconds = value, samples, samples / 8
            trial.files["policy"] = digest

    def close(self, trial, state):
        trial.state, trial.position = state, self.finished
        self.finished += 1

    @precondition(lambda self: any(trial.attempts for trial in self.trials))
    @rule(data=st.data(), how=st.sampled_from(["lose", "fail", "preempt"]))
    def end_without_outcome(self, data, how):
        self.end(*self.an_attempt(data), how)

    def end(self, trial, attempt, token, how):
        allowed = attempt.state == "running" and token == attempt.token
        self.attempted(allowed, how, attempt.id, token, "why")
        if allowed:
            attempt.state = {"lose": "lost", "fail": "failed", "preempt": "preempted"}[how]
            trial.state = "queued"
            trial.retries += how != "preempt"

    @precondition(lambda self: self.late())
    @rule(data=st.data())
    def give_up(self, data):
        token, trial = self.a_drive_token(data), data.draw(st.sampled_from(self.trials))
        allowed = self.drives(token) and trial.state == "queued"
        self.attempted(allowed, "give_up", trial.id, token, "enough")
        if allowed:
            self.close(trial, "failed")

    @precondition(lambda self: self.late())
    @rule(data=st.data())
    def cancel_trial(self, data):
        running = [trial for trial in self.trials if trial.state == "running"]
        token, trial = self.a_drive_token(data), data.draw(st.sampled_from(running * 3 + self.trials))
        allowed = self.drives(token) and trial.state in {"queued", "running"}
        self.attempted(allowed, "cancel_trial", trial.id, token, "enough")
        if allowed:
            if trial.state == "running":
                trial.attempts[-1].state = "cancelled"
            trial.state = "cancelled"

    @precondition(lambda self: self.driver is not None and self.late())
    @rule(data=st.data())
    def a_transaction_that_breaks(self, data):
        """Propose, start and finish, then fall over: as if nothing had been."""
        before = self.store.last_event()

        def fall_over():
            with self.store.transaction() as change:
                (trial,) = change.propose(
                    self.id, self.token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0,
                    trials=[NewTrial({}, seed=0)],
                )  # fmt: skip
                attempt = change.start(trial.id, self.token, worker="w")
                change.finish(attempt.id, attempt.token, Result(TrialState.COMPLETE, value=1.0))
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            fall_over()
        assert self.store.last_event() == before

    @invariant()
    def the_database_is_what_the_model_says(self):
        row = self.store.study(self.name)
        assert (row.state, row.wanted, row.driver) == (self.state, self.wanted, self.driver)
        assert (row.drive_token, row.target_trials) == (self.token, self.target)
        assert row.samples == sum(trial.samples for trial in self.trials)
        assert row.seconds == pytest.approx(sum(trial.seconds for trial in self.trials))
        rows = self.store.trials(self.id)
        assert [
            (t.number, t.id, t.state, t.position, t.value, t.samples, t.seconds, t.retries, t.iteration, t.attempts)
            for t in rows
        ] == [
            (
                t.number, t.id, t.state, t.position, t.value, t.samples, t.seconds, t.retries, t.iteration,
                len(t.attempts),
            )
            for t in self.trials
        ]  # fmt: skip
        for row, trial in zip(rows, self.trials, strict=True):
            attempts = self.store.attempts(trial.id)
            assert [(a.id, a.number, a.token, a.state, a.beat) for a in attempts] == [
                (a.id, number, a.token, a.state, a.beat) for number, a in enumerate(trial.attempts, 1)
            ]
            if trial.curve:
                curve = {row.iteration: (row.attempt, row.values["r"]) for row in self.store.metrics(trial.id)}
                assert curve == trial.curve
            if trial.files:
                assert {file.name: file.sha256 for file in self.store.artifacts(trial.id)} == trial.files
            # And what may never break, from the rows alone.
            live = [attempt for attempt in attempts if attempt.state is AttemptState.RUNNING]
            assert len(live) == (row.state is TrialState.RUNNING)
            assert all(older.token < newer.token for older, newer in itertools.pairwise(attempts))
            assert (row.position is not None) == (row.state in OBSERVED_TRIAL)
            assert (row.finished_at is None) == (row.state in {TrialState.QUEUED, TrialState.RUNNING})
        history = self.store.history(self.id)
        assert [trial.position for trial in history] == list(range(len(history)))
        assert len({trial.number for trial in history}) == len(history)

    @invariant()
    def every_final_trial_was_told_exactly_once(self):
        events = self.store.events(after=self.cursor, study_id=self.id, limit=100_000)
        finals = [event.trial for event in events if event.kind == "finished"]
        final = [t.number for t in self.trials if t.state not in {"queued", "running"}]
        assert sorted(finals) == final


def test_random_interleavings_keep_the_invariants(store):
    run_state_machine_as_test(
        lambda: Interleavings(store),
        settings=settings(
            max_examples=16,
            stateful_step_count=60,
            deadline=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
        ),
    )
