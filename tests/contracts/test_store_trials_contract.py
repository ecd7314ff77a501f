"""What every trial database has to do with trials and their attempts, on every engine."""

from __future__ import annotations

import pytest
from store_study import DONE, Study, kinds

from services.errors import Refused, UnknownTrial
from services.states import AttemptState, TrialState
from services.store.port import NewArtifact, NewTrial, Result


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
