"""What a person asks of a study: watching, tables, exports, pictures, replays."""

from __future__ import annotations

import csv
import json
import math
from types import SimpleNamespace

import optuna
import pyarrow.parquet as pq
from PIL import Image
from shown import rows_below

from services.store.open import open_store


def test_watch_tells_the_whole_story_and_ends_with_the_study(shell, finished):
    lines = shell("watch", "hill", "--since", "0").out.splitlines()
    assert lines[0].endswith("study: created")
    assert sum("finished" in line or ": complete, value" in line for line in lines) == 4
    assert lines[-1] == "hill is complete"


def test_watch_as_json_gives_one_object_a_line_and_goes_on_from_a_cursor(shell, finished):
    events = [json.loads(line) for line in shell("watch", "hill", "--since", "0", "--json").out.splitlines()]
    ids = [event["id"] for event in events]
    assert ids == sorted(set(ids))
    assert {event["study"] for event in events} == {"hill"}
    rest = shell("watch", "hill", "--since", str(ids[3]), "--json").out.splitlines()
    assert [json.loads(line) for line in rest] == events[4:]


def test_watch_follows_a_study_while_it_changes(shell, hill, monkeypatch):
    shell.queue("hill")
    waits = []

    def while_watch_waits(seconds):
        waits.append(seconds)
        if len(waits) == 2:
            store = open_store(shell.home / "halma.db")
            with store.transaction() as change:
                change.ask("hill", "cancel")
            store.close()

    monkeypatch.setattr("services.cli.studies.time", SimpleNamespace(sleep=while_watch_waits))
    typed = shell("watch", "hill")
    assert len(waits) >= 2
    assert "study: asked to cancel" in typed.out
    assert typed.out.splitlines()[-1] == "hill was cancelled: asked to cancel"


def test_listings_of_nothing_say_what_to_do(shell, hill):
    assert shell("ls").out == "No studies yet. Start one: halma run studies/quickstart.yaml\n"
    assert shell("ls", "--json").json == []
    shell.queue("hill")
    assert shell("trials", "hill").out == "hill has no trials yet.\n"


def test_show_and_ls_and_trials_are_tables_of_the_same_facts(shell, finished):
    shown = shell("show", "hill").out
    assert "complete" in shown
    assert "4 of 4 (4 complete)" in shown
    assert "Next: halma trials hill, halma extend hill --trials 10" in shown
    assert "4 of 4" in shell("ls").out
    table = rows_below(shell("trials", "hill").out, "tries")
    assert [line.split()[0] for line in table] == ["0", "1", "2", "3"]
    assert shell("trials", "hill", "--state", "failed").out == "hill has no trial that is failed.\n"


