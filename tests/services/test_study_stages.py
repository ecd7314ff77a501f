"""A study in stages, through the service: proposed, run, shown, interrupted, extended."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from services.admission import admit, find
from services.artifacts.open import open_artifacts
from services.budget import check_rounds, most_trials, rounds_of
from services.coordinator import Coordinator
from services.dispatch.inline import InlineDispatcher
from services.errors import BadInput, WrongState
from services.problems import BadStudy
from services.proposing import InlineStrategist
from services.report import distinct_trials
from services.spec import ResolvedSpec, StudySpec
from services.spec_check import parse_study
from services.stages import stages_of_study
from services.states import StudyState, TrialState
from services.store.open import open_store
from services.store.port import Driver
from services.translate import job_of, settings_in

SHAPES = """
name: s
task:
  name: sample_shapes:shape
  settings: {features: {kind: euclidean, names: [side], low: [0], high: [9], distinct: 0.5}}
space: {x: {type: float, low: 0, high: 1}}
search: {strategy: sobol, trials: 4}
stages:
  novelty: {kind: novelty, after: search, strategies: 2, trainings: 2, threshold: 1.0}
  polish: {kind: polish, after: [search, novelty], strategies: 3, rounds: 2}
resources: {parallel: 3}
seed: 5
"""
HOPS = """
name: s
task: {name: point_jump, settings: {bar: 0.7}}
space: {speed: {type: float, low: 1.5, high: 2.5}, spin: {type: float, low: -6, high: 6}}
search: {strategy: sobol, trials: 3}
training: {budget: {samples: 1500}, network: {hidden: [8]}}
stages:
  novelty: {kind: novelty, after: search, strategies: 1, trainings: 1, training: {budget: {samples: 30000}}}
  polish:
    kind: polish
    after: [search, novelty]
    strategies: 2
    rounds: 2
    settings: {bar: 1.2}
    training: {ppo: {sigma_start: 0.2}}
