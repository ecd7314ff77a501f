"""Exports that other people's tools open: Optuna's dashboard shows the study, TensorBoard's reader its curves."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx
import optuna
import pytest

from services.artifacts.open import open_artifacts
from services.errors import BadInput, NotInstalled
from services.export import Format, write
from services.states import TrialState
from services.store.open import open_store
from tests.record import Record


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A store with a study in which trials ended in every way, and some have not."""
    folder = tmp_path_factory.mktemp("study")
    store = open_store(folder / "halma.db")
    record = Record(store, open_artifacts(folder / "artifacts"), "jump").begin()
    for _ in range(3):
        record.one(iterations=4, files=())
    record.one(iterations=2, state=TrialState.DIVERGED, message="the loss was NaN")
    record.one(iterations=1, state=TrialState.INFEASIBLE, message="no run-up reaches the bar")
    record.one(iterations=1, state=TrialState.FAILED, message="it raised")
    running, _, dropped = record.propose(3)
    record.report(record.start(running), 1, **{"return": 0.25, "samples": 700.0})
    with store.transaction() as change:
        change.cancel_trial(dropped.id, record.token, "nobody wants it")
    yield store, store.study("jump")
    store.close()


@pytest.fixture(scope="module")
def exported(study, tmp_path_factory):
    store, row = study
    path = tmp_path_factory.mktemp("optuna") / "jump.optuna.db"
    assert write(store, row, Format.OPTUNA, path) == 9
    return path


STATES = ["COMPLETE"] * 3 + ["FAIL", "PRUNED", "FAIL", "RUNNING", "WAITING", "FAIL"]
STATUS = ["complete"] * 3 + ["diverged", "infeasible", "failed", "running", "queued", "cancelled"]


def test_optuna_has_all_that_the_record_has_under_the_same_numbers(study, exported):
    store, row = study
    loaded = optuna.load_study(study_name="jump", storage=f"sqlite:///{exported}")
    rows = store.trials(row.id)
    assert [trial.state.name for trial in loaded.trials] == STATES
    assert [trial.user_attrs["status"] for trial in loaded.trials] == STATUS
    for trial, own in zip(loaded.trials, rows, strict=True):
        assert (trial.number, trial.params, trial.value) == (own.number, own.params, own.value)
        assert trial.user_attrs.get("features") == (None if own.features is None else list(own.features))
        assert (trial.user_attrs.get("message", ""), trial.user_attrs["seed"]) == (own.message, str(own.seed))
        returns = {each.iteration: each.values["return"] for each in store.metrics(own.id)}
        assert trial.intermediate_values == returns
        if own.finished_at is not None and own.started_at is not None:
            assert trial.duration == own.finished_at - own.started_at
            assert trial.datetime_start.astimezone() == own.started_at
    assert loaded.trials[0].distributions["omega_x"] == optuna.distributions.FloatDistribution(-3.0, 3.0)
    assert loaded.user_attrs["intermediate_values"] == "return"
    assert loaded.best_trial.number == max(rows, key=lambda own: own.value or 0.0).number


