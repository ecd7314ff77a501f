"""Optuna's own conformance suite for samplers, on ours; and what it doesn't ask."""

import warnings

import numpy as np
import optuna
import pytest
from optuna.testing import pytest_samplers
from optuna.testing.pytest_samplers import BasicSamplerTestCase, RelativeSamplerTestCase, SingleOnlySamplerTestCase

from search import BadFeatures, Features, SearchError
from search.optuna_samplers import BDSSampler, CMFBOSampler


@pytest.fixture(autouse=True)
def quiet():
    with warnings.catch_warnings():
        # what Optuna says about its own suite: fixed parameters and their ranges, experimental parts
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        warnings.simplefilter("ignore", UserWarning)
        yield


SUITES = (BasicSamplerTestCase, RelativeSamplerTestCase, SingleOnlySamplerTestCase)
NOT_OURS = {"MultiObjectiveSamplerTestCase"}
"""Its opposite is `SingleOnlySamplerTestCase`: a sampler either takes several objectives or refuses them."""


def test_every_class_of_the_suite_is_run_or_known_not_to_apply():
    shipped = {name for name in vars(pytest_samplers) if name.endswith("TestCase") and not name.startswith("_")}
    assert shipped == {case.__name__ for case in SUITES} | NOT_OURS


class TestCMFBOSamplerConforms(*SUITES):
    @pytest.fixture
    def sampler(self):
        return lambda: CMFBOSampler(seed=0)


class TestBDSSamplerConforms(*SUITES):
    @pytest.fixture
    def sampler(self):
        return lambda: BDSSampler(seed=0)


def test_cmfbo_finds_the_minimum_of_a_bowl_that_random_search_misses():
    def bowl(trial):
        x, y = trial.suggest_float("x", -5, 5), trial.suggest_float("y", -5, 5)
        return (x - 1.3) ** 2 + (y + 2.1) ** 2

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=CMFBOSampler(seed=1))
    study.optimize(bowl, n_trials=25)
    by_chance = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    by_chance.optimize(bowl, n_trials=25)
    assert study.best_value < 0.05 < by_chance.best_value


def test_a_behaviour_comes_from_a_user_attribute_and_its_absence_is_an_error():
    sampler = BDSSampler(Features.circle(), seed=0)
    study = optuna.create_study(direction="maximize", sampler=sampler)

    def facing(trial):
        x = trial.suggest_float("x", -3, 3)
        trial.set_user_attr("features", [x])
        return 1.0

    study.optimize(facing, n_trials=12)
    assert np.ptp([t.params["x"] for t in study.trials]) > 4
    silent = optuna.create_study(sampler=BDSSampler(Features.circle(), seed=0))
    with pytest.raises(BadFeatures, match="trial 0: expected its behaviour in the user attribute 'features'"):
        silent.optimize(lambda trial: trial.suggest_float("x", -3, 3), n_trials=3)


def test_a_budget_that_is_used_up_ends_the_study_with_what_to_do():
    study = optuna.create_study(sampler=CMFBOSampler(seed=0, settings={"cost_budget": 4.0}))
    with pytest.raises(SearchError, match="after 4 trials, found its budget used up; raise it"):
        study.optimize(lambda trial: trial.suggest_float("x", -3, 3), n_trials=9)
    assert len([t for t in study.trials if t.state == optuna.trial.TrialState.COMPLETE]) == 4
