"""What repeated work is put down to: sequences worked by hand."""

from __future__ import annotations

import pytest
from invariants import Verdict
from repetitions import Begun, Marks


def iterations(*words):
    """`"3.1a"`: the first iteration of trial 3 in the process a."""
    return [Begun(int(word[0]), int(word[2:-1]), word[-1]) for word in words]


def judged(marks, work):
    verdict = Verdict()
    marks.judge(work, verdict)
    return verdict.broken


def test_an_undisturbed_training_repeats_nothing():
    work = iterations("0.1a", "0.2a", "0.3a", "1.1a")
    marks = Marks()
    marks.set("worker killed", 4)
    assert marks.count(work)["worker killed"].iterations == 0
    assert judged(marks, work) == []


def test_what_an_interrupted_training_did_again_is_put_down_to_the_fault_before_it():
    work = iterations("0.1a", "0.2a", "0.2b", "0.3b", "0.4b")
    marks = Marks()
    marks.set("worker killed", 2)
    marks.set("strategy killed", 4)
    found = marks.count(work)
    assert (found["worker killed"].iterations, found["worker killed"].most) == (1, 1)
    assert found["strategy killed"].iterations == 0
    assert judged(marks, work) == []


def test_two_iterations_repeated_after_a_kill_are_one_too_many():
    work = iterations("0.1a", "0.2a", "0.1b", "0.2b")
    marks = Marks()
    marks.set("worker killed", 2)
    assert judged(marks, work) == ["worker killed: trial 0 repeated 2 iterations, 1 may be"]


def test_a_torn_checkpoint_may_cost_two_even_where_its_training_goes_on_after_the_next_fault():
    """The other training went on first, and a strategy was killed meanwhile: that costs nothing."""
    work = iterations("0.1a", "0.2a", "1.1c", "1.2c", "1.3c", "0.1b", "0.2b", "0.3b")
    marks = Marks()
    marks.set("checkpoint torn", 2)
    marks.move(2, torn=0)
    marks.set("strategy killed", 4)
    found = marks.count(work)
    assert (found["checkpoint torn"].iterations, found["checkpoint torn"].most) == (2, 2)
    assert found["strategy killed"].iterations == 0
    assert judged(marks, work) == []


def test_a_checkpoint_of_another_trial_excuses_nothing():
    work = iterations("0.1a", "0.2a", "1.1c", "0.1b", "0.2b")
    marks = Marks()
    marks.set("checkpoint torn", 2)
    marks.move(2, torn=1)
    assert judged(marks, work) == ["checkpoint torn: trial 0 repeated 2 iterations, 1 may be"]


def test_a_checkpoint_torn_long_ago_excuses_nothing():
    """The training made new ones since."""
    work = iterations("0.1a", "0.2a", "0.2b", "0.3b", "0.4b", "0.3c", "0.4c")
    marks = Marks()
    marks.set("checkpoint torn", 2)
    marks.move(2, torn=0)
    marks.set("driver stopped", 3)
    marks.set("worker killed", 5)
    assert judged(marks, work) == ["worker killed: trial 0 repeated 2 iterations, 1 may be"]


def test_a_fault_that_was_marked_before_the_last_iteration_began_is_found():
    work = iterations("0.1a", "0.2a", "0.2b")
    marks = Marks()
    marks.set("worker killed", 1)
    assert marks.count(work)["worker killed"].iterations == 1


def test_what_a_training_that_was_given_up_does_beside_its_successor_is_no_repetition():
    work = iterations("0.1a", "0.2a", "0.2b", "0.3a", "0.3b", "0.4b", "0.4a")
    marks = Marks()
    marks.set("worker stopped beyond its lease", 2)
    row = marks.count(work)["worker stopped beyond its lease"]
    assert (row.iterations, row.most, row.beside) == (1, 1, 2)
    assert judged(marks, work) == []


def test_an_attempt_given_up_unheard_that_starts_after_its_successor_is_no_repetition():
    """A host was cut off when it was given the training, which another one did meanwhile."""
    work = iterations("0.1b", "0.2b", "0.3b", "0.1c", "0.2c", "0.3c")
    marks = Marks()
    marks.set("network cut beyond a lease", 0)
    attempts = {0: [None, "b"]}
    row = marks.count(work, attempts)["network cut beyond a lease"]
    assert (row.iterations, row.beside) == (0, 3)
    verdict = Verdict()
    marks.judge(work, verdict, attempts)
    assert verdict.broken == []
    # The same work by an attempt that was heard of, or that nobody had given up, would be repeated.
    for known in ({0: ["b", "c"]}, {0: ["b", None]}):
        assert marks.count(work, known)["network cut beyond a lease"].iterations == 3


def test_work_done_again_without_a_fault_is_noted():
    broken = judged(Marks(), iterations("0.1a", "0.2a", "0.2b"))
    assert broken == ["trial 0 repeated 1 iterations without any fault"]


@pytest.mark.parametrize("process", ["a", "b"])
def test_a_process_may_take_a_training_up_again(process):
    work = iterations("0.1a", "0.2a", f"0.2{process}", f"0.3{process}")
    marks = Marks()
    marks.set("coordinator killed", 2)
    assert marks.count(work)["coordinator killed"].iterations == 1
