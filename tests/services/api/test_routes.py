"""The REST routes over a real SQLite record."""

from __future__ import annotations

import csv
import io
import json

import pytest

from services.states import StudyState, TrialState

STUDY = "/api/v1/studies/jump"
FILE = """\
name: pasted
task: point_jump
search:
  strategy: random
  trials: 3
"""


def error(answer):
    return answer.json()["error"]


class TestStudies:
    def test_a_listing_says_where_in_the_record_it_was_read(self, client, store, record):
        listing = client.get("/api/v1/studies").json()
        assert listing["cursor"] == store.last_event()
        assert listing["history"] == store.history_id()
        assert [study["name"] for study in listing["studies"]] == ["jump"]

    def test_a_study_counts_its_trials_and_its_cost(self, client, record):
        record.one(value=0.75)
        record.one(state=TrialState.DIVERGED)
        record.propose()
        study = client.get(STUDY).json()
        assert study["trials"] == {"complete": 1, "diverged": 1, "queued": 1}
        assert study["cost"] == {"samples": 14000, "seconds": 63.0}
        assert study["best_value"] == 0.75
        assert study["driver"]["host"] == "runner"
        assert study["spec"]["search"]["strategy"] == "bds"

    def test_an_unknown_study_is_told_with_the_nearest_name(self, client, record):
        answer = client.get("/api/v1/studies/jmp")
        assert answer.status_code == 404
        assert error(answer)["kind"] == "UnknownStudy"
        assert "'jump'" in error(answer)["message"]


class TestTrials:
    def test_pages_join_without_a_gap_or_a_repeat(self, client, record):
        record.propose(7)
        numbers, page = [], {"next": ""}
        while page["next"] is not None:
            given = {"page": page["next"]} if page["next"] else {}
            page = client.get(f"{STUDY}/trials", params={"limit": 3, **given}).json()
            numbers += [trial["number"] for trial in page["trials"]]
        assert numbers == [0, 1, 2, 3, 4, 5, 6]

    def test_a_page_that_ends_with_the_last_trial_names_no_next_one(self, client, record):
        record.propose(3)
        assert client.get(f"{STUDY}/trials", params={"limit": 3}).json()["next"] is None

    def test_only_the_states_asked_for_are_listed(self, client, record):
        record.one()
        record.one(state=TrialState.FAILED, message="no worker")
        page = client.get(f"{STUDY}/trials", params={"state": ["failed"]}).json()
        assert [(trial["number"], trial["message"]) for trial in page["trials"]] == [(1, "no worker")]

    def test_a_trial_comes_with_its_attempts_and_files(self, client, record):
        record.one(iterations=2)
        trial = client.get(f"{STUDY}/trials/0").json()
        assert trial["seed"] == 2**63
        assert [attempt["state"] for attempt in trial["attempt_list"]] == ["complete"]
        assert sorted(trial["artifacts"]) == ["policy.safetensors", "pose.png"]
        assert trial["info"] == {"mode": "explore", "deviation": 0.41}

    def test_a_learning_curve_is_fetched_from_the_iteration_known(self, client, record):
        record.one(iterations=5)
        curve = client.get(f"{STUDY}/trials/0/metrics", params={"after": 3}).json()
        assert curve["iterations"] == [4, 5]
        assert curve["series"]["bar"] == pytest.approx([0.58, 0.60])

    def test_a_metric_that_an_iteration_lacks_is_null_there(self, client, record):
        (trial,) = record.propose()
        attempt = record.start(trial)
        record.report(attempt, 1, loss=2.0)
        record.report(attempt, 2, loss=1.0, bar=0.5)
        curve = client.get(f"{STUDY}/trials/0/metrics").json()
        assert curve["series"] == {"bar": [None, 0.5], "loss": [2.0, 1.0]}

    def test_an_unknown_trial_says_which_there_are(self, client, record):
        record.one()
        answer = client.get(f"{STUDY}/trials/9")
        assert answer.status_code == 404
        assert "from 0 to 0" in error(answer)["message"]


