"""Tasks for the command line's tests: plain functions, told by name in study files as `sample_hills:...`."""

from __future__ import annotations

import io
import math
import time

from PIL import Image

from workers.contracts import Cost, FeatureSpec, Outcome, TaskInfo


def hill(params):
    """Height on a hill, and where one stands."""
    return 1 - (params["x"] - 0.3) ** 2, [params["x"]]


def bare_hill(params):
    """Height on a hill, without behaviour."""
    return 1 - (params["x"] - 0.3) ** 2


def peak(params, z):
    """Highest at a rate of 1e-3; easier versions are lower and cheaper."""
    return z * (9 - (math.log10(params["rate"]) + 3) ** 2), None, int(1000 * z)


def cliff(params):
    """Always raises."""
    message = "no way up"
    raise RuntimeError(message)


def fog(params):
    """Always NaN."""
    return float("nan"), [params["x"]]


FRAMES = 3


class Recorded:
    """A replay of the Painter."""

    seconds = 1.5

    def __init__(self, policy):
        self.policy = policy

    def to_bytes(self):
        return self.policy * FRAMES


class Painter:
    """A task that leaves what a learning task leaves: a policy, its replay, and a picture."""

    def info(self, settings):
        features = FeatureSpec("euclidean", ("place",), distinct=0.2, low=(0.0,), high=(1.0,))
        return TaskInfo("sample_hills:Painter", "paints", features=features, settings=dict(settings))

    def validate(self, settings, training, names):
        pass

    def run(self, job, context):
        policy = f"{job.params['x']:.3f}".encode()
        context.save_artifact("policy.safetensors", policy)
        context.save_artifact("replay.bin", Recorded(policy).to_bytes())
        picture = io.BytesIO()
        Image.new("RGB", (64, 48), (200, 30 * job.trial, 0)).save(picture, "PNG")
        context.save_artifact("pose.png", picture.getvalue())
        height = 1 - (job.params["x"] - 0.3) ** 2
        return Outcome(
            "complete",
            height,
            (job.params["x"],),
            Cost(100, 0.1),
            details=self.words(job) | {"height": height, "calm": True},
        )

    def words(self, job):
        return {}

    def simulate(self, job, policy):
        return Recorded(policy)


class NamingPainter(Painter):
    """A Painter that says in words where it stood."""

    def words(self, job):
        return {"name": "left of the top" if job.params["x"] < 0.3 else "right of the top"}


class Judge(NamingPainter):
    """A Painter whose policies are judged: none may stand beyond 0.9."""

    def audit(self, job, policy, rollouts):
        return Judged(float(policy), rollouts)


class Judged:
    """What the Judge says."""

    def __init__(self, place, rollouts):
        self.place, self.rollouts = place, rollouts

    @property
    def passed(self):
        return self.place <= 0.9

    def to_json(self):
        checks = {
            "place": {"found": self.place, "bound": 0.9, "unit": "m", "passed": self.passed},
            "tries": {"found": self.rollouts, "bound": None, "unit": "tries", "passed": True},
        }
        return {"passed": self.passed, "checks": checks}


class Liar(Painter):
    """A Painter whose own audit refuses it on the left half, and who reports a value all the same."""

    def words(self, job):
        return {"audit": {"passed": job.params["x"] >= 0.5, "checks": {}}}


def trek(params):
    """Takes 0.2 s."""
    time.sleep(0.2)
    return hill(params)


def shape(params, avoid=None):
    """Left or right of 0.5 are two strategies; whoever is told what is known finds what lies beyond it."""
    beyond = None if avoid is None else 2.0 + float(max(avoid)[0])
    return params["x"], [float(params["x"] > 0.5) if beyond is None else beyond]
