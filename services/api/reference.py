"""Motion-capture clips beside trials: a clip goes in, a replay as trials leave it comes out. Nothing is kept."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import Field

from services.api.models import Model
from services.errors import BadInput

router = APIRouter(prefix="/api/v1")


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
    responses={200: {"content": {"application/octet-stream": {}}}},
)
def reference(clip: ClipIn) -> Response:
    """A reference clip as a replay: its highest point over the bar, its way there along x."""
    # Bullet takes a second to load, and a server that nobody shows a clip needs none.
    from workers.contracts import BadJob  # noqa: PLC0415
    from workers.reference import replay_of_clip  # noqa: PLC0415

    try:
        data = replay_of_clip(clip.text, clip.bar).to_bytes()
    except BadJob as error:
        raise BadInput(str(error)) from None
    return Response(data, media_type="application/octet-stream")
