"""Files that nothing needs any more, found and removed: what `halma gc` does.

A file is removed only where the trial database says that nothing can need it, and never by its age alone:

- its trial has ended (ended trials never begin again), and no row names the file; checkpoints of ended trials among
  them, unless the study keeps them;
- or its study was deleted, and the journal says so.

Whatever belongs to a trial that has not ended stays: a living attempt may be writing it, the next one may start from
it. The files are listed before the rows are read, so that a file is never older news than what is known of its trial.
On top of it nothing young is removed. What halma has not named itself is never touched.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum

from services.artifacts.names import Belonging, FileKind, belonging, study_key
from services.artifacts.port import ArtifactStore, StoredFile
from services.artifacts.root import confirm
from services.spec import StudySpec
from services.states import OPEN_TRIAL
from services.store.port import Store, StudyRow

LEAST_AGE = 3600.0
"""Seconds. Files younger than that stay: whoever looks into what has just happened finds them."""


class Fate(StrEnum):
    """Why a file goes, or stays."""

    CHECKPOINT = "checkpoints of trials that have ended"
    UNNAMED = "files that no trial names"
    DELETED = "files of studies that were deleted"
    NAMED = "that trials name"
    OPEN = "of trials that have not ended"
    KEPT = "checkpoints that their study keeps"
    YOUNG = "too young"
    FOREIGN = "that halma has not made"

    @property
    def goes(self) -> bool:
        """Whether the file is removed."""
        return self in {Fate.CHECKPOINT, Fate.UNNAMED, Fate.DELETED}


@dataclass
class Collected:
    """What came of it, by fate: files and bytes."""

    files: Counter[Fate] = field(default_factory=Counter)
    sizes: Counter[Fate] = field(default_factory=Counter)

    def count(self, fate: Fate, size: int) -> None:
        """Count a file."""
        self.files[fate] += 1
        self.sizes[fate] += size

    @property
    def removed(self) -> tuple[int, int]:
        """Files and bytes that went."""
        goes = [fate for fate in Fate if fate.goes]
        return sum(self.files[fate] for fate in goes), sum(self.sizes[fate] for fate in goes)


def collect(
    store: Store,
    artifacts: ArtifactStore,
    *,
    least_age: float = LEAST_AGE,
    dry_run: bool = False,
    clock: Callable[[], float] = time.time,
) -> Collected:
    """Remove the files that nothing needs any more.

    Args:
        store: the trial database.
        artifacts: its files.
        least_age: seconds; what was written later than that, or in the future by this machine's clock, stays.
        dry_run: look only.
        clock: seconds since 1970.

    Returns:
        What was removed (or would be) and what stayed.

    Raises:
        ArtifactsMoved, BadInput: the files are not those of this database.
        StorageUnavailable: storage fails; what was removed until then is gone, the rest stays.
    """
    confirm(store, artifacts)
    now, found = clock(), list(artifacts.files())
    judge = _Judge(store, {row.id: row for row in store.studies()})
    collected = Collected()
    for file in found:
        fate = judge.fate(file)
        if fate.goes and (file.modified is None or not now - least_age - file.modified >= 0):
            fate = Fate.YOUNG
        if fate.goes and not dry_run:
            artifacts.remove(file.path)
        collected.count(fate, file.size)
    return collected


@dataclass
class _Judge:
    """Tells the fate of files, reading each study once."""

    store: Store
    studies: dict[int, StudyRow]
    _open: dict[int, set[int]] = field(default_factory=dict)
    _ended: dict[int, set[int]] = field(default_factory=dict)
    _named: dict[int, set[str]] = field(default_factory=dict)
    _gone: dict[int, set[str]] = field(default_factory=dict)

    def fate(self, file: StoredFile) -> Fate:
        """What becomes of a file."""
        of = belonging(file.path)
        if of is None:
            return Fate.FOREIGN
        row = self.studies.get(of.study)
        if row is None:
            return Fate.DELETED if of.key in self._keys_of_deleted(of.study) else Fate.FOREIGN
        return self._of_a_study(row, of, file.path) if study_key(row.id, row.name) == of.key else Fate.FOREIGN

    def _of_a_study(self, row: StudyRow, of: Belonging, path: str) -> Fate:
        self._read(row)
        if path in self._named[row.id]:
            return Fate.NAMED
        if of.trial in self._open[row.id]:
            return Fate.OPEN
        if of.trial not in self._ended[row.id]:
            return Fate.FOREIGN  # no trial of ours was ever called so
        if of.kind is not FileKind.CHECKPOINT:
            return Fate.UNNAMED
        return Fate.KEPT if StudySpec.from_json(row.spec).keep_checkpoints else Fate.CHECKPOINT

    def _read(self, row: StudyRow) -> None:
        if row.id in self._named:
            return
        trials = self.store.trials(row.id)
        self._open[row.id] = {trial.number for trial in trials if trial.state in OPEN_TRIAL}
        self._ended[row.id] = {trial.number for trial in trials if trial.state not in OPEN_TRIAL}
        # After the states: a trial that has ended has its artifacts on record, in the same commit.
        self._named[row.id] = {artifact.path for artifact in self.store.study_artifacts(row.id)}

    def _keys_of_deleted(self, study: int) -> Iterable[str]:
        """Folders that a deleted study of this id had; none where the journal knows of no such study."""
        if study not in self._gone:
            self._gone[study] = {
                study_key(study, str(event.payload.get("study")))
                for event in self.store.events(study_id=study)
                if event.kind == "deleted"
            }
        return self._gone[study]