class TestTable:
    def test_its_columns_hold_the_trials_that_a_page_lists(self, client, record):
        record.one()
        record.one(state=TrialState.INFEASIBLE)
        record.propose(2)
        table = client.get(f"{STUDY}/table").json()
        page = client.get(f"{STUDY}/trials").json()["trials"]
        assert table["count"] == 4
        for column, key in (("numbers", "number"), ("states", "state"), ("values", "value"), ("features", "features")):
            assert table[column] == [trial[key] for trial in page]
        assert table["params"]["omega_x"] == [trial["params"]["omega_x"] for trial in page]

    def test_a_trial_that_ends_between_two_requests_is_ended_in_the_second(self, client, record):
        (trial,) = record.propose()
        attempt = record.start(trial)
        assert client.get(f"{STUDY}/table").json()["states"] == ["running"]
        record.finish(attempt, trial, value=0.5)
        record.one()
        assert client.get(f"{STUDY}/table").json()["states"] == ["complete", "complete"]

    def test_a_study_of_the_same_name_as_a_deleted_one_starts_empty(self, client, store, record):
        record.one()
        assert client.get(f"{STUDY}/table").json()["count"] == 1
        record.end()
        with store.transaction() as change:
            change.delete_study("jump")
        record.begin()
        assert client.get(f"{STUDY}/table").json()["count"] == 0

    def test_csv_holds_every_bit_of_a_value(self, client, record):
        record.one(value=0.1 + 0.2)
        answer = client.get(f"{STUDY}/trials.csv")
        (row,) = csv.DictReader(io.StringIO(answer.text))
        assert float(row["value"]) == 0.1 + 0.2
        assert json.loads(row["features"]) == client.get(f"{STUDY}/trials/0").json()["features"]
        assert 'filename="jump.csv"' in answer.headers["content-disposition"]

    def test_csv_makes_no_formula_of_a_message(self, client, record):
        record.one(state=TrialState.FAILED, message="=HYPERLINK(1)")
        (row,) = csv.DictReader(io.StringIO(client.get(f"{STUDY}/trials.csv").text))
        assert row["message"] == "'=HYPERLINK(1)"


class TestStrategies:
    def test_trials_nearer_than_the_tasks_distance_are_one_strategy_led_by_the_best(self, client, record):
        record.one(value=0.5, features=(0.0,))
        record.one(value=0.9, features=(0.2,))
        record.one(value=0.7, features=(3.0,))
        found = client.get(f"{STUDY}/strategies").json()
        assert found["distance"] == 0.5
        assert [(one["number"], one["members"]) for one in found["strategies"]] == [(1, 2), (2, 1)]
        assert found["strategies"][0]["pose"] is True
        assert found["strategies"][0]["replay"] is False


