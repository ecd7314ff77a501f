"""Taking studies in, and telling an old study from a changed one."""

from __future__ import annotations

import dataclasses

import pytest

from services.admission import StudyChanged, admit, apply_changes, changes_of, find, flat
from services.amending import read_amendments
from services.errors import BadInput, NameTaken
from services.spec import StudySpec
from services.store.open import open_store
from services.translate import resolve
from workers.contracts import ParameterSpec, TaskInfo

INFO = TaskInfo("t", "a task", {"x": ParameterSpec("float", 0.0, 1.0)})


def spec(**fields):
    return StudySpec.from_json({"name": "s", "task": "t", "search": {"strategy": "random", "trials": 3}, **fields})


@pytest.fixture
def store(tmp_path):
    opened = open_store(tmp_path / "halma.db")
    yield opened
    opened.close()


def test_a_study_is_admitted_with_its_budget_seed_pool_and_priority(store):
    asked = spec(seed=9, priority=2, resources={"pool": "gpu"}, search={"strategy": "random", "cost": 100.0})
    row = admit(store, resolve(asked, INFO))
    assert (row.name, row.seed, row.priority, row.pool) == ("s", 9, 2, "gpu")
    assert (row.target_trials, row.target_cost) == (None, 100.0)
    assert StudySpec.from_json(row.spec) == resolve(asked, INFO)


def test_a_name_that_exists_is_refused_with_the_ways_on(store):
    admit(store, resolve(spec(), INFO))
    with pytest.raises(NameTaken) as caught:
        admit(store, resolve(spec(seed=1), INFO))
    assert str(caught.value) == (
        "name: expected the name of a new study, found s, which exists; look at it with `halma show s`, go on with "
        "`halma resume s` or `halma extend s --trials N`, or give this one another name (--name)"
    )
    assert len(store.studies()) == 1
    assert find(store, "s").seed == 0
    assert find(store, "other") is None


def test_a_study_that_leaves_the_space_to_its_task_keeps_the_one_it_had(store):
    row = admit(store, resolve(spec(), INFO))
    newer = dataclasses.replace(INFO, parameters={"x": ParameterSpec("float", 0.0, 9.0)})
    assert resolve(spec(), newer) != StudySpec.from_json(row.spec)
    assert not changes(row, spec())


def changes(row, asked):
    return changes_of(row, asked, "a.yaml:1", "halma run a.yaml --name NEW")


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"seed": 4}, "  seed: 0 in the study, 4 in the file"),
        ({"training": {"budget": {"samples": 5}}}, "  training.budget.samples: nothing in the study, 5 in the file"),
        ({"space": {"x": {"type": "float", "low": 0, "high": 2}}}, "  space.x.high: 1.0 in the study, 2.0 in the file"),
        ({"task": "u"}, "  task.name: the text 't' in the study, the text 'u' in the file"),
        (
            {"search": {"strategy": "sobol", "trials": 3}},
            "  search.strategy: the text 'random' in the study, the text 'sobol' in the file",
        ),
        ({"search": {"strategy": "random", "trials": 2}}, "  search.trials: 3 in the study, 2 in the file"),
        (
            {"search": {"strategy": "random", "trials": 3, "cost": 9.0}},
            "  search.cost: nothing in the study, 9.0 in the file",
        ),
    ],
)
def test_what_makes_a_study_what_it_is_can_not_change_and_the_message_says_what_can(store, change, line):
    row = admit(store, resolve(spec(), INFO))
    before = store.study("s"), store.last_event()
    with pytest.raises(StudyChanged) as caught:
        changes(row, spec(**{"priority": 3, **change}))
    head, *found, stays, may, further = str(caught.value).splitlines()
    assert head == "a.yaml:1: name: expected the study s as it was created, or a new name, found changes:"
    assert found == [line]
    assert stays.endswith("space, seed, search, training, stages. Nothing was changed.")
    assert may.startswith("What can change is how it is run (priority, share, resources.pool,")
    assert may.endswith(
        "its budget (search.trials, search.cost) can be raised. Of this file that is: priority: 0 -> 3."
    )
    assert further == (
        "Run this file as a new study: halma run a.yaml --name NEW. Go on with the old one as it is: halma resume s"
    )
    assert (store.study("s"), store.last_event()) == before


def test_how_a_study_is_run_and_more_budget_are_taken_from_its_file_and_recorded(store):
    row = admit(store, resolve(spec(), INFO))
    asked = spec(
        priority=2, share=3.0, resources={"parallel": 4, "pool": "gpu", "cpus": 2.0}, retries={"limit": 7, "total": 9},
        keep_checkpoints=True, search={"strategy": "random", "trials": 5},
    )  # fmt: skip
    found = changes(row, asked)
    assert "search.trials: 3 -> 5" in found.words
    assert "resources.pool: the text 'default' -> the text 'gpu'" in found.words
    row = apply_changes(store, row, found)
    assert (row.priority, row.pool, row.target_trials) == (2, "gpu", 5)
    kept = StudySpec.from_json(row.spec)
    assert (kept.share, kept.resources, kept.retries) == (3.0, asked.resources, asked.retries)
    assert kept.search.trials == 3, "what it began with"
    amended, extended = store.events(study_id=row.id)[1:]
    assert amended.kind == "amended"
    assert amended.payload["changes"]["resources.parallel"] == {"from": 1, "to": 4}
    assert (extended.kind, extended.payload["trials"]) == ("extended", 2)
    assert not changes(row, asked), "the second time there is nothing to change"
    assert not changes(row, spec(**{**asked.to_json(), "search": {"strategy": "random", "trials": 3}}))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["seed=3"], "seed: expected a field that can be changed once the study exists, found seed; "),
        (["search.trials=9"], "found search.trials; raise it with `halma extend s`"),
        (["priorty=3"], "found priorty; did you mean priority?"),
        (["priority=high"], "priority=high: priority: expected a whole number, found the text 'high'"),
        (["parallel=0"], "resources.parallel=0: resources.parallel: expected a number above 0, found 0"),
        (["priority"], "priority: expected field=value"),
        (["pool=a b"], "expected a name of letters, digits"),
        (["share=-1"], "share: expected a number above 0, found -1"),
    ],
)
def test_an_amendment_that_can_not_be_is_refused_with_field_and_value(store, texts, message):
    row = admit(store, resolve(spec(), INFO))
    with pytest.raises(BadInput) as caught:
        read_amendments(row, texts)
    assert message in str(caught.value)
    assert "--set" not in str(caught.value)


def test_amendments_may_be_typed_in_short(store):
    row = admit(store, resolve(spec(), INFO))
    assert read_amendments(row, ["pool=gpu", "priority=3", "share=2"]) == {
        "resources.pool": "gpu",
        "priority": 3,
        "share": 2.0,
    }


def test_nested_mappings_become_dotted_keys():
    assert flat({"a": {"b": 1, "c": {"d": [2]}}, "e": {}, "f": None}) == {"a.b": 1, "a.c.d": [2], "f": None}
