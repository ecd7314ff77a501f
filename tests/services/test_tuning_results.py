"""What comparisons of searches leave on file, so that they can be made in several sittings."""

import pytest

from benchmarks import tuning

TINY = [
    "training.budget.samples=64", "training.ppo.samples=32", "training.ppo.minibatch=16", "task.settings.episodes=1",
    "task.settings.max_episode_steps=8", "training.network.hidden=[4]", "search.cost=320",
]  # fmt: skip


@pytest.fixture
def compare(tmp_path, capsys):
    """Runs the benchmark on a tiny problem; gives what it printed."""

    def run(*words, overrides=TINY):
        chosen = [word for each in overrides for word in ("--set", each)]
        places = ["--results", str(tmp_path / "rows.jsonl"), "--work", str(tmp_path / "work")]
        tuning.main(["gymnasium", *words, *chosen, *places])
        return capsys.readouterr().out

    run.rows = lambda: tuning.read(tmp_path / "rows.jsonl")
    run.file = tmp_path / "rows.jsonl"
    run.work = tmp_path / "work"
    return run


def test_a_finished_search_is_a_row_and_is_not_run_again(compare):
    first = compare("--seeds", "2", "--configs", "random;cmfbo")
    rows = compare.rows()
    assert [(row["search"], row["seed"]) for row in rows] == [("random", 0), ("cmfbo", 0), ("random", 1), ("cmfbo", 1)]
    for row in rows:
        assert row["problem"] == "gymnasium"
        assert row["budget"] == 320
        assert row["spent"] > 320 - 64  # no further whole training was to be had
        spent, values = zip(*row["curve"], strict=True)
        assert list(spent) == sorted(spent)
        assert list(values) == sorted(values)
        assert row["trials"] >= row["at_z1"] >= len(values)
        assert len(row["revision"].rstrip("+")) == 12
    assert list(compare.work.iterdir()) == []  # policies of what is over are not kept
    again = compare("--seeds", "1-2", "--configs", "random;cmfbo")
    assert [(row["search"], row["seed"]) for row in compare.rows()[4:]] == [("random", 2), ("cmfbo", 2)]
    assert "seed 1:" in first
    assert "seed 1:" not in again


def test_a_search_that_was_interrupted_goes_on_at_the_trial_it_was_in(compare, monkeypatch):
    compare("--seeds", "1", "--configs", "random")
    (whole,) = compare.rows()
    compare.file.unlink()
    begun, trained = [], tuning._trained

    def third_is_interrupted(study, candidate, number, paid):
        begun.append(number)
        if begun == [0, 1]:
            raise KeyboardInterrupt
        return trained(study, candidate, number, paid)

    monkeypatch.setattr(tuning, "_trained", third_is_interrupted)
    with pytest.raises(KeyboardInterrupt):
        compare("--seeds", "1", "--configs", "random")
    assert compare.rows() == []
    compare("--seeds", "1", "--configs", "random")
    assert begun == [0, 1, *range(1, whole["trials"])]
    (row,) = compare.rows()
    assert {**row, "seconds": 0} == {**whole, "seconds": 0}


def test_rows_of_another_version_of_the_study_are_neither_taken_for_done_nor_printed(compare):
    compare("--seeds", "1", "--configs", "random")
    other = [*TINY[1:], "training.budget.samples=40"]
    printed = compare("--seeds", "1", "--configs", "random", overrides=other)
    assert "random, seed 0:" in printed
    assert "1 rows are of another version of the study" in printed
    assert len({row["digest"] for row in compare.rows()}) == 2


def test_how_children_begin_is_another_study_only_to_searches_that_have_some(compare):
    names = ["--seeds", "1", "--configs", "random;cmfbo"]
    default = compare(*names).splitlines()
    other = compare(*names, overrides=[*TINY, "training.ppo.sigma_child=parent"])
    assert "random, seed 0:" not in other
    assert "cmfbo, seed 0:" in other
    assert next(line for line in default if line.startswith("random  ")) in other
    assert "1 rows are of another version of the study" in other


def row(search, seed, curve):
    return {
        "problem": "gymnasium", "search": search, "seed": seed, "digest": "d", "revision": "r" * 12, "budget": 100,
        "spent": 110, "trials": 4, "at_z1": 2, "curve": curve, "worst": -9.0, "seconds": 1.0,
    }  # fmt: skip


def test_the_table_has_means_and_intervals_over_the_seeds_it_names(capsys):
    tuning.report("gymnasium", [
        row("random", 0, [(20, -8.0), (110, -4.0)]),
        row("random", 2, [(60, -6.0)]),
        row("cmfbo", 0, [(40, -5.0), (70, -1.0)]),
        row("boca", 0, []),
    ])  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    table = {line.split()[0]: line for line in lines[2:5]}
    # at a quarter the second one has no answer yet: as good as the worst that was seen, -9
    assert "0,2" in table["random"]
    assert "-8.5 [-9, -8]" in table["random"]
    assert "-7 [-8, -6]" in table["random"]
    assert "-5 [-6, -4]" in table["random"]
    assert "-1 [-1, -1]" in table["cmfbo"]
    assert table["cmfbo"].split()[-1] == "0.40"  # random ends with -5, which it has after 40 of 100
    assert table["boca"].split()[-1] == "never"
    assert lines[-1] == f"revisions: {'r' * 12}"


def test_what_is_on_file_can_be_printed_without_running_anything(compare):
    with pytest.raises(SystemExit, match="no finished search of gymnasium on file"):
        compare("--print")
    compare("--seeds", "1", "--configs", "random")
    before = compare.file.read_text()
    assert "random" in compare("--print")
    assert compare.file.read_text() == before


@pytest.mark.parametrize("words", [["--seeds", "few"], ["--seeds", "3-"], ["--configs", "cmfba"]])
def test_what_the_comparison_does_not_know_is_refused(compare, words, capsys):
    with pytest.raises(SystemExit) as refused:
        compare(*words)
    assert refused.value.code == 2
    assert f"found {words[1]!r}" in capsys.readouterr().err


def test_the_rows_in_the_repository_can_be_read():
    paths = sorted(tuning.FIGURES.glob("tuning-*.jsonl"))
    assert paths
    for path in paths:
        rows = tuning.read(path)
        assert rows
        assert len({(row["search"], row["seed"], row["digest"]) for row in rows}) == len(rows)
        assert {row["problem"] for row in rows} == {path.stem.removeprefix("tuning-")}
        assert {row["search"] for row in rows} <= set(tuning.CONFIGS)
