"""How the best value rose, and at what cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from services.states import TrialState
from services.store.port import TrialRow


def answers(trial: TrialRow) -> bool:
    """Whether a trial is an answer: complete, with a value, and of the real task (no difficulty, or z = 1).

    The values of easier versions of a task don't compare with those of the task itself.
    """
    return trial.state is TrialState.COMPLETE and trial.value is not None and trial.z in {None, 1.0}


@dataclass(frozen=True, slots=True)
class Step:
    """A finished trial on the course of its study.

    Args:
        trial: the trial.
        samples: what all finished trials up to this one have cost together, control steps.
        minutes: from the first start to the end of this one; None where the record has no times.
        best: the best answer so far; None before the first.
        is_best: whether this trial raised it.
    """

    trial: TrialRow
    samples: int
    minutes: float | None
    best: float | None
    is_best: bool


def course(history: Sequence[TrialRow]) -> list[Step]:
    """The course of a study.

    Args:
        history: its finished trials, in order of position.
    """
    starts = [trial.started_at for trial in history if trial.started_at is not None]
    begin = min(starts, default=None)
    steps: list[Step] = []
    samples, best = 0, None
    for trial in history:
        samples += trial.samples
        value = trial.value if answers(trial) else None
        is_best = value is not None and (best is None or value > best)
        best = value if is_best else best
        end = trial.finished_at
        minutes = None if begin is None or end is None else (end - begin).total_seconds() / 60
        steps.append(Step(trial, samples, minutes, best, is_best))
    return steps
