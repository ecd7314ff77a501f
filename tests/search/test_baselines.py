"""The baselines do what their names say, as functions of the record."""

import numpy as np
import optuna
import pytest

from search import Candidate, Categorical, Features, Float, Int, Observation, Space, make_strategy
from search.baselines.optuna import SampledBy, distributions

BOX = Space({"x": Float(0, 1), "y": Float(0, 1), "w": Float(1e-4, 1, log=True)})


def bowl(params):
    return -((params["x"] - 0.3) ** 2) - (params["y"] - 0.6) ** 2


def run(strategy, evaluations, seed=0, batch=1, features=None):
    history = []
    while len(history) < evaluations:
        found = strategy.propose(history, [], batch, np.random.default_rng((seed, len(history))))
        history += [
            Observation(c, bowl(c.params), None if features is None else [c.params["x"], c.params["y"]], 1.0)
            for c in found
        ]
    return history


@pytest.mark.parametrize(("name", "evaluations"), [("cmaes", 60), ("gp_ucb", 25), ("tpe", 60)])
def test_a_baseline_that_learns_beats_random_search_on_a_bowl(name, evaluations):
    best = [
        np.mean([max(o.value for o in run(make_strategy(n, BOX), evaluations, seed=s)) for s in range(3)])
        for n in (name, "random")
    ]
    assert best[0] > best[1]


def test_a_generation_of_cmaes_is_the_same_whether_asked_at_once_or_one_by_one():
    strategy = make_strategy("cmaes", BOX)
    at_once = strategy.propose([], [], 4, np.random.default_rng(0))
    one_by_one = []
    for _ in range(4):
        one_by_one += strategy.propose([], one_by_one, 1, np.random.default_rng(9))
    assert [c.params for c in at_once] == [c.params for c in one_by_one]


def test_cmaes_goes_on_drawing_while_a_generation_is_still_running():
    strategy = make_strategy("cmaes", BOX)
    running = strategy.propose([], [], 7, np.random.default_rng(0))
    more = strategy.propose([], running, 5, np.random.default_rng(0))
    asked = {tuple(c.params.values()) for c in [*running, *more]}
    assert len(asked) == 12


@pytest.mark.parametrize("name", ["map_elites", "cma_me"])
def test_a_quality_diversity_baseline_spreads_over_behaviours(name):
    features = Features.euclidean(2)
    strategy = make_strategy(name, BOX, features=features)
    history = run(strategy, 40, features=features)
    cells = {tuple(np.floor(np.array(o.features) * 4).astype(int)) for o in history}
    assert len(cells) >= 6


def test_any_optuna_sampler_is_a_strategy():
    space = Space({"x": Float(-1, 1), "n": Int(1, 9), "kind": Categorical(("a", "b"))})
    strategy = SampledBy(space, lambda seed: optuna.samplers.RandomSampler(seed=seed))
    found = strategy.propose([], [], 3, np.random.default_rng(0))
    again = strategy.propose([], [], 3, np.random.default_rng(0))
    assert found == again
    assert [type(v) for v in found[0].params.values()] == [float, int, str]


def test_optuna_speaks_as_loudly_after_a_proposal_as_before():
    before = optuna.logging.get_verbosity()
    make_strategy("tpe", BOX).propose([], [], 1, np.random.default_rng(0))
    assert optuna.logging.get_verbosity() == before


def test_ranges_reach_optuna_as_they_are():
    space = Space({"w": Float(1e-4, 1, log=True), "n": Int(1, 9), "kind": Categorical(("a", "b"))})
    assert distributions(space) == {
        "w": optuna.distributions.FloatDistribution(1e-4, 1, log=True),
        "n": optuna.distributions.IntDistribution(1, 9),
        "kind": optuna.distributions.CategoricalDistribution(("a", "b")),
    }


def test_failures_and_pending_trials_are_survived_by_the_optuna_strategies():
    history = [Observation(Candidate({"x": 0.05 * i, "y": 0.5, "w": 0.1}), status="failed") for i in range(12)]
    for name in ("tpe", "gp"):
        assert len(make_strategy(name, BOX).propose(history, [history[0].candidate], 2, np.random.default_rng(0))) == 2
