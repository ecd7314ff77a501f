"""Whether everything halma needs is there: one check a thing, with what was found and what to do."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import uuid
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import make_url

from services.artifacts.open import open_artifacts
from services.errors import ArtifactDamaged, BadInput
from services.settings import Settings
from services.store.engine import shown
from services.store.open import open_store

PACKAGES = ("torch", "pybullet", "ray", "botorch", "optuna", "gymnasium", "sqlalchemy", "pydantic", "fastapi")
LEAST_MEMORY = 4 * 2**30
"""Bytes. Ray and two workers with physics and torch were seen to need about 3 GiB."""
LEAST_DISK = 2 * 2**30


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at.

    Args:
        name: of the thing.
        good: whether it is as it should be.
        found: what was found.
        remedy: what to do where it is not good.
    """

    name: str
    good: bool
    found: str
    remedy: str = ""


def examine(settings: Settings) -> list[Check]:
    """All checks, in the order in which things build on each other."""
    looks: tuple[Callable[[Settings], Check], ...] = (
        _python,
        _packages,
        _cores,
        _memory,
        _disk,
        _database,
        _artifacts,
        _ray,
        _browser,
    )
    return [look(settings) for look in looks]


def _python(_settings: Settings) -> Check:
    good = sys.version_info[:2] == (3, 11)
    return Check("python", good, platform.python_version(), "use Python 3.11: python3.11 -m venv .venv")


def _packages(_settings: Settings) -> Check:
    found, missing = [], []
    for name in PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    words = ", ".join(found) + (f"; missing: {', '.join(missing)}" if missing else "")
    return Check("packages", not missing, words, "make setup")


def _cores(_settings: Settings) -> Check:
    usable = len(os.sched_getaffinity(0))
    return Check("cores", usable >= 1, f"{usable} usable")


def _memory(_settings: Settings) -> Check:
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return Check(
        "memory",
        total >= LEAST_MEMORY,
        f"{total / 2**30:.1f} GiB",
        f"at least {LEAST_MEMORY // 2**30} GiB; with less, run one trial at a time: --set resources.parallel=1",
    )


def _disk(settings: Settings) -> Check:
    place = settings.home
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    return Check(
        "disk", free >= LEAST_DISK, f"{free / 2**30:.1f} GiB free at {place}", "free some space, or set HALMA_HOME"
    )


def _database(settings: Settings) -> Check:
    try:
        store = open_store(settings.database)
    except BadInput as error:
        return Check("database", False, str(error), "give another one with --db or HALMA_DB")
    try:
        return Check("database", True, f"{shown(make_url(store.url))}, {len(store.studies())} studies")
    finally:
        store.close()


def _artifacts(settings: Settings) -> Check:
    """Writes, reads and removes a small file, because permissions alone tell half the truth."""
    data = uuid.uuid4().bytes
    try:
        artifacts = open_artifacts(settings.artifacts)
        written = artifacts.put("doctor", 0, "check.bin", data)
        good = artifacts.read(written) == data
        artifacts.remove(written.path)
    except (OSError, ImportError, ValueError, BadInput, ArtifactDamaged) as error:
        return Check("artifacts", False, f"{settings.artifacts}: {error}", "make it writable, or set HALMA_ARTIFACTS")
    return Check(
        "artifacts", good, f"{settings.artifacts}, writable", "check the disk: what was written reads differently"
    )


def _ray(_settings: Settings) -> Check:
    try:
        version = importlib.import_module("ray").__version__
    except ImportError as error:
        return Check("ray", False, f"can't be imported: {error}", "make setup; until then: halma run FILE --inline")
    return Check("ray", True, f"{version} can be imported")


def _browser(_settings: Settings) -> Check:
    """Asks the pages' own check in a process of its own: the services don't import the dashboards."""
    if importlib.util.find_spec("dashboards") is None:
        return Check("browser", False, "the package dashboards is not installed", "make setup")
    asked = subprocess.run(
        [sys.executable, "-m", "dashboards.vendor", "--check"], capture_output=True, text=True, timeout=60, check=False
    )
    lines = asked.stderr.strip().splitlines()
    found = lines[-1] if lines else "no answer"
    remedy = "python -m dashboards.vendor (needs the npm registry once); only the pages need it"
    return Check("browser", asked.returncode == 0, f"libraries {found}", remedy)
