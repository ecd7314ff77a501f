"""People's own task modules on their way to workers of other machines: found, packed, unpacked.

What travels is what the task's module consists of and imports from the folder that halma was started in: single
files, and packages with all that is in them. It comes from the person who starts the driver and goes to workers that
run as that person's; installed packages (halma itself among them) are expected to be installed on every host.
"""

from __future__ import annotations

import ast
import hashlib
import io
import os
import shutil
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path

from services.errors import BadInput

LARGEST_BYTES = 64 * 2**20
"""What is larger is no code: put it on storage that all hosts share, or into an installed package."""

_LEFT_OUT = {"__pycache__", "node_modules", ".git", ".venv"}
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Bundle:
    """Files of a task, packed.

    Args:
        sha256: of `data`; equal files give equal bundles.
        data: a ZIP archive.
    """

    sha256: str
    data: bytes


def collect(directory: Path, task: str) -> Bundle | None:
    """Pack what a task needs from a folder.

    Args:
        directory: where the driver was started.
        task: as the study file names it.

    Returns:
        None where the task comes from an installed package.

    Raises:
        BadInput: it is too large to travel.
    """
    module, colon, _ = task.partition(":")
    if not colon or module == "gymnasium":
        return None
    files = _closure(directory, module.partition(".")[0])
    if not files:
        return None
    size = sum(file.stat().st_size for file in files)
    if size > LARGEST_BYTES:
        raise BadInput(
            f"task {task!r}: expected code of at most {LARGEST_BYTES >> 20} MiB to send to workers, found "
            f"{size / 2**20:.0f} MiB in {len(files)} files below {directory}; move data out of the package"
        )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files):
            # Without the files' own times, so that equal code has an equal hash.
            archive.writestr(zipfile.ZipInfo(file.relative_to(directory).as_posix(), _EPOCH), file.read_bytes())
    data = packed.getvalue()
    return Bundle(hashlib.sha256(data).hexdigest(), data)


def _closure(directory: Path, first: str) -> set[Path]:
    """Files of a module of this folder, and of all modules of this folder that it imports, directly or not."""
    found: set[Path] = set()
    known, waiting = {first}, [first]
    while waiting:
        files = _files_of(directory, waiting.pop())
        found |= files
        for file in files:
            if file.suffix == ".py":
                more = _imported(file) - known
                known |= more
                waiting += more
    return found


def _files_of(directory: Path, module: str) -> set[Path]:
    single, package = directory / f"{module}.py", directory / module
    if package.is_dir():
        return {file for file in package.rglob("*") if file.is_file() and not _LEFT_OUT.intersection(file.parts)}
    return {single} if single.is_file() else set()


def _imported(file: Path) -> set[str]:
    """First names of the modules that a file imports by name."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return set()  # whoever imports it is told
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names.add(node.module.partition(".")[0])
    return names


def unpack(bundle: Bundle) -> Path:
    """Put a bundle's files into a folder of this user, once for each bundle. Returns the folder.

    Raises:
        ValueError: it is not what its hash says, or holds a path that leaves its folder.
    """
    found = hashlib.sha256(bundle.data).hexdigest()
    if found != bundle.sha256:
        raise ValueError(f"code bundle: expected SHA-256 {bundle.sha256}, found {found}")
    home = Path(tempfile.gettempdir()) / f"halma-code-{os.getuid()}"
    home.mkdir(mode=0o700, exist_ok=True)
    if home.stat().st_uid != os.getuid() or home.is_symlink():
        raise ValueError(f"code folder {home}: expected one of our own, found another user's; remove it")
    folder = home / bundle.sha256
    if folder.is_dir():
        return folder
    fresh = home / f".{uuid.uuid4().hex}"
    with zipfile.ZipFile(io.BytesIO(bundle.data)) as archive:
        for name in archive.namelist():
            if not (fresh / name).resolve().is_relative_to(fresh.resolve()):
                raise ValueError(f"code bundle: expected paths below its folder, found {name!r}")
        archive.extractall(fresh)
    try:
        fresh.rename(folder)
    except OSError:  # another worker was faster
        shutil.rmtree(fresh)
    return folder
