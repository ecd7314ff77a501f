"""What every trial database has to do, on every engine."""

from __future__ import annotations

import math
import threading
from datetime import UTC, datetime, timedelta

import pytest

from services.errors import NameTaken, Refused, StudyDriven, UnknownStudy, UnknownTrial, WrongState
from services.states import AttemptState, StudyState, TrialState
from services.store.open import open_store
from services.store.port import Driver, NewArtifact, NewTrial, Result

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


@pytest.fixture
def study(store):
    return Study(store)


def kinds(store, **which):
    return [event.kind for event in store.events(**which)]


class TestStudies:
    def test_a_new_study_is_queued_and_keeps_all_it_was_given(self, store):
        spec = {"b": [1, 2.5, None, "ü"], "a": {"deep": 0.1 + 0.2}}
        with store.transaction() as change:
            made = change.create_study(
                "jump", spec, seed=2**64 - 1, pool="big", priority=-3, target_trials=10, target_cost=1.5
            )
        assert made == store.study("jump")
        assert made.state is StudyState.QUEUED
        assert made.wanted == "run"
        assert made.spec == spec
        assert list(made.spec) == ["b", "a"]
        assert (made.seed, made.pool, made.priority) == (2**64 - 1, "big", -3)
        assert (made.target_trials, made.target_cost) == (10, 1.5)
        assert (made.driver, made.driven_since, made.finished_at, made.best_value) == (None, None, None, None)
        assert (made.counts, made.samples, made.seconds) == ({}, 0, 0.0)
        assert abs(datetime.now(UTC) - made.created_at) < timedelta(minutes=1)

    def test_a_name_is_taken_once(self, store, study):
        with pytest.raises(NameTaken, match=r"study 'jump'.*found a study of that name, running; resume or extend"):
            study.do("create_study", "jump", {}, seed=1)
        assert len(store.studies()) == 1

    @pytest.mark.parametrize("seed", [-1, 2**64])
    def test_a_seed_beyond_64_bits_is_an_error(self, store, seed):
        with store.transaction() as change, pytest.raises(ValueError, match="unsigned 64-bit"):
            change.create_study("jump", {}, seed=seed)
        assert store.studies() == []

    def test_an_unknown_study_is_told_with_the_nearest_names(self, store, study):
        with pytest.raises(UnknownStudy, match="study 'jmp': expected the name of a study, found 'jump'"):
            store.study("jmp")
        with pytest.raises(UnknownStudy, match="found none of a similar name"):
            study.do("ask", "xyz", "run")

    def test_studies_come_newest_first_with_counts_costs_and_the_best_value(self, store, study):
        values = [(TrialState.COMPLETE, 3.0), (TrialState.COMPLETE, -1.0), (TrialState.DIVERGED, None)]
        for state, value in values:
            study.finish(study.running()[1], Result(state, value=value, samples=10, seconds=0.5))
        study.running()
        study.propose(2)
        study.do("create_study", "later", {}, seed=0)
        later, first = store.studies()
        assert (later.name, later.counts, later.samples) == ("later", {}, 0)
        assert first.counts == {"complete": 2, "diverged": 1, "running": 1, "queued": 2}
        assert (first.samples, first.seconds, first.best_value) == (30, 1.5, 3.0)
        assert first == store.study("jump")

    def test_wanted_reads_the_rows_it_was_asked_for(self, store, study):
        study.do("create_study", "later", {}, seed=0)
        study.do("ask", "jump", "pause")
        rows = store.wanted([study.id])
        assert list(rows) == [study.id]
        assert rows[study.id].wanted == "pause"
        assert rows[study.id].driver == ME
        assert rows[study.id].drive_token == study.token
        assert store.wanted([]) == {}

    def test_what_is_asked_of_an_undriven_study_happens_at_once(self, study):
        study.propose(2)
        study.do("release_drive", study.id, study.token, StudyState.QUEUED, "interrupted")
        assert study.row().reason == "interrupted"
        assert study.do("ask", "jump", "pause").state is StudyState.PAUSED
        assert study.do("ask", "jump", "pause").state is StudyState.PAUSED
        assert study.do("ask", "jump", "run").state is StudyState.QUEUED
        cancelled = study.do("ask", "jump", "cancel")
        assert cancelled.state is StudyState.CANCELLED
        assert cancelled.counts == {"cancelled": 2}
        assert cancelled.finished_at is not None
        again = study.do("ask", "jump", "run")
        assert (again.state, again.wanted, again.finished_at) == (StudyState.QUEUED, "run", None)

    def test_what_is_asked_of_a_driven_study_is_left_to_its_driver(self, study):
        for wanted in ("pause", "cancel", "run"):
            row = study.do("ask", "jump", wanted)
            assert (row.state, row.wanted) == (StudyState.RUNNING, wanted)

    def test_what_makes_no_sense_is_refused(self, study):
        study.do("release_drive", study.id, study.token, StudyState.COMPLETE)
        with pytest.raises(WrongState, match="found it complete; extend it"):
            study.do("ask", "jump", "run")
        with pytest.raises(WrongState, match="expected a live one to pause, found it complete"):
            study.do("ask", "jump", "pause")
        with pytest.raises(WrongState, match="expected a live one to cancel, found it complete"):
            study.do("ask", "jump", "cancel")
        with pytest.raises(ValueError, match="found 'stop'"):
            study.do("ask", "jump", "stop")

    def test_a_complete_study_can_be_extended_and_is_queued_again(self, store):
        study = Study(store, target_trials=3, target_cost=1.5)
        study.do("release_drive", study.id, study.token, StudyState.COMPLETE)
        assert study.row().finished_at is not None
        row = study.do("extend", "jump", trials=4, cost=0.5)
        assert (row.target_trials, row.target_cost, row.state, row.wanted) == (7, 2.0, StudyState.QUEUED, "run")
        assert row.finished_at is None

    def test_how_a_study_is_run_can_be_changed_and_what_was_is_told(self, store):
        study = Study(store, pool="a", priority=1)
        row = study.do(
            "amend", "jump", {"priority": 3, "resources.pool": "b", "resources.parallel": 4, "task": "sphere"}
        )
        assert (row.priority, row.pool) == (3, "b")
        assert row.spec == {"task": "sphere", "priority": 3, "resources": {"pool": "b", "parallel": 4}}
        assert store.wanted([study.id])[study.id].spec == row.spec
        event = store.events()[-1]
        assert (event.kind, event.payload["changes"]) == (
            "amended",
            {
                "priority": {"from": None, "to": 3},
                "resources.pool": {"from": None, "to": "b"},
                "resources.parallel": {"from": None, "to": 4},
            },
        )
        assert study.do("amend", "jump", {"priority": 3}) == study.row()
        assert store.last_event() == event.id, "no change, no event"
        with pytest.raises(UnknownStudy):
            study.do("amend", "nobody", {"priority": 3})

    def test_extending_by_nothing_or_where_there_is_no_budget_is_refused(self, study):
        with pytest.raises(WrongState, match="found 0 trials and cost 0"):
            study.do("extend", "jump")
        with pytest.raises(WrongState, match="found -1 trials"):
            study.do("extend", "jump", trials=-1, cost=2.0)
        with pytest.raises(WrongState, match="expected a budget in cost to extend, found none"):
            study.do("extend", "jump", cost=1.0)

    def test_a_live_study_is_not_deleted(self, study):
        with pytest.raises(WrongState, match="found it running; cancel it before"):
            study.do("delete_study", "jump")

    def test_a_deleted_study_leaves_nothing_but_the_event_and_its_id_is_not_given_again(self, store, study):
        trial, attempt = study.running()
        study.do("report", attempt.id, attempt.token, iteration=1, metrics={"r": 1.0}, samples=1, seconds=1.0)
        study.finish(attempt, Result(TrialState.COMPLETE, artifacts=[NewArtifact("p", "1/p", "0" * 64, 3)]))
        study.do("release_drive", study.id, study.token, StudyState.COMPLETE)
        study.do("delete_study", "jump")
        assert store.studies() == []
        assert [(event.kind, event.study, event.study_id) for event in store.events()] == [
            ("deleted", "jump", study.id)
        ]
        assert store.trials(study.id) == []
        for read in (store.attempts, store.metrics, store.artifacts, store.proposals):
            assert read(trial.id) == []
        assert study.do("create_study", "jump", {}, seed=1).id > study.id


