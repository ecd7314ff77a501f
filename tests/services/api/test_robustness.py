"""Whatever is asked, the API answers within its description: no 5xx, and every error in the one shape."""

from __future__ import annotations

from urllib.parse import quote

import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.api.assembly import create_api
from services.api.models import ErrorOut
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper
from services.store.open import open_store
from tests.record import Record
from tests.services.api.conftest import TOKEN

TEXT = st.text(max_size=20)
NUMBER = st.one_of(st.integers(-3, 4), st.integers(), st.just(2**63 - 1), st.just(2**63), TEXT)
STUDY = st.one_of(st.just("jump"), TEXT)
QUERY = st.dictionaries(st.sampled_from(["after", "limit", "page", "state", "study"]), NUMBER, max_size=3)
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), TEXT),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXT, inner, max_size=3)),
    max_leaves=6,
)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robust")
    store = open_store(folder / "halma.db")
    record = Record(store, open_artifacts(folder / "artifacts"), "jump").begin()
    record.one(iterations=1)
    record.propose(2)
    app = create_api(store, record.artifacts, gate=Gatekeeper(TOKEN))
    with TestClient(app, base_url="http://localhost", raise_server_exceptions=True) as made:
        made.headers["authorization"] = f"Bearer {TOKEN}"
        yield made
    store.close()


def assert_told(answer):
    assert answer.status_code < 500, answer.text
    if answer.status_code >= 400:
        assert ErrorOut.model_validate(answer.json()).error.message


def filled(template, study, number, name):
    return template.format(
        study=quote(str(study), safe=""), number=quote(str(number), safe=""), name=quote(str(name), safe="")
    )


def reads(client):
    paths = client.get("/api/v1/openapi.json").json()["paths"]
    return sorted(path for path, methods in paths.items() if "get" in methods)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data(), STUDY, NUMBER, st.one_of(st.just("pose.png"), TEXT), QUERY)
def test_every_read_is_answered(client, data, study, number, name, query):
    path = filled(data.draw(st.sampled_from(reads(client))), study, number, name)
    assert_told(client.get(path, params=query))


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["pause", "resume", "cancel", "extend", "nothing"]), STUDY, JSON)
def test_every_action_is_answered(client, action, study, body):
    assert_told(client.post(filled(f"/api/v1/studies/{{study}}/{action}", study, 0, ""), json=body))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(max_size=60), st.just(b'{"text": "a: 1"}'), st.just(b'{"text": "a", "overrides": 1}')))
def test_every_submission_is_answered(client, body):
    answer = client.post("/api/v1/studies", content=body, headers={"content-type": "application/json"})
    assert_told(answer)
    assert answer.status_code in {400, 422}
