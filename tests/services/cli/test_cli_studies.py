"""What a person types over the life of a study, and what the terminal says."""

from __future__ import annotations

import os

import pytest
from shown import rows_below

from services.cli import run_command
from services.driver import this_process
from services.states import StudyState
from services.store.open import open_store


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


def test_a_study_begins_with_the_points_that_it_gives(shell, hill):
    shell.write("given.yaml", hill.replace("trials: 4", "trials: 4\n  first: [{x: 0.75}, {x: 0.25}]"))
    assert shell("run", "given.yaml", "--inline").code == 0
    trials = shell("trials", "hill", "--json").json
    assert [trial["params"]["x"] for trial in trials[:2]] == [0.75, 0.25]
    assert [trial["info"].get("mode") for trial in trials] == ["given", "given", "random", "random"]


def test_points_that_are_none_of_the_space_are_refused_all_at_once_by_line(shell, hill):
    shell.write("given.yaml", hill.replace("trials: 4", "trials: 4\n  first:\n    - {x: 2}\n    - {y: 0.1}\n    - 7"))
    refused = shell("run", "given.yaml", "--inline")
    assert refused.code == 2
    assert refused.err.splitlines()[0].startswith("given.yaml:13: search.first[2]: expected a mapping")
    shell.write("given.yaml", hill.replace("trials: 4", "trials: 4\n  first:\n    - {x: 2}\n    - {y: 0.1}"))
    refused = shell("run", "given.yaml", "--inline")
    assert refused.code == 2
    assert refused.err.splitlines() == [
        "given.yaml:11: search.first[0]: parameter 'x': expected a value in [0.0, 1.0], found 2.0",
        "given.yaml:12: search.first[1]: expected parameters ['x'], found unknown 'y'",
    ]
    assert shell.study_names() == []


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
    shell.queue("hill")
    assert shell("pause", "hill").out == "hill is paused.\n"
    assert shell("ls", "--json").json[0]["state"] == "paused"
    assert shell("resume", "hill", "--inline").code == 0
    assert shell("show", "hill", "--json").json["state"] == "complete"


def test_run_resumes_what_was_paused(shell, hill):
    shell.queue("hill")
    shell("pause", "hill")
    typed = shell("run", "hill.yaml", "--inline")
    assert typed.code == 0
    assert "hill is complete" in typed.out


def test_a_cancelled_study_says_so_and_can_be_taken_up_again(shell, hill):
    shell.queue("hill")
    assert shell("cancel", "hill").out == "hill was cancelled.\n"
    again = shell("cancel", "hill")
    assert again.code in {0, 2}
    assert shell("resume", "hill", "--inline").code == 0


def test_a_study_whose_driver_died_obeys_at_once(shell, hill):
    shell.queue("hill")
    kill_driver_of(shell, "hill")
    assert shell("pause", "hill").out == "hill is paused.\n"
    kill_driver_of(shell, "hill", ask="run")
    assert shell("cancel", "hill").out == "hill was cancelled.\n"


def test_a_study_that_somebody_drives_is_only_told(shell, hill):
    shell.queue("hill")
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
    shell.queue("hill")
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


def test_trials_that_become_nan_are_diverged_and_a_study_of_nothing_else_says_what_to_do(shell, hill):
    shell.write("a.yaml", hill.replace(":hill", ":fog"))
    typed = shell("run", "a.yaml", "--inline")
    assert typed.code == 1
    assert typed.err == (
        "hill: expected a result, found none in 4 trials; what ended the newest is above. halma task check with the "
        "study file tells what to mend; then go on: halma extend hill --trials 4\n"
    )
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


def test_db_upgrade_says_what_it_found(shell):
    assert shell("db", "upgrade").out == "The schema is up to date (it was empty).\n"
    assert shell("db", "upgrade").out.startswith("The schema is up to date (it was ")


def test_interrupting_any_command_exits_with_130(shell, monkeypatch, capsys):
    def interrupt(*_arguments, **_keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr("services.cli.studies.session", interrupt)
    assert run_command(["ls"]) == 130


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
