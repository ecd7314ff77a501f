"""The WebSocket: frames of events from a cursor (see `services.api.live`), and nothing in the other direction."""

from __future__ import annotations

import asyncio
import logging
from typing import Annotated

from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect

from services.api.routes import LARGEST_ID
from services.api.service import Uses

log = logging.getLogger(__name__)

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
    async with service.hub.listen(study, after) as frames:

        async def sending() -> None:
            async for frame in frames:
                await socket.send_text(frame)

        send = asyncio.create_task(sending(), name="halma socket sender")
        # A sender that waits for news doesn't notice that nobody is there any more; a receiver does.
        receive = asyncio.create_task(_until_gone(socket), name="halma socket receiver")
        done, pending = await asyncio.wait({send, receive}, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        if send in done and receive not in done:
            if (error := send.exception()) is not None and not isinstance(error, WebSocketDisconnect):
                log.warning("a viewer's events stopped: %s", error)
            await socket.close(TRY_AGAIN)


async def _until_gone(socket: WebSocket) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
