"""Starting Ray, keeping a coordinator actor alive in it, and letting both go."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import ray

from services.errors import HalmaError
from services.ray_service import start_coordinator, start_ray, stop_ray
from services.running import INTERRUPTED, leaving_on_signals
from services.states import StudyState

RESTARTS = 5
"""A coordinator that keeps dying is not restarted for ever."""

Begin = Callable[[Any], Any]
"""Given a coordinator actor, calls its main method and returns the reference."""


class Supervisor:
    """Keeps one coordinator actor running: where its process is lost, another takes its studies over.

    Args:
        create: makes a coordinator actor.
        begin: starts its main method.
    """

    def __init__(self, create: Callable[[], Any], begin: Begin) -> None:
        self._create = create
        self._begin = begin
        self._actor = create()
        self._leaving: tuple[StudyState, str] | None = None

    def leave(self, state: StudyState, reason: str) -> None:
        """Ask for a stop at the next checkpoints."""
        self._leaving = (state, reason)
        self._actor.leave.remote(state.value, reason)

    def run(self) -> None:
        """Until the main method returns. Raises what it raised."""
        for restart in range(RESTARTS + 1):
            reference = self._begin(self._actor)
            try:
                while not ray.wait([reference], timeout=0.5)[0]:
                    pass
                ray.get(reference)
            except ray.exceptions.RayActorError as error:
                if restart == RESTARTS:
                    raise HalmaError(f"The coordinator process was lost {RESTARTS + 1} times: {error}") from error
                self._actor = self._create()
                if self._leaving is not None:
                    self._actor.leave.remote(self._leaving[0].value, self._leaving[1])
            except ray.exceptions.RayTaskError as error:
                if isinstance(error.cause, HalmaError):
                    raise error.cause from None
                raise
            else:
                return


def drive_with_ray(
    database: str,
    artifact_root: str,
    directory: str,
    name: str,
    pools: Mapping[str, int] | None,
    *,
    take_over: bool,
    ray_address: str | None,
) -> None:
    """Drive one study on a local Ray, or on the cluster at `ray_address`."""
    start_ray(pools, ray_address)
    try:
        supervisor = Supervisor(
            lambda: start_coordinator(database, artifact_root, directory, pools),
            lambda actor: actor.drive.remote(name, take_over=take_over),
        )
        with leaving_on_signals(lambda: supervisor.leave(StudyState.PAUSED, INTERRUPTED)):
            supervisor.run()
    finally:
        stop_ray()


@contextmanager
def coordinator_serving(
    database: str, artifact_root: str, directory: str, pools: Mapping[str, int] | None, ray_address: str | None = None
) -> Iterator[None]:
    """A coordinator that drives whatever is submitted, while the block runs.

    Leaving the block stops trainings at their next checkpoints and leaves their studies `queued`, so that the
    next service goes on with them.
    """
    start_ray(pools, ray_address)
    try:
        supervisor = Supervisor(
            lambda: start_coordinator(database, artifact_root, directory, pools),
            lambda actor: actor.serve.remote(),
        )
        failures: list[Exception] = []

        def run() -> None:
            try:
                supervisor.run()
            except Exception as error:  # noqa: BLE001 - raised again in the main thread, below
                failures.append(error)
                # Pages over a record that nobody drives would look well and do nothing: stop the whole service.
                os.kill(os.getpid(), signal.SIGTERM)

        thread = threading.Thread(target=run, name="coordinator", daemon=True)
        thread.start()
        try:
            yield
        finally:
            if not failures:
                supervisor.leave(StudyState.QUEUED, "the service stopped")
            thread.join()
        if failures:
            raise HalmaError(f"The coordinator ended, and the service with it: {failures[0]}") from failures[0]
    finally:
        stop_ray()
