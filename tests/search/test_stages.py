"""Stages as a function of the record: who is taken up, how often, and when it is over."""

import numpy as np
import pytest
from search_cases import facing, jump_space

from search import BadHistory, Candidate, Features, Observation, make_strategy
from search.given import Given
from search.stages import NoveltyStage, PolishStage, Staged, in_order

PARAMS = {"alpha": 0.0, "omega_x": 0.0, "rate": 1e-3}
NOVELTY = NoveltyStage("novelty", ("search",), strategies=2, trainings=2, threshold=1.5)
POLISH = PolishStage("polish", ("search", "novelty"), strategies=3, rounds=3, rise=0.05)


def staged(*stages, trials=3):
    search = make_strategy("random", jump_space(), features=Features.circle())
    return Staged(search, trials, stages, Features.circle(), apart=0.5)


def ask(study, history, pending=(), count=20):
    return study.propose(history, list(pending), count, np.random.default_rng(len(history)))


def seen(value, y, stage="search", parent=None, status="complete"):
    return Observation(Candidate(PARAMS, None, parent, stage=stage), value, None if y is None else [y], status=status)


# Three trials, two strategies: the one at 1.0 (trials 0 and 2, the better) and the one at 0.0.
SEARCHED = [seen(1.0, 0.0), seen(0.5, 1.0), seen(1.2, 0.1)]


def summary(candidates):
    return [(c.stage, c.warm_start, c.info["round"]) for c in candidates]


def test_later_stages_wait_until_the_search_is_over():
    study = staged(NOVELTY)
    first = ask(study, [])
    assert [c.stage for c in first] == ["search"] * 3
    assert ask(study, SEARCHED[:2], first[2:]) == []
    assert [c.stage for c in ask(study, SEARCHED[:2])] == ["search"]


def test_novelty_trains_from_each_strategy_round_by_round_away_from_all_that_is_known():
    found = ask(staged(NOVELTY), SEARCHED)
    assert summary(found) == [("novelty", 2, 1), ("novelty", 1, 1), ("novelty", 2, 2), ("novelty", 1, 2)]
    assert sorted(found[0].info["avoid"]) == [[0.0], [0.1], [1.0]]
    assert found[0].info["strategies"] == [[0.1], [1.0]], "of a strategy's members the best stands for it"
    assert found[0].info["threshold"] == 1.5
    assert dict(found[0].params) == PARAMS


def test_only_the_best_strategies_are_taken_up():
    one = NoveltyStage("novelty", ("search",), strategies=1, trainings=1, threshold=1.5)
    assert summary(ask(staged(one), SEARCHED)) == [("novelty", 2, 1)]


def test_trainings_that_are_open_or_failed_count():
    study = staged(NOVELTY)
    failed = seen(None, None, "novelty", 2, status="failed")
    pending = [Candidate(PARAMS, None, 1, stage="novelty")]
    assert summary(ask(study, [*SEARCHED, failed], pending)) == [("novelty", 2, 2), ("novelty", 1, 2)]


def test_a_search_that_was_extended_takes_up_only_what_is_new():
    done = [seen(1.0, 2.0 + 0.01 * k, "novelty", parent) for k, parent in enumerate([2, 1, 2, 1])]
    over = [*SEARCHED, *done]
    assert ask(staged(NOVELTY), over) == []
    # A better trial of a known strategy is nothing new; a strategy that is better than the second best takes its place.
    better, other = seen(1.3, 0.05), seen(1.1, 3.0)
    found = ask(staged(NOVELTY, trials=5), [*over, better, other])
    assert summary(found) == [("novelty", 8, 1), ("novelty", 8, 2)]


def test_a_polish_goes_on_from_its_last_training_while_the_value_rises():
    study = staged(PolishStage("polish", ("search",), strategies=1, rounds=3, rise=0.05))
    assert summary(ask(study, SEARCHED)) == [("polish", 2, 1)]
    once = [*SEARCHED, seen(1.4, 0.1, "polish", 2)]
    assert summary(ask(study, once)) == [("polish", 3, 2)]
    twice = [*once, seen(1.6, 0.1, "polish", 3)]
    assert summary(ask(study, twice)) == [("polish", 4, 3)]
    assert ask(study, [*twice, seen(1.9, 0.1, "polish", 4)]) == [], "three rounds are the most"


