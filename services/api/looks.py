"""Looks at what searches have learnt, for many viewers at once.

Fitting a surrogate takes up to seconds. All looks share one thread of their own, so that they can never use up the
threads that read the database for live events; what was worked out is kept as long as the history is the same.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

from services.api.tables import FinishedTrials
from services.states import TrialState
from services.store.port import Store, StudyRow

if TYPE_CHECKING:
    from search.insight.slices import Ask
    from services.insight import Looked

Found = TypeVar("Found")

SURROGATES = 8
"""Studies whose surrogates are kept."""
ANSWERS = 128
"""Answers that are kept; one takes up to 200 kB."""


class Looks:
    """Slices and importances of studies, kept while they hold.

    Args:
        store: the trial database.
        trials: finished trials by study.
    """

    def __init__(self, store: Store, trials: FinishedTrials) -> None:
        self._store = store
        self._trials = trials
        self._thread = ThreadPoolExecutor(1, "halma looks")
        self._looked: OrderedDict[Hashable, Looked] = OrderedDict()
        self._answers: OrderedDict[Hashable, Any] = OrderedDict()

    async def slice(self, study: str, ask: Ask) -> dict[str, Any]:
        """A slice with what is open on it. Raises `BadInput`, `UnknownStudy`."""
        return await self._run(lambda: self._slice(study, ask))

    async def importance(self, study: str, subject: str | None) -> dict[str, Any]:
        """Which parameters matter. Raises `BadInput`, `UnknownStudy`."""
        return await self._run(lambda: self._importance(study, subject))

    async def _run(self, work: Callable[[], Found]) -> Found:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _slice(self, study: str, ask: Ask) -> dict[str, Any]:
        # The searches bring scipy and more; a server that nobody asks need not load them.
        from services.insight import next_proposal, open_json, slice_json, with_defaults  # noqa: PLC0415

        row = self._store.study(study)
        pending = self._store.trials(row.id, states=[TrialState.QUEUED, TrialState.RUNNING])
        key, looked = self._look(row)
        ask = with_defaults(looked, ask)
        at = tuple(sorted((name, repr(value)) for name, value in ask.at.items()))
        found = self._kept(
            (key, "slice", ask.x, ask.y, ask.output, at, ask.z, ask.size), lambda: slice_json(looked, ask)
        )
        number = sum(row.counts.values())
        open_numbers = tuple(trial.number for trial in pending)
        proposal = self._kept((key, "next", number, open_numbers), lambda: next_proposal(looked, pending, number))
        return {**found, **open_json(looked, ask, pending, proposal)}

    def _importance(self, study: str, subject: str | None) -> dict[str, Any]:
        from services.insight import importance_json  # noqa: PLC0415 - as above

        key, looked = self._look(self._store.study(study))
        return self._kept((key, "importance", subject), lambda: importance_json(looked, subject))  # type: ignore[arg-type]  # the route has checked it

    def _look(self, row: StudyRow) -> tuple[Hashable, Looked]:
        from services.insight import look, looked_at  # noqa: PLC0415 - as above

        history = self._trials.history(row)
        key = (self._store.history_id(), row.id, looked_at(len(history)))
        if key not in self._looked:
            self._looked[key] = look(row, history)
        self._looked.move_to_end(key)
        while len(self._looked) > SURROGATES:
            self._looked.popitem(last=False)
        return key, self._looked[key]

    def _kept(self, key: Hashable, work: Callable[[], Found]) -> Found:
        """An answer, worked out where it isn't known."""
        if key not in self._answers:
            self._answers[key] = work()
        self._answers.move_to_end(key)
        while len(self._answers) > ANSWERS:
            self._answers.popitem(last=False)
        found: Found = self._answers[key]
        return found
