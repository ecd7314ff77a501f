"""What a person types over the life of a study, and what the terminal says."""

from __future__ import annotations

import csv
import json
import math
import os
import threading
import time

import optuna
import pyarrow.parquet as pq
import pytest
from PIL import Image

from services.cli import run_command
from services.driver import this_process
from services.states import StudyState
from services.store.open import open_store


@pytest.fixture
def finished(shell, hill):
    """A study of four trials, finished; what `run` said."""
    typed = shell("run", "hill.yaml", "--inline")
    assert typed.code == 0, typed.err
    return typed.out


def rows_below(text, head):
    """The lines of a table: those after its rule, up to the next empty line."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if head in line)
    body = lines[start + 2 :]
    return body[: body.index("")] if "" in body else body


def test_run_ends_with_the_distinct_strategies_the_cost_and_what_to_type_next(shell, finished):
    lines = finished.splitlines()
    assert lines[0] == (
        "hill starts: random on sample_hills:hill, 4 trials. Ctrl-C interrupts; halma resume hill goes on."
    )
    trials = shell("trials", "hill", "--json").json
    # The slow obvious version: the best first, whoever is further than 0.2 from all before is another strategy.
    leaders = []
    for trial in sorted(trials, key=lambda trial: -trial["value"]):
        if all(abs(trial["features"][0] - leader["features"][0]) > 0.2 for leader in leaders):
            leaders.append(trial)
    plural = "strategy" if len(leaders) == 1 else "strategies"
    assert f"hill is complete: {len(leaders)} distinct {plural} in 4 trials" in lines
    table = rows_below(finished, "x  trial")
    assert [line.split()[4] for line in table] == [str(leader["number"]) for leader in leaders]
    assert "Cost: 4 trials (4 complete), 4 samples, " in finished
    assert "  halma extend hill --trials 10  # search on" in lines


def test_run_again_shows_the_finished_study_and_runs_nothing(shell, finished):
    before = shell("trials", "hill", "--json").out
    again = shell("run", "hill.yaml", "--inline")
    assert again.code == 0
    assert again.out == finished[finished.index("hill is complete") :]
    assert shell("trials", "hill", "--json").out == before


def test_trials_as_json_begin_with_the_promised_keys_in_order(shell, finished):
    trials = shell("trials", "hill", "--json").json
    promised = [
        "number",
        "state",
        "stage",
        "params",
        "z",
        "value",
        "features",
        "cost",
        "attempts",
        "warm_start",
        "seed",
    ]
    assert [list(trial)[:11] for trial in trials] == [promised] * 4
    assert [trial["number"] for trial in trials] == [0, 1, 2, 3]
    assert list(trials[0]["cost"]) == ["samples", "seconds"]
    assert trials[0]["features"] == [trials[0]["params"]["x"]]
    assert {"message", "details", "artifacts"} <= set(trials[0])


def test_two_runs_with_the_same_seed_give_the_same_trials(shell, finished):
    assert shell("run", "hill.yaml", "--inline", "--name", "twin").code == 0
    timeless = [
        [
            {key: trial[key] for key in ("number", "state", "params", "value", "features", "seed")}
            for trial in shell("trials", name, "--json").json
        ]
        for name in ("hill", "twin")
    ]
    assert timeless[0] == timeless[1]


def test_extend_and_resume_go_on_where_the_study_ended(shell, finished):
    before = shell("trials", "hill", "--json").json
    assert shell("extend", "hill", "--trials", "3").out == (
        "hill now has a budget of 7 trials. Go on: halma resume hill\n"
    )
    typed = shell("resume", "hill", "--inline")
    assert typed.code == 0
    assert typed.out.startswith("hill goes on: random on sample_hills:hill, 7 trials.")
    after = shell("trials", "hill", "--json").json
    assert after[:4] == before
    assert len(after) == 7


def test_an_extended_study_still_accepts_its_old_and_its_adapted_file(shell, hill, finished):
    shell("extend", "hill", "--trials", "3")
    shell("resume", "hill", "--inline")
    shell.write("more.yaml", hill.replace("trials: 4", "trials: 7"))
    for file in ("hill.yaml", "more.yaml"):
        typed = shell("run", file, "--inline")
        assert (typed.code, typed.err) == (0, "")
        assert "7 trials" in typed.out


def test_a_paused_study_waits_until_it_is_resumed(shell, hill):
    queue(shell, "hill")
    assert shell("pause", "hill").out == "hill is paused.\n"
    assert shell("ls", "--json").json[0]["state"] == "paused"
    assert shell("resume", "hill", "--inline").code == 0
    assert shell("show", "hill", "--json").json["state"] == "complete"


def test_run_resumes_what_was_paused(shell, hill):
    queue(shell, "hill")
    shell("pause", "hill")
    typed = shell("run", "hill.yaml", "--inline")
    assert typed.code == 0
    assert "hill is complete" in typed.out


def test_a_cancelled_study_says_so_and_can_be_taken_up_again(shell, hill):
    queue(shell, "hill")
    assert shell("cancel", "hill").out == "hill was cancelled.\n"
    again = shell("cancel", "hill")
    assert again.code in {0, 2}
    assert shell("resume", "hill", "--inline").code == 0


def test_a_study_whose_driver_died_obeys_at_once(shell, hill):
    queue(shell, "hill")
    kill_driver_of(shell, "hill")
    assert shell("pause", "hill").out == "hill is paused.\n"
    kill_driver_of(shell, "hill", ask="run")
    assert shell("cancel", "hill").out == "hill was cancelled.\n"


def test_a_study_that_somebody_drives_is_only_told(shell, hill):
    queue(shell, "hill")
    store = open_store(shell.home / "halma.db")
    with store.transaction() as change:
        change.drive("hill", this_process())
    store.close()
    before = shell("show", "hill", "--json").json
    for command in (("resume", "hill"), ("run", "hill.yaml")):
        typed = shell(*command)
        assert (typed.code, typed.out) == (2, "")
        assert typed.err.startswith(f"study 'hill': expected that nobody drives it, found process {os.getpid()} on ")
        assert ", since 20" in typed.err
        assert typed.err.endswith(
            " UTC; follow it: halma watch hill; stop it: halma pause hill; or take it over: "
            "halma resume hill --take-over\n"
        )
    assert shell("show", "hill", "--json").json == before
    assert shell("pause", "hill").out == "hill pauses as soon as its trials have reached a checkpoint.\n"
    assert shell("show", "hill", "--json").json["state"] == "running"


def test_a_changed_file_changes_how_its_study_is_run_and_never_what_it_is(shell, hill, finished):
    shell.write("wide.yaml", hill.replace("trials: 4", "trials: 6") + "resources: {parallel: 2}\npriority: 4\n")
    typed = shell("run", "wide.yaml", "--inline")
    assert (typed.code, typed.err) == (0, "")
    assert typed.out.startswith(
        "hill changes with its file: priority: 0 -> 4; resources.parallel: 1 -> 2; search.trials: 4 -> 6\n"
    )
    shown = shell("show", "hill", "--json").json
    assert (shown["priority"], shown["trials"], shown["spec"]["resources"]["parallel"]) == (4, {"complete": 6}, 2)
    shell.write("other.yaml", hill.replace("seed: 7", "seed: 8"))
    refused = shell("run", "other.yaml", "--inline")
    assert (refused.code, refused.out) == (2, "")
    assert "  seed: 7 in the study, 8 in the file" in refused.err
    assert "Run this file as a new study: halma run other.yaml --name NEW." in refused.err
    assert shell("show", "hill", "--json").json == shown
    again = shell("run", "other.yaml", "--inline", "--name", "other")
    assert (again.code, again.err) == (0, "")


def test_set_changes_how_a_study_is_run(shell, hill):
    queue(shell, "hill")
    typed = shell("set", "hill", "priority=5", "pool=gpu")
    assert (typed.code, typed.err) == (0, "")
    assert typed.out == "hill: priority is 5 (it was 0)\nhill: resources.pool is gpu (it was default)\n"
    assert shell("set", "hill", "priority=5").out == "hill: priority is 5\n"
    shown = shell("show", "hill", "--json").json
    assert (shown["priority"], shown["pool"]) == (5, "gpu")
    for wrong in ("seed=3", "search.trials=9", "priority=high", "priority"):
        typed = shell("set", "hill", wrong)
        assert (typed.code, typed.out) == (2, "")
    assert shell("show", "hill", "--json").json == shown
    assert shell("resume", "hill", "--inline").code == 0, "alone it gets the pool that it asks for"


def test_a_study_whose_every_trial_fails_stops_with_the_reason_and_exit_code_1(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":cliff").replace("trials: 4", "trials: 20"))
    typed = shell("run", "a.yaml", "--inline")
    assert typed.code == 1
    assert "hill failed: 5 trials, no strategy that works" in typed.out
    assert (
        "Why: the last 5 trials all failed (stop_after_failures: 5); the newest: RuntimeError: no way up" in typed.out
    )
    assert typed.err == "hill failed; the reason is above. All of a trial's words: halma trials hill --json\n"


def test_trials_that_become_nan_are_diverged_and_the_study_goes_on(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":fog"))
    typed = shell("run", "a.yaml", "--inline")
    assert typed.code == 0
    assert "hill is complete: 4 trials, no strategy that works" in typed.out
    assert "The newest trial is diverged: " in typed.out
    assert [trial["state"] for trial in shell("trials", "hill", "--json").json] == ["diverged"] * 4


def test_a_task_without_behaviour_gets_its_best_trials(shell):
    shell.write(
        "a.yaml",
        "name: bare\ntask: sample_hills:bare_hill\nspace: {x: {type: float, low: 0, high: 1}}\n"
        "search: {strategy: random, trials: 8}\n",
    )
    typed = shell("run", "a.yaml", "--inline")
    assert "bare is complete: 8 trials, the best 5 of them:" in typed.out
    values = sorted((trial["value"] for trial in shell("trials", "bare", "--json").json), reverse=True)
    shown = [float(line.split()[1]) for line in rows_below(typed.out, "value")]
    assert shown == pytest.approx(values[:5], rel=1e-3)


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


def test_watch_follows_a_study_while_another_thread_changes_it(shell, hill):
    queue(shell, "hill")

    def cancel_soon():
        time.sleep(0.3)
        store = open_store(shell.home / "halma.db")
        with store.transaction() as change:
            change.ask("hill", "cancel")
        store.close()

    thread = threading.Thread(target=cancel_soon)
    thread.start()
    typed = shell("watch", "hill")
    thread.join()
    assert "study: asked to cancel" in typed.out
    assert typed.out.splitlines()[-1] == "hill was cancelled: asked to cancel"


def test_listings_of_nothing_say_what_to_do(shell, hill):
    assert shell("ls").out == "No studies yet. Start one: halma run studies/quickstart.yaml\n"
    assert shell("ls", "--json").json == []
    queue(shell, "hill")
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


def test_db_upgrade_says_what_it_found(shell):
    assert shell("db", "upgrade").out == "The schema is up to date (it was empty).\n"
    assert shell("db", "upgrade").out.startswith("The schema is up to date (it was ")


def test_interrupting_any_command_exits_with_130(shell, monkeypatch, capsys):
    def interrupt(*_arguments, **_keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr("services.cli.studies.session", interrupt)
    assert run_command(["ls"]) == 130


def queue(shell, name):
    """Submit hill.yaml without running it."""
    from services.admission import admit
    from services.spec_check import parse_study

    store = open_store(shell.home / "halma.db")
    try:
        admit(store, parse_study((shell.folder / "hill.yaml").read_text(encoding="utf-8"), name="hill.yaml"))
    finally:
        store.close()


def kill_driver_of(shell, name, ask=None):
    """Leave a study as the kill -9 of its driver does: running, with a driver that isn't there."""
    from dataclasses import replace

    store = open_store(shell.home / "halma.db")
    try:
        with store.transaction() as change:
            if ask:
                change.ask(name, ask)
            change.drive(name, replace(this_process(), started="1"))
        assert store.study(name).state is StudyState.RUNNING
    finally:
        store.close()


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
