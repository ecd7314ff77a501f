import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from search_cases import facing, jump_space

from search import Candidate, Features, Observation, make_strategy
from search.novelty import Archive


def archive_history():
    params = {"alpha": 0.0, "omega_x": 0.0, "rate": 1e-3}
    outcomes = [(0.0, 1.0, "complete"), (0.1, 3.0, "complete"), (2.0, 2.0, "complete"), (None, None, "failed")]
    return [Observation(Candidate(params), v, None if y is None else [y], status=s) for y, v, s in outcomes]


def test_hand_worked_novelty_and_reward_of_equation_12():
    archive = Archive.from_history(Features.circle(), archive_history())
    Y = np.array([[0.05], [1.0], [2.0], [-3.0]])
    assert archive.novelty(Y) == pytest.approx([0.05, 0.9, 0.0, 2 * math.pi - 5.0])
    assert archive.novelty_reward(Y, 0.5) == pytest.approx([0.1, 1.0, 0.01, 1.0])


def test_an_empty_archive_finds_everything_new():
    archive = Archive.from_history(Features.circle(), [])
    assert archive.novelty_reward(np.array([[0.3]]), 0.5).tolist() == [1.0]


def test_distinct_strategies_are_named_by_their_place_in_the_history():
    clusters = Archive.from_history(Features.circle(), archive_history()).distinct(0.5)
    assert [(c.representative, c.members) for c in clusters] == [(1, (0, 1)), (2, (2,))]


def run(settings, count=1):
    space = jump_space()
    strategy = make_strategy("novelty", space, features=Features.circle(), settings=settings)
    history = []
    while True:
        found = strategy.propose(history, [], count, np.random.default_rng(len(history)))
        if not found:
            return history
        history += [Observation(c, 1.0 + 0.01 * len(history), facing(c.params), 1.0) for c in found]


def test_each_good_initial_state_is_trained_k_times_more_round_by_round():
    history = run({"trials": 8, "initial": 3, "k": 2, "threshold": 0.3})
    second = history[8:]
    assert [o.candidate.info["round"] for o in second] == [1, 1, 1, 2, 2, 2]
    starts = [o.candidate.warm_start for o in second]
    assert starts[:3] == starts[3:]
    assert len(set(starts)) == 3
    for o in second:
        assert o.candidate.params == history[o.candidate.warm_start].candidate.params
        assert len(o.candidate.info["avoid"]) >= 3


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_stage_two_agrees_with_a_slow_obvious_version(seed):
    rng = np.random.default_rng(seed)
    trials, initial, k, threshold = 8, int(rng.integers(1, 5)), int(rng.integers(1, 4)), float(rng.uniform(0.1, 1.5))
    space, history = jump_space(), []
    for u in rng.random((trials + int(rng.integers(0, 6)), 3)):
        c = Candidate(space.from_unit(u))
        if rng.random() < 0.25:
            history.append(Observation(c, status="failed"))
        else:
            history.append(Observation(c, float(rng.random()), [float(rng.uniform(-3, 3))]))
    pending = [Candidate(space.from_unit(u)) for u in rng.random((int(rng.integers(0, 3)), 3))]

    # the best of stage 1 stands for all within the threshold, then the best of the rest, and so on
    left = [i for i in range(trials) if history[i].status == "complete"]
    states = []
    while left:
        best = max(left, key=lambda i: history[i].value)
        states.append(best)
        left = [i for i in left if turn_between(history[i].features[0], history[best].features[0]) > threshold]
    rounds = [(r + 1, i) for r in range(k) for i in states[:initial]]
    expected = rounds[len(history) + len(pending) - trials :][:3]
    known = sorted({o.features[0] for o in history if o.status == "complete"})

    chosen = {"trials": trials, "initial": initial, "k": k, "threshold": threshold}
    strategy = make_strategy("novelty", space, features=Features.circle(), settings=chosen)
    found = strategy.propose(history, pending, 3, rng)
    assert [(c.info["round"], c.warm_start) for c in found] == expected
    for c in found:
        assert c.params == history[c.warm_start].candidate.params
        assert sorted(y for (y,) in c.info["avoid"]) == pytest.approx(known)
        assert c.info["threshold"] == threshold


def turn_between(a, b):
    return abs(math.remainder(a - b, 2 * math.pi))


def test_stage_two_waits_for_stage_one():
    space = jump_space()
    strategy = make_strategy("novelty", space, features=Features.circle(), settings={"trials": 4})
    first = strategy.propose([], [], 4, np.random.default_rng(0))
    history = [Observation(c, 1.0, facing(c.params), 1.0) for c in first[:3]]
    assert strategy.propose(history, first[3:], 2, np.random.default_rng(0)) == []
