"""How far each stage of a study is: the search, and what follows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from search.record import SEARCH
from services.budget import has_stages, most_of
from services.report import distinct_trials, spec_of
from services.spec import StudySpec
from services.states import OPEN_TRIAL, StudyState, TrialState
from services.store.port import StudyRow, TrialRow
from services.translate import stages_of


@dataclass(frozen=True, slots=True)
class StageProgress:
    """One stage of a study.

    Args:
        name: of the stage.
        kind: the strategy of the search; `novelty` or `polish`.
        after: stages whose strategies it takes up.
        state: `waiting`, `running` or `over`.
        done: finished trials.
        running: running trials.
        most: at most so many trials; as far as the strategies to take up aren't known, it counts with the most allowed.
        new: distinct strategies that no stage before it had found.
        best: highest value; None before there is one.
        samples: that it cost.
        seconds: of training that it cost.
    """

    name: str
    kind: str
    after: tuple[str, ...]
    state: str
    done: int
    running: int
    most: int
    new: int
    best: float | None
    samples: int
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """For scripts."""
        return {**asdict(self), "after": list(self.after)}


def stage_names(row: StudyRow) -> list[str]:
    """Names of the stages that follow a study's search, in order."""
    return [stage.name for stage in stages_of(spec_of(row))] if has_stages(row) else []


def stages_of_study(row: StudyRow, trials: Sequence[TrialRow]) -> list[StageProgress]:
    """The stages of a study in the order in which they follow each other; none where nothing follows its search.

    Args:
        row: the study.
        trials: all its trials.
    """
    if not has_stages(row):
        return []
    spec = spec_of(row)
    names = [SEARCH, *stage_names(row)]
    own = {name: [trial for trial in trials if trial.stage == name] for name in names}
    progress: list[StageProgress] = []
    before: list[TrialRow] = []
    known = 0
    for name in names:
        before += own[name]
        found = len(distinct_trials(row, before))
        progress.append(_progress(row, spec, name, own, new=max(0, found - known)))
        known = max(known, found)
    return progress


def _progress(row: StudyRow, spec: StudySpec, name: str, own: dict[str, list[TrialRow]], *, new: int) -> StageProgress:
    stage = spec.stages.get(name)
    trials = own[name]
    values = [trial.value for trial in trials if trial.state is TrialState.COMPLETE and trial.value is not None]
    return StageProgress(
        name=name,
        kind=spec.search.strategy if stage is None else stage.kind,
        after=() if stage is None else stage.after,
        state=_state(row, spec, name, own),
        done=sum(trial.position is not None for trial in trials),
        running=sum(trial.state is TrialState.RUNNING for trial in trials),
        most=(row.target_trials or 0) if stage is None else most_of(stage),
        new=new,
        best=max(values, default=None),
        samples=sum(trial.samples for trial in trials),
        seconds=sum(trial.seconds for trial in trials),
    )


def _state(row: StudyRow, spec: StudySpec, name: str, own: dict[str, list[TrialRow]]) -> str:
    """A stage is over once one that follows it has begun, or the whole study is complete."""
    if any(trial.state in OPEN_TRIAL for trial in own[name]):
        return "running"
    followed = any(own[later] for later, stage in spec.stages.items() if name in stage.after)
    if followed or row.state is StudyState.COMPLETE:
        return "over"
    return "running" if own[name] and row.state is StudyState.RUNNING else "waiting"
