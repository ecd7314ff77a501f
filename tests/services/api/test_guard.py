"""The gate: who gets in, from where, with how much."""

from __future__ import annotations

import pytest
from starlette.datastructures import Headers
from starlette.websockets import WebSocketDisconnect

from services.api.guard import LARGEST_BODY, Hosts, same_origin
from services.auth import COOKIE, SESSION_SECONDS, Gatekeeper
from tests.services.api.conftest import TOKEN

ORIGIN = "http://localhost:8642"
SOCKET = "ws://localhost:8642/api/v1/events"


@pytest.fixture
def browser(anyone):
    """A client with a session and no token."""
    anyone.cookies.set(COOKIE, Gatekeeper(TOKEN).new_session(), domain="localhost.local")
    return anyone


class TestIdentity:
    @pytest.mark.parametrize(
        "path", ["/api/v1/studies", "/api/v1/server", "/api/v1/openapi.json", "/anything", "/api/v1/studies/x/table"]
    )
    def test_without_a_token_there_is_nothing(self, anyone, path):
        answer = anyone.get(path)
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"] == "Bearer"
        assert "HALMA_HOME/token" in answer.json()["error"]["message"]

    @pytest.mark.parametrize("value", ["Bearer wrong", "Bearer ", f"Basic {TOKEN}", TOKEN, "Bearer \xff"])
    def test_a_wrong_token_is_refused(self, anyone, value):
        assert anyone.get("/api/v1/studies", headers={"authorization": value.encode("latin-1")}).status_code == 401

    def test_the_token_opens(self, client):
        assert client.get("/api/v1/studies").status_code == 200

    def test_a_session_opens(self, browser):
        assert browser.get("/api/v1/studies").status_code == 200

    def test_a_browser_is_sent_to_the_login_page_and_back(self, anyone):
        answer = anyone.get("/studies/a%20b?x=1&y=2", headers={"accept": "text/html"}, follow_redirects=False)
        assert answer.status_code == 303
        assert answer.headers["location"] == "/login?next=/studies/a%20b%3Fx%3D1%26y%3D2"

    def test_a_socket_without_a_token_is_refused(self, anyone):
        with pytest.raises(WebSocketDisconnect) as refused, anyone.websocket_connect(SOCKET):
            pass
        assert refused.value.code == 4401
        assert "Authorization: Bearer TOKEN" in refused.value.reason


class TestOrigin:
    def test_a_session_acts_from_our_own_pages(self, browser, record):
        assert browser.post("/api/v1/studies/jump/pause", headers={"origin": ORIGIN}).status_code == 200

    @pytest.mark.parametrize(
        "headers",
        [
            {"origin": "http://evil.example"},
            {"origin": "null"},
            {"origin": "https://localhost:8642"},
            {"origin": "http://localhost:8643"},
            {"sec-fetch-site": "cross-site"},
            {"sec-fetch-site": "same-site"},
            {},
        ],
    )
    def test_a_session_does_not_act_for_anybody_else(self, browser, store, record, headers):
        answer = browser.post("/api/v1/studies/jump/pause", headers=headers)
        assert answer.status_code == 403
        assert answer.json()["error"]["kind"] == "ForeignOrigin"
        assert store.study("jump").wanted == "run"

    def test_a_program_with_the_token_needs_no_origin(self, client, record):
        assert client.post("/api/v1/studies/jump/pause").status_code == 200

    def test_a_socket_of_a_session_comes_from_our_own_pages(self, browser, record):
        with browser.websocket_connect(SOCKET, headers={"origin": ORIGIN}) as socket:
            assert socket.receive_json()["type"] == "hello"
        foreign = browser.websocket_connect(SOCKET, headers={"origin": "http://evil.example"})
        with pytest.raises(WebSocketDisconnect) as refused, foreign:
            pass
        assert "from another origin" in refused.value.reason

    def test_without_an_origin_the_browser_itself_has_to_say_so(self):
        scope = {"scheme": "http"}
        assert same_origin(scope, Headers({"sec-fetch-site": "same-origin"}))
        assert not same_origin(scope, Headers({"sec-fetch-site": "none"}))


class TestHost:
    @pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8642", "[::1]:8642", "192.168.1.7", "HALMA.example:80"])
    def test_we_answer_to_our_names_and_to_addresses(self, client, host):
        assert client.get("/api/v1/server", headers={"host": host}).status_code == 200

    @pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "", "127.0.0.1.evil.example", "[bad"])
    def test_we_do_not_answer_to_a_foreign_name(self, client, host):
        answer = client.get("/healthz", headers={"host": host})
        assert answer.status_code == 421
        assert "--allow-host" in answer.json()["error"]["message"]

    def test_names_are_compared_without_case(self):
        assert Hosts.of_this_machine(["Training.Lab"]).allows("training.lab:8642")


class TestSize:
    def test_a_body_over_the_limit_is_refused(self, client):
        answer = client.post("/api/v1/studies", content=b"x" * (LARGEST_BODY + 1))
        assert answer.status_code == 413

    def test_one_that_does_not_say_its_size_is_refused_too(self, client):
        answer = client.post("/api/v1/studies", content=(b"x" * 65536 for _ in range(17)))
        assert answer.status_code == 413

    @pytest.mark.parametrize(
        ("path", "body", "field"),
        [
            ("/api/v1/studies", {"text": "#" * (256 * 1024 + 1)}, "text"),
            ("/api/v1/studies", {"text": "name: a", "overrides": ["a=1"] * 65}, "overrides"),
            ("/api/v1/reference", {"text": " " * 900_001}, "text"),
        ],
    )
    def test_what_fits_a_body_but_no_field_is_refused_by_name(self, client, store, path, body, field):
        answer = client.post(path, json=body)
        assert answer.status_code == 422
        assert answer.json()["error"]["field"] == field
        assert store.studies() == []


class TestHeaders:
    def test_every_answer_forbids_what_a_page_of_ours_never_does(self, anyone):
        for path in ("/healthz", "/api/v1/studies", "/nothing"):
            headers = anyone.get(path).headers
            assert "script-src 'self'" in headers["content-security-policy"]
            assert "unsafe" not in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["cache-control"] == "no-store"


class TestSessions:
    def test_one_ends_after_its_time(self):
        now = [1_000_000.0]
        gate = Gatekeeper(TOKEN, clock=lambda: now[0])
        session = gate.new_session()
        now[0] += SESSION_SECONDS
        assert gate.is_session(session)
        now[0] += 2
        assert not gate.is_session(session)

    def test_another_token_ends_all(self):
        assert not Gatekeeper("another-token-for-tests").is_session(Gatekeeper(TOKEN).new_session())

    @pytest.mark.parametrize("forged", ["", ".", "..", "9999999999.x.", "é.é.é", TOKEN])
    def test_a_forged_one_is_refused(self, forged):
        assert not Gatekeeper(TOKEN).is_session(forged)

    def test_a_changed_date_breaks_the_signature(self):
        issued, chance, signature = Gatekeeper(TOKEN).new_session().split(".")
        assert not Gatekeeper(TOKEN).is_session(f"{int(issued) + 1}.{chance}.{signature}")
        assert Gatekeeper(TOKEN).is_session(f"{issued}.{chance}.{signature}")

    def test_the_token_is_not_in_it(self):
        assert TOKEN not in Gatekeeper(TOKEN).new_session()
