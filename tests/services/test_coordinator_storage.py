"""The coordinator while its database, or the storage of files, is away."""

import pytest
from driven import World

from services.coordinator import WORKER_LEASE_SECONDS
from services.dispatch.port import Beat, Hindered
from services.errors import DatabaseUnavailable
from services.states import AttemptState, StudyState


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


def test_workers_are_not_taken_for_lost_while_their_driver_waits_for_its_database(tmp_path):
    world = World(tmp_path / "halma.db")
    world.store = flaky = Flaky(world.store)
    world.coordinator = world.driver()
    world.coordinator.take("s")
    world.steps()
    for given in world.dispatcher.given:
        world.dispatcher.inbox.append(Beat(given.attempt, given.token))
    world.steps(1)
    for moment in ("a message", "the driver's own beat"):
        flaky.fail_before = 40
        began = world.clock.now
        if moment == "a message":
            world.dispatcher.report(world.dispatcher.given[0], 1)
        else:
            world.clock.now += 3.0
        world.steps(1)
        assert world.clock.now - began > 4 * WORKER_LEASE_SECONDS
        for given in world.dispatcher.given:
            world.dispatcher.inbox.append(Beat(given.attempt, given.token))
        world.steps(2)
        assert world.dispatcher.killed == [], moment
    assert world.states() == ["running", "running"]
    world.store.close()


def test_a_driver_that_was_itself_stopped_listens_before_it_takes_workers_for_lost(world):
    world.steps()
    first, second = world.dispatcher.given
    world.dispatcher.inbox += [Beat(given.attempt, given.token) for given in (first, second)]
    answers = world.coordinator._strategist.answers

    def stopped_for_a_while():
        world.clock.now += 10 * WORKER_LEASE_SECONDS
        world.coordinator._strategist.answers = answers
        return answers()

    world.coordinator._strategist.answers = stopped_for_a_while
    world.steps(1)
    world.dispatcher.inbox.append(Beat(first.attempt, first.token))  # it had been sent meanwhile
    world.steps(1)
    assert world.dispatcher.killed == [second.attempt], "only who has really said nothing"


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
