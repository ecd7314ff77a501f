"""Whether the service lives, and whether it can work. Open to everybody, and says nothing else."""

from __future__ import annotations

from fastapi import APIRouter, Response

from services.api.service import Uses

router = APIRouter(tags=["service"])


@router.get("/healthz")
async def healthz() -> dict[str, str]:
    """The event loop turns."""
    return {"status": "ok"}


@router.get("/readyz", responses={503: {"description": "the trial database can't be read"}})
def readyz(service: Uses, response: Response) -> dict[str, str]:
    """The trial database answers."""
    try:
        service.store.last_event()
    except Exception:  # noqa: BLE001  (whatever keeps the database from answering is the answer)
        response.status_code = 503
        return {"status": "the trial database can't be read"}
    return {"status": "ok"}
