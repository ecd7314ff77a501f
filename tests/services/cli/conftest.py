"""A halma home of its own for each test, and a way to type commands into it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from services.admission import admit
from services.cli import run_command
from services.spec_check import parse_study
from services.store.open import open_store

HILL = """\
name: hill
task:
  name: sample_hills:hill
  settings: {features: {kind: euclidean, names: [place], low: [0], high: [1], distinct: 0.2}}
space:
  x: {type: float, low: 0, high: 1}
search:
  strategy: random
  trials: 4
seed: 7
"""


@dataclass
class Typed:
    """What came of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@dataclass
class Shell:
    """Types commands in-process, in a folder and a home of its own."""

    folder: Path
    home: Path
    capture: pytest.CaptureFixture[str]

    def __call__(self, *arguments: str) -> Typed:
        self.capture.readouterr()
        code = run_command([str(argument) for argument in arguments])
        out, err = self.capture.readouterr()
        return Typed(code, out, err)

    def write(self, name: str, text: str) -> str:
        (self.folder / name).write_text(text, encoding="utf-8")
        return name

    def study_names(self) -> list[str]:
        store = open_store(self.home / "halma.db")
        try:
            return [row.name for row in store.studies()]
        finally:
            store.close()

    def queue(self, name: str) -> None:
        """Submit a study file that was written, without running it."""
        store = open_store(self.home / "halma.db")
        try:
            admit(store, parse_study((self.folder / f"{name}.yaml").read_text(encoding="utf-8"), name=f"{name}.yaml"))
        finally:
            store.close()


@pytest.fixture
def shell(tmp_path, monkeypatch, capsys):
    folder, home = tmp_path / "work", tmp_path / "home"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("HALMA_DB", "HALMA_ARTIFACTS", "HALMA_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HALMA_HOME", str(home))
    return Shell(folder, home, capsys)


@pytest.fixture
def hill(shell):
    """The text of a study file, written as hill.yaml."""
    shell.write("hill.yaml", HILL)
    return HILL


@pytest.fixture
def finished(shell, hill):
    """A study of four trials, finished; what `run` said."""
    typed = shell("run", "hill.yaml", "--inline")
    assert typed.code == 0, typed.err
    return typed.out
