"""Without the token there is the login page, and nothing else; whatever route somebody adds is closed."""

from __future__ import annotations

import re

import pytest
from fastapi.testclient import TestClient
from starlette.routing import Mount
from starlette.websockets import WebSocketDisconnect

from dashboards import login
from dashboards.app import STATIC, create_app
from dashboards.rendering import static_root
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import COOKIE
from services.store.open import open_store
from tests.record import Record

TOKEN = "a-token-for-tests-only"
OPEN = {"/healthz", "/readyz", "/login", "/favicon.ico"}


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    folder = tmp_path_factory.mktemp("closed")
    store, artifacts = open_store(folder / "halma.db"), open_artifacts(folder / "artifacts")
    record = Record(store, artifacts, "jump").begin()
    record.one(iterations=1)
    yield create_app(store, artifacts, token=TOKEN, submit=submit_to(store))
    store.close()


@pytest.fixture
def anyone(app):
    with TestClient(app, base_url="http://localhost") as client:
        yield client


EXISTING = {"study": "jump", "number": "0", "name": "pose.png"}


def filled(path):
    """A path with its parameters filled with what exists."""
    return re.sub(r"\{(\w+)[^}]*\}", lambda match: EXISTING[match[1]], path)


def routes(app):
    """Every path of the application with its methods, but the static files."""
    flat, pending = [], list(app.routes)
    while pending:
        route = pending.pop()
        inner = getattr(route, "original_router", None)
        if inner is not None:
            pending += inner.routes
        elif not isinstance(route, Mount):
            flat.append((filled(route.path), sorted(getattr(route, "methods", None) or ["WEBSOCKET"])))
    return flat


def described(app):
    """The same from the description, in case a router hides its routes from this test."""
    return [(filled(path), [each.upper() for each in methods]) for path, methods in app.openapi()["paths"].items()]


PAGES = [
    "/", "/workers", "/submit", "/studies/jump", "/studies/jump/trials", "/studies/jump/events", "/studies/jump/file",
    "/studies/jump/trials/0",
]  # fmt: skip


def test_without_a_token_every_route_gives_the_login_page_or_nothing(app, anyone):
    asked = routes(app) + described(app) + [(path, ["GET"]) for path in PAGES]
    assert len(asked) > 40
    for path, methods in asked:
        for method in methods:
            if method == "WEBSOCKET" or path in OPEN:
                continue
            answer = anyone.request(method, path, follow_redirects=False)
            assert answer.status_code == 401, (method, path)
            assert "jump" not in answer.text
            page = anyone.request(method, path, headers={"accept": "text/html"}, follow_redirects=False)
            if page.status_code == 303:
                assert page.headers["location"].startswith("/login")
                assert page.text == ""
            else:
                assert page.status_code == 401, (method, path)


METHODS = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"]


def test_no_method_of_any_route_opens_it_and_neither_does_a_wrong_token_or_session(app, anyone):
    paths = sorted({path for path, _ in routes(app) + described(app)} - OPEN)
    # whatever a router hides from one way of finding routes, the other finds
    assert {path for path, _ in described(app)} <= {path for path, _ in routes(app)}
    assert len(paths) > 40
    attempts = [{}, {"authorization": "Bearer not-the-token-at-all"}, {"cookie": f"{COOKIE}=1.x.forged"}]
    for path in paths:
        for method in METHODS:
            for headers in attempts:
                answer = anyone.request(method, path, headers=headers, follow_redirects=False)
                assert answer.status_code == 401, (method, path, headers)
                assert not {"jump", "omega_x"} & set(answer.text.split('"')), (method, path, headers)


def test_a_route_that_somebody_adds_later_is_closed(tmp_path):
    store = open_store(tmp_path / "halma.db")
    added = create_app(store, open_artifacts(tmp_path / "artifacts"), token=TOKEN)

    @added.get("/later")
    def later():
        return "secret"

    with TestClient(added, base_url="http://localhost") as client:
        assert client.get("/later").status_code == 401
        assert client.get("/later", headers={"authorization": f"Bearer {TOKEN}"}).json() == "secret"
    store.close()


