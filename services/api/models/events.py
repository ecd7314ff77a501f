"""What happened."""

from __future__ import annotations

from datetime import datetime
from typing import Self

from pydantic import JsonValue

from services.api.models.basis import Model, Page
from services.store.port import EventRow


class EventOut(Model):
    """Something that happened."""

    id: int
    study: str | None
    trial: int | None
    kind: str
    payload: dict[str, JsonValue]
    at: datetime

    @classmethod
    def of(cls, row: EventRow) -> Self:
        """From the store's row."""
        return cls(id=row.id, study=row.study, trial=row.trial, kind=row.kind, payload=dict(row.payload), at=row.at)


class EventPage(Page):
    """Some events, oldest first."""

    events: list[EventOut]
