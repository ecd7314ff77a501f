"""Starting Ray, keeping a coordinator actor alive in it, and letting both go."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import ray

from services.errors import HalmaError, InterruptedByUser
from services.held import Tell, waiting_words
from services.ray_processes import LocalRay
from services.ray_service import start_coordinator, start_ray, stop_ray
from services.running import INTERRUPTED, leaving_on_signals
from services.states import StudyState

RESTARTS = 5
"""A coordinator that keeps dying is not restarted for ever."""

TROUBLE_SECONDS = 2.0
"""How often the coordinator is asked whether it can record what happens."""


class RayLost(HalmaError):
    """One of Ray's own processes has ended, and with it the run."""


Begin = Callable[[Any], Any]
"""Given a coordinator actor, calls its main method and returns the reference."""


class Supervisor:
    """Keeps one coordinator actor running: where its process is lost, another takes its studies over.

    Args:
        create: makes a coordinator actor.
        begin: starts its main method.
        processes: of the Ray that was started here; None on a cluster that others look after.
        tell: is told what people should know meanwhile.
    """

    def __init__(
        self,
        create: Callable[[], Any],
        begin: Begin,
        processes: LocalRay | None = None,
        tell: Tell = lambda _: None,
    ) -> None:
        self._processes = processes
        self._tell = tell
        self._trouble, self._trouble_due = "", 0.0
        self._asked: Any = None
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
                    self._look_after_ray()
                    self._ask_for_trouble()
                ray.get(reference)
            except ray.exceptions.RayActorError as error:
                self._look_after_ray()
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

    def _look_after_ray(self) -> None:
        lost = "" if self._processes is None else self._processes.lost()
        if lost:
            raise RayLost(f"Ray's {lost} has ended, and with it this run; what had finished is on record.")

    def _ask_for_trouble(self) -> None:
        """Tell when the coordinator begins to wait for its database, and when that is over."""
        now = time.monotonic()
        if self._asked is None:
            if now >= self._trouble_due:
                self._trouble_due = now + TROUBLE_SECONDS
                self._asked = self._actor.trouble.remote()
            return
        if not ray.wait([self._asked], timeout=0)[0]:
            return
        asked, self._asked = self._asked, None
        try:
            found = str(ray.get(asked))
        except ray.exceptions.RayError:
            return  # it was lost meanwhile, which `run` finds out by itself
        if found != self._trouble:
            self._trouble = found
            self._tell(waiting_words(found))


@contextmanager
def local_or_joined(pools: Mapping[str, int] | None, address: str | None) -> Iterator[LocalRay | None]:
    """Ray while the block runs: started here, whose processes are looked after, or a cluster that was joined."""
    start_ray(pools, address)
    processes = LocalRay.of_this_process() if address is None else None
    try:
        yield processes
    except KeyboardInterrupt:  # the second Ctrl-C: at once, where Ray would take seconds
        if processes is not None:
            processes.end(InterruptedByUser.exit_code)
        raise
    finally:
        if processes is None or not processes.ended:
            if processes is not None and processes.lost():
                processes.end(RayLost.exit_code)
            else:
                stop_ray()


def drive_with_ray(
    database: str,
    artifact_root: str,
    directory: str,
    name: str,
    pools: Mapping[str, int] | None,
    *,
    take_over: bool,
    ray_address: str | None,
    tell: Tell,
) -> None:
    """Drive one study on a local Ray, or on the cluster at `ray_address`."""
    with local_or_joined(pools, ray_address) as processes:
        supervisor = Supervisor(
            lambda: start_coordinator(database, artifact_root, directory, pools),
            lambda actor: actor.drive.remote(name, take_over=take_over),
            processes,
            tell,
        )
        with leaving_on_signals(lambda: supervisor.leave(StudyState.PAUSED, INTERRUPTED)):
            try:
                supervisor.run()
            except RayLost as lost:
                raise RayLost(f"{lost} Go on with: halma resume {name}") from None


@contextmanager
def coordinator_serving(
    database: str,
    artifact_root: str,
    directory: str,
    pools: Mapping[str, int] | None,
    ray_address: str | None = None,
    tell: Tell = lambda _: None,
) -> Iterator[None]:
    """A coordinator that drives whatever is submitted, while the block runs.

    Leaving the block stops trainings at their next checkpoints and leaves their studies `queued`, so that the
    next service goes on with them.
    """
    with local_or_joined(pools, ray_address) as processes:
        supervisor = Supervisor(
            lambda: start_coordinator(database, artifact_root, directory, pools),
            lambda actor: actor.serve.remote(),
            processes,
            tell,
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
