"""What routes share: the parameters in their paths and queries, and the errors that they may answer with."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Query
from pydantic import Field

from services.api.models import ErrorOut
from services.states import TrialState

ERRORS: dict[int | str, dict[str, object]] = {
    status: {"model": ErrorOut, "description": text}
    for status, text in {
        400: "the body is no text of the kind it says it is",
        401: "no token or session, or a wrong one",
        404: "no such study, trial or artifact",
        409: "the state of the study doesn't allow this",
        413: "the request is too large",
        422: "the request or the study file is wrong",
        503: "the trial database can't be reached",
    }.items()
}
LARGEST_ID = 2**63 - 1

Study = Annotated[str, Path(max_length=255, description="name of the study")]
Number = Annotated[int, Path(ge=0, le=LARGEST_ID, description="number of the trial within its study")]
Limit = Annotated[int, Query(ge=1, le=1000, description="at most so many")]
Sort = Annotated[
    str, Query(max_length=200, description="a field, with - before it descending; e.g. -value, params.rate")
]
States = Annotated[list[TrialState] | None, Query(description="only trials in these states")]
Where = Annotated[
    list[Annotated[str, Field(max_length=300)]] | None,
    Query(max_length=16, description="FIELD OPERATOR VALUE, all of which must hold; e.g. value>=0.5, message~NaN"),
]
Columns = Annotated[
    list[Annotated[str, Field(max_length=200)]] | None,
    Query(max_length=400, description="only these fields, in this order; e.g. number, value, params.rate"),
]
AfterEvent = Annotated[
    int, Query(ge=0, le=LARGEST_ID, description="only events beyond this one: the `cursor` of another answer")
]
