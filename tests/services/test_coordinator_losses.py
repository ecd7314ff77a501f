"""What the coordinator does about workers that vanish, errors of tasks, and trials that come to nothing."""

import pytest
from driven import pair

from services.coordinator import START_LEASE_SECONDS, WORKER_LEASE_SECONDS
from services.dispatch.port import Beat, Crashed, Reported, Vanished
from services.states import AttemptState, StudyState, TrialState
from workers.contracts import Job


@pair
def test_a_vanished_worker_costs_one_attempt_after_a_pause(world):
    world.steps(2, seconds=0.1)
    given = world.dispatcher.given[0]
    world.dispatcher.inbox.append(Vanished(given.attempt, given.token, reason="gone"))
    world.steps(3, seconds=0.1)
    assert world.attempts(0) == [AttemptState.LOST]
    assert world.states()[0] == "queued"  # it backs off
    world.steps(4, seconds=1.0)
    assert world.attempts(0) == [AttemptState.LOST, AttemptState.RUNNING]
    assert world.trials()[0].seed == Job.from_json(given.job).seed


@pair
def test_a_worker_that_is_not_heard_of_is_ended_and_its_late_result_refused(world):
    world.steps()
    silent, other = world.dispatcher.given
    world.dispatcher.inbox += [Beat(silent.attempt, silent.token), Beat(other.attempt, other.token)]
    world.steps(1)
    world.clock.now += WORKER_LEASE_SECONDS - 5
    world.dispatcher.inbox.append(Beat(other.attempt, other.token))
    world.steps(1, seconds=6.0)
    world.steps(1)
    assert world.dispatcher.killed == [silent.attempt]
    world.steps(4)
    world.dispatcher.end(silent, value=9.0)
    world.steps(2)
    trial = world.trials()[0]
    assert (trial.state, trial.value) == (TrialState.RUNNING, None)
    refused = world.events("refused")[-1]
    assert refused.payload["attempt"] == silent.attempt
    assert "expected it running, found it lost" in refused.payload["reason"]


def test_a_worker_process_that_is_still_starting_is_given_time(world):
    world.steps()
    world.clock.now += START_LEASE_SECONDS - 10
    world.steps(1)
    assert world.dispatcher.killed == []


@pytest.mark.parametrize("world", [["search.trials=1"]], indirect=True, ids=["one trial"])
def test_a_worker_whose_predecessor_did_not_start_in_time_is_given_twice_the_time(world):
    """On a machine that is slow for everybody, ending it at the same moment again would get nowhere."""
    world.steps()
    world.clock.now += START_LEASE_SECONDS + 1
    world.steps(1)
    assert world.attempts(0) == [AttemptState.LOST]
    world.clock.now += 10
    world.steps()
    world.clock.now += 2 * START_LEASE_SECONDS - 10
    world.steps(1)
    assert world.attempts(0) == [AttemptState.LOST, AttemptState.RUNNING]
    world.clock.now += 20
    world.steps(1)
    assert world.attempts(0) == [AttemptState.LOST, AttemptState.LOST]


@pair
def test_a_trial_that_loses_every_worker_becomes_a_failure_on_record(world):
    for _ in range(2):
        world.steps()
        given = [assignment for assignment in world.dispatcher.given if assignment.trial == 0][-1]
        world.dispatcher.inbox.append(Vanished(given.attempt, given.token, reason="no memory"))
        world.steps(1)
    trial = world.trials()[0]
    assert (trial.state, trial.position) == (TrialState.FAILED, 0)
    assert trial.message == "its worker was lost 2 times; the last time: no memory"