class TestArtifacts:
    def test_a_picture_is_shown_and_anything_else_is_a_download(self, client, record):
        record.one()
        picture = client.get(f"{STUDY}/trials/0/artifacts/pose.png")
        assert picture.headers["content-type"] == "image/png"
        assert picture.content.startswith(b"\x89PNG")
        policy = client.get(f"{STUDY}/trials/0/artifacts/policy.safetensors")
        assert policy.content == b"\x08weights"
        assert policy.headers["content-disposition"] == 'attachment; filename="jump-0-policy.safetensors"'

    def test_a_picture_that_the_browser_has_is_not_sent_again(self, client, record):
        record.one()
        first = client.get(f"{STUDY}/trials/0/artifacts/pose.png")
        again = client.get(f"{STUDY}/trials/0/artifacts/pose.png", headers={"if-none-match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")

    def test_a_damaged_file_is_refused_with_what_to_do(self, client, record, tmp_path):
        record.one()
        (file,) = (tmp_path / "artifacts").rglob("pose-*.png")
        file.write_bytes(b"something else")
        answer = client.get(f"{STUDY}/trials/0/artifacts/pose.png")
        assert answer.status_code == 410
        assert "restore the file from a backup" in error(answer)["message"]

    @pytest.mark.parametrize("name", ["..%2f..%2fhalma.db", "%2e%2e%2fhalma.db", "halma.db", "pose.png%00"])
    def test_only_what_the_record_names_is_served(self, client, record, name):
        record.one()
        assert client.get(f"{STUDY}/trials/0/artifacts/{name}").status_code == 404


class TestActions:
    def test_pausing_a_driven_study_asks_its_driver(self, client, store, record, changes):
        assert client.post(f"{STUDY}/pause").json()["wanted"] == "pause"
        assert store.study("jump").state is StudyState.RUNNING
        assert changes == ["changed"]

    def test_resuming_a_cancelled_study_queues_it(self, client, store, record):
        record.end(StudyState.PAUSED, "interrupted")
        assert client.post(f"{STUDY}/cancel").json()["state"] == "cancelled"
        assert client.post(f"{STUDY}/resume").json()["state"] == "queued"

    def test_how_a_study_is_run_can_be_changed(self, client, store, record):
        answer = client.patch(STUDY, json={"fields": {"priority": 7, "resources.pool": "gpu"}})
        assert (answer.status_code, answer.json()["priority"], answer.json()["pool"]) == (200, 7, "gpu")
        assert store.study(record.name).spec["resources"]["pool"] == "gpu"

    @pytest.mark.parametrize("fields", [{"seed": 3}, {"priority": "high"}, {"priority": 10**6}, {}])
    def test_what_makes_a_study_what_it_is_can_not(self, client, store, record, fields):
        before = store.last_event()
        assert client.patch(STUDY, json={"fields": fields}).status_code == 422
        assert store.last_event() == before

    def test_extending_raises_the_target(self, client, store, record):
        assert client.post(f"{STUDY}/extend", json={"trials": 6}).json()["target_trials"] == 30

    @pytest.mark.parametrize("body", [{}, {"trials": 0}, {"trials": -1}, {"trials": "many"}, {"wheels": 2}, [1]])
    def test_an_extension_by_nothing_is_refused_and_changes_nothing(self, client, store, record, body):
        answer = client.post(f"{STUDY}/extend", json=body)
        assert answer.status_code == 422
        assert error(answer)["message"]
        assert store.study("jump").target_trials == 24

    def test_what_makes_no_sense_in_a_state_is_refused_in_words(self, client, record):
        record.end()
        answer = client.post(f"{STUDY}/pause")
        assert answer.status_code == 409
        assert error(answer)["kind"] == "WrongState"


class TestSubmission:
    def test_a_study_file_becomes_a_queued_study(self, client, store, changes):
        answer = client.post("/api/v1/studies", json={"text": FILE, "overrides": ["search.trials=5"]})
        assert answer.status_code == 201
        assert answer.json()["state"] == "queued"
        assert store.study("pasted").target_trials == 5
        assert changes == ["changed"]

    def test_every_mistake_is_told_with_its_line_and_field_and_nothing_is_recorded(self, client, store):
        text = FILE.replace("random", "randon").replace("trials: 3", "trials: 0")
        answer = client.post("/api/v1/studies", json={"text": text, "name": "mine.yaml"})
        assert answer.status_code == 422
        found = [(problem["line"], problem["field"]) for problem in error(answer)["problems"]]
        assert found == [(4, "search.strategy"), (5, "search.trials")]
        assert (error(answer)["line"], error(answer)["field"]) == (4, "search.strategy")
        assert error(answer)["message"].startswith("mine.yaml:4: search.strategy: ")
        assert store.studies() == []

    def test_broken_yaml_is_told_with_its_line(self, client):
        answer = client.post("/api/v1/studies", json={"text": "name: [\n"})
        assert answer.status_code == 422
        assert error(answer)["line"] is not None

    def test_an_override_is_named_instead_of_a_line(self, client):
        answer = client.post("/api/v1/studies", json={"text": FILE, "overrides": ["search.trials=-3"]})
        assert answer.status_code == 422
        assert error(answer)["line"] is None
        assert "--set search.trials=-3" in error(answer)["message"]

    def test_a_taken_name_is_a_conflict(self, client):
        assert client.post("/api/v1/studies", json={"text": FILE}).status_code == 201
        answer = client.post("/api/v1/studies", json={"text": FILE})
        assert answer.status_code == 409
        assert "halma resume pasted" in error(answer)["message"]


class TestEvents:
    def test_they_come_in_order_from_a_cursor(self, client, record):
        record.one(iterations=1)
        first = client.get("/api/v1/events", params={"limit": 2}).json()
        assert [event["kind"] for event in first["events"]] == ["created", "driven"]
        rest = client.get("/api/v1/events", params={"page": first["next"]}).json()
        assert [event["kind"] for event in rest["events"]] == ["proposed", "started", "progress", "finished"]
        assert rest["next"] is None
        assert client.get("/api/v1/events", params={"after": first["events"][-1]["id"]}).json() == rest
        assert client.get(f"{STUDY}/events", params={"page": first["next"]}).json() == rest


class TestService:
    def test_health_needs_no_token_and_says_nothing_else(self, anyone):
        assert anyone.get("/healthz").json() == {"status": "ok"}
        assert anyone.get("/readyz").json() == {"status": "ok"}

    def test_it_is_not_ready_without_its_database(self, anyone, app, monkeypatch):
        monkeypatch.setattr(app.state.service.store, "last_event", lambda: 1 / 0)
        assert anyone.get("/readyz").status_code == 503
        assert anyone.get("/healthz").status_code == 200

    def test_the_description_is_served_by_ourselves_and_nothing_else_is(self, client):
        paths = client.get("/api/v1/openapi.json").json()["paths"]
        assert "/api/v1/studies/{study}/trials/{number}" in paths
        assert client.get("/docs").status_code == 404

    @pytest.mark.parametrize("path", ["/api/v1/nothing", "/api/v2/studies"])
    def test_an_unknown_route_answers_like_every_error(self, client, path):
        answer = client.get(path)
        assert answer.status_code == 404
        assert error(answer)["kind"] == "HttpError"
