"""Submitting over HTTP: what is sent, and what each answer means to the person who typed it."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import httpx
import pytest

from services.address import find_server, read_server
from services.client import Client, ServerRefused, ServerUnavailable
from services.errors import BadInput, NameTaken
from services.settings import find_settings


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
    with answering(settings, 201, {"name": "hill"}, seen) as client:
        assert client.submit("name: hill", ["seed=3"], "hill.yaml") == {"name": "hill"}
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
