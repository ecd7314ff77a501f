"""The coordinator over a real SQLite store, with a scripted dispatcher in place of workers."""

import pytest
from driven import Scripted, World

from services.coordinator import START_LEASE_SECONDS, WORKER_LEASE_SECONDS
from services.dispatch.port import Beat, Began, Crashed, Hindered, Reported, Stopped, Vanished
from services.errors import DatabaseUnavailable, StudyDriven
from services.proposing import proposal_key
from services.states import AttemptState, StudyState, TrialState
from services.store.port import Driver
from workers.contracts import Job


@pytest.fixture(params=[()])
def world(request, tmp_path):
    made = World(tmp_path / "halma.db", overrides=request.param)
    made.coordinator.take("s")
    yield made
    made.store.close()


pair = pytest.mark.parametrize("world", [["search.trials=2"]], indirect=True, ids=["two trials"])
"""As many trials as slots, so that a retry finds its slot free."""


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


def test_pause_stops_at_checkpoints_and_the_next_driver_goes_on(world):
    world.steps()
    with world.store.transaction() as change:
        change.ask("s", "pause")
    world.steps(1)
    assert sorted(world.dispatcher.stopped) == [assignment.attempt for assignment in world.dispatcher.given]
    world.dispatcher.inbox += [Stopped(given.attempt, given.token) for given in world.dispatcher.given]
    world.steps(2)
    row = world.store.study("s")
    assert (row.state, row.reason) == (StudyState.PAUSED, "paused by request")
    assert world.attempts(0) == [AttemptState.PREEMPTED]
    with world.store.transaction() as change:
        change.ask("s", "run")
    world.coordinator.take("s")
    world.steps()
    assert world.attempts(0) == [AttemptState.PREEMPTED, AttemptState.RUNNING]
    assert world.trials()[0].retries == 0


def test_a_pause_that_is_taken_back_in_time_only_costs_a_stop(world):
    world.steps()
    first, second = world.dispatcher.given
    ask(world, "pause")
    world.steps(1)
    world.dispatcher.inbox.append(Stopped(first.attempt, first.token))
    world.steps(1)
    ask(world, "run")
    world.dispatcher.inbox.append(Stopped(second.attempt, second.token))
    world.steps(4)
    row = world.store.study("s")
    assert (row.state, row.driver is not None) == (StudyState.RUNNING, True)
    assert world.attempts(0) == world.attempts(1) == [AttemptState.PREEMPTED, AttemptState.RUNNING]


def test_an_extension_between_the_last_result_and_the_release_is_not_lost(world):
    world.steps()
    for _ in range(2):
        for given in world.dispatcher.given:
            if given.attempt not in world.dispatcher.over:
                world.dispatcher.end(given)
        world.steps(1)
    (last,) = [given for given in world.dispatcher.given if given.attempt not in world.dispatcher.over]
    world.dispatcher.end(last)
    world.coordinator._control_due = world.clock.now + 60  # it has just looked
    with world.store.transaction() as change:
        change.extend("s", trials=2)
    world.steps(3)
    assert world.store.study("s").state is StudyState.RUNNING
    assert world.states() == ["complete"] * 3 + ["running"] * 2


def ask(world, wanted):
    with world.store.transaction() as change:
        change.ask("s", wanted)


def test_a_running_study_follows_what_is_changed_of_it(world):
    world.steps()
    with world.store.transaction() as change:
        change.amend("s", {"resources.parallel": 3, "retries.limit": 0})
    world.steps()
    assert [given.trial for given in world.dispatcher.given] == [0, 1, 2]
    given = world.dispatcher.given[0]
    world.dispatcher.inbox.append(Vanished(given.attempt, given.token, reason="gone"))
    world.steps(1)
    assert world.states()[0] == "failed"


def test_a_worker_that_reaches_no_checkpoint_in_time_is_ended(world):
    world.steps()
    world.coordinator.leave(StudyState.PAUSED, "interrupted")
    world.steps(1)
    assert world.store.study("s").state is StudyState.RUNNING
    world.clock.now += 60
    world.steps(2)
    assert world.dispatcher.killed == [given.attempt for given in world.dispatcher.given]
    row = world.store.study("s")
    assert (row.state, row.reason) == (StudyState.PAUSED, "interrupted")
    assert world.attempts(1) == [AttemptState.PREEMPTED]


def test_cancel_ends_open_trials(world):
    world.steps()
    world.dispatcher.end(world.dispatcher.given[0])
    world.steps(1)
    with world.store.transaction() as change:
        change.ask("s", "cancel")
    world.steps(1)
    running = [given for given in world.dispatcher.given if given.attempt not in world.dispatcher.over]
    world.dispatcher.inbox += [Stopped(given.attempt, given.token) for given in running]
    world.steps(2)
    assert world.store.study("s").state is StudyState.CANCELLED
    assert world.states() == ["complete", "cancelled", "cancelled"]


def test_a_second_driver_is_told_who_drives(world):
    world.steps()
    with pytest.raises(StudyDriven, match="s"):
        world.driver().take("s")


def test_a_driver_that_was_taken_over_ends_its_workers_and_writes_no_more(world):
    world.steps()
    old = list(world.dispatcher.given)
    second = Scripted()
    successor = world.driver(second)
    successor.take("s", take_over=True)
    world.dispatcher.end(old[0], value=9.0)
    world.steps(2)
    assert world.coordinator.driven() == []
    assert sorted(world.dispatcher.killed) == [given.attempt for given in old]
    assert world.trials()[0].value is None
    world.coordinator = successor
    world.steps()
    assert [given.trial for given in second.given] == [0, 1]
    assert world.attempts(0) == [AttemptState.LOST, AttemptState.RUNNING]
    assert world.trials()[0].retries == 0
    assert world.events("driver_fenced")