class TestDriving:
    def test_a_driver_is_named_in_the_row(self, study):
        row = study.row()
        assert (row.state, row.driver, row.drive_token) == (StudyState.RUNNING, ME, study.token)
        assert row.driven_since is not None

    def test_a_second_driver_is_told_who_drives_where_and_since_when(self, study):
        with pytest.raises(StudyDriven, match=r"found me \(process 41 on here\) driving it since \d{4}-.*UTC; stop"):
            study.do("drive", "jump", OTHER)
        assert study.row().driver == ME

    def test_the_token_rises_with_every_driver(self, study):
        study.do("release_drive", study.id, study.token, StudyState.QUEUED)
        assert study.do("drive", "jump", OTHER) > study.token

    def test_taking_over_ends_running_attempts_as_lost_without_counting_a_retry(self, store, study):
        trial, attempt = study.running()
        (queued,) = study.propose()
        token = study.do("drive", "jump", OTHER, take_over_from=study.token)
        assert token > study.token
        after = study.trial(trial.number)
        assert (after.state, after.retries, after.attempts) == (TrialState.QUEUED, 0, 1)
        (ended,) = store.attempts(trial.id)
        assert ended.state is AttemptState.LOST
        assert ended.ended_at is not None
        assert "me was taken over by other" in ended.reason
        assert study.trial(queued.number) == queued
        with pytest.raises(Refused, match="expected it running, found it lost"):
            study.finish(attempt)
        assert kinds(store)[-2:] == ["driven", "lost"]

    def test_taking_over_from_the_wrong_driver_is_refused(self, study):
        study.do("drive", "jump", OTHER, take_over_from=study.token)
        with pytest.raises(StudyDriven, match="found other"):
            study.do("drive", "jump", Driver("third", "x", 1), take_over_from=study.token)

    def test_all_that_a_fenced_driver_tries_is_refused(self, study):
        (trial,) = study.propose()
        study.do("drive", "jump", OTHER, take_over_from=study.token)
        message = "expected drive token 1 of study 'jump' to be in force, found that other on there drives it"
        for attempt in (
            study.propose,
            lambda: study.start(trial),
            lambda: study.do("beat_drive", study.id, study.token),
            lambda: study.do("release_drive", study.id, study.token, StudyState.PAUSED),
            lambda: study.do("give_up", trial.id, study.token, "enough"),
            lambda: study.do("cancel_trial", trial.id, study.token, "enough"),
        ):
            with pytest.raises(Refused, match=message):
                attempt()
        assert study.trial(0) == trial
        assert len(study.store.trials(study.id)) == 1

    def test_a_driver_that_let_go_is_refused(self, study):
        study.do("release_drive", study.id, study.token, StudyState.PAUSED, "asked to")
        with pytest.raises(Refused, match=r"nobody drives it \(it is paused\)"):
            study.propose()

    def test_the_drivers_beat_rises(self, study):
        before = study.row().drive_beat
        study.do("beat_drive", study.id, study.token)
        study.do("beat_drive", study.id, study.token)
        assert study.row().drive_beat == before + 2

    def test_letting_go_while_attempts_run_is_refused(self, study):
        _, attempt = study.running()
        with pytest.raises(Refused, match="expected no running attempt, found 1"):
            study.do("release_drive", study.id, study.token, StudyState.PAUSED)
        study.do("preempt", attempt.id, attempt.token, "paused")
        study.do("release_drive", study.id, study.token, StudyState.PAUSED, "asked to")
        row = study.row()
        assert (row.state, row.reason, row.driver) == (StudyState.PAUSED, "asked to", None)

    def test_a_study_is_not_left_running(self, study):
        with pytest.raises(ValueError, match="found 'running'"):
            study.do("release_drive", study.id, study.token, StudyState.RUNNING)

    def test_a_study_left_cancelled_has_no_open_trials(self, study):
        study.propose(2)
        study.do("release_drive", study.id, study.token, StudyState.CANCELLED)
        assert study.row().counts == {"cancelled": 2}

    @pytest.mark.parametrize(
        ("state", "advice"), [("complete", "extend it"), ("cancelled", "resume it"), ("failed", "resume it")]
    )
    def test_an_ended_study_is_not_driven(self, study, state, advice):
        study.do("release_drive", study.id, study.token, StudyState(state))
        with pytest.raises(WrongState, match=f"expected one that is queued, found it {state}; {advice}"):
            study.do("drive", "jump", ME)

    def test_a_study_paused_by_people_waits_for_them_and_one_paused_by_trouble_does_not(self, study):
        study.do("release_drive", study.id, study.token, StudyState.PAUSED, "the disk is full")
        token = study.do("drive", "jump", ME)
        study.do("ask", "jump", "pause")
        study.do("release_drive", study.id, token, StudyState.PAUSED)
        with pytest.raises(WrongState, match="found it paused; resume it"):
            study.do("drive", "jump", ME)


