"""Policies handed from trial to trial, through the service: a strategy names the parent, a worker starts from it."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from search import Candidate
from services.admission import admit, find
from services.artifacts.open import open_artifacts
from services.cli.tables import parent_of
from services.coordinator import Coordinator
from services.dispatch.inline import InlineDispatcher
from services.lineage import line_of, lineage_words
from services.problems import BadStudy
from services.proposing import InlineStrategist, Proposer
from services.report import findings
from services.spec_check import parse_study
from services.states import StudyState, TrialState
from services.store.open import open_store

STUDY = """
name: s
task: {name: point_jump, settings: {bar: 1.5}}
space: {speed: {type: float, low: 1.5, high: 2.5}}
search: {strategy: cmfbo, cost: 100000, trials: 3}
training: {budget: {samples: 1500}, network: {hidden: [8]}}
seed: 5
"""


class Chain:
    """A strategy whose every trial starts from the one before it."""

    def __init__(self, params=None):
        self.params = params or {"speed": 2.0}

    def propose(self, history, pending, count, rng):
        parent = len(history) - 1
        return [Candidate(self.params, z=1.0, warm_start=parent if parent >= 0 else None)]


class Service:
    """One driver that runs trials inline, with `Chain` in place of the study's strategy."""

    def __init__(self, folder, text=STUDY):
        self.store = open_store(f"sqlite:///{folder}/halma.db")
        self.artifacts = open_artifacts(folder / "artifacts")
        self.row = find(self.store, "s") or admit(self.store, parse_study(text, name="s.yaml"))

    def drive(self):
        """Drive until the study is released."""
        strategist = InlineStrategist()
        coordinator = Coordinator(self.store, InlineDispatcher(self.artifacts), strategist)
        with self.store.transaction() as change:
            change.ask("s", "run")
        coordinator.take("s")
        strategist._proposers[self.row.id]._strategy = Chain()
        while coordinator.driven():
            coordinator.step(0.0)
        return self.store.study("s")

    def trials(self):
        return self.store.trials(self.row.id)


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"it was not so within {seconds} s"
        time.sleep(0.02)


@pytest.fixture
def service(tmp_path):
    service = Service(tmp_path)
    yield service
    service.store.close()


def test_a_trial_starts_from_its_parents_policy_and_pays_for_itself_alone(service):
    assert service.drive().state is StudyState.COMPLETE
    first, second, third = service.trials()
    assert [trial.warm_start for trial in service.trials()] == [None, 0, 1]
    assert "warm_start" not in first.details
    assert second.details["warm_start"]["parent"] == 0
    assert third.details["warm_start"] == {
        "parent": 1,
        "networks": True,
        "message": "started from the parent's policy",
    }
    for trial in (first, second, third):
        samples = [metric.values["samples"] for metric in service.store.metrics(trial.id)]
        assert samples[0] < 1500, "counted from its own first sample on"
        assert samples[-1] == trial.samples < 2500
    assert service.store.study("s").samples == first.samples + second.samples + third.samples
    assert lineage_words(service.trials()) == "2 of 3 trials started from another's policy; the longest line: 0 → 1 → 2"


def test_a_parent_whose_policy_was_deleted_is_refused_with_a_sentence_and_the_study_goes_on(service):
    service.drive()
    policy = next(a for a in service.store.artifacts(service.trials()[2].id) if a.name == "policy.safetensors")
    service.artifacts.remove(policy.path)
    with service.store.transaction() as change:
        change.extend("s", trials=1)
    assert service.drive().state is StudyState.COMPLETE
    orphan = service.trials()[3]
    assert (orphan.state, orphan.attempts, orphan.samples) == (TrialState.FAILED, 1, 0)
    assert orphan.message.startswith("warm start from trial 2: its policy.safetensors can't be used: artifact ")
    assert "found no file" in orphan.message


DRIVE = """
import sys
from pathlib import Path
from test_warm_starts import LONG, Service

Service(Path(sys.argv[1]), LONG).drive()
"""
LONG = STUDY.replace("trials: 3", "trials: 2").replace("bar: 1.5", "bar: 3.0").replace("1500", "30000")


