"""The training that the chaos tests run: a walk whose every step depends on all steps before it.

It costs next to nothing, and does what a real training does: it reports each iteration, saves a checkpoint that holds
all it needs, stops where it is asked to, and leaves a policy. A step that was lost, repeated on a wrong state or taken
from another trial's checkpoint changes every number after it.

`HALMA_CHAOS_WORK` names a file to which each iteration is appended when it begins: what was really computed, whatever
the trial database says of it.
"""

from __future__ import annotations

import os
import time

import numpy as np

from workers.contracts import BadSetting, Checkpoint, Cost, FeatureSpec, Interrupted, Outcome, ParameterSpec, TaskInfo

SAMPLES = 10
"""Of each iteration."""

_SETTINGS = {"iterations": 4, "seconds": 0.0}


class Walk:
    """Settings: `iterations` of a training, and `seconds` that each takes."""

    def info(self, settings):
        return TaskInfo(
            "walk:Walk",
            "a walk, in iterations",
            parameters={"pull": ParameterSpec("float", 0.0, 1.0), "turn": ParameterSpec("angle")},
            features=FeatureSpec("euclidean", ("end",), 0.5, (-20.0,), (20.0,)),
            trains=False,
            settings={**_SETTINGS, **settings},
        )

    def validate(self, settings, training, names):
        for name in settings:
            if name not in _SETTINGS:
                raise BadSetting("task.settings", name, f"expected one of {', '.join(_SETTINGS)}")

    def run(self, job, context):
        settings = {**_SETTINGS, **job.task_settings}
        newest = context.load_checkpoint()
        rng = job.rng("walk")
        iteration, path, seconds = 0, np.zeros(8), 0.0
        if newest is not None:
            iteration, path = newest.iteration, newest.tensors["path"].copy()
            rng.bit_generator.state = newest.state["rng"]
            seconds = newest.state["seconds"]
        while iteration < settings["iterations"]:
            iteration += 1
            note_work(job, iteration)
            time.sleep(settings["seconds"])
            path = np.tanh(0.9 * path + job.params["pull"] * rng.normal(size=8) + np.cos(job.params["turn"]) / 8)
            seconds += settings["seconds"]
            cost = Cost(iteration * SAMPLES, seconds)
            context.report(iteration, {"end": float(path.sum())}, cost)
            state = {"rng": rng.bit_generator.state, "seconds": seconds}
            context.save_checkpoint(Checkpoint(iteration, {"path": path}, state))
            if context.stop_requested():
                raise Interrupted(f"stopped after iteration {iteration}")
        context.save_artifact("policy.bin", path.tobytes())
        context.log(f"walked {iteration} iterations")
        return Outcome("complete", float(path.sum()), (float(path[0]),), Cost(iteration * SAMPLES, seconds))


def note_work(job, iteration):
    """One short line for each iteration that begins; appended in one write, so that processes don't mix theirs."""
    place = os.environ.get("HALMA_CHAOS_WORK")
    if not place:
        return
    # Hosts of the chaos tests have process tables of their own, in which ids are the same.
    line = f"{job.study} {job.trial} {iteration} {os.getpid()}@{os.uname().nodename}\n"
    descriptor = os.open(place, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    try:
        os.write(descriptor, line.encode())
    finally:
        os.close(descriptor)
