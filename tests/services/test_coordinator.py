"""The coordinator over a real SQLite store, with a scripted dispatcher in place of workers: a study's course."""

import pytest

from services.dispatch.port import Began, Reported, Stopped
from services.proposing import proposal_key
from services.states import AttemptState, StudyState, TrialState
from workers.contracts import Job


def test_as_many_trials_start_as_may_run_at_once(world):
    world.steps()
    assert [assignment.trial for assignment in world.dispatcher.given] == [0, 1]
    assert world.states() == ["running", "running"]


def test_a_trial_is_on_record_before_a_worker_hears_of_it(world):
    seen = []
    start = world.dispatcher.start

    def watched(assignment):
        seen.append((world.store.trial(world.row.id, assignment.trial).state, world.attempts(assignment.trial)))
        return start(assignment)

    world.dispatcher.start = watched
    world.steps()
    assert seen == [(TrialState.RUNNING, [AttemptState.RUNNING])] * 2


def test_the_worker_gets_the_job_that_the_record_describes(world):
    world.steps()
    trial = world.trials()[1]
    job = Job.from_json(world.dispatcher.given[1].job)
    assert (job.trial, job.params, job.seed) == (1, trial.params, trial.seed)
    assert (job.task, job.training, job.study) == ("point_jump", {"budget": {"samples": 100}}, "s")


def test_a_study_ends_when_its_trials_have(world):
    for _ in range(3):
        world.steps()
        for assignment in world.dispatcher.given:
            if assignment.attempt not in world.dispatcher.over:
                world.dispatcher.end(assignment)
    world.steps()
    row = world.store.study("s")
    assert (row.state, row.driver, dict(row.counts)) == (StudyState.COMPLETE, None, {"complete": 3})
    assert [trial.position for trial in world.trials()] == [0, 1, 2]
    assert (row.samples, row.seconds) == (30, 3.0)
    assert world.coordinator.driven() == []


def test_checkpoints_are_dropped_once_the_end_of_their_trial_is_on_record(world):
    world.steps()
    first, second = world.dispatcher.given
    drop = world.dispatcher.drop_checkpoints
    seen = []

    def watched(study_key, trial):
        seen.append(world.store.trial(world.row.id, trial).state)
        drop(study_key, trial)

    object.__setattr__(world.coordinator._arrivals, "drop_checkpoints", watched)
    world.dispatcher.inbox.append(Stopped(second.attempt, second.token))
    world.dispatcher.end(first)
    world.steps(1)
    assert world.dispatcher.dropped == [(f"{world.row.id}-s", 0)], "the one that stopped goes on from its own"
    assert seen == [TrialState.COMPLETE]
    with world.store.transaction() as change:
        change.ask("s", "cancel")
    world.steps(1)
    running = [given for given in world.dispatcher.given if given.attempt not in world.dispatcher.over]
    world.dispatcher.inbox += [Stopped(given.attempt, given.token) for given in running]
    world.steps(2)
    assert sorted(trial for _, trial in world.dispatcher.dropped) == [0, 1, 2]
    assert seen[1:] == [TrialState.CANCELLED] * 2


@pytest.mark.parametrize("world", [["keep_checkpoints=true"]], indirect=True, ids=["kept"])
def test_a_study_may_keep_its_checkpoints(world):
    world.steps()
    world.dispatcher.end(world.dispatcher.given[0])
    world.steps(1)
    assert world.states()[0] == "complete"
    assert world.dispatcher.dropped == []


def test_a_proposal_logs_what_it_saw(world):
    world.steps()
    world.dispatcher.end(world.dispatcher.given[0])
    world.steps()
    first, second = world.store.proposals(world.row.id)
    assert (first.history, first.pending, first.rng_key) == (0, (), proposal_key(5, 0))
    assert (second.history, second.pending, second.rng_key) == (1, (1,), proposal_key(5, 2))


def test_reports_become_the_learning_curve(world):
    world.steps()
    given = world.dispatcher.given[0]
    world.dispatcher.inbox += [
        Began(given.attempt, given.token, host="h", pid=77),
        Reported(given.attempt, given.token, iteration=1, metrics={"return_mean": 0.5}, samples=40, seconds=0.5),
    ]
    world.steps(1)
    trial = world.trials()[0]
    assert [(row.iteration, dict(row.values)) for row in world.store.metrics(trial.id)] == [(1, {"return_mean": 0.5})]
    assert (trial.iteration, trial.samples) == (1, 40)
    assert world.store.attempts(trial.id)[0].pid == 77
