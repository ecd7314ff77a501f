"""Pages of every list: they join without a gap or a repeat, also where the list changes between two of them."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.api.cursors import cursor, key_of
from services.errors import BadInput
from services.states import TrialState
from tests.record import Record

STUDY = "/api/v1/studies/jump"
LISTS = {
    "/api/v1/studies": "studies",
    "/api/v1/events": "events",
    "/api/v1/workers": "workers",
    f"{STUDY}/trials": "trials",
    f"{STUDY}/events": "events",
    f"{STUDY}/proposals": "proposals",
    f"{STUDY}/strategies": "strategies",
    f"{STUDY}/artifacts": "artifacts",
    f"{STUDY}/ladder": "points",
    f"{STUDY}/lineage": "edges",
    f"{STUDY}/trials/0/attempts": "attempts",
    f"{STUDY}/trials/0/artifacts": "artifacts",
}


@pytest.fixture
def busy(store, artifacts, record):
    """Everything that can be listed, several of each."""
    (first,) = record.propose()
    for _ in range(2):
        lost = record.start(first)
        with store.transaction() as change:
            change.lose(lost.id, lost.token, "the host went away")
    record.finish(record.start(first), first, value=0.3, features=(0.0,), files=[("a.txt", b"a"), ("b.txt", b"b")])
    for number in range(3):
        record.one(iterations=1, z=0.5, value=0.5 + number, features=(1.0 + number,))
    record.one(iterations=1, state=TrialState.FAILED, message="it fell")
    for worker, trial in enumerate(record.propose(3)):
        record.start(trial, worker=f"default-{worker}")
    with store.transaction() as change:
        parents = [trial.number for trial in store.trials(record.id)[:2]]
        from services.store.port import NewTrial

        children = [NewTrial({"omega_x": 0.0, "alpha": 0.0}, seed=1, z=1.0, warm_start=parent) for parent in parents]
        change.propose(
            record.id, record.token, strategy="bds", history=0, pending=(), rng_key=(7,), seconds=0.1, trials=children
        )
    for name in ("hop", "skip"):
        Record(store, artifacts, name).begin()
    return record


def rows_of(page, name):
    rows = page[name]
    return list(rows.items()) if isinstance(rows, dict) else rows


@pytest.mark.parametrize("path", LISTS)
def test_pages_of_one_row_join_to_the_whole_list(client, busy, path):
    whole = rows_of(client.get(path, params={"limit": 1000}).json(), LISTS[path])
    assert len(whole) > 1
    joined, given_ = [], {}
    while True:
        page = client.get(path, params={"limit": 1, **given_}).json()
        assert len(rows_of(page, LISTS[path])) == 1
        joined += rows_of(page, LISTS[path])
        if page["next"] is None:
            break
        given_ = {"page": page["next"]}
    assert joined == whole


def test_what_comes_in_between_two_pages_makes_no_row_come_twice_or_be_left_out(client, store, artifacts, busy):
    first = client.get("/api/v1/studies", params={"limit": 2}).json()
    assert [study["name"] for study in first["studies"]] == ["skip", "hop"]
    Record(store, artifacts, "later").begin()
    rest = client.get("/api/v1/studies", params={"limit": 2, "page": first["next"]}).json()
    assert [study["name"] for study in rest["studies"]] == ["jump"]

    before = client.get(f"{STUDY}/strategies", params={"limit": 2}).json()
    assert [one["value"] for one in before["strategies"]] == [2.5, 1.5]
    busy.one(iterations=1, value=9.0, features=(-2.0,))
    after = client.get(f"{STUDY}/strategies", params={"page": before["next"]}).json()
    assert [one["value"] for one in after["strategies"]] == [0.5, 0.3]


def test_a_deleted_row_takes_no_other_along(client, store, artifacts, record):
    for name in ("hop", "skip"):
        Record(store, artifacts, name).begin().end()
    first = client.get("/api/v1/studies", params={"limit": 1}).json()
    with store.transaction() as change:
        change.delete_study(first["studies"][0]["name"])
    rest = client.get("/api/v1/studies", params={"page": first["next"]}).json()
    assert [study["name"] for study in rest["studies"]] == ["hop", "jump"]


@pytest.mark.parametrize("path", LISTS)
def test_a_cursor_of_another_list_or_of_nobody_is_refused(client, busy, path):
    for page in (cursor("somewhere", 1), "x", "", "e30", cursor(LISTS[path], "a", "b", "c", "d", "e")):
        answer = client.get(path, params={"page": page})
        assert answer.status_code == 422, page
        assert "page: expected the `next` of a page of" in answer.json()["error"]["message"]


def test_every_list_is_described_with_its_cursor(client):
    paths = client.get("/api/v1/openapi.json").json()["paths"]
    described = {
        path
        for path, methods in paths.items()
        if any(parameter["name"] == "page" for parameter in methods.get("get", {}).get("parameters", []))
    }
    wanted = {path.replace("/jump", "/{study}").replace("/trials/0", "/trials/{number}") for path in LISTS}
    assert described == wanted
    # and no route answers with a bare list, which couldn't say that it goes on
    for path, methods in paths.items():
        shape = (
            methods.get("get", {}).get("responses", {}).get("200", {}).get("content", {}).get("application/json", {})
        )
        assert shape.get("schema", {}).get("type") != "array", path


@given(
    st.lists(
        st.integers(-(2**62), 2**62) | st.text(max_size=20) | st.floats(allow_nan=False, allow_infinity=False),
        max_size=4,
    )
)
def test_a_key_survives_its_cursor(key):
    assert key_of("things", cursor("things", *key), *(type(part) for part in key)) == key


@given(st.text(max_size=40) | st.text("ABCDabcd0123-_=", max_size=40))
def test_any_text_is_a_cursor_or_refused(text):
    with contextlib.suppress(BadInput):
        assert len(key_of("things", text, int)) == 1