class TestTrials:
    def test_proposed_trials_are_numbered_in_order_and_keep_all_they_were_given(self, store, study):
        first = study.propose(3)
        (odd,) = study.propose(1, z=0.25, warm_start=1, stage="final", info={"mode": "explore", "mean": [0.1]})
        assert [trial.number for trial in first] == [0, 1, 2]
        assert odd.number == 3
        assert (odd.z, odd.warm_start, odd.stage) == (0.25, 1, "final")
        assert odd.info == {"mode": "explore", "mean": [0.1]}
        assert first[2].params == {"x": 2.0}
        assert first[2].seed == 2
        assert first[0].proposal_id == first[2].proposal_id != odd.proposal_id
        assert store.trials(study.id) == [*first, odd]
        assert all(trial.state is TrialState.QUEUED and trial.position is None for trial in first)

    def test_a_proposal_is_kept_for_replay(self, store, study):
        with store.transaction() as change:
            change.propose(
                study.id,
                study.token,
                strategy="bds",
                history=4,
                pending=[5, 6],
                rng_key=[2**128 - 1, 3],
                seconds=0.25,
                trials=[],
                info={"note": "empty"},
            )
        (proposal,) = store.proposals(study.id)
        assert (proposal.strategy, proposal.history, proposal.pending) == ("bds", 4, (5, 6))
        assert (proposal.rng_key, proposal.count, proposal.seconds) == ((2**128 - 1, 3), 0, 0.25)
        assert proposal.info == {"note": "empty"}

    def test_parameters_keep_every_bit(self, store, study):
        params = {"z": 0.1 + 0.2, "a": 5e-324, "n": 2**53 + 1, "kind": "ü\u2028"}
        with store.transaction() as change:
            (trial,) = change.propose(
                study.id, study.token, strategy="s", history=0, pending=[], rng_key=[], seconds=0.0,
                trials=[NewTrial(params, seed=2**64 - 1)],
            )  # fmt: skip
        assert trial.params == params
        assert list(trial.params) == list(params)
        assert store.trial(study.id, 0) == trial
        assert trial.seed == 2**64 - 1

    def test_a_started_trial_has_a_live_attempt(self, store, study):
        trial, attempt = study.running()
        assert (attempt.number, attempt.state, attempt.first_iteration) == (1, AttemptState.RUNNING, 0)
        assert (attempt.worker, attempt.host, attempt.pid) == ("w1", "here", 9)
        assert store.attempts(trial.id) == [attempt]
        after = study.trial(0)
        assert (after.state, after.attempts) == (TrialState.RUNNING, 1)
        assert after.started_at is not None

    def test_a_running_trial_is_not_started_again(self, study):
        trial, _ = study.running()
        with pytest.raises(Refused, match="the start of trial 0: expected it queued, found it running"):
            study.start(trial)

    def test_reports_keep_the_curve_and_the_cost_and_raise_the_beat(self, store, study):
        trial, attempt = study.running()
        for iteration in (1, 2, 3):
            study.do(
                "report", attempt.id, attempt.token, iteration=iteration, metrics={"r": iteration / 3},
                samples=100 * iteration, seconds=0.5 * iteration,
            )  # fmt: skip
        study.do("report", attempt.id, attempt.token, iteration=3, metrics={"r": 9.0}, samples=310, seconds=1.6)
        curve = store.metrics(trial.id)
        assert [(row.iteration, row.attempt, row.values) for row in curve] == [
            (1, 1, {"r": 1 / 3}),
            (2, 1, {"r": 2 / 3}),
            (3, 1, {"r": 9.0}),
        ]
        assert store.metrics(trial.id, after=2) == curve[2:]
        after = study.trial(0)
        assert (after.iteration, after.samples, after.seconds) == (3, 310, 1.6)
        assert store.attempts(trial.id)[0].beat == 4
        assert kinds(store)[-4:] == ["progress"] * 4

    def test_the_next_attempt_begins_at_the_iteration_reached_with_a_higher_token(self, store, study):
        trial, first = study.running()
        study.do("report", first.id, first.token, iteration=5, metrics={}, samples=1, seconds=1.0)
        study.do("preempt", first.id, first.token, "shutdown")
        second = study.start(trial)
        assert second.number == 2
        assert second.token > first.token
        assert second.first_iteration == 5
        assert [attempt.state for attempt in store.attempts(trial.id)] == ["preempted", "running"]

    def test_a_beat_is_no_event(self, store, study):
        trial, attempt = study.running()
        before = store.last_event()
        study.do("beat", attempt.id, attempt.token)
        (after,) = store.attempts(trial.id)
        assert after.beat == attempt.beat + 1
        assert after.beat_at >= attempt.beat_at
        assert store.last_event() == before

    def test_a_finished_trial_is_final_and_keeps_all_in_one_commit(self, store, study):
        trial, attempt = study.running()
        result = Result(
            TrialState.COMPLETE,
            value=0.1 + 0.2,
            features=(1.0, -0.5),
            samples=1234,
            seconds=5.5,
            message="fine",
            details={"bar": 0.92},
            artifacts=[NewArtifact("b", "1/b", "b" * 64, 2), NewArtifact("a", "1/a", "a" * 64, 1)],
        )
        final = study.finish(attempt, result)
        assert final == study.trial(0)
        assert (final.state, final.position, final.value) == (TrialState.COMPLETE, 0, 0.1 + 0.2)
        assert (final.features, final.samples, final.seconds) == ((1.0, -0.5), 1234, 5.5)
        assert (final.message, final.details) == ("fine", {"bar": 0.92})
        assert final.finished_at is not None
        assert [(file.name, file.path, file.sha256, file.size) for file in store.artifacts(trial.id)] == [
            ("a", "1/a", "a" * 64, 1),
            ("b", "1/b", "b" * 64, 2),
        ]
        (event,) = [event for event in store.events() if event.kind == "finished"]
        assert (event.study, event.study_id, event.trial) == ("jump", study.id, 0)
        assert event.payload["features"] == [1.0, -0.5]

    def test_values_come_back_as_floats_even_where_they_are_whole(self, study):
        final = study.finish(study.running()[1], Result(TrialState.COMPLETE, value=3, features=(1, 2), seconds=4))
        for row in (final, study.trial(0)):
            assert isinstance(row.value, float)
            assert isinstance(row.seconds, float)
            assert all(isinstance(value, float) for value in row.features)

    def test_history_positions_follow_the_order_of_finish_without_holes(self, store, study):
        trials = study.propose(5)
        attempts = [study.start(trial) for trial in trials]
        study.finish(attempts[3])
        study.do("cancel_trial", trials[0].id, study.token, "not wanted")
        study.finish(attempts[1], Result(TrialState.INFEASIBLE))
        study.do("fail", attempts[4].id, attempts[4].token, "broke")
        study.do("give_up", trials[4].id, study.token, "out of retries")
        study.finish(attempts[2], Result(TrialState.DIVERGED))
        assert [(trial.number, trial.position) for trial in store.history(study.id)] == [(3, 0), (1, 1), (4, 2), (2, 3)]
        assert [trial.number for trial in store.history(study.id, start=2)] == [4, 2]
        assert study.trial(0).position is None

    def test_positions_of_studies_are_their_own(self, store, study):
        other = Study(store, "other")
        study.finish(study.running()[1])
        assert other.finish(other.running()[1]).position == 0
        assert study.finish(study.running()[1]).position == 1

    def test_an_open_state_is_no_result(self, study):
        _, attempt = study.running()
        for state in (TrialState.QUEUED, TrialState.RUNNING, TrialState.CANCELLED):
            with pytest.raises(ValueError, match=f"found <TrialState.{state.name}"):
                study.finish(attempt, Result(state))
        assert study.trial(0).state is TrialState.RUNNING

    @pytest.mark.parametrize(
        ("transition", "state", "retries"), [("lose", "lost", 1), ("fail", "failed", 1), ("preempt", "preempted", 0)]
    )
    def test_an_attempt_that_ends_without_an_outcome_puts_its_trial_back(
        self, store, study, transition, state, retries
    ):
        trial, attempt = study.running()
        after = study.do(transition, attempt.id, attempt.token, "because")
        assert (after.state, after.retries, after.attempts) == (TrialState.QUEUED, retries, 1)
        (ended,) = store.attempts(trial.id)
        assert (ended.state, ended.reason) == (AttemptState(state), "because")
        event = store.events()[-1]
        assert (event.kind, event.trial) == (state, 0)
        assert event.payload == {"attempt": 1, "reason": "because", "retries": retries}

    def test_a_late_result_of_a_lost_attempt_is_refused(self, store, study):
        trial, first = study.running()
        study.do("lose", first.id, first.token, "no beat for 60 s")
        second = study.start(trial)
        before = store.last_event()
        late = {
            "report": {"iteration": 1, "metrics": {}, "samples": 1, "seconds": 1.0},
            "beat": {},
            "finish": {"result": DONE},
            "lose": {"reason": "x"},
            "fail": {"reason": "x"},
            "preempt": {"reason": "x"},
        }
        for transition, values in late.items():
            with pytest.raises(Refused, match=r"attempt 1 of trial 0: .*found it lost \(no beat for 60 s\)"):
                study.do(transition, first.id, first.token, **values)
            with pytest.raises(Refused, match="attempt 2 of trial 0: expected its token 2, found 1"):
                study.do(transition, second.id, first.token, **values)
        assert store.last_event() == before
        assert store.metrics(trial.id) == []
        assert study.finish(second).position == 0

    def test_a_result_is_not_taken_twice(self, study):
        _, attempt = study.running()
        study.finish(attempt)
        with pytest.raises(Refused, match="expected it running, found it complete"):
            study.finish(attempt)

    def test_an_attempt_that_never_was_is_refused(self, study):
        with pytest.raises(Refused, match="found none of that id"):
            study.do("beat", 999_999, 1)
        with pytest.raises(Refused, match="expected trial id 999999, found none"):
            study.do("give_up", 999_999, study.token, "x")

    def test_only_a_queued_trial_is_given_up(self, store, study):
        trial, attempt = study.running()
        with pytest.raises(Refused, match="giving up of trial 0: expected it queued, found it running"):
            study.do("give_up", trial.id, study.token, "x")
        study.do("fail", attempt.id, attempt.token, "broke")
        final = study.do("give_up", trial.id, study.token, "failed 1 time: broke")
        assert (final.state, final.position, final.message) == (TrialState.FAILED, 0, "failed 1 time: broke")
        assert store.history(study.id) == [final]

    def test_cancelling_a_trial_ends_its_attempt(self, store, study):
        trial, attempt = study.running()
        final = study.do("cancel_trial", trial.id, study.token, "asked to")
        assert (final.state, final.message, final.position) == (TrialState.CANCELLED, "asked to", None)
        assert store.attempts(trial.id)[0].state is AttemptState.CANCELLED
        with pytest.raises(Refused, match="found it cancelled"):
            study.finish(attempt)
        with pytest.raises(Refused, match="expected it queued or running, found it cancelled"):
            study.do("cancel_trial", trial.id, study.token, "again")

    def test_trials_are_listed_by_window_and_by_state(self, store, study):
        trials = study.propose(6)
        for trial in trials[::2]:
            study.finish(study.start(trial))
        numbers = lambda **which: [trial.number for trial in store.trials(study.id, **which)]  # noqa: E731 - a name for one line
        assert numbers() == [0, 1, 2, 3, 4, 5]
        assert numbers(after=1, limit=3) == [2, 3, 4]
        assert numbers(states=[TrialState.COMPLETE]) == [0, 2, 4]
        assert numbers(states={TrialState.QUEUED, TrialState.RUNNING}, after=1) == [3, 5]
        assert numbers(states=[]) == []

    def test_an_unknown_trial_is_told_with_what_there_is(self, store, study):
        with pytest.raises(UnknownTrial, match="trial 0 of study 'jump': expected a study that has trials"):
            store.trial(study.id, 0)
        study.propose(3)
        with pytest.raises(UnknownTrial, match="trial 3 of study 'jump': expected a number from 0 to 2"):
            store.trial(study.id, 3)


