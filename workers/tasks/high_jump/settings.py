"""Settings of the task, checked."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from workers.contracts import JSON, BadJob, BadSetting, Scalar
from workers.learning.settings import (
    Budget,
    NetworkSettings,
    PPOSettings,
    Rule,
    TrainingSettings,
    refuse_unknown,
    setting,
)
from workers.physics.athlete import Joint
from workers.physics.world import GRAVITY
from workers.poses.model import PoseModel
from workers.tasks.high_jump import takeoff
from workers.tasks.high_jump.behaviour import FeatureName
from workers.tasks.high_jump.rules import Landing
from workers.tasks.high_jump.takeoff import Formulation, TakeOff
from workers.tasks.high_jump.variations import Cast, Spine, varied_joints

SECTION = "task.settings"
Actions = Literal["offset", "pose"]

TRAINING = TrainingSettings(
    budget=Budget(samples=100_000),
    network=NetworkSettings(hidden=(256, 128)),
    ppo=PPOSettings(environments=4, samples=400),
)
"""Training settings where a study gives none. With four environments inference is cheap enough, and rebuilding too."""


@dataclass(frozen=True, slots=True)
class HighJumpSettings:
    """What a study may set of the high jump.

    Args:
        formulation: `support` begins in the middle of the last support, so that the stance leg must push off;
            `flight` as the foot leaves the ground.
        feature: which behaviour the search sees: `facing` (an angle) or `rotation` (a unit quaternion).
        forward_speed: speed of the run-up along the athlete's heading, m/s.
        rise: upward velocity of the root at the start, m/s; None: 1.2 for `support`, 3.5 for `flight`.
        time_to_bar: the bar stands where the athlete gets in so many seconds, which should be about the highest point.
        first_bar: where the curriculum begins, m.
        lowest_bar: a jump over a lower bar counts for nothing: it can be stepped over, and every style can, m.
        bar_step: one step of the curriculum, m.
        highest_bar: the highest that is tried; mastered, the training ends, m.
        z_freeze: mastered, the training ends already, m; None: at the highest bar. A search need not know how high a
            strategy can get, a polish finds out.
        control_rate: actions a second, a divisor of 120.
        mat_height: thickness of the mat, m.
        actions: `offset` from the push-off pose, or `pose`: a latent vector of a pose model, and an offset.
        gravity: m/s^2; 3.711 on Mars.
        landing: on which part the athlete may land, `any` or `feet`.
        take_off_leg: torque of the take-off leg's hip, knee and ankle over the usual one.
        spine: `free`, or `stiff`: it doesn't bend back.
        cast: which leg's knee is in a cast that keeps it all but straight: `none`, `take_off` or `swing`.
        poses: file of the pose model, of `halma poses train`; None: the model of the packaged clips.
    """

    formulation: Formulation = dataclasses.field(
        default="support", metadata={"rule": Rule("str", choices=("support", "flight"))}
    )
    feature: FeatureName = dataclasses.field(
        default="facing", metadata={"rule": Rule("str", choices=("facing", "rotation"))}
    )
    forward_speed: float = setting(3.5, Rule("float", 0.0, 10.0))
    rise: float | None = setting(None, Rule("float", -3.0, 6.0, optional=True))
    time_to_bar: float = setting(0.35, Rule("float", 0.1, 2.0))
    first_bar: float = setting(0.2, Rule("float", 0.1, 2.5))
    lowest_bar: float = setting(0.4, Rule("float", 0.0, 2.5))
    bar_step: float = setting(0.02, Rule("float", 0.001, 0.5))
    highest_bar: float = setting(2.5, Rule("float", 0.1, 2.9))
    z_freeze: float | None = setting(None, Rule("float", 0.1, 2.9, optional=True))
    control_rate: int = setting(10, Rule("int", 1, 120))
    mat_height: float = setting(0.3, Rule("float", 0.05, 1.0))
    actions: Actions = dataclasses.field(default="offset", metadata={"rule": Rule("str", choices=("offset", "pose"))})
    gravity: float = setting(GRAVITY, Rule("float", 0.5, 30.0))
    landing: Landing = dataclasses.field(default="any", metadata={"rule": Rule("str", choices=("any", "feet"))})
    take_off_leg: float = setting(1.0, Rule("float", 0.1, 2.0))
    spine: Spine = dataclasses.field(default="free", metadata={"rule": Rule("str", choices=("free", "stiff"))})
    cast: Cast = dataclasses.field(
        default="none", metadata={"rule": Rule("str", choices=("none", "take_off", "swing"))}
    )
    poses: str | None = setting(None, Rule("path", optional=True))

    @classmethod
    def parse(cls, settings: Mapping[str, JSON]) -> HighJumpSettings:
        """The settings over their defaults. Raises `BadSetting` naming the field, what was expected and found."""
        rules: dict[str, Rule] = {f.name: f.metadata["rule"] for f in dataclasses.fields(cls)}
        refuse_unknown(SECTION, "", settings, rules)
        values: dict[str, Any] = {key: rules[key].read(SECTION, key, value) for key, value in settings.items()}
        parsed = cls(**values)
        if 120 % parsed.control_rate:
            raise BadSetting(
                SECTION,
                "control_rate",
                f"expected a divisor of 120 (the frames of a second), found {parsed.control_rate}",
            )
        for name, least in (("first_bar", parsed.first_bar), ("lowest_bar", parsed.lowest_bar)):
            if parsed.highest_bar < least:
                raise BadSetting(
                    SECTION,
                    "highest_bar",
                    f"expected at least {name}, which is {least:g}, found {parsed.highest_bar:g}",
                )
        if parsed.z_freeze is not None and not parsed.first_bar <= parsed.z_freeze <= parsed.highest_bar:
            raise BadSetting(
                SECTION,
                "z_freeze",
                f"expected a bar from first_bar, {parsed.first_bar:g}, to highest_bar, {parsed.highest_bar:g}, "
                f"found {parsed.z_freeze:g}",
            )
        if parsed.poses is not None and parsed.actions != "pose":
            raise BadSetting(SECTION, "poses", "expected none with actions: offset, found one; write actions: pose")
        try:
            parsed.pose_model()
        except BadJob as error:
            raise BadSetting(SECTION, "poses", str(error)) from None
        return parsed

    def joints(self) -> tuple[Joint, ...]:
        """The athlete's joints under the variations asked for."""
        return varied_joints(self.take_off_leg, self.spine, self.cast)

    @property
    def last_bar(self) -> float:
        """Where the curriculum ends, m."""
        return self.highest_bar if self.z_freeze is None else self.z_freeze

    def pose_model(self) -> PoseModel | None:
        """The model to act through, or None. Raises `BadJob` where its file is none."""
        return pose_model(self.poses) if self.actions == "pose" else None

    def poses_used(self) -> dict[str, JSON]:
        """As details of an outcome: which model it was, since a file can change."""
        model = self.pose_model()
        return {} if model is None else {"poses_sha256": model.sha256()}

    def to_json(self) -> dict[str, JSON]:
        """All settings, defaults written out."""
        return dataclasses.asdict(self)

    def take_off(self, params: Mapping[str, Scalar]) -> TakeOff:
        """The take-off state of a candidate under these settings."""
        support = self.formulation == "support"
        default = 1.2 if support else 3.5
        return takeoff.take_off(
            params,
            forward=self.forward_speed,
            rise=default if self.rise is None else self.rise,
            time_to_bar=self.time_to_bar,
            formulation=self.formulation,
        )


@functools.cache
def pose_model(path: str | None) -> PoseModel:
    """The pose model in a file, or the default one; read once in a process. Raises `BadJob`."""
    from workers.poses.training import default_model  # noqa: PLC0415 - torch takes seconds to import

    return default_model() if path is None else PoseModel.read(Path(path).expanduser())


def check_parameters(names: Iterable[str]) -> None:
    """Refuse parameter names that are none of the take-off state's."""
    refuse_unknown("space", "", names, takeoff.PARAMETERS)
