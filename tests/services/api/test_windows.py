"""A window on many trials: what is sorted, filtered and counted."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.api.windows import Condition, matching, ordered
from services.errors import BadInput
from services.states import TrialState


@pytest.fixture
def jumps(record):
    for number in range(6):
        record.one(iterations=1, files=(), value=[0.5, 0.9, 0.1, 0.9, 0.3, 0.7][number])
    record.one(iterations=1, files=(), state=TrialState.DIVERGED, message="the loss was NaN")
    record.propose()
    return record


def window(client, **query):
    return client.get("/api/v1/studies/jump/window", params=query)


def numbers(client, **query):
    return [trial["number"] for trial in window(client, **query).json()["trials"]]


def test_a_window_is_part_of_a_sorted_whole(client, jumps):
    # 0.9 (1), 0.9 (3), 0.7 (5), 0.5 (0), 0.3 (4), 0.1 (2), then those without a value
    assert numbers(client, sort="-value") == [1, 3, 5, 0, 4, 2, 6, 7]
    assert numbers(client, sort="value", limit=3) == [2, 4, 0]
    assert numbers(client, sort="-value", offset=2, limit=2) == [5, 0]
    found = window(client, sort="-value", offset=2, limit=2).json()
    assert (found["count"], found["matched"], found["offset"]) == (8, 8, 2)
    assert numbers(client, offset=100) == []


@pytest.mark.parametrize("descending", ["", "-"])
@pytest.mark.parametrize("field", ["params.omega_x", "features.0", "finished_at", "details.bar", "mode", "message"])
def test_every_field_sorts(client, store, jumps, field, descending):
    trials = store.trials(jumps.id)

    def key(trial):
        group, _, name = field.partition(".")
        if group == "params":
            return trial.params[name]
        if group == "features":
            return None if trial.features is None else trial.features[0]
        if group == "details":
            return trial.details.get(name)
        return trial.info.get("mode") if field == "mode" else getattr(trial, field)

    have = sorted((trial for trial in trials if key(trial) is not None), key=key, reverse=bool(descending))
    lack = [trial for trial in trials if key(trial) is None]
    assert numbers(client, sort=descending + field) == [trial.number for trial in have + lack]


def test_filters_hold_together(client, jumps):
    assert numbers(client, where=["value>=0.5", "value<0.9"]) == [0, 5]
    assert numbers(client, where="value=0.9") == [1, 3]
    assert numbers(client, where="message~nan") == [6]
    assert numbers(client, state=["diverged", "queued"]) == [6, 7]
    assert numbers(client, where="state!=complete") == [6, 7]
    assert numbers(client, where="value!=0.9") == [0, 2, 4, 5, 6, 7]
    assert numbers(client, where="number > 5", state="complete") == []
    found = window(client, where="value>0.6", limit=1).json()
    assert (found["count"], found["matched"], len(found["trials"])) == (8, 3, 1)


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"sort": "speed"}, "sort: expected one of number, state"),
        ({"sort": "params."}, "found 'params.'"),
        ({"where": "value"}, "where: expected FIELD OPERATOR VALUE"),
        ({"where": "value>high"}, "expected a number after >, found 'high'"),
        ({"where": "speed>1"}, "where: expected one of"),
        ({"limit": 0}, "limit: "),
        ({"where": ["number>1"] * 17}, "where: "),
    ],
)
def test_what_is_wrong_is_named(client, jumps, query, message):
    answer = window(client, **query)
    assert answer.status_code == 422
    assert message in answer.json()["error"]["message"]


@given(st.text(max_size=30))
def test_any_condition_is_read_or_refused(text):
    with contextlib.suppress(BadInput):
        assert Condition.parse(text).operator in text


def test_sorting_by_mixed_kinds_puts_numbers_before_text_and_nothing_last(jumps, store):
    from dataclasses import replace

    trials = store.trials(jumps.id)[:5]
    values = ["b", 2.0, None, "a", True]
    mixed = [replace(trial, params={"x": value}) for trial, value in zip(trials, values, strict=True)]
    assert [trial.params["x"] for trial in ordered(mixed, "params.x")] == [True, 2.0, "a", "b", None]
    assert [trial.params["x"] for trial in matching(mixed, None, ["params.x=true"])] == [True]


def test_a_download_holds_what_passes_in_its_order_with_the_chosen_columns(client, jumps):
    query = {"sort": "-value", "where": "value>0.4", "column": ["number", "value", "params.alpha", "message"]}
    answer = client.get("/api/v1/studies/jump/trials.csv", params=query)
    lines = answer.text.splitlines()
    assert lines[0] == "number,value,params.alpha,message"
    assert [line.split(",")[:2] for line in lines[1:]] == [["1", "0.9"], ["3", "0.9"], ["5", "0.7"], ["0", "0.5"]]
    wrong = client.get("/api/v1/studies/jump/trials.csv", params={"column": "speed"})
    assert wrong.status_code == 422
    assert "column: expected one of number" in wrong.json()["error"]["message"]


def test_words_are_looked_for_in_state_stage_mode_and_message(client, jumps):
    assert numbers(client, where="text~NAN") == [6]
    assert numbers(client, where="text~queued") == [7]
    assert numbers(client, where=["text~explore", "number>5"]) == [6, 7]


def test_what_many_ask_for_is_sorted_once_until_something_happens(client, app, jumps, monkeypatch):
    from services.api import windows

    sorted_by = []
    ordered = windows.ordered
    monkeypatch.setattr(windows, "ordered", lambda trials, sort: sorted_by.append(sort) or ordered(trials, sort))
    for offset in (0, 2, 4, 2):
        assert window(client, sort="-value", offset=offset, limit=2).status_code == 200
    assert sorted_by == ["-value"]
    jumps.one(iterations=1, files=(), value=0.95)
    assert numbers(client, sort="-value", limit=1) == [8]
    assert sorted_by == ["-value", "-value"]
