"""A record of trials for tests of what reads it: made through the port, by real transitions."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field

from PIL import Image, ImageDraw

from services.states import StudyState, TrialState
from services.store.port import Driver, NewTrial, Result

CIRCLE = {"kind": "circle", "names": ["facing"], "distinct": 0.5, "low": [], "high": [], "unit": "rad"}


def spec(name, behaviour=CIRCLE, trials=24, stages=None):
    """A frozen spec as the service keeps it."""
    space = {"omega_x": {"type": "float", "low": -3.0, "high": 3.0, "log": False}, "alpha": {"type": "angle"}}
    return {
        "name": name,
        "task": {"name": "high_jump", "settings": {}},
        "space": space,
        "search": {"strategy": "bds", "settings": {}, "trials": trials, "cost": None},
        "stages": stages or {},
        "training": {"budget": 50000},
        "resources": {"parallel": 2, "cpus": 1.0, "pool": "default"},
        "seed": 7,
        "priority": 0,
        "retries": {"limit": 2, "backoff_seconds": 1.0},
        "stop_after_failures": 5,
        "behaviour": behaviour,
        "units": {"omega_x": "rad/s", "alpha": "rad"},
        "has_difficulty": True,
        "trains": True,
    }


def picture(number):
    """A PNG that stands for a pose."""
    image = Image.new("RGB", (320, 240), (214, 220, 226))
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 150, 320, 156), fill=(120, 60, 40))
    angle = number * 0.7
    centre = (160, 110)
    for turn, length in ((0.0, 60), (2.3, 50), (3.6, 55)):
        end = (centre[0] + length * math.cos(angle + turn), centre[1] + length * math.sin(angle + turn))
        draw.line((centre, end), fill=(30, 90, 140), width=12)
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


@dataclass
class Record:
    """A study that a test drives by hand.

    Args:
        store: the trial database.
        artifacts: where files go.
        name: of the study.
    """

    store: object
    artifacts: object
    name: str
    behaviour: dict | None = field(default_factory=lambda: CIRCLE)
    target: int = 24
    stages: dict | None = None

    def begin(self):
        with self.store.transaction() as change:
            row = change.create_study(
                self.name,
                spec(self.name, self.behaviour, self.target, self.stages),
                seed=7,
                target_trials=self.target,
            )
            self.id = row.id
            self.token = change.drive(self.name, Driver("driver-1", "runner", 4711, "1"))
        return self

    def propose(self, count=1, z=1.0, stage="search", **info):
        given = info or {"mode": "explore", "deviation": 0.41}
        with self.store.transaction() as change:
            first = len(self.store.trials(self.id))
            trials = [
                NewTrial(
                    {
                        "omega_x": round(3 * math.sin(1.7 * (first + i)), 6),
                        "alpha": round(math.cos(2.3 * (first + i)), 6),
                    },
                    seed=2**63 + first + i,
                    z=z,
                    stage=stage,
                    info=given,
                )
                for i in range(count)
            ]
            return change.propose(
                self.id,
                self.token,
                strategy="bds",
                history=0,
                pending=(),
                rng_key=(7, first),
                seconds=0.2,
                trials=trials,
            )

    def start(self, trial, worker="default-0"):
        with self.store.transaction() as change:
            return change.start(trial.id, self.token, worker=worker, host="runner", pid=99)

    def report(self, attempt, iteration, **metrics):
        with self.store.transaction() as change:
            change.report(
                attempt.id,
                attempt.token,
                iteration=iteration,
                metrics=metrics,
                samples=700 * iteration,
                seconds=1.5 * iteration,
            )

    def finish(
        self, attempt, trial, *, state=TrialState.COMPLETE, value=None, features=None, files=(), message="", **details
    ):
        left = [self.artifacts.put(f"{self.id}-{self.name}", trial.number, name, data) for name, data in files]
        with self.store.transaction() as change:
            return change.finish(
                attempt.id,
                attempt.token,
                Result(
                    state, value, features, samples=7000, seconds=31.5, message=message, details=details, artifacts=left
                ),
            )

    def one(self, *, iterations=6, state=TrialState.COMPLETE, value=None, features=None, files=None, message="", z=1.0):
        """A whole trial."""
        (trial,) = self.propose(z=z)
        attempt = self.start(trial)
        for i in range(1, iterations + 1):
            self.report(
                attempt,
                i,
                **{
                    "return": 1 - math.exp(-i / 9),
                    "bar": 0.5 + 0.02 * i,
                    "success": 0.5,
                    "kl": 0.01 / i,
                    "samples_per_second": 450.0 + i,
                },
            )
        good = state is TrialState.COMPLETE
        number = trial.number
        return self.finish(
            attempt,
            trial,
            state=state,
            value=(0.6 + 0.35 * math.sin(0.9 * number) ** 2 if value is None else value) if good else None,
            features=((2.1 * number + math.pi) % (2 * math.pi) - math.pi,) if good and features is None else features,
            files=[("pose.png", picture(number)), ("policy.safetensors", b"\x08weights")]
            if files is None and good
            else files or (),
            message=message,
            bar=0.6 + 0.01 * number,
            audit={"ballistic": True, "push": 4.2},
        )

    def end(self, state=StudyState.COMPLETE, reason=""):
        with self.store.transaction() as change:
            change.release_drive(self.id, self.token, state, reason)