def test_the_policy_lets_a_page_load_and_send_nothing_elsewhere(anyone):
    policy = anyone.get("/login").headers["content-security-policy"]
    parts = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert parts["default-src"] == "'none'"
    assert parts["script-src"] == parts["style-src"] == parts["connect-src"] == parts["form-action"] == "'self'"
    assert parts["base-uri"] == parts["frame-ancestors"] == "'none'"
    allowed = {source for sources in parts.values() for source in sources.split()}
    assert allowed == {"'none'", "'self'", "data:", "blob:"}, "no host, no inline code, no eval"
    assert set(parts["img-src"].split()) == {"'self'", "data:", "blob:"}, "the rest only for pictures"


def test_logging_out_from_a_foreign_page_is_refused(app):
    app.state.throttle = type(app.state.throttle)()
    with TestClient(app, base_url="http://localhost") as client:
        client.post("/login", data={"token": TOKEN}, follow_redirects=False)
        foreign = client.post("/logout", headers={"origin": "http://evil.example"}, follow_redirects=False)
        assert foreign.status_code == 403
        assert client.get("/api/v1/studies").status_code == 200
        client.post("/logout", headers={"origin": "http://localhost"}, follow_redirects=False)
        assert client.get("/api/v1/studies").status_code == 401


def test_of_the_static_files_only_the_login_pages_own_are_open(anyone):
    names = [file.relative_to(STATIC).as_posix() for file in STATIC.rglob("*") if file.is_file()]
    assert len(names) > 20
    open_ones = {name for name in names if anyone.get(f"{static_root()}/{name}").status_code == 200}
    assert {f"{static_root()}/{name}" for name in open_ones} == login.open_paths() - {"/login", "/favicon.ico"}


def test_the_login_page_tells_nothing_of_what_is_behind_it(anyone):
    for path in ("/login", "/login?next=/studies/jump"):
        page = anyone.get(path)
        assert page.status_code == 200
        assert "omega_x" not in page.text
        assert TOKEN not in page.text
    assert anyone.get("/healthz").json() == anyone.get("/readyz").json() == {"status": "ok"}


def test_a_socket_is_closed_too(anyone):
    with pytest.raises(WebSocketDisconnect) as refused, anyone.websocket_connect("ws://localhost/api/v1/events"):
        pass
    assert refused.value.code == 4401


def test_guessing_is_slowed_down(anyone):
    statuses = [anyone.post("/login", data={"token": f"guess-{i}"}).status_code for i in range(7)]
    assert statuses[:5] == [401] * 5
    assert statuses[5:] == [429] * 2
    # not even the right one, for a while
    late = anyone.post("/login", data={"token": TOKEN})
    assert late.status_code == 429
    assert 1 <= int(late.headers["retry-after"]) <= 60


def test_the_cookie_is_for_this_site_and_no_script(app):
    app.state.throttle = type(app.state.throttle)()
    with TestClient(app, base_url="http://localhost") as client:
        cookie = client.post("/login", data={"token": TOKEN}, follow_redirects=False).headers["set-cookie"]
    assert cookie.startswith(f"{COOKIE}=")
    assert TOKEN not in cookie
    parts = {part.strip().lower() for part in cookie.split(";")[1:]}
    assert {"httponly", "samesite=strict", "path=/"} <= parts
    with TestClient(app, base_url="https://localhost") as client:
        assert (
            "secure"
            in client.post("/login", data={"token": TOKEN}, follow_redirects=False).headers["set-cookie"].lower()
        )


def test_a_login_from_a_foreign_page_is_refused(anyone):
    answer = anyone.post("/login", data={"token": TOKEN}, headers={"origin": "http://evil.example"})
    assert answer.status_code == 403


@pytest.mark.parametrize(
    "name", ["../app.py", "..%2fapp.py", "%2e%2e/app.py", "....//app.py", "/etc/passwd", "..\\app.py"]
)
def test_static_paths_stay_inside(app, name):
    with TestClient(app, base_url="http://localhost") as client:
        client.headers["authorization"] = f"Bearer {TOKEN}"
        assert client.get(f"{static_root()}/{name}").status_code in {404, 405}
        assert client.get(f"/api/v1/studies/jump/trials/0/artifacts/{name}").status_code == 404


@pytest.mark.parametrize("target", ["//evil.example", "https://evil.example", "/\\evil.example", "javascript:alert(1)"])
def test_a_login_leads_nowhere_else(app, target):
    app.state.throttle = type(app.state.throttle)()
    with TestClient(app, base_url="http://localhost") as client:
        answer = client.post("/login", data={"token": TOKEN, "next": target}, follow_redirects=False)
    assert answer.headers["location"] == "/"
