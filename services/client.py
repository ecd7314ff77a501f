"""A typed client of a running service, for programs, notebooks and the command line.

    from services.client import Client

    with Client.here() as client:                      # the service of this HALMA_HOME
        for study in client.studies():
            print(study.name, study.state, study.best_value)
        for trial in client.trials("quickstart", states=["complete"]):
            print(trial.number, trial.params, trial.value)

Answers are the API's own models (`services.api.models`). Lists are iterators that ask for a page when they need it.
Errors are those of `services.errors`, worded for the person in front of the terminal.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self
from urllib.parse import quote

import httpx

from services.address import read_server
from services.api.models import (
    ArtifactOut,
    ArtifactPage,
    AttemptOut,
    AttemptPage,
    ClusterOut,
    CurveList,
    EdgeOut,
    EventOut,
    EventPage,
    ImportanceList,
    Ladder,
    LadderPoint,
    LeftOut,
    LeftPage,
    LevelOut,
    Lineage,
    Metrics,
    ProposalOut,
    ProposalPage,
    ServerOut,
    SliceOut,
    StrategyList,
    StrategyOut,
    StudyList,
    StudyOut,
    StudySummary,
    TrialDetail,
    TrialOut,
    TrialPage,
    TrialTable,
    WorkerList,
    WorkerOut,
)
from services.errors import BadInput
from services.settings import Settings, find_settings
from services.states import TrialState
from services.wire import ServerRefused, ServerUnavailable, Wire, read_token

__all__ = ["Client", "ServerRefused", "ServerUnavailable"]

ROWS = 1000
"""Rows that a list asks for at once: the most that the service gives."""


class Client:
    """Talks to a service.

    Args:
        settings: where the token is.
        server: base URL, or None for the one that `HALMA_HOME/server.json` names.
        token: the token, instead of `HALMA_TOKEN` or the one in the settings' file.
        transport: for tests.

    Raises:
        ServerUnavailable: none is named.
        BadInput: the URL is none.
    """

    def __init__(
        self,
        settings: Settings,
        server: str | None = None,
        transport: httpx.BaseTransport | None = None,
        token: str | None = None,
    ) -> None:
        if server is None:
            found = read_server(settings.server_file)
            if found is None:
                raise ServerUnavailable(
                    "expected a running service, found none; start one with `halma serve` (in another terminal), "
                    "name one with --server URL, or run the study here with `halma run FILE`"
                )
            server = found.url
        file = settings.token_file
        given = token.strip() if token is not None else None
        self._wire = Wire(
            server,
            (lambda: read_token(file)) if given is None else (lambda: given),
            str(file) if given is None else "`token`",
            transport,
        )
        self.url = self._wire.url

    @classmethod
    def here(cls) -> Self:
        """A client of the service that runs in this `HALMA_HOME`. Raises `ServerUnavailable`."""
        return cls(find_settings())

    @classmethod
    def at(cls, url: str, token: str | None = None) -> Self:
        """A client of the service at a URL; without a token, that of `HALMA_TOKEN` or this `HALMA_HOME`."""
        return cls(find_settings(), url, token=token)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the connections."""
        self._wire.close()

    # The service

    def server(self) -> ServerOut:
        """The service: its version, its database, and where the record stands."""
        return self._wire.get("/api/v1/server", ServerOut)

    def workers(self) -> Iterator[WorkerOut]:
        """Attempts that run now, by pool and worker."""
        for page in self._wire.pages("/api/v1/workers", WorkerList, ROWS):
            yield from page.workers

    def cluster(self) -> ClusterOut:
        """Pools, workers, queue and shares, at one moment."""
        return self._wire.get("/api/v1/cluster", ClusterOut)

    # Studies

    def studies(self) -> Iterator[StudySummary]:
        """All studies, newest first."""
        for page in self._wire.pages("/api/v1/studies", StudyList, ROWS):
            yield from page.studies

    def study(self, study: str) -> StudyOut:
        """A study with its spec. Raises `UnknownStudy`."""
        return self._wire.get(_study(study), StudyOut)

    def submit(self, text: str, overrides: Sequence[str] = (), name: str = "study.yaml") -> StudyOut:
        """Submit the text of a study file, which errors call `name`.

        Raises:
            BadInput: the service refuses the study (its words), or the token.
            NameTaken: a study of that name exists.
            ServerUnavailable: nothing answers.
        """
        body = {"text": text, "overrides": list(overrides), "name": name}
        return self._wire.post("/api/v1/studies", StudyOut, body)

    def pause(self, study: str) -> StudyOut:
        """Let running trials come to their next checkpoint, then wait. Raises `UnknownStudy`, `WrongState`."""
        return self._wire.post(f"{_study(study)}/pause", StudyOut)

    def resume(self, study: str) -> StudyOut:
        """Go on with a study that was paused, cancelled or extended. Raises `UnknownStudy`, `WrongState`."""
        return self._wire.post(f"{_study(study)}/resume", StudyOut)

    def cancel(self, study: str) -> StudyOut:
        """Stop a study; what it found stays. Raises `UnknownStudy`, `WrongState`."""
        return self._wire.post(f"{_study(study)}/cancel", StudyOut)

    def extend(self, study: str, *, trials: int = 0, cost: float = 0.0, rounds: int = 0) -> StudyOut:
        """Give a study so many more trials, samples, or rounds of its polish. Raises `UnknownStudy`, `BadInput`."""
        more = {"trials": trials, "cost": cost, "rounds": rounds}
        return self._wire.post(f"{_study(study)}/extend", StudyOut, more)

    def amend(self, study: str, fields: Mapping[str, Any]) -> StudyOut:
        """Change how a study is run, by dotted name: `{"priority": 5, "resources.pool": "gpu"}`.

        Raises:
            UnknownStudy: there is none of that name.
            BadInput: a field that can't be changed, or not to that.
        """
        return self._wire.post(_study(study), StudyOut, {"fields": dict(fields)}, method="PATCH")

    # Trials

    def trials(self, study: str, *, states: Sequence[TrialState | str] = (), after: int = -1) -> Iterator[TrialOut]:
        """Trials by number, those with a number above `after`; in these states only, where any are given."""
        wanted = [str(TrialState(state)) for state in states]
        for page in self._wire.pages(f"{_study(study)}/trials", TrialPage, ROWS, after=after, state=wanted or None):
            yield from page.trials

    def trial(self, study: str, number: int) -> TrialDetail:
        """A trial with its attempts and files. Raises `UnknownStudy`, `UnknownTrial`."""
        return self._wire.get(_trial(study, number), TrialDetail)

    def table(self, study: str) -> TrialTable:
        """All trials as columns: `pandas.DataFrame(client.table(s).params)`, and so on."""
        return self._wire.get(f"{_study(study)}/table", TrialTable)

    def attempts(self, study: str, number: int) -> Iterator[AttemptOut]:
        """Attempts at a trial, by number."""
        for page in self._wire.pages(f"{_trial(study, number)}/attempts", AttemptPage, ROWS):
            yield from page.attempts

    def metrics(self, study: str, number: int, *, after: int = 0) -> Metrics:
        """The learning curve of a trial, beyond an iteration."""
        return self._wire.get(f"{_trial(study, number)}/metrics", Metrics, after=after)

    def curves(self, study: str, numbers: Sequence[int], metric: str | None = None) -> CurveList:
        """One metric of at most 20 trials, thinned to 1,000 points each."""
        joined = ",".join(str(number) for number in numbers)
        return self._wire.get(f"{_study(study)}/curves", CurveList, numbers=joined, metric=metric)

    # Files

    def artifacts(self, study: str, number: int) -> dict[str, ArtifactOut]:
        """What a trial left, by name."""
        left: dict[str, ArtifactOut] = {}
        for page in self._wire.pages(f"{_trial(study, number)}/artifacts", ArtifactPage, ROWS):
            left |= page.artifacts
        return left

    def study_artifacts(self, study: str) -> Iterator[LeftOut]:
        """What all trials of a study left, by trial and name."""
        for page in self._wire.pages(f"{_study(study)}/artifacts", LeftPage, ROWS):
            yield from page.artifacts

    def artifact(self, study: str, number: int, name: str) -> bytes:
        """One file that a trial left, which the service has checked against its hash.

        Raises:
            BadInput: it left none of that name.
            ArtifactDamaged: it is gone, or not what was kept.
        """
        return self._wire.read(f"{_trial(study, number)}/artifacts/{quote(name, safe='')}")

    # What was found

    def strategies(self, study: str) -> Iterator[StrategyOut]:
        """The distinct strategies, best first."""
        for page in self._wire.pages(f"{_study(study)}/strategies", StrategyList, ROWS):
            yield from page.strategies

    def proposals(self, study: str) -> Iterator[ProposalOut]:
        """What each proposal saw and gave, oldest first."""
        for page in self._wire.pages(f"{_study(study)}/proposals", ProposalPage, ROWS):
            yield from page.proposals

    def slice(
        self,
        study: str,
        *,
        x: str | None = None,
        y: str | None = None,
        at: Mapping[str, Any] | None = None,
        z: float = 1.0,
        size: int = 40,
        output: str | None = None,
    ) -> SliceOut:
        """A slice through the surrogate of a study's strategy; by default over the parameters that matter most."""
        values = None if at is None else json.dumps(dict(at))
        return self._wire.get(f"{_study(study)}/slice", SliceOut, x=x, y=y, at=values, z=z, size=size, output=output)

    def importance(self, study: str, of: str | None = None) -> ImportanceList:
        """Which parameters matter to the `value` or the `behaviour`; by default to what the search learns."""
        return self._wire.get(f"{_study(study)}/importance", ImportanceList, of=of)

    def levels(self, study: str) -> list[LevelOut]:
        """The difficulties of a study and what each cost, easiest first."""
        return self._wire.get(f"{_study(study)}/ladder", Ladder, limit=1).levels

    def ladder(self, study: str) -> Iterator[LadderPoint]:
        """Trials with their difficulties, by number; none where the study has no difficulty."""
        for page in self._wire.pages(f"{_study(study)}/ladder", Ladder, ROWS):
            yield from page.points

    def lineage(self, study: str) -> Iterator[EdgeOut]:
        """Whose policy each trial started from, by number of the child."""
        for page in self._wire.pages(f"{_study(study)}/lineage", Lineage, ROWS):
            yield from page.edges

    # What happened

    def events(self, study: str | None = None, *, after: int = 0) -> Iterator[EventOut]:
        """Events beyond a cursor, oldest first, up to now; of one study, or of all."""
        path = "/api/v1/events" if study is None else f"{_study(study)}/events"
        for page in self._wire.pages(path, EventPage, ROWS, after=after):
            yield from page.events

    def some_events(self, study: str | None = None, *, after: int = 0, limit: int = ROWS) -> list[EventOut]:
        """At most `limit` events beyond a cursor, in one request: for a program that asks again and again."""
        path = "/api/v1/events" if study is None else f"{_study(study)}/events"
        return self._wire.get(path, EventPage, after=after, limit=min(limit, ROWS)).events


def _study(name: str) -> str:
    # A dot alone would be taken for the folder itself.
    if not name or set(name) <= {"."}:
        raise BadInput(f"expected the name of a study, found {name!r}")
    return f"/api/v1/studies/{quote(name, safe='')}"


def _trial(study: str, number: int) -> str:
    return f"{_study(study)}/trials/{number}"
