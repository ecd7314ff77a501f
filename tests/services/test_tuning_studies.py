"""The studies that tune what learns, as they are shipped."""

from pathlib import Path

import numpy as np
import pytest

from search import strategies
from services.spec_check import load_study
from services.translate import make_strategy_of
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.run import run
from workers.tasks.imitation.settings import TRAINING

STUDIES = Path(__file__).parents[2] / "studies"
TUNING = ("tune_gymnasium", "tune_walk", "tune_backflip", "walker_morphology")
BASELINES = sorted(
    each.name for each in strategies() if not each.uses_features and (each.extra is None or each.name == "cmaes")
)


@pytest.mark.parametrize("name", TUNING)
@pytest.mark.parametrize("profile", ["quick", "paper"])
def test_a_study_can_be_run_in_its_profiles(name, profile):
    spec = load_study(STUDIES / f"{name}.yaml", [f"profile={profile}"])
    assert spec.name.endswith(f"-{profile}")
    assert spec.has_difficulty
    assert spec.search.strategy == "cmfbo"
    whole = spec.training["budget"]["samples"]
    assert spec.search.cost >= 8 * whole, "a search of less than eight whole trainings finds nothing"


def test_the_baselines_are_all_there():
    assert {"cmfbo", "gp_ucb", "boca", "tpe_hyperband", "gp", "random", "tpe", "sobol", "top_k"} <= set(BASELINES)


@pytest.mark.parametrize("strategy", BASELINES)
def test_every_baseline_runs_on_the_same_study(strategy, tmp_path):
    tiny = ["training.budget.samples=60", "training.ppo.samples=16", "task.settings.episodes=1",
            "task.settings.max_episode_steps=8", "training.network.hidden=[4]"]  # fmt: skip
    overrides = ["profile=quick", f"search.strategy={strategy}", *tiny]
    spec = load_study(STUDIES / "tune_gymnasium.yaml", overrides)
    (candidate,) = make_strategy_of(spec).propose([], [], 1, np.random.default_rng(1))
    job = Job(spec.name, 0, spec.task.name, dict(candidate.params), 1, spec.task.settings, spec.training, candidate.z)
    outcome = run(job, LocalContext(tmp_path))
    assert outcome.status == "complete", outcome.message
    assert set(candidate.params) == set(spec.space)
    for other in ("walker_morphology", "tune_walk"):
        assert make_strategy_of(load_study(STUDIES / f"{other}.yaml", [f"search.strategy={strategy}"]))


def test_the_walks_study_begins_with_what_halma_trains_with_by_default():
    spec = load_study(STUDIES / "tune_walk.yaml")
    default = TRAINING.to_json()["ppo"]
    assert spec.search.first == ({name: default[name.removeprefix("ppo.")] for name in spec.space},)