class TestNumbersThatAreNone:
    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
    def test_a_result_that_is_no_number_is_an_error_that_says_so(self, study, bad):
        _, attempt = study.running()
        for result, what in (
            (Result(TrialState.COMPLETE, value=bad), "result.value"),
            (Result(TrialState.COMPLETE, features=(0.0, bad)), "result.features"),
            (Result(TrialState.COMPLETE, details={"bar": bad}), "result.details"),
            (Result(TrialState.COMPLETE, seconds=bad), "result.seconds"),
        ):
            with pytest.raises(ValueError, match=rf"{what}.*expected .*finite"):
                study.finish(attempt, result)
        with pytest.raises(ValueError, match="metrics of iteration 1: expected numbers that are finite"):
            study.do("report", attempt.id, attempt.token, iteration=1, metrics={"r": bad}, samples=1, seconds=1.0)
        assert study.trial(0).state is TrialState.RUNNING
        assert study.store.metrics(study.trial(0).id) == []
        assert study.finish(attempt).state is TrialState.COMPLETE

    def test_text_that_a_broken_program_printed_is_kept_readably(self, study):
        _, attempt = study.running()
        final = study.finish(attempt, Result(TrialState.FAILED, message="core\0dump \udc80"))
        assert final.message == "core\\0dump \\udc80"


