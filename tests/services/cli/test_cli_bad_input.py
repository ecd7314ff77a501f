"""Bad input: one message that says where, what was expected and what was found; exit code 2; no study row."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from services.amending import AMENDABLE

ROOT = Path(__file__).parents[3]


def refused(shell, *arguments, rows=()):
    """The message of a command that must be refused as bad input and leave these study rows."""
    typed = shell(*arguments)
    assert typed.code == 2
    assert typed.out == ""
    assert shell.study_names() == list(rows)
    assert "Traceback (most recent call last)" not in typed.err or "sample" not in typed.err
    return typed.err


def test_a_missing_file(shell, hill):
    assert refused(shell, "run", "hil.yaml") == (
        "hil.yaml: expected a study file, found no such file; did you mean hill.yaml?\n"
    )


def test_broken_yaml(shell):
    shell.write("a.yaml", "name: a\ntask: b: c\n")
    assert refused(shell, "run", "a.yaml") == (
        "a.yaml:2: expected YAML, found a mistake: mapping values are not allowed here\n"
    )


def test_an_unknown_key(shell, hill):
    shell.write("a.yaml", hill.replace("trials: 4", "trails: 4"))
    assert refused(shell, "run", "a.yaml") == (
        "a.yaml:9: search.trails: expected a known key, found trails; did you mean trials?\n"
    )


@pytest.mark.parametrize("low", ["1", "2.5"])
def test_a_bound_where_low_is_not_below_high(shell, hill, low):
    shell.write("a.yaml", hill.replace("low: 0,", f"low: {low},"))
    assert refused(shell, "run", "a.yaml") == (
        f"a.yaml:6: space.x.low: expected low below high, found low {low} and high 1\n"
    )


def test_an_unknown_strategy(shell, hill):
    shell.write("a.yaml", hill.replace("random", "radnom"))
    message = refused(shell, "run", "a.yaml")
    assert message.startswith("a.yaml:8: search.strategy: expected a strategy among random, sobol, ")
    assert message.endswith("found 'radnom'; did you mean 'random'?\n")


def test_an_unknown_task(shell, hill):
    shell.write("a.yaml", hill.replace("sample_hills:hill", "hihg_jump"))
    message = refused(shell, "run", "a.yaml")
    assert message.startswith(
        "a.yaml:3: task.name: expected a task, found hihg_jump: unknown; did you mean 'high_jump'"
    )


def test_a_task_that_its_module_does_not_have(shell, hill):
    shell.write("a.yaml", hill.replace("sample_hills:hill", "sample_hills:hil"))
    assert refused(shell, "run", "a.yaml") == (
        "a.yaml:3: task.name: expected a task, found sample_hills:hil: 'sample_hills' has no 'hil'; "
        "did you mean 'hill' or 'bare_hill'?\n"
    )


@pytest.mark.parametrize(
    ("addition", "message"),
    [
        ("training: {budget: 0}", "a.yaml:11: training.budget: expected a number above 0, found 0\n"),
        (
            "training:\n  budget:\n    samples: 0",
            "a.yaml:13: training.budget.samples: expected a number above 0, found 0\n",
        ),
    ],
)
def test_a_training_budget_of_zero(shell, hill, addition, message):
    shell.write("a.yaml", f"{hill}{addition}\n")
    assert refused(shell, "run", "a.yaml") == message


def test_a_search_budget_of_zero(shell, hill):
    shell.write("a.yaml", hill.replace("trials: 4", "trials: 0"))
    assert refused(shell, "run", "a.yaml") == "a.yaml:9: search.trials: expected a number above 0, found 0\n"
    assert refused(shell, "run", "hill.yaml", "--set", "search.trials=0") == (
        "--set search.trials=0: search.trials: expected a number above 0, found 0\n"
    )


def test_a_name_that_exists_says_what_changed_what_may_and_how_to_go_on(shell, hill):
    assert shell("run", "hill.yaml", "--inline").code == 0
    before = shell("show", "hill", "--json").json
    shell.write("a.yaml", hill.replace("trials: 4", "trials: 6").replace("seed: 7", "seed: 8"))
    assert refused(shell, "run", "a.yaml", rows=["hill"]) == (
        "a.yaml:1: name: expected the study hill as it was created, or a new name, found changes:\n"
        "  seed: 7 in the study, 8 in the file\n"
        "A study keeps what makes it what it is: task, space, seed, search, training, stages. Nothing was changed.\n"
        f"What can change is how it is run ({', '.join(AMENDABLE)}), and its budget (search.trials, search.cost) "
        "can be raised. Of this file that is: search.trials: 4 -> 6.\n"
        "Run this file as a new study: halma run a.yaml --name NEW. "
        "Go on with the old one as it is: halma resume hill\n"
    )
    assert shell("show", "hill", "--json").json == before, "not even the budget, which alone could be raised"
    shell.write("b.yaml", hill.replace("trials: 4", "trials: 3"))
    assert "  search.trials: 4 in the study, 3 in the file" in refused(shell, "run", "b.yaml", rows=["hill"])


def test_a_database_that_is_another_file(shell, hill):
    message = refused(shell, "run", "hill.yaml", "--db", "hill.yaml")
    assert message.startswith(f"database {shell.folder}/hill.yaml: expected a SQLite file we can write, found: ")
    assert "give another path" in message


def test_a_database_in_a_folder_that_can_not_be_made(shell, hill):
    message = refused(shell, "run", "hill.yaml", "--db", "hill.yaml/x.db")
    assert message.startswith(f"database {shell.folder}/hill.yaml/x.db: expected ")


def test_a_database_of_an_engine_that_is_not_supported(shell, hill):
    assert refused(shell, "ls", "--db", "mysql://host/x") == (
        "database mysql://host/x: expected SQLite (a path) or PostgreSQL (postgresql://...), found 'mysql'\n"
    )


def test_resuming_something_unknown(shell, hill):
    shell("run", "hill.yaml", "--inline")
    assert refused(shell, "resume", "hil", rows=["hill"]) == (
        "study 'hil': expected the name of a study, found 'hill'; `halma ls` lists them all\n"
    )


def test_resuming_something_finished(shell, hill):
    shell("run", "hill.yaml", "--inline")
    assert refused(shell, "resume", "hill", rows=["hill"]) == (
        "resume: expected a study with budget left, found hill complete after 4 trials; look at it with "
        "`halma show hill`, or give it more with `halma extend hill --trials 10`\n"
    )


def test_a_task_module_that_fails_to_import_shows_the_users_traceback_without_ours(shell, hill):
    shell.write("steep.py", "import math\n\nHEIGHT = math.sqrt(-1)\n")
    shell.write("a.yaml", hill.replace("sample_hills:hill", "steep:hill"))
    message = refused(shell, "run", "a.yaml")
    lines = message.splitlines()
    assert lines[0] == "a.yaml:3: task.name: task 'steep:hill': its module could not be imported"
    assert lines[1] == "Traceback (most recent call last):"
    assert lines[2] == f'  File "{shell.folder}/steep.py", line 3, in <module>'
    assert lines[-1].startswith("ValueError: ")
    assert "services/" not in message
    assert "workers/" not in message
    assert "importlib" not in message


def test_a_strategy_that_needs_a_behaviour_the_task_does_not_have(shell, hill):
    shell.write(
        "a.yaml",
        "name: a\ntask: sample_hills:bare_hill\nspace: {x: {type: float, low: 0, high: 1}}\n"
        "search: {strategy: bds, trials: 3}\n",
    )
    assert refused(shell, "run", "a.yaml") == (
        "a.yaml:4: search.strategy: expected a strategy that needs no behaviour, because the task "
        "sample_hills:bare_hill has none, found bds\n"
    )


def test_a_space_is_asked_for_where_the_task_has_none(shell):
    shell.write("a.yaml", "name: a\ntask: sample_hills:hill\nsearch: {strategy: random, trials: 3}\n")
    assert refused(shell, "run", "a.yaml") == (
        "a.yaml:1: space: expected a space, because sample_hills:hill has none of its own, found nothing\n"
    )


def test_settings_that_task_and_strategy_do_not_know_name_their_line(shell, hill):
    shell.write("a.yaml", hill.replace("settings: {features", "settings: {feature: 1, features"))
    message = refused(shell, "run", "a.yaml")
    assert message.startswith("a.yaml:4: task.settings.feature: ")
    shell.write("b.yaml", hill.replace("  trials: 4", "  trials: 4\n  settings:\n    speed: 3"))
    message = refused(shell, "run", "b.yaml")
    assert message.startswith("b.yaml:11: search.settings.speed: ")


def test_mistakes_of_form_task_and_strategy_are_listed_together(shell, hill):
    text = hill.replace("random", "radnom").replace("low: 0,", "low: 3,").replace(":hill", ":hil")
    shell.write("a.yaml", text)
    message = refused(shell, "run", "a.yaml")
    assert [line.split(" ")[0] for line in message.splitlines()] == ["a.yaml:3:", "a.yaml:6:", "a.yaml:8:"]


@pytest.mark.parametrize("command", ["show", "trials", "watch", "pause", "cancel", "resume"])
def test_an_unknown_study_is_refused_by_every_command(shell, command):
    assert refused(shell, command, "nobody") == (
        "study 'nobody': expected the name of a study, found none of a similar name; `halma ls` lists them all\n"
    )


def test_extend_without_an_amount(shell):
    assert refused(shell, "extend", "hill") == (
        "extend: expected --trials N, --cost N or --rounds N, found none of them; "
        "for example halma extend hill --trials 10\n"
    )


def test_a_replay_of_a_trial_without_policy(shell, hill):
    shell("run", "hill.yaml", "--inline")
    message = refused(shell, "replay", "hill", "1", rows=["hill"])
    assert message == (
        "replay: expected a trial with a policy, found that trial 1 (complete) left nothing; "
        "complete are the trials 0, 1, 2, 3\n"
    )
    assert "expected a number from 0 to 3" in refused(shell, "replay", "hill", "9", rows=["hill"])
    assert refused(shell, "replay", "hill", "1", "--video", "a.avi", rows=["hill"]) == (
        "--video: expected a file that ends in .mp4 or .gif, found a.avi\n"
    )


def test_submit_without_a_service_says_how_to_start_one(shell, hill):
    assert refused(shell, "submit", "hill.yaml") == (
        "expected a running service, found none; start one with `halma serve` (in another terminal), "
        "name one with --server URL, or run the study here with `halma run FILE`\n"
    )


def test_submit_checks_the_form_before_it_looks_for_a_service(shell, hill):
    shell.write("a.yaml", hill.replace("trials: 4", "trails: 4"))
    assert refused(shell, "submit", "a.yaml").startswith("a.yaml:9: search.trails: expected a known key")


def test_a_home_that_is_a_file(shell, monkeypatch):
    shell.write("home", "")
    monkeypatch.setenv("HALMA_HOME", str(shell.folder / "home"))
    typed = shell("ls")
    assert (typed.code, typed.out) == (2, "")
    assert typed.err == f"HALMA_HOME: expected a folder, found the file {shell.folder}/home; name another one\n"


@pytest.mark.parametrize("arguments", [("frobnicate",), ("ls", "--foo"), ("replay", "hill", "x"), ("run",)])
def test_what_is_no_command_at_all_exits_with_2(shell, arguments):
    assert shell(*arguments).code == 2


def test_the_installed_command_prints_one_message_and_exits_with_2(shell, hill):
    """The same through a process of its own: no traceback, nothing on standard output."""
    shell.write("a.yaml", hill.replace("trials: 4", "trails: 4"))
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{Path(__file__).parent}"}
    done = subprocess.run(
        [sys.executable, "-c", "from services.cli import main; main()", "run", "a.yaml"],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "a.yaml:9: search.trails: expected a known key, found trails; did you mean trials?\n"


def test_pages_that_drive_nothing_take_no_pools(shell):
    said = shell("serve", "--pages-only", "--pool", "default=2")
    assert said.code == 2
    assert "--pages-only: expected neither --pool nor --ray-address beside it" in said.err