def test_export_writes_what_the_listing_says(shell, finished):
    trials = shell("trials", "hill", "--json").json
    for form, name in (("csv", "hill.csv"), ("json", "hill.json"), ("parquet", "hill.parquet"), ("optuna", "hill.db")):
        typed = shell("export", "hill", "--format", form, "--output", name)
        assert typed.out == f"Wrote 4 trials to {shell.folder}/{name}\n"
    with (shell.folder / "hill.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["value"]) for row in rows] == [trial["value"] for trial in trials]
    assert [int(row["seed"]) for row in rows] == [trial["seed"] for trial in trials]
    whole = json.loads((shell.folder / "hill.json").read_text(encoding="utf-8"))
    assert whole["trials"] == trials
    assert whole["study"]["spec"]["search"]["strategy"] == "random"
    columns = pq.read_table(shell.folder / "hill.parquet").to_pydict()
    assert columns["feature_place"] == [trial["features"][0] for trial in trials]
    assert columns["seed"] == [trial["seed"] for trial in trials]
    study = optuna.load_study(study_name="hill", storage=f"sqlite:///{shell.folder}/hill.db")
    assert study.best_value == max(trial["value"] for trial in trials)
    assert [trial.params for trial in study.trials] == [trial["params"] for trial in trials]


def test_export_refuses_what_it_would_overwrite_or_can_not_write(shell, finished):
    shell("export", "hill", "-f", "optuna", "-o", "hill.db")
    assert shell("export", "hill", "-f", "optuna", "-o", "hill.db").err == (
        f"--output: expected a new file for the Optuna database, found {shell.folder}/hill.db, which exists\n"
    )
    assert shell("export", "hill", "-o", "nowhere/a.csv").err == (
        f"--output: expected a file in an existing folder, found no folder {shell.folder}/nowhere\n"
    )


def test_a_plain_function_leaves_no_picture_and_none_is_missed(finished):
    assert "Picture" not in finished


def test_the_pictures_that_trials_left_are_drawn_on_one_sheet(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":Painter"))
    typed = shell("run", "a.yaml", "--inline")
    path = shell.home / "halma.reports" / "hill.png"
    assert f"Picture: {path}" in typed.out.splitlines()
    strategies = len(rows_below(typed.out, "x  trial"))
    with Image.open(path) as sheet:
        assert sheet.format == "PNG"
        columns = math.ceil(math.sqrt(strategies))
        assert sheet.width == 12 + columns * (320 + 12)
    assert "  halma replay hill " in typed.out


def test_a_value_with_a_name_is_called_by_it(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":Painter"))
    head = next(line for line in shell("run", "a.yaml", "--inline").out.splitlines() if "x  trial" in line)
    assert head.split()[:4] == ["place", "height", "x", "trial"]


def test_a_replay_is_simulated_again_and_compared_bit_by_bit(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":Painter"))
    shell("run", "a.yaml", "--inline")
    typed = shell("replay", "hill", "2", "--check")
    assert typed.code == 0
    assert typed.out.startswith("Trial 2 of hill: 1.50 s, value ")
    stored = shell("trials", "hill", "--json").json[2]["artifacts"]["replay.bin"]["sha256"]
    assert f"Bit-equal to the stored replay (SHA-256 {stored[:16]}...)." in typed.out


def test_a_replay_that_differs_is_told_and_fails_the_check(shell, hill, monkeypatch):
    shell.write("a.yaml", hill.replace(":hill", ":Painter"))
    shell("run", "a.yaml", "--inline")
    monkeypatch.setattr("sample_hills.FRAMES", 7)
    typed = shell("replay", "hill", "2", "--check")
    assert typed.code == 1
    assert "Differs from the stored replay: SHA-256 " in typed.out
    assert typed.err == "replay --check: expected the stored replay to the last bit, found another one\n"
    assert shell("replay", "hill", "2").code == 0, "without --check it is only told"


def test_a_policy_that_was_altered_on_disk_is_not_simulated(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":Painter"))
    shell("run", "a.yaml", "--inline")
    for path in (shell.home / "halma.artifacts").rglob("000002/policy*"):
        path.write_bytes(b"another one")
    typed = shell("replay", "hill", "2")
    assert (typed.code, typed.out) == (1, "")
    assert "expected 5 bytes with SHA-256" in typed.err


def test_named_strategies_are_shown_by_their_names(shell):
    shell.write(
        "named.yaml",
        "name: named\ntask: sample_hills:NamingPainter\nspace: {x: {type: float, low: 0, high: 1}}\n"
        "search: {strategy: random, trials: 6}\n",
    )
    ran = shell("run", "named.yaml", "--inline")
    assert ran.code == 0, ran.err
    shown = shell("show", "named").out
    names = {trial["details"]["name"] for trial in shell("trials", "named", "--json").json}
    assert names <= {"left of the top", "right of the top"}
    for text in (ran.out, shown):
        table = rows_below(text, "   strategy")
        assert table
        assert all(any(name in line for name in names) for line in table)


def test_strategies_without_names_have_no_column_for_them(shell, finished):
    assert "  strategy  " not in finished
    assert "distinct" in shell("show", "hill").out
