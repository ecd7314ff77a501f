"""The client: what is sent, and what each answer means to the person who typed it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import httpx
import pytest

from services.address import find_server, read_server
from services.api.assembly import create_api
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper
from services.client import Client, ServerRefused, ServerUnavailable
from services.errors import (
    ArtifactDamaged,
    BadInput,
    DatabaseUnavailable,
    NameTaken,
    UnknownStudy,
    UnknownTrial,
    WrongState,
)
from services.remote_store import RemoteStore
from services.settings import find_settings
from services.states import TrialState
from services.store.open import open_store
from tests.record import Record
from tests.served import served

HILL = {
    "name": "hill", "state": "queued", "reason": "", "wanted": "run", "task": "hill", "strategy": "random",
    "pool": "default", "priority": 0, "target_trials": 4, "search_trials": 4, "target_cost": None, "trials": {},
    "cost": {"samples": 0, "seconds": 0.0}, "best_value": None, "driver": None, "finished_at": None,
    "created_at": "2026-03-01T12:00:00Z", "seed": 7, "spec": {"name": "hill"},
}  # fmt: skip
"""A study as the API tells it."""


@pytest.fixture
def settings(tmp_path, monkeypatch):
    monkeypatch.delenv("HALMA_TOKEN", raising=False)
    (tmp_path / "token").write_text("secret-token\n", encoding="utf-8")
    return find_settings(environ={"HALMA_HOME": str(tmp_path)})


def answering(settings, status, body, seen=None):
    def handle(request):
        if seen is not None:
            seen.append(request)
        return httpx.Response(status, json=body) if body is not None else httpx.Response(status, text="<html>")

    return Client(settings, "http://127.0.0.1:9/", transport=httpx.MockTransport(handle))


def test_a_study_is_posted_with_the_token(settings):
    seen = []
    with answering(settings, 201, HILL, seen) as client:
        study = client.submit("name: hill", ["seed=3"], "hill.yaml")
    assert (study.name, study.state, study.spec) == ("hill", "queued", {"name": "hill"})
    (request,) = seen
    assert (request.method, str(request.url)) == ("POST", "http://127.0.0.1:9/api/v1/studies")
    assert request.headers["authorization"] == "Bearer secret-token"
    assert json.loads(request.content) == {"text": "name: hill", "overrides": ["seed=3"], "name": "hill.yaml"}


@pytest.mark.parametrize(
    ("status", "body", "kind", "message"),
    [
        (422, {"error": {"kind": "BadStudy", "message": "a.yaml:3: x: wrong"}}, BadInput, "a.yaml:3: x: wrong"),
        (409, {"error": {"kind": "NameTaken", "message": "name: taken"}}, NameTaken, "name: taken"),
        (401, {"error": {"message": "no"}}, BadInput, "expected the token of the service at http://127.0.0.1:9 in"),
        (500, None, ServerRefused, "expected the service at http://127.0.0.1:9 to answer, found status 500."),
        (404, None, ServerRefused, "found status 404."),
        (200, ["no object"], ServerRefused, "found status 200."),
    ],
)
def test_refusals_in_words(settings, status, body, kind, message):
    with answering(settings, status, body) as client, pytest.raises(kind) as caught:
        client.submit("", [], "a.yaml")
    assert message in str(caught.value)
    assert type(caught.value) is kind


def test_a_service_that_does_not_answer(settings):
    def handle(request):
        raise httpx.ConnectError("refused", request=request)

    client = Client(settings, "http://127.0.0.1:9", transport=httpx.MockTransport(handle))
    with client, pytest.raises(ServerUnavailable, match=r"found: refused; start one with `halma serve`"):
        client.submit("", [], "a.yaml")


def test_a_service_that_takes_too_long_may_have_taken_the_study(settings):
    def handle(request):
        raise httpx.ReadTimeout("slow", request=request)

    client = Client(settings, "http://127.0.0.1:9", transport=httpx.MockTransport(handle))
    with client, pytest.raises(ServerUnavailable, match="within 180 s, found none; see with `halma ls`"):
        client.submit("", [], "a.yaml")


def test_a_url_without_scheme_is_refused(settings):
    with pytest.raises(BadInput, match=r"--server: expected a URL such as .*, found localhost:9"):
        Client(settings, "localhost:9")


def test_a_missing_token_names_its_file(settings):
    settings.token_file.unlink()
    with (
        answering(settings, 201, {}) as client,
        pytest.raises(BadInput, match=r"expected the service's token in .*token"),
    ):
        client.submit("", [], "a.yaml")


def test_the_service_of_this_home_is_found_while_its_process_lives(settings):
    assert read_server(settings.server_file) is None
    fields = {"url": "http://127.0.0.1:9", "pid": os.getpid(), "database": settings.database}
    settings.server_file.write_text(json.dumps(fields), encoding="utf-8")
    assert find_server(settings).url == "http://127.0.0.1:9"
    other = json.dumps({**fields, "database": "elsewhere.db"})
    settings.server_file.write_text(other, encoding="utf-8")
    assert find_server(settings) is None, "it works on another database"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    settings.server_file.write_text(json.dumps({**fields, "pid": ended.pid}), encoding="utf-8")
    assert find_server(settings) is None, "its process has ended"
    for torn in ('{"url": "http', "[]", "{}"):
        settings.server_file.write_text(torn, encoding="utf-8")
        assert read_server(settings.server_file) is None


class TestOtherVersions:
    """What is said where the two sides don't speak the same language."""

    def client(self, settings, study, version="9.9"):
        def handle(request):
            if request.url.path.endswith("/server"):
                told = {"version": version, "boot": "b", "history": "h", "cursor": 1, "database": "d"}
                return httpx.Response(200, json=told)
            return study

        return Client(settings, "http://127.0.0.1:9", transport=httpx.MockTransport(handle))

    def test_what_a_newer_service_says_more_is_no_error(self, settings):
        with self.client(settings, httpx.Response(200, json={**HILL, "mood": "good"})) as client:
            assert client.study("hill").name == "hill"

    def test_an_answer_that_lacks_something_names_both_versions(self, settings):
        lacking = {name: value for name, value in HILL.items() if name != "cost"}
        with (
            self.client(settings, httpx.Response(200, json=lacking)) as client,
            pytest.raises(
                ServerRefused, match=r"as this halma knows it, found status 200\. cost: Field required"
            ) as told,
        ):
            client.study("hill")
        assert "The service is halma 9.9, this is halma " in str(told.value)
        assert str(told.value).endswith("use the same version on both sides")

    def test_a_route_that_an_older_service_lacks_is_named(self, settings):
        missing = httpx.Response(404, json={"error": {"kind": "HttpError", "message": "Not Found"}})
        with (
            self.client(settings, missing) as client,
            pytest.raises(
                ServerRefused, match=r"that knows /api/v1/studies/hill/slice, found status 404. The service is"
            ),
        ):
            client.slice("hill")

    def test_what_is_no_halma_at_all_is_asked_about(self, settings):
        def handle(request):
            return httpx.Response(404, text="<html>")

        client = Client(settings, "http://127.0.0.1:9", transport=httpx.MockTransport(handle))
        with client, pytest.raises(ServerRefused, match=r"found status 404. Is it a halma service\?"):
            client.study("hill")