def test_optuna_dashboard_shows_the_study_and_its_trials(exported):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [str(Path(sys.executable).parent / "optuna-dashboard"), f"sqlite:///{exported}", "--port", str(port),
               "--server", "wsgiref", "--quiet"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
            told = answer_of(client, "/api/studies", process)
            (summary,) = told["study_summaries"]
            assert summary["study_name"] == "jump"
            detail = client.get(f"/api/studies/{summary['study_id']}", params={"after": 0}).json()
    finally:
        process.kill()
        process.communicate()
    assert [trial["state"].upper() for trial in detail["trials"]] == STATES
    first = detail["trials"][0]
    assert first["values"] == [pytest.approx(0.6)]
    assert {point["step"] for point in first["intermediate_values"]} == {1, 2, 3, 4}
    assert {param["name"] for param in first["params"]} == {"omega_x", "alpha"}
    attributes = {pair["key"]: pair["value"] for pair in detail["trials"][3]["user_attrs"]}
    assert (attributes["status"], attributes["message"]) == ("diverged", "the loss was NaN")


def answer_of(client, path, process):
    """What a server says as soon as it is up."""
    for _ in range(1200):
        assert process.poll() is None, process.stderr.read()
        try:
            return client.get(path).raise_for_status().json()
        except httpx.TransportError:
            time.sleep(0.1)
    pytest.fail("it never came up")


@pytest.fixture(scope="module")
def runs(study, tmp_path_factory):
    store, row = study
    path = tmp_path_factory.mktemp("events") / "jump"
    assert write(store, row, Format.TENSORBOARD, path) == 7
    return path


def read(folder):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    return EventAccumulator(str(folder)).Reload()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_reads_each_trials_curves(study, runs):
    store, row = study
    assert sorted(path.name for path in runs.iterdir()) == [f"trial-{number:05d}" for number in range(7)]
    told = read(runs / "trial-00001")
    rows = store.metrics(store.trial(row.id, 1).id)
    for name in ("return", "kl", "samples_per_second"):
        curve = [(event.step, event.value) for event in told.Scalars(name)]
        assert curve == [(each.iteration, pytest.approx(each.values[name], rel=1e-6)) for each in rows]
    own = store.trial(row.id, 1)
    assert told.Scalars("return")[-1].wall_time == pytest.approx(own.finished_at.timestamp())
    # over samples where those were reported
    assert [(event.step, event.value) for event in read(runs / "trial-00006").Scalars("return")] == [(700, 0.25)]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_reads_each_trials_hyperparameters_and_results(study, runs):
    from tensorboard.plugins.hparams import metadata

    store, row = study
    own = store.trial(row.id, 2)
    told = read(runs / "trial-00002")
    content = told.SummaryMetadata(metadata.SESSION_START_INFO_TAG).plugin_data.content
    given = metadata.parse_session_start_info_plugin_data(content).hparams
    assert {name: given[name].number_value for name in own.params} == pytest.approx(own.params)
    assert (given["difficulty"].number_value, given["stage"].string_value) == (1.0, "search")
    (value,) = told.Scalars("halma/value")
    assert (value.step, value.value) == (own.samples, pytest.approx(own.value, rel=1e-6))
    assert told.Scalars("halma/facing")[0].value == pytest.approx(own.features[0], rel=1e-6)
    assert "halma/value" not in read(runs / "trial-00003").Tags()["scalars"], "it diverged"


def test_event_files_are_not_mixed_with_others(study, tmp_path):
    store, row = study
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "old").touch()
    with pytest.raises(BadInput, match=r"--output: expected a new or empty folder for event files, found .*/full"):
        write(store, row, Format.TENSORBOARD, tmp_path / "full")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["old"]


def test_without_tensorboardx_it_says_what_to_install(study, tmp_path, monkeypatch):
    monkeypatch.setattr("services.export.find_spec", lambda name: None)
    with pytest.raises(NotInstalled, match=r"pip install 'halma\[tensorboard\]'"):
        write(*study, Format.TENSORBOARD, tmp_path / "jump")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", [Format.CSV, Format.JSON, Format.PARQUET, Format.OPTUNA, Format.TENSORBOARD])
def test_an_export_that_breaks_off_leaves_nothing(study, tmp_path, monkeypatch, form):
    store, row = study

    def breaks(*args, **options):
        raise OSError(28, "No space left on device")

    names = ["services.export.csv_text", "services.export.json.dumps", "services.export._write_parquet",
             "search.optuna_export.export", "services.tensorboard.write_events"]  # fmt: skip
    for name in names:
        monkeypatch.setattr(name, breaks)
    with pytest.raises(BadInput, match="No space left on device"):
        write(store, row, form, tmp_path / "jump")
    assert not list(tmp_path.iterdir())
