"""What all models share: where an answer was read, how lists go on, what something cost, and errors."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class Model(BaseModel):
    """Frozen; unknown keys of a request are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Position(Model):
    """Where in the record something was read: everything up to `cursor` is in it."""

    cursor: int = Field(description="newest event that the answer reflects")
    history: str = Field(description="identity of the database's history; another one means: forget what you know")


class Page(Model):
    """A page of a list."""

    next: str | None = Field(description="pass it as `page` for what follows; none at the end")


class Cost(Model):
    """What something has cost."""

    samples: int = Field(description="simulation samples (control steps)")
    seconds: float = Field(description="wall-clock seconds of training, over all attempts")


class Problem(Model):
    """One thing that is wrong with a study file."""

    line: int | None
    field: str
    message: str


class ErrorBody(Model):
    """What went wrong: what was expected, what was found, what to do."""

    kind: str = Field(description="name of the error, for programs")
    message: str
    line: int | None = None
    field: str = ""
    problems: list[Problem] = []


class ErrorOut(Model):
    """The body of every answer that isn't a success."""

    error: ErrorBody


class ServerOut(Model):
    """The service itself."""

    version: str
    boot: str = Field(description="changes when the service restarts")
    history: str
    cursor: int
    database: str = Field(description="URL without its password")
