"""`halma plot`: files for a paper, and what it says where there is nothing to draw or nobody to draw it."""

from __future__ import annotations

import pytest

from services.cli import plotting


@pytest.fixture
def ran(shell, hill):
    assert shell("run", "hill.yaml", "--inline").code == 0
    return shell


def test_a_study_becomes_files_and_what_does_not_apply_is_said(ran):
    typed = ran("plot", "hill", "--format", "svg")
    assert typed.code == 0, typed.err
    written = {path.name for path in (ran.folder / "hill-figures").iterdir()}
    assert {"cost.svg", "behaviour.svg", "parallel.svg", "parameters.svg"} <= written
    assert "Left out: ladder (no trial has a difficulty)" in typed.out
    assert all(name in typed.out for name in written)


def test_one_figure_for_a_script(ran):
    typed = ran("plot", "hill", "--only", "cost", "--out", "figures", "--json")
    assert typed.json == {"files": {"cost": str(ran.folder / "figures" / "cost.pdf")}, "left_out": {}}
    assert (ran.folder / "figures" / "cost.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nope"], "study 'nope': expected the name of a study"),
        (["hill", "--only", "ladder"], "plot: expected something to draw of hill, found nothing (ladder: no trial has"),
        (["hill", "--out", "hill.yaml"], "--out: expected a folder, found the file"),
        (["hill", "--format", "gif"], "gif"),
    ],
)
def test_bad_input_is_one_message_and_leaves_nothing(ran, arguments, message):
    typed = ran("plot", *arguments)
    assert typed.code == 2
    assert message in typed.err
    assert [path.name for path in ran.folder.iterdir()] == ["hill.yaml"]


def test_without_matplotlib_it_says_what_to_install(ran, monkeypatch):
    monkeypatch.setattr(plotting, "find_spec", lambda name: None)
    typed = ran("plot", "hill")
    assert (typed.code, typed.out) == (1, "")
    assert "pip install 'halma[plot]'" in typed.err
