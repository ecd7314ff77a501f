import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workers.contracts import BadSetting
from workers.learning.settings import Budget, NetworkSettings, PPOSettings, TrainingSettings

ENOUGH = {"budget": {"samples": 100}}
YAML_HINT = "found the text '{}' (in YAML write {})"


@pytest.mark.parametrize(
    ("training", "message"),
    [
        ({}, "training.budget: expected samples, iterations or both, found neither"),
        ({"budget": {"samples": 0}}, "training.budget.samples: expected a whole number of at least 1, found 0"),
        ({"budget": {"iterations": -3}}, "training.budget.iterations: expected a whole number of at least 1, found -3"),
        (
            {"budget": {"samples": "1e5"}},
            "training.budget.samples: expected a whole number of at least 1, " + YAML_HINT.format("1e5", "1.0e+5"),
        ),
        ({"budgte": {}}, "training.budgte: unknown setting; did you mean 'budget'?"),
        ({"budget": 1000}, "training.budget: expected a mapping, found 1000"),
        (ENOUGH | {"ppo": {"clipp": 1}}, "training.ppo.clipp: unknown setting; did you mean 'clip'?"),
        (ENOUGH | {"ppo": {"clip": 0}}, "training.ppo.clip: expected a number above 0 and at most 1, found 0"),
        (ENOUGH | {"ppo": {"clip": None}}, "training.ppo.clip: expected a number above 0 and at most 1, found nothing"),
        (ENOUGH | {"ppo": {"epochs": True}}, "training.ppo.epochs: expected a whole number from 1 to 1000, found true"),
        (ENOUGH | {"ppo": {"epochs": 2.5}}, "training.ppo.epochs: expected a whole number from 1 to 1000, found 2.5"),
        (
            ENOUGH | {"ppo": {"actor_rate": "1e-4"}},
            "training.ppo.actor_rate: expected a number above 0 and at most 1, " + YAML_HINT.format("1e-4", "1.0e-4"),
        ),
        (ENOUGH | {"ppo": {"gamma": float("nan")}}, "training.ppo.gamma: expected a number from 0 to 1, found nan"),
        (ENOUGH | {"ppo": {"sigma": "free"}}, "training.ppo.sigma: expected annealed or learnt, found the text 'free'"),
        (ENOUGH | {"ppo": {"normalise_rewards": 1}}, "training.ppo.normalise_rewards: expected true or false, found 1"),
        (
            ENOUGH | {"network": {"hidden": 64}},
            "training.network.hidden: expected a list of whole numbers from 1 to 8192, found 64",
        ),
        (
            ENOUGH | {"network": {"hidden": [64, 0]}},
            "training.network.hidden[1]: expected a whole number from 1 to 8192, found 0",
        ),
        (
            ENOUGH | {"network": {"activation": "gelu"}},
            "training.network.activation: expected relu or tanh, found the text 'gelu'",
        ),
    ],
)
def test_a_wrong_setting_is_refused_by_name_with_what_was_expected_and_found(training, message):
    with pytest.raises(BadSetting) as refusal:
        TrainingSettings.parse(training)
    assert str(refusal.value) == message
    assert refusal.value.section == "training"


def test_what_a_study_leaves_out_has_the_tasks_default_and_a_budget_given_replaces_the_default_budget():
    defaults = TrainingSettings(Budget(samples=5), NetworkSettings((9,)), PPOSettings(clip=0.1, epochs=3))
    read = TrainingSettings.parse({"budget": {"iterations": 2}, "ppo": {"epochs": 4.0}}, defaults)
    assert read.budget == Budget(None, 2)
    assert read.network.hidden == (9,)
    assert (read.ppo.clip, read.ppo.epochs) == (0.1, 4)
    assert TrainingSettings.parse({}, defaults) == defaults


@given(
    st.integers(1, 10**9),
    st.lists(st.integers(1, 8192), max_size=4),
    st.floats(0, 1, exclude_min=True),
    st.sampled_from(["annealed", "learnt"]),
)
def test_settings_written_out_are_read_back_the_same(samples, hidden, clip, sigma):
    settings = TrainingSettings(
        Budget(samples=samples), NetworkSettings(tuple(hidden), "tanh"), PPOSettings(clip=clip, sigma=sigma)
    )
    assert TrainingSettings.parse(settings.to_json()) == settings


def test_every_setting_has_a_rule_that_its_default_passes():
    for section in (Budget, NetworkSettings, PPOSettings):
        for field in dataclasses.fields(section):
            assert field.metadata["rule"].read("training", field.name, field.default) == field.default
