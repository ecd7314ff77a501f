"""How many trials a study may have, those of its later stages among them."""

from __future__ import annotations

from services.errors import BadInput
from services.spec import MOST_ROUNDS, LaterStage, NoveltyStage, PolishStage, StudySpec
from services.store.port import StudyRow


def has_stages(row: StudyRow) -> bool:
    """Whether something follows a study's search."""
    return bool(row.spec.get("stages"))


def most_trials(row: StudyRow) -> int | None:
    """How many trials a study may have at most, those of its later stages among them; None where nothing limits it."""
    if row.target_trials is None or not has_stages(row):
        return row.target_trials
    return row.target_trials + sum(most_of(stage) for stage in StudySpec.from_json(row.spec).stages.values())


def check_rounds(row: StudyRow, more: int) -> None:
    """Raises `BadInput` where a study can't have so many more rounds."""
    for name, rounds in rounds_of(row).items():
        if rounds + more > MOST_ROUNDS:
            raise BadInput(
                f"extend: expected at most {MOST_ROUNDS} rounds in the stage {name}, found {rounds} and {more} more; "
                f"extend by {MOST_ROUNDS - rounds} or fewer"
            )


def rounds_of(row: StudyRow) -> dict[str, int]:
    """Of each stage of kind polish, by its name."""
    stages = StudySpec.from_json(row.spec).stages
    return {name: stage.rounds for name, stage in stages.items() if isinstance(stage, PolishStage)}


def most_of(stage: LaterStage) -> int:
    """How many trials a later stage may have."""
    if isinstance(stage, NoveltyStage):
        return stage.strategies * stage.trainings
    return stage.strategies * (stage.rounds if isinstance(stage, PolishStage) else 1)
