"""Faults at exact points, in every process that starts with this folder on its PYTHONPATH: Ray's workers too.

Nothing of this is in the product. `HALMA_CHAOS_PLAN` names a file; while there is one, each process counts the points
that it passes and does what the file says at the n-th (with several `n`: each counted from the one before):

    {"point": "commit", "when": "before", "n": [7], "do": "kill"}

Points: `commit` (a database transaction is made durable), `rename` (a file with a checkpoint or a result appears under
its name). `before` and `after` are meant literally. `do`: `kill` ends the process with SIGKILL; `cut` raises what a
database client sees when its connection is gone, so that an `after` leaves a commit made that looks as if it was not;
`count` only writes a line for each point into the file named by `into`.

`HALMA_CHAOS_LEASES` divides the leases and beats of the product by its value, so that what takes 30 s takes 3.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import json
import os
import signal
import sys
from pathlib import Path

PLANNED = "HALMA_CHAOS_PLAN" in os.environ
FASTER = float(os.environ.get("HALMA_CHAOS_LEASES", "1"))


class _Counter:
    """Points passed since the plan was first seen."""

    def __init__(self):
        self.plan, self.stamp, self.passed = None, None, 0

    def reach(self, point, when):
        """Do what the plan says, if this is the point."""
        place = Path(os.environ["HALMA_CHAOS_PLAN"])
        try:
            stamp = place.stat().st_mtime_ns
        except OSError:
            return
        if stamp != self.stamp:
            try:
                self.plan = json.loads(place.read_text(encoding="utf-8"))
            except OSError:
                return  # another process has just carried it out
            self.stamp, self.passed = stamp, 0
        plan = self.plan
        if plan["do"] == "count":
            if when == "before":
                with Path(plan["into"]).open("a", encoding="utf-8") as file:
                    file.write(f"{point}\n")
            return
        if plan["point"] != point or plan["when"] != when:
            return
        if plan.get("workers_only") and "default_worker" not in " ".join(sys.orig_argv):
            return
        self.passed += 1
        if self.passed == plan["n"][0]:
            del plan["n"][0]
            self.passed = 0
            self.carry_out(plan, place)

    def carry_out(self, plan, place):
        if not plan["n"]:
            try:
                place.rename(f"{place}.done")  # once, whoever comes first
            except OSError:
                return
        with Path(f"{place}.faults").open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()} {plan['point']} {plan['when']} {plan['do']}\n")
        if plan["do"] == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        from sqlalchemy.exc import OperationalError

        raise OperationalError("COMMIT", None, Exception("the connection was cut"))


def _patch_sqlalchemy(module):
    commit = module.Connection.commit

    def watched(self):
        COUNTER.reach("commit", "before")
        commit(self)
        COUNTER.reach("commit", "after")

    module.Connection.commit = watched


def _patch_artifacts(module):
    replace = os.replace

    def watched(source, target, **where):
        ours = ".artifacts" in str(target)
        if ours:
            COUNTER.reach("rename", "before")
        replace(source, target, **where)
        if ours:
            COUNTER.reach("rename", "after")

    os.replace = watched


def _patch_times(module):
    for name in ("WORKER_LEASE_SECONDS", "START_LEASE_SECONDS", "BEAT_SECONDS", "LEASE_SECONDS"):
        if hasattr(module, name):
            setattr(module, name, getattr(module, name) / FASTER)


PATCHES = {}
if PLANNED:
    PATCHES |= {"sqlalchemy.engine.base": [_patch_sqlalchemy], "services.artifacts.folder": [_patch_artifacts]}
if FASTER != 1:
    for name in ("services.coordinator", "services.driver", "services.dispatch.runtime"):
        PATCHES.setdefault(name, []).append(_patch_times)
COUNTER = _Counter()


class _Patching(importlib.abc.MetaPathFinder):
    """Finds modules as everybody does, and patches those named once they are made."""

    def find_spec(self, name, path=None, target=None):
        if name not in PATCHES:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            for patch in PATCHES[name]:
                patch(module)

        spec.loader.exec_module = exec_module
        return spec


if PATCHES:
    sys.meta_path.insert(0, _Patching())