def test_the_errors_there_are_the_errors_here(settings):
    kinds = {UnknownStudy: 404, UnknownTrial: 404, WrongState: 409, ArtifactDamaged: 410, DatabaseUnavailable: 503}
    for kind, status in kinds.items():
        body = {"error": {"kind": kind.__name__, "message": "in its words"}}
        with answering(settings, status, body) as client, pytest.raises(kind, match=r"^in its words$"):
            client.study("hill")


@pytest.mark.parametrize("name", ["", ".", ".."])
def test_a_name_that_would_be_another_path_is_refused(settings, name):
    with answering(settings, 200, HILL) as client, pytest.raises(BadInput, match="expected the name of a study"):
        client.study(name)


def test_a_name_is_one_part_of_the_path(settings):
    seen = []
    with answering(settings, 200, HILL, seen) as client:
        client.study("a/b?c#d e")
    assert seen[0].url.raw_path == b"/api/v1/studies/a%2Fb%3Fc%23d%20e"


def test_a_token_that_is_given_beats_the_file_and_a_wrong_one_is_said_to_be_the_given_one(settings):
    seen = []

    def handle(request):
        seen.append(request.headers["authorization"])
        return httpx.Response(401, json={"error": {"message": "no"}})

    client = Client(settings, "http://127.0.0.1:9", httpx.MockTransport(handle), token=" mine \n")
    with client, pytest.raises(BadInput, match=r"the token of the service at http://127\.0\.0\.1:9 in `token`"):
        client.server()
    assert seen == ["Bearer mine"]


@pytest.fixture(scope="module")
def jump(tmp_path_factory):
    """A real server over a record in which everything occurs; a client of it, its store, and the record."""
    folder = tmp_path_factory.mktemp("jump")
    store, artifacts = open_store(folder / "halma.db"), open_artifacts(folder / "artifacts")
    record = Record(store, artifacts, "jump").begin()
    for number in range(7):
        record.one(iterations=3, z=1.0 if number else 0.5)
    record.one(state=TrialState.FAILED, iterations=1, message="it fell")
    record.start(record.propose()[0])
    Record(store, artifacts, "hop").begin()
    app = create_api(store, artifacts, gate=Gatekeeper("secret-token"), submit=submit_to(store), pools={"default": 2})
    with served(app) as url, Client(find_settings(), url, token="secret-token") as client:
        yield client, store, record
    store.close()


