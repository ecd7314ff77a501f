"""gc and verify as a person types them, and artifacts that are not where they were."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pytest


@pytest.fixture
def painted(shell, hill):
    """A finished study whose trials left files; the folder of these."""
    shell.write("hill.yaml", hill.replace(":hill", ":Painter"))
    typed = shell("run", "hill.yaml", "--inline")
    assert typed.code == 0, typed.err
    return shell.home / "halma.artifacts"


def files_of(root):
    return sorted(path for path in root.rglob("*") if path.is_file() and path.name != ".halma-artifacts")


def orphan(root, trial=0, age=7200):
    """What a fenced worker leaves."""
    path = next((root / "1-hill").iterdir()).parent / f"{trial:06d}" / f"policy-{'0' * 16}.safetensors"
    path.write_bytes(b"x" * 1500)
    os.utime(path, (time.time() - age,) * 2)
    return path


def test_gc_removes_what_no_trial_names_and_prints_the_bytes(shell, painted):
    before = files_of(painted)
    path = orphan(painted)
    looked = shell("gc", "--dry-run")
    assert (looked.code, looked.err) == (0, "")
    assert looked.out.splitlines()[0] == f"Would remove 1 file, 1.5 kB, from {painted}"
    assert path.exists()
    typed = shell("gc")
    lines = typed.out.splitlines()
    assert lines[0] == f"Removed 1 file, 1.5 kB, from {painted}"
    assert lines[1].split() == ["1", "1.5", "kB", "files", "that", "no", "trial", "names"]
    assert lines[2].endswith(": 12 that trials name")
    assert files_of(painted) == before
    assert shell("verify").code == 0


def test_gc_leaves_what_is_young_unless_told_otherwise(shell, painted):
    path = orphan(painted, age=60)
    assert shell("gc").out.startswith("Removed 0 files, 0 B, from ")
    assert path.exists()
    typed = shell("gc", "--older-than", "0.01", "--json").json
    assert (typed["removed"], typed["fates"]["named"]["files"]) == ({"files": 1, "bytes": 1500}, 12)


def test_verify_says_which_files_are_not_as_recorded_and_exits_with_1(shell, painted):
    good = shell("verify", "hill")
    assert good.code == 0
    size = sum(path.stat().st_size for path in files_of(painted))
    assert good.out.startswith("12 files, ")
    assert shell("verify", "--json").json == {
        "artifacts": str(painted), "files": 12, "bytes": size, "mismatches": [],
    }  # fmt: skip
    altered, missing = (next((painted / "1-hill" / "000002").glob(f"{name}*")) for name in ("pose", "policy"))
    altered.write_bytes(altered.read_bytes()[:-1])
    missing.unlink()
    bad = shell("verify", "hill")
    assert bad.code == 1
    assert [line.split(": ")[0] for line in bad.out.splitlines()] == [
        "hill, trial 2, policy.safetensors",
        "hill, trial 2, pose.png",
        bad.out.splitlines()[-1].split(": ")[0],
    ]
    assert bad.err == "verify: expected every file that a trial names, found 2 files missing or altered\n"
    listed = shell("verify", "--json")
    assert (listed.code, [each["artifact"] for each in listed.json["mismatches"]]) == (
        1,
        ["policy.safetensors", "pose.png"],
    )


def test_an_unknown_study_is_refused(shell, painted):
    assert shell("verify", "nobody").code == 2


def test_artifacts_that_moved_are_told_before_anything_is_changed(shell, hill, painted):
    shell("extend", "hill", "--trials", "2")
    there = painted.with_name("elsewhere")
    shutil.move(painted, there)
    before = shell("show", "hill", "--json").json
    for command in (("resume", "hill", "--inline"), ("run", "hill.yaml", "--inline"), ("gc",), ("verify",)):
        typed = shell(*command)
        assert (typed.code, typed.out) == (2, ""), command
        assert f"last seen at {painted}, found a root without a mark" in typed.err
        assert "--artifacts PLACE" in typed.err
    assert shell("show", "hill", "--json").json == before
    assert not painted.exists()
    typed = shell("resume", "hill", "--inline", "--artifacts", str(there))
    assert typed.code == 0, typed.err
    assert shell("verify", "--artifacts", str(there)).out.startswith("18 files, ")


def test_artifacts_that_are_gone_can_be_done_without(shell, painted):
    shell("extend", "hill", "--trials", "1")
    shutil.rmtree(painted)
    assert shell("resume", "hill", "--inline").code == 2
    adopted = shell("verify", "--adopt")
    assert adopted.code == 1
    assert len(adopted.out.splitlines()) == 13
    assert shell("resume", "hill", "--inline").code == 0
    assert shell("verify").code == 1, "and what is lost stays told"


def test_a_study_keeps_no_checkpoint_of_a_finished_trial(shell):
    text = """\
name: point
task: point_jump
search: {strategy: random, trials: 2}
training: {budget: {samples: 200}}
"""
    shell.write("point.yaml", text)
    assert shell("run", "point.yaml", "--inline").code == 0
    root = shell.home / "halma.artifacts"
    assert [path for path in files_of(root) if path.suffix == ".checkpoint"] == []
    shell.write("kept.yaml", text.replace("point\n", "kept\n", 1) + "keep_checkpoints: true\n")
    assert shell("run", "kept.yaml", "--inline").code == 0
    kept = [path for path in files_of(root) if path.suffix == ".checkpoint"]
    assert {path.parts[-3] for path in kept} == {"000000", "000001"}
    assert all(Path(path).parts[-4] == "2-kept" for path in kept)


def test_a_whole_study_keeps_its_files_on_an_s3_server(shell, hill, s3_root):
    shell.write("hill.yaml", hill.replace(":hill", ":Painter"))
    typed = shell("run", "hill.yaml", "--inline", "--artifacts", s3_root)
    assert (typed.code, typed.err) == (0, "")
    verified = shell("verify", "--artifacts", s3_root)
    assert verified.out.startswith("12 files, ")
    assert verified.out.endswith(f"in {s3_root}: as recorded\n")
    assert shell("replay", "hill", "1").code != 0, "the files are there and nowhere else"
    assert shell("gc", "--dry-run", "--artifacts", s3_root).out.startswith(f"Would remove 0 files, 0 B, from {s3_root}")


def test_a_database_of_a_newer_schema_is_bad_input_with_what_to_do(shell, hill, painted):
    import sqlite3

    with sqlite3.connect(shell.home / "halma.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '0815'")
    for command in (("resume", "hill", "--inline"), ("run", "hill.yaml", "--inline"), ("ls",), ("gc",), ("verify",)):
        typed = shell(*command)
        assert (typed.code, typed.out) == (2, "")
        assert "found 0815, which a newer halma wrote; update halma, or give another database" in typed.err
