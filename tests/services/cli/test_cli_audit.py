"""`halma audit`: what is reported is judged once more."""

from __future__ import annotations

import pytest


@pytest.fixture
def study(shell):
    def run(task, low, high):
        shell.write(
            "judged.yaml",
            f"name: judged\ntask: sample_hills:{task}\nspace: {{x: {{type: float, low: {low}, high: {high}}}}}\n"
            "search: {strategy: sobol, trials: 4}\n",
        )
        ran = shell("run", "judged.yaml", "--inline")
        assert ran.code == 0, ran.err
        return ran.out

    return run


def test_a_study_whose_strategies_all_pass_exits_with_0(shell, study):
    study("Judge", 0.0, 0.8)
    told = shell("audit", "judged")
    assert told.code == 0, told.err
    assert "FAILED" not in told.out
    assert "passed" in told.out
    judged = shell("audit", "judged", "--json", "--rollouts", "7").json
    assert judged["passed"] is True
    assert judged["strategies"]
    for strategy in judged["strategies"]:
        assert strategy["passed"] is True
        assert strategy["checks"]["tries"] == {"found": 7, "bound": None, "unit": "tries", "passed": True}
        assert strategy["name"] in {"left of the top", "right of the top"}


def test_one_failing_strategy_exits_with_1_and_is_marked(shell, study):
    study("Judge", 0.91, 1.0)
    told = shell("audit", "judged")
    assert told.code == 1
    assert "expected every strategy to pass, found trial" in told.err
    assert "FAILED" in told.out
    assert " !" in told.out
    judged = shell("audit", "judged", "--json")
    assert judged.code == 1
    assert judged.json["strategies"][0]["failures"] == ["place"]


def test_a_damaged_policy_is_a_failed_audit(shell, study):
    study("Judge", 0.0, 0.8)
    for policy in shell.home.rglob("policy-*"):
        policy.write_bytes(b"0.1")
    told = shell("audit", "judged")
    assert told.code == 1
    assert "could not be judged" in told.out


def test_a_task_without_an_audit_is_told(shell, study):
    study("bare_hill", 0.0, 1.0)
    told = shell("audit", "judged")
    assert told.code == 2
    assert told.err == "audit: expected a task that can judge its policies, found that sample_hills:bare_hill can't\n"


def test_an_unknown_study_is_told(shell):
    assert shell("audit", "nowhere").code == 2


def test_what_its_own_audit_refused_is_not_reported(shell, study):
    out = study("Liar", 0.0, 0.49)
    assert "no strategy that works" in out
    assert shell("show", "judged").out.count("trial") >= 1


def test_what_its_own_audit_passed_is_reported(study):
    assert "distinct strateg" in study("Liar", 0.5, 1.0)
