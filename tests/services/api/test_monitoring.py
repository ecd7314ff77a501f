"""Who is doing what, and the counts for Prometheus."""

from __future__ import annotations

from services.api.monitoring import exposition
from services.states import TrialState
from tests.record import Record


def test_workers_are_the_attempts_that_run_now(client, record):
    record.one()
    first, second = record.propose(2)
    attempt = record.start(first)
    record.report(attempt, 2, loss=1.0)
    listing = client.get("/api/v1/workers").json()
    (worker,) = listing["workers"]
    assert (worker["study"], worker["trial"], worker["worker"], worker["iteration"]) == ("jump", 1, "default-0", 2)
    # 1,400 samples in 3 seconds of training.
    assert worker["samples_per_second"] == 1400 / 3
    assert listing["queue"] == [
        {
            "study": "jump",
            "state": "running",
            "pool": "default",
            "priority": 0,
            "parallel": 2,
            "running": 1,
            "queued": 1,
        }
    ]
    assert second.number == 2


def test_a_worker_that_has_not_reported_has_no_rate(client, record):
    record.start(record.propose()[0])
    assert client.get("/api/v1/workers").json()["workers"][0]["samples_per_second"] is None


def test_finished_studies_wait_for_nobody(client, record):
    record.one()
    record.end()
    listing = client.get("/api/v1/workers").json()
    assert (listing["workers"], listing["queue"]) == ([], [])


def test_prometheus_reads_what_the_record_holds(client, store, record):
    record.one(value=0.625)
    record.one(state=TrialState.FAILED)
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    lines = answer.text.splitlines()
    for line in (
        'halma_studies{state="running"} 1',
        'halma_trials{study="jump",state="complete"} 1',
        'halma_trials{study="jump",state="failed"} 1',
        'halma_samples_total{study="jump"} 14000',
        'halma_training_seconds_total{study="jump"} 63.0',
        'halma_best_value{study="jump"} 0.625',
        f"halma_events_total {store.last_event()}",
        "halma_viewers 0",
    ):
        assert line in lines


def test_prometheus_own_parser_reads_every_family(store, artifacts, client):
    from prometheus_client.parser import text_string_to_metric_families

    record = Record(store, artifacts, "first").begin()
    record.one(value=-0.25)
    families = {each.name: each for each in text_string_to_metric_families(client.get("/metrics").text)}
    assert {name: family.type for name, family in families.items()} == {
        "halma_studies": "gauge",
        "halma_trials": "gauge",
        "halma_samples": "counter",
        "halma_training_seconds": "counter",
        "halma_best_value": "gauge",
        "halma_events": "counter",
        "halma_viewers": "gauge",
    }
    assert all(family.documentation for family in families.values())
    (best,) = families["halma_best_value"].samples
    assert (best.labels, best.value) == ({"study": "first"}, -0.25)
    (samples,) = families["halma_samples"].samples
    assert (samples.name, samples.value) == ("halma_samples_total", 7000.0)


def test_names_with_quotes_and_line_breaks_are_escaped(store, artifacts):
    from dataclasses import replace

    from prometheus_client.parser import text_string_to_metric_families

    Record(store, artifacts, "odd").begin()
    odd = 'a "quoted"\nname \\ with all'
    rows = [replace(row, name=odd) for row in store.studies()]
    text = "".join(exposition(rows, 7, 0))
    named = [
        sample.labels["study"]
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if "study" in sample.labels
    ]
    assert set(named) == {odd}


def test_prometheus_needs_the_token_too(anyone):
    assert anyone.get("/metrics").status_code == 401


def test_the_cluster_tells_pools_shares_and_what_each_worker_holds(store, artifacts, record):
    import os
    import socket

    from fastapi.testclient import TestClient

    from services.api.assembly import create_api
    from services.auth import Gatekeeper

    record.one()
    first, _ = record.propose(2)
    with store.transaction() as change:
        attempt = change.start(first.id, record.token, worker="default-0", host="elsewhere")
        change.began(attempt.id, attempt.token, host=socket.gethostname(), pid=os.getpid())
    app = create_api(store, artifacts, gate=Gatekeeper("a-token-for-tests-only"), pools={"default": 4, "gpu": 1})
    with TestClient(app, base_url="http://localhost") as client:
        client.headers["authorization"] = "Bearer a-token-for-tests-only"
        found = client.get("/api/v1/cluster").json()
    assert found["pools"] == [
        {"name": "default", "cores": 4.0, "held": 1.0, "running": 1, "queued": 1},
        {"name": "gpu", "cores": 1.0, "held": 0.0, "running": 0, "queued": 0},
    ]
    (worker,) = found["workers"]
    assert (worker["study"], worker["trial"], worker["pid"], worker["cores"]) == ("jump", 1, os.getpid(), 1.0)
    assert worker["memory"] > 20e6
    (share,) = found["queue"]
    assert (share["waiting"], share["cores_held"], share["cores_wanted"]) == (True, 1.0, 2.0)
    assert (share["core_seconds"], share["samples"]) == (31.5, 7000)


def test_memory_of_a_process_elsewhere_is_not_told(client, record):
    record.start(record.propose()[0])
    assert client.get("/api/v1/cluster").json()["workers"][0]["memory"] is None
