"""The WebSocket: frames of events from a cursor (see `services.api.live`), and nothing in the other direction."""

from __future__ import annotations

import contextlib
from typing import Annotated

import anyio
from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect

from services.api.parameters import LARGEST_ID
from services.api.service import Uses

router = APIRouter()

TRY_AGAIN = 1013
"""Close code: the trial database could not be read; come back in a moment."""


@router.websocket("/api/v1/events")
async def events(
    socket: WebSocket,
    service: Uses,
    after: Annotated[int, Query(ge=0, le=LARGEST_ID)] = 0,
    study: Annotated[str | None, Query(max_length=255)] = None,
) -> None:
    """Frames of one study, or of all, beyond a cursor."""
    await socket.accept()
    async with service.hub.listen(study, after) as frames, anyio.create_task_group() as group:
        # A sender that waits for news doesn't notice that nobody is there any more; a receiver does.
        group.start_soon(_until_gone, socket, group.cancel_scope)
        with contextlib.suppress(WebSocketDisconnect):
            async for frame in frames:
                await socket.send_text(frame)
            await socket.close(TRY_AGAIN)
        group.cancel_scope.cancel()


async def _until_gone(socket: WebSocket, scope: anyio.CancelScope) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
    scope.cancel()
