"""From the text of a study file to a study in the database, for people who submit over HTTP."""

from __future__ import annotations

from collections.abc import Sequence

from services.admission import admit
from services.api.service import Submit
from services.store.port import Store, StudyRow


def submit_to(store: Store) -> Submit:
    """A way to submit to this store."""

    def submit(text: str, overrides: Sequence[str], name: str) -> StudyRow:
        # Reading a study asks its task and its strategy, whose libraries take seconds to import.
        from services.spec_check import parse_study  # noqa: PLC0415

        return admit(store, parse_study(text, name=name, overrides=overrides))

    return submit
