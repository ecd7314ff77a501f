"""A study in stages, typed."""

STAGED = """\
name: staged
task:
  name: sample_hills:shape
  settings: {features: {kind: euclidean, names: [side], low: [0], high: [9], distinct: 0.5}}
space: {x: {type: float, low: 0, high: 1}}
search: {strategy: sobol, trials: 4}
stages:
  novelty: {kind: novelty, after: search, strategies: 2, trainings: 1}
  polish: {kind: polish, after: [search, novelty], strategies: 3, rounds: 2}
seed: 5
"""


def test_a_study_in_stages_is_run_and_shown_by_stage(shell):
    typed = shell("run", shell.write("staged.yaml", STAGED), "--inline")
    assert (typed.code, typed.err) == (0, "")
    assert typed.out.startswith("staged starts: sobol on sample_hills:shape, 4 trials, then novelty, then polish.")
    shown = shell("show", "staged")
    assert "9 of at most 12 (9 complete)" in shown.out
    assert "new strategies" in shown.out
    told = shell("show", "staged", "--json").json
    assert [(stage["name"], stage["state"], stage["done"], stage["after"]) for stage in told["stages"]] == [
        ("search", "over", 4, []),
        ("novelty", "over", 2, ["search"]),
        ("polish", "over", 3, ["search", "novelty"]),
    ]
    assert "novelty" in shell("trials", "staged").out
    assert [trial["stage"] for trial in shell("trials", "staged", "--json").json][4:6] == ["novelty"] * 2
    extended = shell("extend", "staged", "--trials", "2")
    assert extended.out == "staged now has a budget of 6 trials of the search. Go on: halma resume staged\n"


def test_a_study_without_stages_shows_none(shell, hill):
    shell("run", "hill.yaml", "--inline")
    assert shell("show", "hill", "--json").json["stages"] == []
    assert "stage" not in shell("show", "hill").out
