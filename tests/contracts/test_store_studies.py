"""What every trial database has to do with studies and their drivers, on every engine."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from store_study import ME, OTHER, Study, kinds

from services.errors import NameTaken, Refused, StudyDriven, UnknownStudy, WrongState
from services.states import AttemptState, StudyState, TrialState
from services.store.port import Driver, NewArtifact, Result


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
        with pytest.raises(WrongState, match="found 0 trials, cost 0 and 0 rounds"):
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
