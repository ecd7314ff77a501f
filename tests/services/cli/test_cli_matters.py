"""What `halma show` says of parameters, difficulties, and the setting to go on from."""

from __future__ import annotations

import pytest

PEAK = """\
name: peak
task: sample_hills:peak
space:
  rate: {type: float, low: 1.0e-5, high: 0.1, log: true}
  idle: {type: float, low: 0, high: 1}
search: {strategy: cmfbo, trials: 30}
seed: 3
"""


@pytest.fixture
def peak(shell):
    shell.write("peak.yaml", PEAK)
    typed = shell("run", "peak.yaml", "--inline")
    assert typed.code == 0, typed.err


def test_show_tells_what_matters_the_ladder_and_the_best_setting(shell, peak):
    shown = shell("show", "peak").out
    table = shown[shown.index("What matters to the value:") :].splitlines()
    assert table[4].split()[0] == "rate"
    assert table[5].split()[0] == "idle"
    assert "of the variance of the value is predicted unseen." in shown
    assert "Difficulties:" in shown
    told = shell("show", "peak", "--json").json
    trials = shell("trials", "peak", "--json").json
    assert [level["z"] for level in told["ladder"]] == sorted({round(trial["z"], 3) for trial in trials})
    assert sum(level["samples"] for level in told["ladder"]) == sum(trial["cost"]["samples"] for trial in trials)
    assert told["importance"]["parameters"][0]["name"] == "rate"
    best = max((trial for trial in trials if trial["z"] == 1), key=lambda trial: trial["value"])
    assert told["importance"]["best"]["params"] == best["params"]


def test_with_too_few_trials_of_the_real_task_it_says_so(shell):
    shell.write("peak.yaml", PEAK.replace("trials: 30", "trials: 14"))
    shell("run", "peak.yaml", "--inline")
    done = sum(trial["z"] == 1 for trial in shell("trials", "peak", "--json").json)
    assert done < 8
    shown = shell("show", "peak").out
    assert "What matters" not in shown
    assert f"Too few complete trials at full difficulty ({done}) to tell which parameters matter." in shown


def test_the_best_setting_pasted_into_the_next_study_runs(shell, peak):
    pasted = shell("show", "peak", "--json").json["importance"]["best"]
    head, _, tail = PEAK.replace("name: peak", "name: again").partition("space:")
    shell.write("again.yaml", head + pasted["yaml"] + tail[tail.index("search:") :].replace("trials: 30", "trials: 3"))
    typed = shell("run", "again.yaml", "--inline")
    assert typed.code == 0, typed.err
    space = shell("show", "again", "--json").json["spec"]["space"]
    for trial in shell("trials", "again", "--json").json:
        assert space["rate"]["low"] <= trial["params"]["rate"] <= space["rate"]["high"]
    assert space["rate"]["high"] / space["rate"]["low"] < 1e4


def test_a_study_that_has_found_nothing_shows_none_of_it(shell, hill):
    shell.write("fog.yaml", hill.replace("sample_hills:hill", "sample_hills:fog").replace("name: hill", "name: fog"))
    shell("run", "fog.yaml", "--inline")
    shown = shell("show", "fog").out
    assert "What matters" not in shown
    assert shell("show", "fog", "--json").json["importance"]["parameters"] == []