@pair
def test_a_trial_that_comes_further_each_time_may_lose_any_number_of_workers(world):
    for iteration in range(1, 6):
        world.steps()
        given = [assignment for assignment in world.dispatcher.given if assignment.trial == 0][-1]
        world.dispatcher.inbox += [
            Reported(given.attempt, given.token, iteration=iteration, metrics={}, samples=iteration, seconds=0.1),
            Vanished(given.attempt, given.token, reason="the host went home"),
        ]
        world.steps(4)
    assert world.attempts(0)[:5] == [AttemptState.LOST] * 5
    assert world.trials()[0].state is TrialState.RUNNING
    for _ in range(2):  # and then it gets nowhere twice
        given = [assignment for assignment in world.dispatcher.given if assignment.trial == 0][-1]
        world.dispatcher.inbox.append(Vanished(given.attempt, given.token, reason="gone"))
        world.steps(4)
    assert (world.trials()[0].state, world.trials()[0].retries) == (TrialState.FAILED, 7)


@pair
def test_the_tasks_own_error_is_tried_again_and_then_an_observation(world):
    for _ in range(2):
        world.steps()
        given = [assignment for assignment in world.dispatcher.given if assignment.trial == 0][-1]
        world.dispatcher.inbox.append(Crashed(given.attempt, given.token, message="ValueError: no"))
        world.steps(1)
    trial = world.trials()[0]
    assert world.attempts(0) == [AttemptState.FAILED, AttemptState.FAILED]
    assert (trial.state, trial.message) == (TrialState.FAILED, "ValueError: no")


def test_an_error_that_no_retry_mends_is_final_at_once(world):
    world.steps()
    given = world.dispatcher.given[0]
    world.dispatcher.inbox.append(Crashed(given.attempt, given.token, message="bad", retry=False))
    world.steps(1)
    assert world.trials()[0].state is TrialState.FAILED


def test_a_failure_keeps_what_its_trial_had_cost(world):
    world.steps()
    given = world.dispatcher.given[0]
    world.dispatcher.inbox.append(
        Reported(given.attempt, given.token, iteration=3, metrics={}, samples=40, seconds=0.5)
    )
    world.dispatcher.inbox.append(Crashed(given.attempt, given.token, message="bad", retry=False))
    world.steps(1)
    trial = world.trials()[0]
    assert (trial.state, trial.samples, trial.seconds) == (TrialState.FAILED, 40, 0.5)


def test_a_divergence_is_an_observation_and_the_study_goes_on(world):
    world.steps()
    world.dispatcher.end(world.dispatcher.given[0], status="diverged", message="iteration 3: reward became NaN")
    world.steps()
    assert world.states() == ["diverged", "running", "running"]
    assert world.trials()[0].message == "iteration 3: reward became NaN"


def test_a_study_whose_every_trial_fails_stops_with_the_reason(world):
    world.steps()
    for assignment in list(world.dispatcher.given):
        world.dispatcher.inbox.append(Crashed(assignment.attempt, assignment.token, message="no module", retry=False))
    world.steps()
    row = world.store.study("s")
    assert row.state is StudyState.FAILED
    assert row.reason == "the last 2 trials all failed (stop_after_failures: 2); the newest: no module"


def test_a_study_of_which_nothing_but_divergence_comes_stops_with_the_reason(world):
    """`stop_after_failures` is 2; four times as many, from the first trial on."""
    with world.store.transaction() as change:
        change.extend("s", trials=20)
    done = 0
    for _ in range(20):
        world.steps()
        row = world.store.study("s")
        if row.state is StudyState.FAILED:
            break
        for assignment in world.dispatcher.given[done:]:
            world.dispatcher.end(assignment, status="diverged", message="iteration 1: reward became NaN")
        done = len(world.dispatcher.given)
    assert row.state is StudyState.FAILED
    diverged = row.counts["diverged"]
    assert 8 <= diverged < 8 + 4
    assert row.reason.startswith(
        f"all of the first {diverged} trials diverged; the newest: iteration 1: reward became NaN;"
    )
    assert "halma task check" in row.reason


def test_a_failed_study_that_is_resumed_gets_a_new_chance(world):
    test_a_study_whose_every_trial_fails_stops_with_the_reason(world)
    with world.store.transaction() as change:
        change.ask("s", "run")
    world.coordinator.take("s")
    world.steps()
    world.dispatcher.end(world.dispatcher.given[-1])
    world.steps()
    assert world.store.study("s").state is StudyState.COMPLETE
