"""Several studies on the same pools: priorities, shares in core-seconds, preemption at checkpoints, moves."""

from __future__ import annotations

import json
from collections import Counter
from types import SimpleNamespace

import pytest
from driven import Scripted, World
from hypothesis import given
from hypothesis import strategies as st

from services.dispatch.port import Crashed, Vanished
from services.drive import Live
from services.scheduling import Scheduler
from services.states import AttemptState, StudyState, TrialState


@pytest.fixture
def world(request, tmp_path):
    made = World(tmp_path / "halma.db", overrides=getattr(request, "param", ["search.trials=100000"]))
    made.coordinator.take("s")
    yield made
    made.store.close()


def study_of(assignment):
    return json.loads(assignment.job)["study"]


def attempts_of(world, study, number):
    return world.store.attempts(world.store.trial(world.store.study(study).id, number).id)


def run(world, seconds, lengths, tick=1.0):
    """Let trials run for as long as their study's take; core-seconds that each study had."""
    had, left = Counter(), {}
    for _ in range(round(seconds / tick)):
        for each in world.dispatcher.running():
            had[study_of(each)] += each.cpus * tick
            left[each.attempt] = left.get(each.attempt, lengths[study_of(each)]) - tick
            if left[each.attempt] <= 0:
                world.dispatcher.end(each)
        world.steps(1, seconds=tick)
    return had


class TestShares:
    @pytest.mark.parametrize("world", [["search.trials=100000", "share=2", "resources.parallel=9"]], indirect=True)
    def test_studies_of_shares_two_to_one_get_core_seconds_two_to_one_whatever_their_trials_take(self, world):
        world.dispatcher.size = 5
        world.another("t", "search.trials=100000", "resources.parallel=9", "resources.cpus=2")
        had = run(world, 3000, {"s": 15.0, "t": 65.0}, tick=5.0)
        assert had["s"] / had["t"] == pytest.approx(2.0, rel=0.06)
        # Between the end of a trial and the start of the next one a pass goes by: here 5 s of at least 15.
        assert sum(had.values()) > 0.7 * 5 * 3000, "and the pool is busy"

    def test_equal_studies_share_the_pool_at_once(self, world):
        world.dispatcher.size = 4
        world.another("t", "search.trials=9", "resources.parallel=4")
        world.another("u", "search.trials=9", "resources.parallel=4")
        world.steps(6)
        assert Counter(map(study_of, world.dispatcher.given)) == {"s": 2, "t": 1, "u": 1}

    def test_a_newcomer_shares_from_now_on_and_is_owed_nothing_for_before(self, world):
        world.dispatcher.size = 2
        run(world, 300, {"s": 10.0}, tick=5.0)
        world.another("t", "search.trials=100000", "resources.parallel=2")
        had = run(world, 600, {"s": 10.0, "t": 10.0}, tick=5.0)
        assert had["s"] / had["t"] == pytest.approx(1.0, rel=0.1)

    def test_who_paused_for_a_while_is_owed_nothing_either(self, world):
        world.dispatcher.size = 2
        world.another("t", "search.trials=100000", "resources.parallel=2")
        run(world, 100, {"s": 10.0, "t": 10.0}, tick=5.0)
        with world.store.transaction() as change:
            change.ask("t", "pause")
        run(world, 300, {"s": 10.0, "t": 10.0}, tick=5.0)
        with world.store.transaction() as change:
            change.ask("t", "run")
        world.coordinator.take("t")
        had = run(world, 600, {"s": 10.0, "t": 10.0}, tick=5.0)
        assert had["s"] / had["t"] == pytest.approx(1.0, rel=0.1)

    @pytest.mark.parametrize("world", [["search.trials=100000", "resources.parallel=9"]], indirect=True)
    def test_a_wide_trial_is_not_passed_for_ever_by_narrow_ones(self, world):
        world.dispatcher.size = 4
        world.steps(3)
        world.another("wide", "search.trials=100000", "resources.parallel=1", "resources.cpus=4")
        had = run(world, 1500, {"s": 10.0, "wide": 40.0}, tick=5.0)
        assert had["wide"] / had["s"] == pytest.approx(1.0, rel=0.25)

    def test_a_share_changes_while_the_study_runs(self, world):
        world.dispatcher.size = 2
        world.another("t", "search.trials=100000", "resources.parallel=2")
        with world.store.transaction() as change:
            change.amend("t", {"share": 3.0})
        had = run(world, 900, {"s": 10.0, "t": 10.0}, tick=5.0)
        assert had["t"] / had["s"] == pytest.approx(3.0, rel=0.1)


