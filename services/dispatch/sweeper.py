"""Removes checkpoints that nobody needs any more, beside the coordinator: storage may be slow, dispatching may not."""

from __future__ import annotations

import contextlib
import queue
import threading

from services.artifacts.port import ArtifactStore
from services.errors import StorageUnavailable

CLOSE_SECONDS = 5.0
"""How long those that wait may take at the end; what is left then, `halma gc` finds."""


class Sweeper:
    """A thread that drops checkpoints, one trial after the other.

    Args:
        artifacts: where they are.
    """

    def __init__(self, artifacts: ArtifactStore) -> None:
        self._artifacts = artifacts
        self._waiting: queue.SimpleQueue[tuple[str, int] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._sweep, name="sweeper", daemon=True)
        self._thread.start()

    def drop(self, study_key: str, trial: int) -> None:
        """Drop the checkpoints of a trial that has ended, soon."""
        self._waiting.put((study_key, trial))

    def close(self) -> None:
        """Finish what waits, within `CLOSE_SECONDS`."""
        self._waiting.put(None)
        self._thread.join(CLOSE_SECONDS)

    def _sweep(self) -> None:
        while (trial := self._waiting.get()) is not None:
            with contextlib.suppress(StorageUnavailable):  # `halma gc` will find them
                self._artifacts.drop_checkpoints(*trial)
