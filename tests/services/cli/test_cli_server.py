"""The command line on a service: it says there what it says here, and does there what it does here."""

from __future__ import annotations

import json

import pytest

from services.api.assembly import create_api
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper
from services.store.open import open_store
from tests.served import served

TOKEN = "a-token-for-tests-only"
PAINTED = """\
name: painted
task: sample_hills:NamingPainter
space: {x: {type: float, low: 0, high: 1}}
search: {strategy: random, trials: 5}
seed: 7
"""


@pytest.fixture
def both(shell, hill, monkeypatch):
    """A home with two finished studies, and a service over the same database."""
    shell.write("painted.yaml", PAINTED)
    for name in ("hill", "painted"):
        assert shell("run", f"{name}.yaml", "--inline").code == 0
    monkeypatch.setenv("HALMA_TOKEN", TOKEN)
    store = open_store(shell.home / "halma.db")
    files = open_artifacts(shell.home / "halma.artifacts")
    app = create_api(store, files, gate=Gatekeeper(TOKEN), submit=submit_to(store))
    with served(app) as shell.url:
        yield shell
    store.close()


LOOKS = [
    ["ls"],
    ["ls", "--json"],
    ["show", "painted"],
    ["show", "hill", "--json"],
    ["trials", "painted"],
    ["trials", "painted", "--json"],
    ["trials", "hill", "--state", "failed"],
    ["watch", "painted", "--since", "0"],
    ["watch", "hill", "--since", "0", "--json"],
    ["show", "hil"],
]


def test_what_is_told_there_is_what_is_told_here(both):
    for command in LOOKS:
        here, there = both(*command), both("--server", both.url, *command)
        assert (there.code, there.out, there.err) == (here.code, here.out, here.err), command
        assert here.out or here.err, command


def test_exports_and_figures_are_the_same_files(both):
    for form in ("csv", "json", "parquet"):
        both("export", "painted", "--format", form, "--output", f"here.{form}")
        assert both("--server", both.url, "export", "painted", "--format", form, "--output", f"there.{form}").code == 0
        assert (both.folder / f"here.{form}").read_bytes() == (both.folder / f"there.{form}").read_bytes()
    both("plot", "painted", "--only", "behaviour", "--out", "here")
    both("--server", both.url, "plot", "painted", "--only", "behaviour", "--out", "there")
    here, there = (both.folder / place / "behaviour.pdf" for place in ("here", "there"))
    assert here.read_bytes() == there.read_bytes()


def test_a_study_is_steered_there(both, monkeypatch):
    monkeypatch.setenv("HALMA_SERVER", both.url)
    both.write("other.yaml", PAINTED.replace("painted", "other"))
    assert f"Submitted other to {both.url}" in both("submit", "other.yaml").out
    assert both("pause", "other", "--json").json["state"] == "paused"
    assert both("resume", "other").out == (
        f"The service at {both.url} goes on with other. Follow it: halma watch other\n"
    )
    assert both("extend", "other", "--trials", "3", "--json").json["target_trials"] == 8
    assert both("set", "other", "priority=5").out == "other: priority is 5 (it was 0)\n"
    assert both("cancel", "other").out == "other was cancelled.\n"
    monkeypatch.delenv("HALMA_SERVER")
    (other,) = (row for row in both("ls", "--json").json if row["name"] == "other")
    assert (other["state"], other["target_trials"], other["priority"]) == ("cancelled", 8, 5)
    for name in ("hill", "nope"):
        refused = both("--server", both.url, "pause", name)
        assert (refused.code, refused.err) == (2, both("pause", name).err)


def test_what_no_service_does_is_refused_where_it_is_named_and_done_here_where_it_is_the_default(both, monkeypatch):
    for command in ("replay painted 0", "audit painted", "run hill.yaml", "serve", "gc", "verify"):
        typed = both("--server", both.url, *command.split())
        assert typed.code == 2
        assert "--server: expected a command that a service can do (ls, show, trials, watch, plot," in typed.err
        assert f"found {command.split()[0]}, which works here" in typed.err
    monkeypatch.setenv("HALMA_SERVER", both.url)
    assert both("run", "hill.yaml").code == 0


def test_a_service_or_a_database_but_not_both(both, monkeypatch):
    typed = both("--server", both.url, "ls", "--db", str(both.home / "halma.db"))
    assert typed.code == 2
    assert typed.err == "--server: expected either a service or a database (--db, --artifacts), found both\n"
    monkeypatch.setenv("HALMA_SERVER", "http://127.0.0.1:1")
    assert both("ls", "--db", str(both.home / "halma.db")).code == 0, "a database on the command line beats a default"


def test_what_is_wrong_with_the_way_there_is_told_in_one_message(both, monkeypatch):
    away = both("--server", "http://127.0.0.1:1", "ls")
    assert away.code == 2
    assert "expected a service at http://127.0.0.1:1, found: " in away.err
    assert both("--server", "localhost:1", "ls").code == 2
    inline = both("--server", both.url, "resume", "hill", "--inline")
    assert inline.code == 2
    monkeypatch.setenv("HALMA_TOKEN", "another-token-for-tests")
    wrong = both("--server", both.url, "ls")
    assert wrong.code == 2
    assert f"expected the token of the service at {both.url}" in wrong.err
    monkeypatch.delenv("HALMA_TOKEN")
    missing = both("--server", both.url, "ls")
    assert missing.code == 2
    assert "expected the service's token in" in missing.err
    assert json.dumps(missing.out) == '""'