class TestARealServer:
    def test_lists_are_whole_whatever_a_page_holds(self, jump, monkeypatch):
        client, store, _ = jump
        for rows in (1, 3, 1000):
            monkeypatch.setattr("services.client.ROWS", rows)
            assert [study.name for study in client.studies()] == ["hop", "jump"]
            assert [trial.number for trial in client.trials("jump")] == list(range(9))
            assert [trial.number for trial in client.trials("jump", after=5)] == [6, 7, 8]
            assert [trial.number for trial in client.trials("jump", states=["failed", TrialState.RUNNING])] == [7, 8]
            assert [event.id for event in client.events()] == [event.id for event in store.events()]
            assert [event.id for event in client.events("hop")] == [e.id for e in store.events() if e.study == "hop"]
            assert len(list(client.proposals("jump"))) == 9
            assert [worker.trial for worker in client.workers()] == [8]
            assert [point.number for point in client.ladder("jump")] == list(range(9))
            assert list(client.lineage("jump")) == []
            assert {left.trial for left in client.study_artifacts("jump")} == set(range(7))
            values = [one.value for one in client.strategies("jump")]
            assert values == sorted(values, reverse=True)
            assert len(values) > 1
            assert [attempt.number for attempt in client.attempts("jump", 0)] == [1]

    def test_one_thing_at_a_time(self, jump):
        client, store, record = jump
        row = store.trial(record.id, 3)
        trial = client.trial("jump", 3)
        assert (trial.value, trial.params, trial.seed, trial.details) == (row.value, row.params, row.seed, row.details)
        assert set(client.artifacts("jump", 3)) == set(trial.artifacts) == {"pose.png", "policy.safetensors"}
        assert client.artifact("jump", 3, "pose.png").startswith(b"\x89PNG")
        assert client.metrics("jump", 3, after=1).iterations == [2, 3]
        assert client.table("jump").numbers == list(range(9))
        assert [curve.number for curve in client.curves("jump", [1, 3], "kl").curves] == [1, 3]
        assert [(level.z, level.trials) for level in client.levels("jump")] == [(0.5, 1), (1.0, 8)]
        assert client.study("jump").spec == store.study("jump").spec
        assert client.server().cursor == store.last_event()
        assert client.cluster().pools[0].cores == 2

    def test_what_the_search_has_learnt(self, jump):
        client, _, _ = jump
        told = client.slice("jump", x="alpha", y="omega_x", size=5, output="value", at={})
        assert (told.x.name, len(told.mean), len(told.mean[0])) == ("alpha", 5, 5)
        assert {one.name for one in client.importance("jump", "value").parameters} == {"alpha", "omega_x"}

    def test_steering_answers_with_the_study(self, jump):
        client, store, _ = jump
        assert client.pause("hop").wanted == "pause"
        assert client.resume("hop").wanted == "run"
        assert client.extend("hop", trials=2).target_trials == store.study("hop").target_trials == 26
        with pytest.raises(BadInput, match="`trials`, `cost` or `rounds` above 0, found none of them"):
            client.extend("hop")
        with pytest.raises(WrongState, match="nobody drives to give more rounds, found it running; pause it first"):
            client.extend("hop", rounds=1)
        with pytest.raises(UnknownStudy, match="'hop'"):
            client.cancel("hopp")

    def test_what_is_not_there_is_told_as_the_store_tells_it(self, jump):
        client, store, record = jump
        with pytest.raises(UnknownTrial) as there:
            client.trial("jump", 99)
        with pytest.raises(UnknownTrial) as here:
            store.trial(record.id, 99)
        assert str(there.value) == str(here.value)
        with pytest.raises(BadInput, match=r"it left: policy\.safetensors, pose\.png"):
            client.artifact("jump", 3, "nothing.txt")

    def test_a_store_over_it_reads_what_the_store_here_reads(self, jump):
        client, store, record = jump
        remote = RemoteStore(client)
        unknown = {"id": 0, "study_id": 0, "trial_id": 0, "drive_token": 0, "drive_beat": 0, "driver": None, "token": 0,
                   "beat": 0, "path": ""}  # fmt: skip

        def same(there, here):
            there, here = (
                [replace(row, **{name: value for name, value in unknown.items() if hasattr(row, name)}) for row in rows]
                for rows in (there, here)
            )
            assert there == here

        row = remote.study("jump")
        same([row], [store.study("jump")])
        same(remote.trials(row.id), store.trials(record.id))
        same(remote.trials(row.id, after=2, limit=3), store.trials(record.id, after=2, limit=3))
        same(remote.history(row.id, start=2), store.history(record.id, start=2))
        trial, own = remote.trial(row.id, 3), store.trial(record.id, 3)
        same(remote.metrics(trial.id, after=1), store.metrics(own.id, after=1))
        same(remote.attempts(trial.id), store.attempts(own.id))
        same(remote.artifacts(trial.id), store.artifacts(own.id))
        same(remote.study_artifacts(row.id), store.study_artifacts(record.id))
        same(remote.proposals(row.id, limit=4), store.proposals(record.id, limit=4))
        same(remote.events(after=3, study_id=row.id), store.events(after=3, study_id=record.id))
        assert remote.history_id() == store.history_id()
        with remote.transaction() as change, pytest.raises(BadInput, match="extend or set of a service, found drive"):
            change.drive("jump", None)
