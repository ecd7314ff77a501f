"""What there is: tasks, strategies, the schema, and the doctor."""

from __future__ import annotations

import pytest
from sqlalchemy import make_url

from services.spec import json_schema


def test_tasks_are_listed_and_shown(shell):
    listed = shell("tasks", "--json").json
    assert {"high_jump", "point_jump"} <= {task["name"] for task in listed}
    assert "point_jump" in shell("tasks").out
    shown = shell("tasks", "point_jump").out
    names = next(task for task in listed if task["name"] == "point_jump")["parameters"]
    assert all(name in shown for name in names)
    assert "Training (defaults):" in shown
    assert shell("tasks", "point_jump", "--json").json["name"] == "point_jump"


def test_a_users_own_task_is_shown_by_its_name(shell):
    assert shell("tasks", "sample_hills:bare_hill").out.startswith(
        "sample_hills:bare_hill: Height on a hill, without behaviour."
    )
    typed = shell("tasks", "sample_hills:nothing")
    assert (typed.code, typed.out) == (2, "")
    assert typed.err.startswith("tasks: task 'sample_hills:nothing': 'sample_hills' has no 'nothing'")


def test_strategies_are_listed_and_shown(shell):
    listed = {info["name"]: info for info in shell("strategies", "--json").json}
    assert {"random", "sobol", "bds"} <= set(listed)
    table = shell("strategies").out
    assert all(name in table for name in listed)
    shown = shell("strategies", "bds").out
    assert all(setting["name"] in shown for setting in listed["bds"]["settings"])
    assert shell("strategies", "random").out.endswith("It has no settings.\n")
    typed = shell("strategies", "radnom")
    assert (typed.code, typed.err) == (2, "strategies: expected a strategy, found radnom; did you mean random?\n")


def test_the_schema_is_json(shell):
    assert shell("schema").json == json_schema()


def test_the_doctor_looks_at_everything_and_names_a_remedy(shell):
    checks = {check["name"]: check for check in shell("doctor", "--json").json}
    assert list(checks) == [
        "python", "packages", "cores", "memory", "disk", "database", "artifacts", "ray", "browser",
    ]  # fmt: skip
    assert checks["database"]["found"].endswith("0 studies")
    assert checks["artifacts"]["good"]
    assert [path for path in (shell.home / "halma.artifacts").rglob("*") if path.is_file()] == [], "it cleans up"


@pytest.mark.postgres
def test_the_doctor_keeps_the_password_of_the_database_to_itself(shell, postgres_server):
    url = make_url(postgres_server.new_database("doctored")).set(password="sesame")
    typed = shell("doctor", "--db", url.render_as_string(hide_password=False))
    assert ":***@" in typed.out
    assert "sesame" not in typed.out + typed.err


def test_the_doctor_finds_a_broken_database_and_exits_with_1(shell):
    shell.write("notes.txt", "no database, but long enough to look like a file of something else" * 20)
    typed = shell("doctor", "--db", "notes.txt")
    assert typed.code == 1
    lines = typed.out.splitlines()
    bad = next(i for i, line in enumerate(lines) if line.startswith("bad") and "database" in line)
    assert "expected a SQLite file we can write" in lines[bad]
    assert lines[bad + 1].strip() == "do: give another one with --db or HALMA_DB"
    assert "database" in typed.err


@pytest.mark.parametrize("arguments", [("--help",), ("run", "--help"), ("db", "--help"), ("--version",)])
def test_help_and_version_exit_with_0(shell, arguments):
    typed = shell(*arguments)
    assert typed.code == 0
    assert typed.out


def test_a_task_is_checked_by_its_name_or_by_its_study_file(shell, tmp_path):
    good = shell("task", "check", "gymnasium:CartPole-v1")
    assert "ok" in good.out
    assert "the same seed gives the same episode" in good.out
    file = tmp_path / "s.yaml"
    file.write_text(
        "name: s\ntask: {name: 'gymnasium:CartPole-v1', settings: {difficulty: {budget: 0.2}}}\n"
        "search: {strategy: cmfbo, cost: 1000}\ntraining: {budget: {samples: 1000}}\n"
    )
    assert "cost in samples: 200 at z = 0" in shell("task", "check", str(file)).out


def test_a_task_that_breaks_a_promise_ends_the_check_with_what_to_mend(shell):
    refused = shell("task", "check", "math:sqrt")
    assert refused.code == 2
    assert "do: check it with its study file" in refused.out
    assert "math:sqrt can't be searched yet; to be mended: spaces" in refused.err
    refused = shell("task", "check", "gymnasium:Cartpole-v1")
    assert refused.code == 2
    assert "did you mean 'CartPole-v1'" in refused.err