def test_a_driver_on_another_host_is_taken_over_once_its_beat_stands_still(world, tmp_path):
    other = World(tmp_path / "other.db")
    with other.store.transaction() as change:
        change.drive("s", Driver(id="x", host="elsewhere.invalid", pid=1))
    other.coordinator.take("s")  # watches for a lease's length by its own clock
    assert other.coordinator.driven() == ["s"]
    assert other.clock.now >= 1015.0
    other.store.close()


def test_a_beating_driver_on_another_host_is_left_alone(tmp_path):
    world = World(tmp_path / "halma.db")
    with world.store.transaction() as change:
        token = change.drive("s", Driver(id="x", host="elsewhere.invalid", pid=1))
    asleep = world.clock.sleep

    def sleep(seconds):
        asleep(seconds)
        with world.store.transaction() as change:
            change.beat_drive(world.row.id, token)

    world.clock.sleep = sleep
    world.coordinator = world.driver()
    with pytest.raises(StudyDriven, match=r"elsewhere\.invalid"):
        world.coordinator.take("s")
    world.store.close()


class Flaky:
    """A store whose transactions fail for a while, before or after the commit."""

    def __init__(self, store):
        self._store = store
        self.fail_before = self.fail_after = 0

    def __getattr__(self, name):
        return getattr(self._store, name)

    def transaction(self):
        flaky = self

        class Around:
            def __enter__(self):
                if flaky.fail_before > 0:
                    flaky.fail_before -= 1
                    raise DatabaseUnavailable("away")
                self.inner = flaky._store.transaction()
                return self.inner.__enter__()

            def __exit__(self, *exception):
                handled = self.inner.__exit__(*exception)
                if flaky.fail_after > 0 and exception[0] is None:
                    flaky.fail_after -= 1
                    raise DatabaseUnavailable("the answer to the commit was lost")
                return handled

        return Around()


@pytest.mark.parametrize("moment", ["fail_before", "fail_after"])
@pytest.mark.parametrize("step", range(12))
def test_no_result_is_lost_or_doubled_when_the_database_goes_away_at_any_commit(tmp_path, moment, step):
    world = World(tmp_path / "halma.db")
    world.store = flaky = Flaky(world.store)
    world.coordinator = world.driver()
    world.coordinator.take("s")
    for tick in range(30):
        if tick == step:
            setattr(flaky, moment, 2)
        world.steps(1)
        for given in world.dispatcher.given:
            if given.attempt not in world.dispatcher.over and not any(
                message.attempt == given.attempt for message in world.dispatcher.inbox
            ):
                world.dispatcher.end(given, value=float(given.trial))
    assert world.store.study("s").state is StudyState.COMPLETE
    assert [(trial.number, trial.value) for trial in world.trials()] == [(0, 0.0), (1, 1.0), (2, 2.0)]
    assert sorted(trial.position for trial in world.trials()) == [0, 1, 2]
    for number in range(3):
        assert world.attempts(number).count(AttemptState.COMPLETE) == 1
    world.store.close()


def test_a_study_whose_files_can_not_be_kept_says_so_and_loses_nothing(world):
    world.steps()
    first, second = world.dispatcher.given
    world.dispatcher.inbox += [
        Hindered(given.attempt, given.token, reason="No space left on device") for given in (first, second)
    ]
    world.steps(2)
    assert world.store.study("s").reason == "No space left on device"
    world.dispatcher.inbox.append(Hindered(first.attempt, first.token, reason=""))
    world.steps(1)
    assert world.store.study("s").reason == "No space left on device", "the other one still waits"
    world.dispatcher.inbox.append(Hindered(second.attempt, second.token, reason=""))
    world.steps(1)
    row = world.store.study("s")
    assert (row.state, row.reason) == (StudyState.RUNNING, "")
    assert [len(world.events(kind)) for kind in ("waiting", "going_on")] == [1, 1]
    assert world.attempts(0) == world.attempts(1) == [AttemptState.RUNNING]


def test_a_database_that_can_be_read_and_not_written_is_waited_for(tmp_path):
    world = World(tmp_path / "halma.db")
    world.store = flaky = Flaky(world.store)
    world.coordinator = world.driver()
    world.coordinator.take("s")
    world.steps()
    flaky.fail_before = 5
    world.dispatcher.end(world.dispatcher.given[0], value=7.0)
    began = world.clock.now
    world.steps(1)
    assert world.trials()[0].value == 7.0
    assert world.clock.now - began > 3.0
    assert world.coordinator.trouble() == ""
    assert world.told == [
        "Nothing can be recorded, so nothing new is started until it can; running trainings go on. away",
        "The database can be written again: going on.",
    ]
    back = [event for event in world.store.events() if event.kind == "database_back"]
    assert [event.payload["reason"] for event in back] == ["away"]
    world.store.close()


def test_a_read_that_fails_does_not_end_the_driver(tmp_path):
    world = World(tmp_path / "halma.db")
    reads = {"left": 2}
    studies = world.store.studies

    def away():
        if reads["left"]:
            reads["left"] -= 1
            raise DatabaseUnavailable("away")
        world.coordinator.leave(StudyState.QUEUED, "the service stopped")
        return studies()

    world.store.studies = away
    world.coordinator = world.driver()
    world.dispatcher.poll = lambda deliver, timeout: world.clock.sleep(1.0)
    world.coordinator.serve()
    assert reads["left"] == 0
    world.store.close()