def test_a_child_that_was_killed_goes_on_from_its_checkpoint_and_still_knows_its_parent(tmp_path):
    service = Service(tmp_path, LONG)
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    command = [sys.executable, "-c", DRIVE, str(tmp_path)]
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": paths})
    try:
        wait_for(lambda: len(service.trials()) > 1 and service.trials()[1].iteration >= 3)
    finally:
        process.kill()
        process.wait()
    parent, child = service.trials()
    assert (parent.state, child.state, child.warm_start) == (TrialState.COMPLETE, TrialState.RUNNING, 0)
    # Its checkpoint is all it needs: what it started from may be gone.
    for artifact in service.store.artifacts(parent.id):
        service.artifacts.remove(artifact.path)
    assert service.drive().state is StudyState.COMPLETE
    resumed = service.trials()[1]
    assert (resumed.state, resumed.attempts, resumed.warm_start) == (TrialState.COMPLETE, 2, 0)
    assert resumed.details["warm_start"]["parent"] == 0
    attempts = service.store.attempts(resumed.id)
    assert attempts[0].state.value == "lost"
    assert attempts[1].first_iteration >= 3
    iterations = [metric.iteration for metric in service.store.metrics(resumed.id)]
    assert iterations == list(range(1, len(iterations) + 1))
    service.store.close()


def test_a_candidate_of_a_task_that_learns_nothing_keeps_no_parent(tmp_path):
    spec = parse_study(STUDY, name="s.yaml")
    told = []
    for trains in (True, False):
        proposer = Proposer(spec.model_copy(update={"trains": trains}).to_json())
        proposer._strategy = Chain()
        proposer._numbers, proposer._history = [7], [None]
        told.append(proposer._told(Chain().propose([None], [], 1, None)[0])["warm_start"])
    assert told == [7, None]


def test_a_cost_budget_that_was_extended_reaches_the_strategy():
    spec = parse_study(STUDY.replace("cost: 100000, trials: 3", "cost: 500"), name="s.yaml")
    proposer = Proposer(spec.to_json())
    assert proposer._strategy.settings.cost_budget == 500
    proposer._plan_for(500.0)
    kept = proposer._strategy
    assert proposer._strategy is kept
    proposer._plan_for(900.0)
    assert proposer._strategy.settings.cost_budget == 900


def test_networks_that_began_anew_are_told_in_the_listing(service):
    service.drive()
    trial = service.trials()[1]
    assert parent_of(service.trials()[0]) == "-"
    assert parent_of(trial) == "0"
    assert parent_of(replace(trial, details={"warm_start": {"networks": False}})) == "0 (statistics)"


def test_the_line_of_a_trial_is_told_from_its_beginning():
    parents = {0: None, 1: 0, 2: None, 3: 1, 4: 3}
    assert line_of(4, parents) == [0, 1, 3, 4]
    assert line_of(2, parents) == [2]
    assert lineage_words([]) is None


@pytest.mark.parametrize("strategy", ["cmfbo", "boca", "top_k", "tpe_hyperband"])
def test_a_strategy_that_chooses_difficulties_needs_a_task_that_has_one(strategy):
    text = f"name: s\ntask: high_jump\nsearch:\n  strategy: {strategy}\n  cost: 1000\n"
    with pytest.raises(BadStudy) as refusal:
        parse_study(text, name="s.yaml")
    message = str(refusal.value)
    assert message.startswith(
        f"s.yaml:4: search.strategy: expected a task with a difficulty for {strategy}, found that high_jump has none"
    )
    assert "gp_ucb" in message
    assert json.dumps(message)


def test_strategies_that_need_a_behaviour_are_not_offered_to_a_task_without_one():
    text = "name: s\ntask: gymnasium:Pendulum-v1\nsearch: {strategy: cmfbo, cost: 1000}\n"
    with pytest.raises(BadStudy) as refusal:
        parse_study(text, name="s.yaml")
    assert str(refusal.value).endswith("or choose a strategy that needs none: gp_ucb, tpe, gp, cmaes")


def test_only_the_task_itself_has_a_best_value(service):
    service.drive()
    row, trials = service.store.study("s"), service.trials()
    values = [trial.value for trial in trials]
    assert row.best_value == max(values)
    plain = replace(row, spec={**row.spec, "behaviour": None})
    easy = [replace(trial, z=0.2, value=99.0) for trial in trials[:1]] + trials[1:]
    best = findings(plain, easy)
    assert [finding.trial.number for finding in best] == sorted((1, 2), key=lambda number: -values[number])
