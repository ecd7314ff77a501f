"""How many trials a study may have, those of its later stages among them."""

from __future__ import annotations

from services.spec import LaterStage, NoveltyStage, PolishStage, StudySpec
from services.store.port import StudyRow


def has_stages(row: StudyRow) -> bool:
    """Whether something follows a study's search."""
    return bool(row.spec.get("stages"))


def most_trials(row: StudyRow) -> int | None:
    """How many trials a study may have at most, those of its later stages among them; None where nothing limits it."""
    if row.target_trials is None or not has_stages(row):
        return row.target_trials
    return row.target_trials + sum(most_of(stage) for stage in StudySpec.from_json(row.spec).stages.values())


def most_of(stage: LaterStage) -> int:
    """How many trials a later stage may have."""
    if isinstance(stage, NoveltyStage):
        return stage.strategies * stage.trainings
    return stage.strategies * (stage.rounds if isinstance(stage, PolishStage) else 1)