@pytest.mark.parametrize("last", [seen(1.25, 0.1, "polish", 2), seen(None, None, "polish", 2, status="infeasible")])
def test_a_polish_that_raises_the_value_no_more_was_the_last(last):
    study = staged(PolishStage("polish", ("search",), strategies=1, rounds=3, rise=0.05))
    assert ask(study, [*SEARCHED, last]) == []


def test_a_strategy_is_polished_one_training_at_a_time():
    study = staged(PolishStage("polish", ("search",), strategies=2, rounds=3, rise=0.0))
    first = ask(study, SEARCHED)
    assert summary(first) == [("polish", 2, 1), ("polish", 1, 1)]
    once = [*SEARCHED, seen(1.4, 0.1, "polish", 2)]
    again = ask(study, once, [first[1]])
    assert summary(again) == [("polish", 3, 2)]
    assert ask(study, once, [first[1], again[0]]) == []


def test_a_polish_waits_for_the_novelty_it_comes_after():
    study = staged(NOVELTY, POLISH)
    pending = ask(study, SEARCHED)
    assert [c.stage for c in pending] == ["novelty"] * 4
    assert ask(study, SEARCHED, pending) == []
    novel = [*SEARCHED, *(seen(0.9, 2.0, "novelty", c.warm_start) for c in pending)]
    assert [(c.stage, c.warm_start) for c in ask(study, novel)] == [("polish", 2), ("polish", 3), ("polish", 1)]


def test_a_whole_study_ends_and_equals_itself_played_in_batches_of_one():
    def play(count):
        history = []
        study = staged(NOVELTY, POLISH, trials=4)
        while found := ask(study, history, count=count):
            for c in found[:1]:
                parent = history[c.warm_start] if c.warm_start is not None else None
                rise = 0.0 if parent is None else 0.1 if len(history) % 2 else 0.0
                value = 1.0 if parent is None else parent.value + rise
                history.append(Observation(c, value, facing(c.params), 1.0))
        return [(o.candidate.stage, o.candidate.warm_start, o.value) for o in history]

    assert play(1) == play(5)
    assert {"search", "novelty", "polish"} == {stage for stage, _, _ in play(1)}


def test_the_search_sees_its_own_trials_alone_and_its_parents_are_told_in_its_own_numbers():
    class Chain:
        def propose(self, history, pending, count, rng):
            self.seen = [o.value for o in history]
            return [Candidate(PARAMS, None, len(history) - 1)]

    chain = Chain()
    study = Staged(chain, 5, (NOVELTY,), Features.circle(), 0.5)
    history = [SEARCHED[0], seen(9.0, 2.0, "novelty", 0), SEARCHED[1]]
    assert [c.warm_start for c in ask(study, history)] == [2]
    assert chain.seen == [1.0, 0.5]


def test_a_trial_of_an_unknown_stage_is_refused():
    with pytest.raises(BadHistory, match="expected a stage among novelty, search, found 'finale'"):
        ask(staged(NOVELTY), [seen(1.0, 0.0, "finale")])


def test_stages_are_ordered_by_what_they_come_after():
    assert in_order({"polish": ["novelty", "search"], "novelty": ["search"]}) == ["novelty", "polish"]
    assert in_order({"b": ["a"], "a": ["b"], "c": ["search"], "d": ["a"]}) == ["c"]


def test_a_search_that_begins_with_points_has_its_later_stages_after_them():
    points = ({**PARAMS, "alpha": 1.0}, {**PARAMS, "alpha": 2.0})
    search = Given(make_strategy("random", jump_space(), features=Features.circle()), points)
    study = Staged(search, 3, (NOVELTY,), Features.circle(), apart=0.5)
    assert [dict(each.params) for each in ask(study, [])[:2]] == [dict(point) for point in points]
    assert summary(ask(study, SEARCHED)) == summary(ask(staged(NOVELTY), SEARCHED))