seed: 5
"""


class Service:
    """One driver that runs trials inline."""

    def __init__(self, folder, text):
        self.store = open_store(f"sqlite:///{folder}/halma.db")
        self.artifacts = open_artifacts(folder / "artifacts")
        self.row = find(self.store, "s") or admit(self.store, parse_study(text, name="s.yaml"))

    def drive(self):
        coordinator = Coordinator(self.store, InlineDispatcher(self.artifacts), InlineStrategist())
        with self.store.transaction() as change:
            change.ask("s", "run")
        coordinator.take("s")
        while coordinator.driven():
            coordinator.step(0.0)
        return self.store.study("s")

    def trials(self):
        return self.store.trials(self.row.id)

    def told(self):
        return [(trial.number, trial.stage, trial.warm_start) for trial in self.trials()]


@pytest.fixture
def shapes(tmp_path):
    service = Service(tmp_path, SHAPES)
    service.drive()
    yield service
    service.store.close()


def test_a_study_goes_through_its_stages_and_each_trial_knows_its_parent(shapes):
    assert shapes.store.study("s").state is StudyState.COMPLETE
    told = shapes.told()
    assert [stage for _, stage, _ in told] == ["search"] * 4 + ["novelty"] * 4 + ["polish"] * 3
    parents = {number: parent for number, _, parent in told}
    stage = {number: name for number, name, _ in told}
    assert {parents[n] for n in range(4)} == {None}
    assert {stage[parents[n]] for n in range(4, 8)} == {"search"}
    # A polish of a function raises nothing, so that each strategy gets one round.
    assert len({parents[n] for n in range(8, 11)}) == 3


def test_novelty_finds_what_the_search_had_not(shapes):
    row, trials = shapes.store.study("s"), shapes.trials()
    assert len(distinct_trials(row, trials[:4])) == 2
    assert len(distinct_trials(row, trials)) > 2
    assert trials[4].info["avoid"]
    assert job_of(StudySpec.from_json(row.spec), trials[4]).novelty == {
        "avoid": trials[4].info["avoid"],
        "strategies": trials[4].info["strategies"],
        "threshold": 1.0,
    }
    assert job_of(StudySpec.from_json(row.spec), trials[0]).novelty is None


def test_the_stages_are_shown_with_what_each_found(shapes):
    row = shapes.store.study("s")
    search, novelty, polish = stages_of_study(row, shapes.trials())
    assert [(s.name, s.kind, s.state, s.done) for s in (search, novelty, polish)] == [
        ("search", "sobol", "over", 4),
        ("novelty", "novelty", "over", 4),
        ("polish", "polish", "over", 3),
    ]
    assert (search.new, polish.new) == (2, 0)
    assert novelty.new > 0
    assert (novelty.most, polish.most, most_trials(row)) == (4, 6, 14)
    assert json.dumps([stage.to_json() for stage in (search, novelty, polish)])


def test_stages_that_have_not_begun_are_waiting(shapes):
    row = replace(shapes.store.study("s"), state=StudyState.RUNNING)
    states = [[s.state for s in stages_of_study(row, shapes.trials()[:count])] for count in (0, 4, 8)]
    assert states == [
        ["waiting", "waiting", "waiting"],
        ["running", "waiting", "waiting"],
        ["over", "running", "waiting"],
    ]


def test_an_extended_search_goes_through_the_later_stages_with_what_is_new_alone(shapes):
    before = shapes.told()
    with shapes.store.transaction() as change:
        change.extend("s", trials=3)
    assert shapes.drive().state is StudyState.COMPLETE
    after = shapes.told()
    assert after[: len(before)] == before
    # The search finds its two strategies again: trained from and polished as they are, nothing more follows.
    assert [stage for _, stage, _ in after[len(before) :]] == ["search"] * 3


def test_a_polish_is_given_more_rounds_and_goes_on_from_where_it_stood(tmp_path):
    service = Service(tmp_path, HOPS.replace("rounds: 2", "rounds: 1"))
    service.drive()
    before = service.told()
    polished = {number for number, stage, _ in before if stage == "polish"}
    with service.store.transaction() as change:
        row = change.extend("s", rounds=2)
    assert (row.state, rounds_of(row)) == (StudyState.QUEUED, {"polish": 3})
    assert service.drive().state is StudyState.COMPLETE
    after = service.told()
    assert after[: len(before)] == before
    more = after[len(before) :]
    assert {stage for _, stage, _ in more} == {"polish"}
    assert more[0][2] in polished
    service.store.close()


def test_more_rounds_are_refused_where_there_is_no_polish_or_a_driver_is_at_work(tmp_path):
    service = Service(tmp_path, HOPS)
    with service.store.transaction() as change:
        change.drive("s", Driver(id="d", host="h", pid=1))
    with service.store.transaction() as change, pytest.raises(WrongState, match="pause it first: halma pause s"):
        change.extend("s", rounds=1)
    assert rounds_of(service.store.study("s")) == {"polish": 2}
    with pytest.raises(BadInput, match="at most 1000 rounds in the stage polish, found"):
        check_rounds(service.store.study("s"), 1000)
    service.store.close()
    (tmp_path / "plain").mkdir()
    plain = Service(tmp_path / "plain", SHAPES.partition("stages:")[0])
    with plain.store.transaction() as change, pytest.raises(WrongState, match="a stage of kind polish"):
        change.extend("s", rounds=1)
    plain.store.close()


def test_the_stages_of_a_real_training_hand_its_policy_on(tmp_path):
    service = Service(tmp_path, HOPS)
    assert service.drive().state is StudyState.COMPLETE
    trials = service.trials()
    by_stage = {name: [t for t in trials if t.stage == name] for name in ("search", "novelty", "polish")}
    assert [len(by_stage["search"]), len(by_stage["novelty"])] == [3, 1]
    assert len(by_stage["polish"]) >= 1
    for trial in (*by_stage["novelty"], *by_stage["polish"]):
        assert trial.details["warm_start"]["parent"] == trial.warm_start
        assert trial.details["warm_start"]["networks"] is True
    novel = service.store.metrics(by_stage["novelty"][0].id)[-1].values
    assert 0.01 <= novel["novelty"] <= 1
    # The polish has settings of its own: its bar is higher than that of the search.
    assert max(t.details["bar"] for t in by_stage["search"]) <= 0.7
    assert max(t.details["bar"] for t in by_stage["polish"]) > 0.7
    service.store.close()


JUMPS = """
name: s
task:
  name: high_jump
  settings: {formulation: flight, first_bar: 0.45, lowest_bar: 0.45, bar_step: 0.05, highest_bar: 0.7, z_freeze: 0.5}
space:
  alpha: {type: float, low: 0.4, high: 0.6}
  omega_x: {type: float, low: -3.0, high: -2.5}
search: {strategy: sobol, trials: 1}
training:
  budget: {iterations: 1}
  network: {hidden: [16]}
  ppo: {samples: 30, environments: 2, minibatch: 16, epochs: 2, sigma_start: 0.1}
stages:
  novelty: {kind: novelty, after: search, strategies: 1, trainings: 1}
  polish: {kind: polish, after: search, strategies: 1, rounds: 1, settings: {z_freeze: null}}
"""


def test_an_athlete_goes_through_the_stages_too(tmp_path):
    service = Service(tmp_path, JUMPS)
    assert service.drive().state is StudyState.COMPLETE
    trials = {trial.stage: trial for trial in service.trials()}
    assert {stage: trial.state for stage, trial in trials.items()} == dict.fromkeys(
        ("search", "novelty", "polish"), TrialState.COMPLETE
    )
    assert trials["novelty"].info["avoid"] == [list(trials["search"].features)]
    for stage in ("novelty", "polish"):
        assert trials[stage].details["warm_start"] == {
            "parent": 0,
            "networks": True,
            "message": "started from the parent's policy",
        }
    levels = {stage: service.store.metrics(trial.id)[0].values["level"] for stage, trial in trials.items()}
    # Something new is learnt from the first bar on, a polish from a little below what is cleared.
    assert levels["search"] == levels["novelty"] == 0.45
    assert levels["polish"] == pytest.approx(max(0.45, trials["search"].value - 0.1))
    service.store.close()


DRIVE = """
import sys
from pathlib import Path
from test_study_stages import HOPS, Service