class TestTransactions:
    def test_an_exception_undoes_all(self, store, study):
        before = store.last_event(), store.study("jump")

        def write_and_break():
            with store.transaction() as change:
                change.create_study("other", {}, seed=1)
                change.ask("jump", "pause")
                raise KeyError

        with pytest.raises(KeyError):
            write_and_break()
        assert (store.last_event(), store.study("jump")) == before
        assert len(store.studies()) == 1

    def test_a_refused_transition_leaves_the_rest_of_the_transaction_standing(self, store, study):
        trials = study.propose(2)
        first, second = (study.start(trial) for trial in trials)
        study.do("lose", first.id, first.token, "gone")
        with store.transaction() as change:
            with pytest.raises(Refused):
                change.finish(first.id, first.token, DONE)
            change.note("refused", study_id=study.id, trial=0, what="a late result")
            change.finish(second.id, second.token, DONE)
        assert study.trial(0).state is TrialState.QUEUED
        assert study.trial(1).state is TrialState.COMPLETE
        assert [(event.kind, event.trial, event.payload) for event in store.events()[-2:-1]] == [
            ("refused", 0, {"what": "a late result"})
        ]

    def test_a_taken_name_leaves_the_rest_of_the_transaction_standing(self, store, study):
        with store.transaction() as change:
            with pytest.raises(NameTaken):
                change.create_study("jump", {}, seed=1)
            change.create_study("other", {}, seed=1)
        assert {row.name for row in store.studies()} == {"jump", "other"}

    def test_nothing_is_seen_before_the_commit(self, store):
        with store.transaction() as change:
            change.create_study("jump", {}, seed=1)
            assert store.studies() == []
            assert store.last_event() == 0
        assert len(store.studies()) == 1

    def test_a_transaction_within_one_is_an_error_and_no_deadlock(self, store):
        with store.transaction(), pytest.raises(RuntimeError, match="expected no open transaction in this thread"):
            store.transaction().__enter__()

    def test_a_change_is_of_no_use_after_its_transaction(self, store):
        with store.transaction() as change:
            change.create_study("jump", {}, seed=1)
        with pytest.raises(RuntimeError, match="this transaction has ended"):
            change.ask("jump", "pause")

    def test_writers_wait_for_each_other_and_lose_nothing(self, store, database):
        """Two stores, as two processes have them, and two threads on each."""
        other = open_store(database)
        failures = []

        def write(to, name):
            try:
                for i in range(10):
                    with to.transaction() as change:
                        change.create_study(f"{name}-{i}", {}, seed=i)
            except Exception as error:  # noqa: BLE001 - carried to the assertion below
                failures.append(error)

        threads = [threading.Thread(target=write, args=(to, f"{i}")) for i, to in enumerate([store, other] * 2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        other.close()
        assert failures == []
        assert len(store.studies()) == 40


class TestEvents:
    def test_a_cursor_sees_every_event_once_and_in_order(self, store, study):
        study.finish(study.running()[1])
        events = store.events()
        assert [event.kind for event in events] == ["created", "driven", "proposed", "started", "finished"]
        assert [event.id for event in events] == sorted({event.id for event in events})
        assert store.last_event() == events[-1].id
        assert store.events(after=events[1].id, limit=2) == events[2:4]
        assert store.events(after=events[-1].id) == []

    def test_events_of_one_study(self, store, study):
        study.do("create_study", "other", {}, seed=1)
        study.do("note", "warning", text="of nobody")
        assert kinds(store, study_id=study.id) == ["created", "driven"]
        nobody = store.events()[-1]
        assert (nobody.study_id, nobody.study, nobody.trial, nobody.payload) == (
            None,
            None,
            None,
            {"text": "of nobody"},
        )

    def test_a_cursor_skips_nothing_while_many_write(self, store, database):
        writers = [open_store(database) for _ in range(4)]

        def write(to):
            for i in range(25):
                with to.transaction() as change:
                    for _ in range(i % 3 + 1):
                        change.note("warning")

        threads = [threading.Thread(target=write, args=(to,)) for to in writers]
        for thread in threads:
            thread.start()
        seen = []
        while any(thread.is_alive() for thread in threads):
            seen += [event.id for event in store.events(after=seen[-1] if seen else 0)]
        seen += [event.id for event in store.events(after=seen[-1] if seen else 0)]
        for to in writers:
            to.close()
        assert seen == [event.id for event in store.events()]
        assert len(seen) == 4 * (8 * 6 + 1)

    def test_the_history_keeps_its_identity_over_reopening(self, store, database):
        again = open_store(database)
        assert again.history_id() == store.history_id()
        assert len(store.history_id()) == 32
        again.close()

    def test_the_history_of_another_database_is_another_one(self, store, tmp_path):
        other = open_store(tmp_path / "other.db")
        assert other.history_id() != store.history_id()
        other.close()
