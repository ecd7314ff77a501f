"""How the files of trials are named below the artifact root, and what a name tells.

<study id>-<study name>/<trial>/policy-<hash>.safetensors     an artifact
<study id>-<study name>/<trial>/checkpoints/<iteration>-<hash>.checkpoint
... .torn                                                     set aside because content and hash differ
.../.writing-<random>                                         unfinished; its writer is at it, or died over it

.halma-artifacts                                              the root's mark, so that it is known again
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePosixPath

from services.errors import BadInput

MARKER = ".halma-artifacts"
"""Holds the identity of a root: the same files under another path, or on another host, have the same."""

TEMPORARY = ".writing-"
TORN = ".torn"

_NAME_DIGITS = 16
"""Hex digits of the hash in an artifact's name: enough to keep writers apart; the row holds all 64."""

CHECKPOINT = re.compile(r"(?P<iteration>\d{8,})-(?P<sha256>[0-9a-f]{64})\.checkpoint")
_ARTIFACT = re.compile(rf"[^.]*-[0-9a-f]{{{_NAME_DIGITS}}}(\..*)?", re.DOTALL)
_OURS = re.compile(
    r"(?P<key>(?P<study>\d+)-[A-Za-z0-9._-]+)/(?P<trial>\d{6,})/(?P<folder>checkpoints/)?(?P<name>[^/]+)", re.DOTALL
)


class FileKind(StrEnum):
    """What a file below the artifact root is."""

    ARTIFACT = "artifact"
    CHECKPOINT = "checkpoint"
    TORN = "torn"
    UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Belonging:
    """Whose a file is, as its path says.

    Args:
        key: folder of the study.
        study: id of the study.
        trial: number of the trial within it.
        kind: what the file is.
    """

    key: str
    study: int
    trial: int
    kind: FileKind


def belonging(path: str) -> Belonging | None:
    """Whose a file is; None for one that no halma has named so."""
    found = _OURS.fullmatch(path)
    if found is None:
        return None
    name, kind = found["name"], None
    if name.startswith(TEMPORARY):
        kind = FileKind.UNFINISHED
    elif found["folder"]:
        if CHECKPOINT.fullmatch(name):
            kind = FileKind.CHECKPOINT
        elif CHECKPOINT.fullmatch(name.removesuffix(TORN)):
            kind = FileKind.TORN
    elif _ARTIFACT.fullmatch(name):
        kind = FileKind.ARTIFACT
    return None if kind is None else Belonging(found["key"], int(found["study"]), int(found["trial"]), kind)


def study_key(study_id: int, name: str) -> str:
    """The folder of a study: its id, which no other study ever has, and its name for people."""
    return f"{study_id}-{re.sub(r'[^A-Za-z0-9._-]+', '_', name)}"


def checked(path: str, *, unfinished: bool = False) -> PurePosixPath:
    """A relative path that stays where it is put.

    Args:
        path: names joined by slashes.
        unfinished: whether the last name may be one of an unfinished file.

    Raises:
        BadInput: it may lead elsewhere.
    """
    parts = path.split("/")
    last = len(parts) - 1
    hidden = any(part.startswith(TEMPORARY) and not (unfinished and i == last) for i, part in enumerate(parts))
    if hidden or any(part in {"", ".", ".."} for part in parts) or re.search(r"[\\\0:]", path):
        raise BadInput(
            f"artifact path {path!r}: expected names joined by single slashes, without '..', '\\' or ':' and not "
            "absolute, so that it can't leave its folder"
        )
    return PurePosixPath(path)


def single(what: str, name: str) -> str:
    """A name that is no path. Raises `BadInput`."""
    if len(checked(name).parts) != 1:
        raise BadInput(f"{what} {name!r}: expected a single name, found a path; leave the folders out")
    return name


def trial_folder(study_key: str, trial: int) -> PurePosixPath:
    """Where the artifacts of a trial are."""
    return PurePosixPath(single("study key", study_key)) / f"{trial:06d}"


def checkpoints_folder(study_key: str, trial: int) -> PurePosixPath:
    """Where the checkpoints of a trial are."""
    return trial_folder(study_key, trial) / "checkpoints"


def hashed(name: str, digest: str) -> str:
    """`policy.safetensors` -> `policy-0123456789abcdef.safetensors`."""
    stem, dot, suffix = name.partition(".")
    return f"{stem}-{digest[:_NAME_DIGITS]}{dot}{suffix}"


def checkpoint_name(iteration: int, digest: str) -> str:
    """The name of a checkpoint."""
    return f"{iteration:08d}-{digest}.checkpoint"
