"""Whether the files that the trial database names are there, and are what was recorded: what `halma verify` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from services.artifacts.port import ArtifactStore
from services.errors import ArtifactDamaged, BadInput
from services.store.port import ArtifactRow, Store, StudyRow


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A file that is missing or altered.

    Args:
        study: its name.
        trial: number of the trial within it.
        artifact: what was recorded.
        found: what is wrong, for people.
    """

    study: str
    trial: int
    artifact: ArtifactRow
    found: str


@dataclass
class Verified:
    """What came of it: files and bytes that are as recorded, and those that are not."""

    files: int = 0
    size: int = 0
    mismatches: list[Mismatch] = field(default_factory=list)


def verify(
    store: Store,
    artifacts: ArtifactStore,
    rows: Sequence[StudyRow],
    tell: Callable[[Mismatch], None] = lambda _: None,
) -> Verified:
    """Read every file that these studies' trials name, and compare it with its recorded hash.

    Args:
        store: the trial database.
        artifacts: its files.
        rows: the studies.
        tell: called with each mismatch as it is found.

    Raises:
        StorageUnavailable: storage fails, which says nothing of the files.
    """
    verified = Verified()
    for row in rows:
        number_of = {trial.id: trial.number for trial in store.trials(row.id)}
        for artifact in store.study_artifacts(row.id):
            try:
                size = len(artifacts.read(artifact))
            except (ArtifactDamaged, BadInput) as error:
                mismatch = Mismatch(row.name, number_of.get(artifact.trial_id, -1), artifact, str(error))
                verified.mismatches.append(mismatch)
                tell(mismatch)
            else:
                verified.files += 1
                verified.size += size
    return verified
