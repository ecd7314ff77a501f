"""What the API stands on: the store, the artifacts, the way to submit, and the events' hub."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol, cast

from fastapi import Depends
from fastapi.requests import HTTPConnection

from services.api.answers import Answers
from services.api.distinct import Distinct
from services.api.known import KnownStudies
from services.api.live import Hub
from services.api.looks import Looks
from services.api.tables import FinishedTrials
from services.api.windows import Finder
from services.store.port import ArtifactRow, Store, StudyRow


class Submit(Protocol):
    """Reads, checks and records a study file."""

    def __call__(self, text: str, overrides: Sequence[str], name: str) -> StudyRow:
        """The new study. Raises `BadInput`, with all problems where the text is wrong; then nothing is recorded."""


class Artifacts(Protocol):
    """What the API needs of the artifact store."""

    def read(self, artifact: ArtifactRow) -> bytes:
        """The whole artifact, checked against its hash. Raises `ArtifactDamaged`."""


@dataclass(frozen=True, slots=True)
class Service:
    """What every route may use.

    Args:
        store: the trial database.
        artifacts: the trials' files.
        submit: takes study files; None where this server only shows.
        on_change: called after something was asked for, so that a driver need not poll fast.
        hub: live events.
        trials: the finished trials of the studies last asked for.
        studies: with their counts.
        finder: sorts and filters trials.
        distinct: strategies of studies.
        looks: what searches have learnt.
        answers: what many people ask for.
        pools: cores by worker pool; empty where this server doesn't know them.
    """

    store: Store
    artifacts: Artifacts
    submit: Submit | None
    on_change: Callable[[], None]
    hub: Hub
    trials: FinishedTrials
    studies: KnownStudies
    finder: Finder
    distinct: Distinct
    looks: Looks
    answers: Answers
    pools: Mapping[str, int]

    def changed(self) -> None:
        """Tell the driver that something was asked for."""
        self.on_change()


def service_of(connection: HTTPConnection) -> Service:
    """The service that an app was made with."""
    return cast("Service", connection.app.state.service)


Uses = Annotated[Service, Depends(service_of)]
"""A route's parameter that is the service."""
