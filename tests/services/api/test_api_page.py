"""`docs/api.md`: its Python is run against a real service, and what it lists is what there is."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from services.api.assembly import create_api
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper, load_or_create_token
from services.serving import announced
from services.settings import find_settings
from services.store.open import open_store
from tests.record import Record
from tests.served import served

PAGE = Path(__file__).parents[3] / "docs" / "api.md"
BLOCKS = re.compile(r"```python\n(.*?)```", re.DOTALL)


@pytest.fixture
def service(tmp_path, monkeypatch):
    """A service of a home of its own, with the study that the page speaks of; its store."""
    monkeypatch.setenv("HALMA_HOME", str(tmp_path / "home"))
    for name in ("HALMA_DB", "HALMA_TOKEN", "HALMA_ARTIFACTS"):
        monkeypatch.delenv(name, raising=False)
    token = load_or_create_token(tmp_path / "home")
    settings = find_settings()
    store, files = open_store(settings.database), open_artifacts(settings.artifacts)
    record = Record(store, files, "throw").begin()
    for _ in range(12):
        record.one(iterations=1, files=())
    app = create_api(store, files, gate=Gatekeeper(token.token), submit=submit_to(store))
    with served(app) as url, announced(settings, url):
        yield store, token.token
    store.close()


def test_its_python_does_what_it_says(service, capsys):
    store, token = service
    names = {"token": token}
    blocks = BLOCKS.findall(PAGE.read_text(encoding="utf-8"))
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    names["client"].close()
    names["http"].close()
    study = store.study("throw")
    rows = store.trials(study.id)
    assert names["best"].value == max(row.value for row in rows)
    assert names["numbers"] == [row.number for row in rows]
    assert names["kinds"] == [event.kind for event in store.events()]
    printed = capsys.readouterr().out
    assert "study 'thrwo': expected the name of a study, found 'throw'" in printed
    assert printed.startswith("throw running {'complete': 12}")


def rows_of(table):
    """First cells of the table under a heading."""
    text = PAGE.read_text(encoding="utf-8").partition(f"\n## {table}\n")[2].partition("\n## ")[0]
    return [
        line.split("|")[1].strip(" `") for line in text.splitlines() if line.startswith("| ") and "---" not in line
    ][1:]


def test_its_routes_are_the_routes(client):
    description = client.get("/api/v1/openapi.json").json()["paths"]
    there = {f"{method.upper()} {path}" for path, methods in description.items() for method in methods}
    assert set(rows_of("Routes")) == there | {"WEBSOCKET /api/v1/events"}


def test_its_metrics_are_the_metrics(client, record):
    record.one(iterations=1)
    families = text_string_to_metric_families(client.get("/metrics").text)
    # the parser takes the suffix of a counter for part of the format
    names = {family.name + ("_total" if family.type == "counter" else "") for family in families}
    assert set(rows_of("Watching the service")) == names


def test_its_frames_are_what_a_socket_sends(client, record):
    known = set(rows_of("Live"))
    record.one(iterations=1)
    with client.websocket_connect("ws://localhost:8642/api/v1/events?study=jump&after=0") as socket:
        seen = [json.loads(socket.receive_text()) for _ in range(2)]
    frames = [frame for each in seen for frame in (each if isinstance(each, list) else [each])]
    assert {frame["type"] for frame in frames} <= known
    assert frames[0]["type"] == "hello"