class TestPriorities:
    def test_studies_of_higher_priority_get_the_slots_first(self, world):
        world.dispatcher.size = 2
        world.another("urgent", "search.trials=9", "priority=5")
        world.steps()
        assert {study_of(given) for given in world.dispatcher.given} == {"urgent"}

    def test_an_urgent_study_preempts_at_a_checkpoint_and_what_it_displaced_goes_on_from_there(self, world):
        world.dispatcher.size = 2
        world.steps()
        first, second = world.dispatcher.running()
        world.dispatcher.report(first, 3)
        world.dispatcher.report(second, 4)
        world.another("urgent", "search.trials=1", "priority=5")
        world.steps(2)
        assert world.dispatcher.stopped == [second.attempt], "one is enough, and the younger has the least to lose"
        assert [study_of(each) for each in world.dispatcher.given] == ["s", "s"], "nothing starts before there is room"
        world.dispatcher.halt(second)
        world.steps(2)
        urgent = world.dispatcher.given[-1]
        assert study_of(urgent) == "urgent"
        trial = world.trials()[1]
        assert (trial.state, trial.retries) == (TrialState.QUEUED, 0)
        (attempt,) = attempts_of(world, "s", 1)
        assert (attempt.state, attempt.reason) == (AttemptState.PREEMPTED, "preempted by urgent (priority 5)")
        world.steps(8)
        assert world.dispatcher.stopped == [second.attempt], "nobody is stopped for who has what he wants"
        world.dispatcher.end(urgent)
        world.steps(2)
        again = world.dispatcher.given[-1]
        assert (study_of(again), again.trial, again.iteration) == ("s", 1, 4)
        assert world.store.study("urgent").state is StudyState.COMPLETE

    def test_the_lowest_priority_gives_way_first(self, world):
        world.dispatcher.size = 3
        world.another("low", "priority=-1", "resources.parallel=1")
        world.steps()
        low = next(each for each in world.dispatcher.given if study_of(each) == "low")
        world.another("urgent", "search.trials=1", "priority=5", "resources.parallel=1")
        world.steps(2)
        assert world.dispatcher.stopped == [low.attempt]

    def test_equals_are_never_stopped_for_each_other(self, world):
        world.dispatcher.size = 2
        world.steps()
        world.another("equal", "search.trials=9")
        world.steps(6)
        assert world.dispatcher.stopped == []

    def test_as_many_narrow_ones_stop_as_a_wide_one_needs_on_one_host(self, world):
        world.dispatcher.size = 2
        world.dispatcher.more = {"default": {"other": 3.0}}
        with world.store.transaction() as change:
            change.amend("s", {"resources.parallel": 5})
        world.steps()
        assert Counter(world.dispatcher.at.values()) == {"host": 2, "other": 3}
        world.another("urgent", "search.trials=1", "priority=5", "resources.cpus=2")
        world.steps(3)
        assert len(world.dispatcher.stopped) == 2
        assert len({world.dispatcher.at[attempt] for attempt in world.dispatcher.stopped}) == 1
        for each in world.dispatcher.running():
            if each.attempt in world.dispatcher.stopped:
                world.dispatcher.halt(each)
        world.steps(3)
        assert study_of(world.dispatcher.given[-1]) == "urgent"

    def test_a_priority_that_is_raised_counts_at_once(self, world):
        world.dispatcher.size = 2
        world.another("later", "search.trials=9")
        world.steps()
        with world.store.transaction() as change:
            change.amend("later", {"priority": 3})
        world.steps(2)
        stopped = {study_of(each) for each in world.dispatcher.given if each.attempt in world.dispatcher.stopped}
        assert stopped == {"s"}


class TestPools:
    def test_a_study_is_moved_to_another_pool_at_its_next_checkpoints(self, world):
        world.dispatcher.more = {"gpu": {"box": 2.0}}
        world.steps()
        first, second = world.dispatcher.running()
        world.dispatcher.report(first, 2)
        with world.store.transaction() as change:
            change.amend("s", {"resources.pool": "gpu"})
        world.steps(2)
        assert sorted(world.dispatcher.stopped) == [first.attempt, second.attempt]
        world.dispatcher.halt(first)
        world.dispatcher.halt(second)
        world.steps(2)
        assert [(each.trial, each.pool, each.iteration) for each in world.dispatcher.running()] == [
            (0, "gpu", 2),
            (1, "gpu", 0),
        ]
        assert attempts_of(world, "s", 0)[0].reason == "moved to pool gpu"
        assert world.trials()[0].retries == 0

    def test_a_pool_without_a_host_is_told_and_what_runs_is_let_run(self, world):
        world.steps()
        with world.store.transaction() as change:
            change.amend("s", {"resources.pool": "gpu"})
        world.steps(3)
        assert world.store.study("s").reason == "", "a host may be about to join"
        world.steps(8)
        row = world.store.study("s")
        assert row.state is StudyState.RUNNING
        assert row.reason == (
            "waits for a host: expected one with 1 core in pool gpu, found no host in it; let one join, or change the "
            "study: halma set s pool=NAME cpus=N (other pools: default (8))"
        )
        assert world.events("waiting")[-1].payload["reason"] == row.reason
        assert world.dispatcher.stopped == []
        world.dispatcher.more = {"gpu": {"box": 2.0}}
        world.steps(4)
        assert world.store.study("s").reason == ""
        assert len(world.dispatcher.stopped) == 2, "now it moves"

    @pytest.mark.parametrize("world", [["resources.cpus=9"]], indirect=True)
    def test_a_trial_too_wide_for_every_host_is_told(self, world):
        world.another("t", "search.trials=9")
        world.steps(10)
        assert "expected one with 9 cores in pool default, found no host with more than 8" in (
            world.store.study("s").reason
        )
        assert {study_of(each) for each in world.dispatcher.given} == {"t"}, "and it holds nobody up"


