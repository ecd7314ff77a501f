"""A study file that is wrong says where, what was expected and what was found; all of it at once."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.problems import BadStudy
from services.spec import AngleParameter, FloatParameter, StudySpec, json_schema
from services.spec_file import draft, read_draft

GOOD = """\
name: quick
task: high_jump
space:
  alpha: angle
  rate: {type: float, low: 1e-5, high: 1e-2, log: true}
  layers: {type: int, low: 1, high: 4}
  net: {type: categorical, choices: [small, large]}
search:
  strategy: bds
  trials: 6
training: {budget: 20000}
"""


def problems(text, *overrides):
    return [str(problem) for problem in draft(text, name="a.yaml", overrides=overrides).problems]


def refusal(text, *overrides):
    with pytest.raises(BadStudy) as caught:
        draft(text, name="a.yaml", overrides=overrides)
    return str(caught.value)


def test_a_study_file_becomes_a_frozen_spec():
    spec = draft(GOOD, name="a.yaml").spec
    assert spec.task.name == "high_jump"
    assert spec.space["alpha"] == AngleParameter(type="angle")
    assert spec.space["rate"] == FloatParameter(type="float", low=1e-5, high=1e-2, log=True)
    assert (spec.search.trials, spec.search.cost) == (6, None)
    assert (spec.resources.parallel, spec.resources.pool, spec.seed) == (1, "default", 0)
    with pytest.raises(ValueError, match="frozen"):
        spec.seed = 3


def test_a_spec_survives_the_database():
    spec = draft(GOOD, name="a.yaml").spec
    assert StudySpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "trials: 6",
            "trails: 6",
            ("a.yaml:10: search.trails: expected a known key, found trails; did you mean trials?"),
        ),
        (
            "trials: 6",
            "zzz: 6",
            ("a.yaml:10: search.zzz: expected a known key, found zzz; known: cost, first, settings, strategy, trials"),
        ),
        ("trials: 6", "trials: 0", "a.yaml:10: search.trials: expected a number above 0, found 0"),
        ("trials: 6", "cost: -1.5", "a.yaml:10: search.cost: expected a number above 0, found -1.5"),
        ("trials: 6", "trials: '6'", "a.yaml:10: search.trials: expected a whole number, found the text '6'"),
        ("trials: 6", "trials: true", "a.yaml:10: search.trials: expected a whole number, found true"),
        ("  trials: 6\n", "", "a.yaml:8: search.trials: expected a budget, `trials` or `cost`, found neither"),
        ("low: 1e-5", "low: 2.5", "a.yaml:5: space.rate.low: expected low below high, found low 2.5 and high 0.01"),
        ("low: 1e-5", "low: 1e-2", "a.yaml:5: space.rate.low: expected low below high, found low 0.01 and high 0.01"),
        (
            "low: 1e-5",
            "low: 0",
            ("a.yaml:5: space.rate.low: expected low above 0 on a logarithmic scale (log: true), found 0"),
        ),
        ("low: 1,", "low: 1.5,", "a.yaml:6: space.layers.low: expected a whole number, found 1.5"),
        ("[small, large]", "[]", "a.yaml:7: space.net.choices: expected at least 1 entry, found an empty list"),
        (
            "[small, large]",
            "[x, x]",
            ("a.yaml:7: space.net.choices: expected different choices, found 'x' more than once"),
        ),
        (
            "type: int",
            "type: flot",
            (
                "a.yaml:6: space.layers.type: expected one of float, int, categorical, angle, "
                "found 'flot'; did you mean float?"
            ),
        ),
        (
            "type: int, ",
            "",
            ("a.yaml:6: space.layers.type: expected one of float, int, categorical, angle, found nothing"),
        ),
        (
            "alpha: angle",
            "alpha: circle",
            (
                "a.yaml:4: space.alpha: expected a parameter, for example "
                "{type: float, low: 0, high: 1}, or angle, found the text 'circle'"
            ),
        ),
        (", high: 4", "", "a.yaml:6: space.layers.high: expected the largest value, found nothing"),
        ("budget: 20000", "budget: 0", "a.yaml:11: training.budget: expected a number above 0, found 0"),
        (
            "name: quick",
            "name: a/b",
            (
                "a.yaml:1: name: expected a name of letters, digits, `_`, `-` and `.`, "
                "beginning with a letter or a digit, found the text 'a/b'"
            ),
        ),
        ("task: high_jump", "task: [1]", "a.yaml:2: task: expected a mapping (key: value), found the list [1]"),
        (
            "task: high_jump",
            "task: {name: x, setings: {}}",
            ("a.yaml:2: task.setings: expected a known key, found setings; did you mean settings?"),
        ),
        (
            "training: {budget: 20000}",
            "seeds: 3",
            ("a.yaml:11: seeds: expected a known key, found seeds; did you mean seed?"),
        ),
        (
            "training: {budget: 20000}",
            "resources: {parallel: 0}",
            ("a.yaml:11: resources.parallel: expected a number above 0, found 0"),
        ),
    ],
)
def test_one_mistake_gives_one_problem_with_its_place(old, new, message):
    assert old in GOOD
    assert problems(GOOD.replace(old, new)) == [message]


def test_several_mistakes_are_all_listed_in_the_order_of_the_file():
    text = GOOD.replace("low: 1e-5", "low: 1").replace("trials: 6", "trails: 6").replace("name: quick", "nam: quick")
    assert [problem.split(": ")[:2] for problem in problems(text)] == [
        ["a.yaml:1", "name"],
        ["a.yaml:1", "nam"],
        ["a.yaml:5", "space.rate.low"],
        ["a.yaml:10", "search.trails"],
    ]


def test_a_missing_section_is_named_with_what_belongs_there():
    assert problems("name: a\n") == [
        "a.yaml:1: task: expected a task: its name, or a mapping of `name` and `settings`, found nothing",
        "a.yaml:1: search: expected a mapping of `strategy`, `settings` and `trials` or `cost`, found nothing",
    ]


def test_overrides_are_typed_and_reach_into_short_forms():
    spec = draft(
        GOOD, name="a.yaml", overrides=["search.trials=4", "task.settings.formulation=flight", "training.rate=1e-4"]
    ).spec
    assert spec.search.trials == 4
    assert spec.task.name == "high_jump"
    assert spec.task.settings == {"formulation": "flight"}
    assert spec.training == {"budget": 20000, "rate": 1e-4}


def test_a_wrong_override_is_named_instead_of_a_line():
    assert problems(GOOD, "search.trials=0") == [
        "--set search.trials=0: search.trials: expected a number above 0, found 0"
    ]
    assert problems(GOOD, "search.trails=5") == [
        "--set search.trails=5: search.trails: expected a known key, found trails; did you mean trials?"
    ]


def test_an_override_reaches_parameters_whose_names_have_dots():
    text = GOOD.replace("rate: {", "ppo.rate: {")
    whole = "space.ppo.clip={type: float, low: 0.1, high: 0.3}"
    spec = draft(text, name="a.yaml", overrides=["space.ppo.rate.low=1e-4", "space.layers.high=9", whole]).spec
    assert set(spec.space) == {"alpha", "ppo.rate", "layers", "net", "ppo.clip"}
    assert (spec.space["ppo.rate"].low, spec.space["ppo.rate"].high) == (1e-4, 1e-2)
    assert spec.space["layers"].high == 9
    assert spec.space["ppo.clip"].high == 0.3
    assert problems(text, "space.ppo.rat.low=0") == [
        "--set space.ppo.rat.low=0: space.ppo.rat.type: expected one of float, int, categorical, angle, found nothing"
    ]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("search.trials", "--set search.trials: expected field=value, for example search.trials=4"),
        (".=3", "--set .=3: expected field=value, for example search.trials=4"),
        ("name.x=3", "--set name.x=3: name.x: expected a field of a mapping, found that name is the text 'quick'"),
        (
            "seed=[1",
            (
                "--set seed=[1: seed: expected YAML, found a mistake while parsing a flow sequence: "
                "expected ',' or ']', but got '<stream end>'"
            ),
        ),
    ],
)
def test_an_override_that_is_none_is_refused(override, message):
    assert refusal(GOOD, override) == message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.yaml:1: expected a study (name, task, search, ...), found an empty file"),
        ("- a", 'a.yaml:1: expected a study (name, task, search, ...), found the list ["a"]'),
        ("name: a\ntask: b: c", "a.yaml:2: expected YAML, found a mistake: mapping values are not allowed here"),
        ("name: a\nname: b", "a.yaml:2: name: expected each key once, found it again (first on line 1)"),
    ],
)
def test_a_text_that_is_no_study_is_refused(text, message):
    assert refusal(text) == message


def test_a_missing_file_names_the_one_that_was_meant(tmp_path):
    (tmp_path / "quickstart.yaml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(BadStudy) as caught:
        read_draft(tmp_path / "quickstrt.yaml")
    assert str(caught.value) == (
        f"{tmp_path}/quickstrt.yaml: expected a study file, found no such file; "
        f"did you mean {tmp_path}/quickstart.yaml?"
    )


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(BadStudy, match=r"found no such file \(there is no folder .*/nowhere either\)"):
        read_draft(tmp_path / "nowhere" / "a.yaml")


def test_a_folder_and_a_binary_file_are_no_study_files(tmp_path):
    with pytest.raises(BadStudy, match="expected a readable study file, found: Is a directory"):
        read_draft(tmp_path)
    (tmp_path / "a.yaml").write_bytes(b"name: \xff")
    with pytest.raises(BadStudy, match="expected text in UTF-8, found the byte 0xff at position 6"):
        read_draft(tmp_path / "a.yaml")


def test_the_schema_offers_what_the_reader_accepts():
    schema = json_schema()
    assert set(schema["properties"]) == {*StudySpec.model_fields, "profiles"}
    profile = schema["properties"]["profiles"]["additionalProperties"]
    assert set(profile["properties"]) == set(StudySpec.model_fields) - {"profile"}
    assert "required" not in json.dumps(profile)
    assert "$ref" not in json.dumps(profile)
    assert schema["additionalProperties"] is False
    assert {"type": "string"} in schema["$defs"]["TaskChoice"]["anyOf"]
    text = json.dumps(schema["properties"]["space"])
    assert '"const": "angle"' in text


@given(low=st.floats(-1e6, 1e6), high=st.floats(-1e6, 1e6), log=st.booleans(), trials=st.integers(-3, 10))
def test_a_spec_is_accepted_exactly_when_its_bounds_enclose_something(low, high, log, trials):
    text = json.dumps(
        {
            "name": "a",
            "task": "t",
            "space": {"x": {"type": "float", "low": low, "high": high, "log": log}},
            "search": {"strategy": "random", "trials": trials},
        }
    )
    read = draft(text, name="a.yaml")
    assert (read.spec is not None) == (low < high and not (log and low <= 0) and trials > 0)
    assert bool(read.problems) == (read.spec is None)
