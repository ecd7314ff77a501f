"""What people ask of a running study, and who drives it."""

import pytest
from driven import Scripted, World

from services.dispatch.port import Stopped, Vanished
from services.errors import StudyDriven
from services.states import AttemptState, StudyState
from services.store.port import Driver


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
    world.coordinator._departures._control_due = world.clock.now + 60  # it has just looked
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