class TestRetries:
    @pytest.mark.parametrize("world", [["search.trials=1", "retries.total=4"]], indirect=True)
    def test_a_trial_that_kills_its_worker_after_every_checkpoint_is_given_up_one_day(self, world):
        for iteration in range(1, 20):
            world.steps(4)
            if not (running := world.dispatcher.running()):
                break
            world.dispatcher.report(running[0], iteration)
            world.dispatcher.inbox.append(Vanished(running[0].attempt, running[0].token, reason="no memory"))
        trial = world.trials()[0]
        assert (trial.state, trial.attempts, trial.iteration) == (TrialState.FAILED, 5, 5)
        assert trial.message == (
            "its worker was lost 5 times, though it came further each time (retries.total: 4); the last time: no memory"
        )

    @pytest.mark.parametrize("world", [["search.trials=1"]], indirect=True)
    def test_losses_do_not_use_up_the_retries_of_the_tasks_own_errors(self, world):
        for iteration in (1, 2, 3):
            world.steps(4)
            (running,) = world.dispatcher.running()
            world.dispatcher.report(running, iteration)
            world.dispatcher.inbox.append(Vanished(running.attempt, running.token, reason="gone"))
        for _ in range(2):  # the limit is 1
            world.steps(6)
            (running,) = world.dispatcher.running()
            world.dispatcher.inbox.append(Crashed(running.attempt, running.token, message="ValueError: no"))
        world.steps(2)
        assert [each.state for each in attempts_of(world, "s", 0)] == [AttemptState.LOST] * 3 + [
            AttemptState.FAILED
        ] * 2
        assert world.trials()[0].message == "ValueError: no"


class Wanting(SimpleNamespace):
    """As much of a `Drive` as the scheduler looks at."""

    def appetite(self, now):
        return self.slots

    @property
    def cores(self):
        return sum(live.cpus for live in self.live.values())


wants = st.tuples(
    st.integers(-1, 1), st.sampled_from([0.5, 1.0, 2.0]), st.integers(1, 4), st.sampled_from([0.5, 1.0, 2.0, 4.0])
)


@given(
    studies=st.lists(wants, min_size=1, max_size=5),
    hosts=st.dictionaries(st.sampled_from("abc"), st.integers(1, 6), min_size=1),
    running=st.lists(st.integers(0, 4), max_size=6),
)
def test_cores_are_never_given_twice_and_nobody_is_passed_by_a_lower_priority(studies, hosts, running):
    """Random studies on random hosts, some attempts under way: what was handed out, and who has to stop for whom."""
    dispatcher = Scripted(size=0, more={"default": {host: float(size) for host, size in hosts.items()}})
    drives = [drive(number, *each) for number, each in enumerate(studies)]
    for attempt, place in enumerate(running):
        owner = drives[place % len(drives)]
        cpus = owner.spec.resources.cpus
        if any(room >= cpus for room in dispatcher.rooms("default").values()):
            owner.live[attempt] = Live(attempt, 1, attempt, "default", cpus, seen=0.0, began=float(attempt))
            dispatcher.start(SimpleNamespace(attempt=attempt, pool="default", cpus=cpus))
    scheduler = Scheduler(dispatcher)
    scheduler.charge(drives, 0.0)
    shares, left = scheduler.hand_out(drives, 0.0)
    given_to = {each.row.id: slots for each, slots in shares}
    total = sum(slots * each.spec.resources.cpus for each, slots in shares)
    rooms = dispatcher.rooms("default")
    assert total == pytest.approx(sum(rooms.values()) - sum(left["default"].values()))
    assert all(room >= 0 for room in left["default"].values())
    unserved = [each for each in drives if given_to.get(each.row.id, 0) < each.appetite(0.0)]
    for each in unserved:
        lower = [other.spec.resources.cpus for other, _ in shares if other.row.priority < each.row.priority]
        # A lower one got a slot only where it is narrower, in a gap too small for this one.
        assert all(cpus < each.spec.resources.cpus for cpus in lower)
    stops = scheduler.displaced(drives, given_to, left, 0.0)
    assert len({live.attempt for _, live, _ in stops}) == len(stops)
    if stops:
        highest = max(each.row.priority for each in unserved)
        assert all(owner.row.priority < highest for owner, _, _ in stops)


def drive(number, priority, share, slots, cpus):
    """A study that wants to run so many trials."""
    resources = SimpleNamespace(cpus=cpus, parallel=slots)
    made = Wanting(
        row=SimpleNamespace(id=number, name=f"study{number}", priority=priority, pool="default"),
        spec=SimpleNamespace(share=share, resources=resources), live={}, asked=None, leaving=None, reserved=0.0,
    )  # fmt: skip
    made.slots = slots
    return made
