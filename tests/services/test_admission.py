"""Taking studies in, and telling an old study from a changed one."""

from __future__ import annotations

import dataclasses

import pytest

from services.admission import StudyChanged, admit, find, flat, refuse_changes
from services.errors import NameTaken
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
    refuse_changes(row, spec(), "a.yaml:1")


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"seed": 4}, "  seed: 0 in the study, 4 in the file"),
        ({"training": {"budget": {"samples": 5}}}, "  training.budget.samples: nothing in the study, 5 in the file"),
        ({"space": {"x": {"type": "float", "low": 0, "high": 2}}}, "  space.x.high: 1.0 in the study, 2.0 in the file"),
        ({"resources": {"parallel": 2}}, "  resources.parallel: 1 in the study, 2 in the file"),
    ],
)
def test_what_changed_is_listed_by_field(store, change, line):
    row = admit(store, resolve(spec(), INFO))
    with pytest.raises(StudyChanged) as caught:
        refuse_changes(row, spec(**change), "a.yaml:1")
    lines = str(caught.value).splitlines()
    assert lines[0] == "a.yaml:1: name: expected the study s as it was created, or a new name, found changes:"
    assert lines[1:-1] == [line]
    assert "run the changed file as a new study with `--name NEW`" in lines[-1]


def test_a_smaller_budget_can_not_be_reached_by_extending(store):
    row = admit(store, resolve(spec(), INFO))
    with pytest.raises(StudyChanged) as caught:
        refuse_changes(row, spec(search={"strategy": "random", "trials": 2}), "a.yaml:1")
    assert "halma extend" not in str(caught.value)


def test_nested_mappings_become_dotted_keys():
    assert flat({"a": {"b": 1, "c": {"d": [2]}}, "e": {}, "f": None}) == {"a.b": 1, "a.c.d": [2], "f": None}
