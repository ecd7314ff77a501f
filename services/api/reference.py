"""Motion-capture clips beside trials: a clip goes in, a replay as trials leave it comes out. Nothing is kept."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import Field

from services.api.errors import TooOften
from services.api.models import ErrorOut, Model
from services.errors import BadInput
from services.throttle import Throttle

router = APIRouter(prefix="/api/v1")

BURST = 12
REFILL_SECONDS = 5.0
"""A clip takes up to a second of a core: an address gets a dozen at once, and a fifth of a core in the long run."""


class ClipIn(Model):
    """A clip to be shown."""

    text: Annotated[str, Field(max_length=900_000, description="the clip in the DeepMimic text form (JSON)")]
    bar: Annotated[float, Field(ge=0, le=4, allow_inf_nan=False)] = Field(
        default=0.0, description="height of the bar to draw, m"
    )


@router.post(
    "/reference",
    tags=["artifacts"],
    response_class=Response,
    responses={
        200: {"content": {"application/octet-stream": {}}},
        429: {"model": ErrorOut, "description": "too many clips in a row; `Retry-After` says when it goes on"},
    },
)
def reference(request: Request, clip: ClipIn) -> Response:
    """A reference clip as a replay: its highest point over the bar, its way there along x."""
    if not hasattr(request.app.state, "clips_throttle"):
        request.app.state.clips_throttle = Throttle(burst=BURST, refill_seconds=REFILL_SECONDS)
    throttle: Throttle = request.app.state.clips_throttle
    address = request.client.host if request.client else "unknown"
    if wait := math.ceil(throttle.wait(address)):
        raise TooOften(f"expected at most {BURST} clips in a row, found more; try again in {wait} s", wait)
    throttle.spend(address)
    # Bullet takes a second to load, and a server that nobody shows a clip needs none.
    from workers.contracts import BadJob  # noqa: PLC0415
    from workers.reference import replay_of_clip  # noqa: PLC0415

    try:
        data = replay_of_clip(clip.text, clip.bar).to_bytes()
    except BadJob as error:
        raise BadInput(str(error)) from None
    return Response(data, media_type="application/octet-stream")
