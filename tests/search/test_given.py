"""Points that a study begins with, before its strategy decides."""

import numpy as np
import pytest

from search import BadParams, Candidate, Categorical, Float, Int, Observation, Space, make_strategy, strategies
from search.given import Given

SPACE = Space({"rate": Float(1e-4, 1e-2, log=True), "epochs": Int(1, 10), "kind": Categorical(("a", "b"))})
POINTS = ({"rate": 1e-3, "epochs": 5, "kind": "a"}, {"rate": 2e-3, "epochs": 9, "kind": "b"})


def begun(strategy="random", points=POINTS):
    return Given(make_strategy(strategy, SPACE), points)


def ask(study, history=(), pending=(), count=1):
    return study.propose(list(history), list(pending), count, np.random.default_rng(5))


def seen(candidate, value=1.0, **rest):
    return Observation(candidate, value, **rest)


def test_the_first_trials_are_the_points_in_their_order():
    study = begun()
    (one,) = ask(study)
    (two,) = ask(study, [seen(one)])
    assert [one.params, two.params] == [dict(point) for point in POINTS]
    assert [one.info, two.info] == [{"mode": "given"}] * 2
    (third,) = ask(study, [seen(one), seen(two)])
    assert third.info.get("mode") != "given"


def test_a_point_that_is_running_or_has_failed_is_not_asked_for_again():
    study = begun()
    (one,) = ask(study)
    (two,) = ask(study, pending=[one])
    assert dict(two.params) == POINTS[1]
    (after_failure,) = ask(study, [seen(one, None, status="failed")])
    assert dict(after_failure.params) == POINTS[1]


def test_the_strategy_fills_up_what_more_is_wanted_and_knows_the_points_as_pending():
    strategy = make_strategy("random", SPACE)
    asked = []
    original = strategy.propose

    def listening(history, pending, count, rng):
        asked.append((len(history), [dict(each.params) for each in pending], count))
        return original(history, pending, count, rng)

    strategy.propose = listening
    found = ask(Given(strategy, POINTS), count=5)
    assert [dict(each.params) for each in found[:2]] == [dict(point) for point in POINTS]
    assert len(found) == 5
    assert asked == [(0, [dict(point) for point in POINTS], 3)]


@pytest.mark.parametrize(
    "name", sorted(each.name for each in strategies() if not each.uses_features and each.extra is None)
)
def test_every_strategy_learns_from_what_came_of_the_points(name):
    study, history = begun(name), []
    for k in range(9):
        found = ask(study, history)
        if not found:
            break
        history.append(seen(found[0], -abs(np.log10(found[0].params["rate"]) + 3), cost=1.0))
        assert (found[0].info.get("mode") == "given") == (k < 2)
    assert len(history) > 2
    best = study.recommend(history)
    assert best == study.search.recommend(history)


def test_where_there_are_difficulties_the_points_are_of_the_task_itself():
    assert [each.z for each in ask(begun("cmfbo"), count=2)] == [1.0, 1.0]
    assert [each.z for each in ask(begun("gp_ucb"), count=2)] == [None, None]
    found = ask(begun("cmfbo"), [seen(Candidate(POINTS[0], 1.0), cost=9.0)], count=2)
    assert [each.z for each in found] == [1.0, 0.1], "then the easy start"


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ({"rate": 1e-3, "epochs": 5}, r"^\[1\] expected parameters .*'kind' is missing$"),
        ({**POINTS[0], "epoch": 5}, r"^\[1\] .*found unknown 'epoch'; did you mean 'epochs'\?$"),
        ({**POINTS[0], "rate": 0.5}, r"^\[1\] parameter 'rate': expected a value in \[0.0001, 0.01\], found 0.5$"),
        ({**POINTS[0], "kind": "c"}, r"^\[1\] parameter 'kind': expected one of \['a', 'b'\], found 'c'$"),
    ],
)
def test_a_point_outside_of_the_space_is_refused(point, message):
    with pytest.raises(BadParams, match=message):
        begun(points=(POINTS[0], point))