Service(Path(sys.argv[1]), HOPS).drive()
"""


def test_a_study_killed_in_a_later_stage_goes_on_there(tmp_path):
    service = Service(tmp_path, HOPS)
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    process = subprocess.Popen([sys.executable, "-c", DRIVE, str(tmp_path)], env={**os.environ, "PYTHONPATH": paths})
    try:
        end = time.monotonic() + 120
        while not (len(service.trials()) > 3 and service.trials()[3].iteration >= 3):
            assert time.monotonic() < end
            time.sleep(0.02)
    finally:
        process.kill()
        process.wait()
    killed = service.trials()
    assert [(t.stage, t.state) for t in killed][3:] == [("novelty", TrialState.RUNNING)]
    assert service.drive().state is StudyState.COMPLETE
    trials = service.trials()
    assert trials[:3] == killed[:3]
    assert (trials[3].stage, trials[3].warm_start, trials[3].info) == ("novelty", killed[3].warm_start, killed[3].info)
    assert service.store.attempts(trials[3].id)[1].first_iteration >= 3
    iterations = [metric.iteration for metric in service.store.metrics(trials[3].id)]
    assert iterations == list(range(1, len(iterations) + 1))
    assert {t.stage for t in trials} == {"search", "novelty", "polish"}
    service.store.close()


def test_a_stage_has_the_studys_settings_with_its_own_laid_over():
    spec = parse_study(HOPS, name="s.yaml")
    assert isinstance(spec, ResolvedSpec)
    settings, training = settings_in(spec, "polish")
    assert settings == {"bar": 1.2}
    assert training == {"budget": {"samples": 1500}, "network": {"hidden": [8]}, "ppo": {"sigma_start": 0.2}}
    assert settings_in(spec, "search") == (spec.task.settings, spec.training)
    assert StudySpec.from_json(spec.to_json()) == spec


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "after: [search, novelty]",
            "after: [search, novlty]",
            "s.yaml:10: stages.polish.after: expected another stage, found novlty; did you mean novelty?",
        ),
        (
            "kind: novelty, after: search",
            "kind: novelty, after: polish",
            "s.yaml:9: stages.novelty.after: expected stages that begin before novelty, found that they wait in a",
        ),
        (
            "kind: polish",
            "kind: polis",
            "s.yaml:10: stages.polish.kind: expected one of novelty, polish, found 'polis'; did you mean polish?",
        ),
        (
            "trials: 4",
            "cost: 400",
            "s.yaml:7: search.trials: expected the number of trials after which the later stages begin, found none",
        ),
        (
            "rounds: 2",
            "round: 2",
            "s.yaml:10: stages.polish.round: expected a known key, found round; did you mean rounds?",
        ),
        ("  novelty: {", "  search: {", "s.yaml:9: stages.search: expected another name, found search"),
        (
            "threshold: 1.0",
            "settings: {bar: 1}",
            "s.yaml:9: stages.novelty.settings.bar: unknown setting of a function",
        ),
        (
            "rounds: 2",
            "settings: {features: {kind: euclidean, names: [side], low: [0], high: [9], distinct: 0.4}}",
            "s.yaml:10: stages.polish.settings: expected settings that leave the behaviour what it is",
        ),
        (
            "after: [search, novelty]",
            "after: [search, search]",
            "s.yaml:10: stages.polish.after: expected each stage once",
        ),
        ("strategies: 2", "strategies: 0", "s.yaml:9: stages.novelty.strategies: expected a number above 0, found 0"),
        (
            "{kind: polish, after: [search, novelty], strategies: 3, rounds: 2}",
            "polish",
            "s.yaml:10: stages.polish: expected a stage, for example {kind: polish, after: search}",
        ),
    ],
)
def test_a_wrong_stage_is_one_clear_message(old, new, message):
    assert old in SHAPES
    with pytest.raises(BadStudy) as refusal:
        parse_study(SHAPES.replace(old, new), name="s.yaml")
    assert len(refusal.value.problems) == 1, str(refusal.value)
    assert str(refusal.value).startswith(message)


def test_novelty_needs_a_task_that_can_be_trained_for_it():
    with pytest.raises(BadStudy, match=r"novelty\.kind: expected a task that can be trained for novelty, found"):
        parse_study(SHAPES.replace("sample_shapes:shape", "test_study_stages:plain"), name="s.yaml")
    text = SHAPES.replace("sample_shapes:shape", "test_study_stages:plain").replace(
        "  settings: {features: {kind: euclidean, names: [side], low: [0], high: [9], distinct: 0.5}}\n", ""
    )
    with pytest.raises(BadStudy, match="stages: expected a task with a behaviour, which tells strategies apart"):
        parse_study(text, name="s.yaml")


def plain(params):
    """A function that knows nothing of novelty."""
    return params["x"], [0.0]
