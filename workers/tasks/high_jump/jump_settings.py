"""What a study may set of any jump, checked; the high jump and the obstacle jump add what is their own."""

from __future__ import annotations

import dataclasses
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from workers.contracts import JSON, BadJob, BadSetting, ParameterSpec, Scalar
from workers.learning.problem import RewardCurriculum, SuccessCurriculum
from workers.learning.settings import Rule, refuse_unknown, setting
from workers.physics.athlete import Joint
from workers.physics.clips import BadClip
from workers.physics.world import GRAVITY
from workers.poses.model import PoseModel
from workers.tasks.high_jump import rules
from workers.tasks.high_jump.approach import captured_run
from workers.tasks.high_jump.behaviour import FeatureName
from workers.tasks.high_jump.rules import Landing
from workers.tasks.high_jump.takeoff import Formulation, TakeOff
from workers.tasks.high_jump.variations import Cast, Spine, varied_joints

SECTION = "task.settings"
_FORMULATION = Rule("str", choices=("support", "flight"))
_FEATURE = Rule("str", choices=("facing", "rotation"))
_CURRICULUM = Rule("str", choices=("success", "reward"))
_CAST = Rule("str", choices=("none", "take_off", "swing"))
Actions = Literal["offset", "pose"]
CurriculumName = Literal["success", "reward"]


@dataclass(frozen=True, slots=True)
class Levels:
    """The levels of a jump (bars, or widths), m.

    Args:
        first: where the curriculum begins.
        lowest: a jump over less counts for nothing.
        step: of the curriculum.
        last: mastered, the training ends.
        highest: the highest that is tried.
    """

    first: float
    lowest: float
    step: float
    last: float
    highest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpSettings(ABC):
    """What a study may set of any jump.

    Args:
        formulation: `support` begins in the middle of the last support, so that the stance leg must push off;
            `flight` as the foot leaves the ground.
        feature: which behaviour the search sees: `facing` (an angle) or `rotation` (a unit quaternion).
        forward_speed: speed of the run-up along the athlete's heading, m/s.
        rise: upward velocity of the root at the start, m/s; None: 1.2 for `support`, 3.5 for `flight`.
        z_freeze: mastered, the training ends already, m; None: at the highest level. A search need not know how high a
            strategy can get, a polish finds out.
        control_rate: actions a second, a divisor of 120.
        control_rate_hard: the same at the hardest levels, up to which it rises; None: always `control_rate`.
        offset_easy, offset_hard: mean offset (c_offset of equation 4, L1 norm, rad) at which a jump is not natural at
            all, at the easiest and at the hardest levels.
        curriculum: what raises the level: how often the jumps of an iteration succeed (`success`), or mean rewards that
            add up to `reward_threshold` (`reward`, as published).
        reward_threshold: for that.
        mat_height: thickness of the mat, m.
        actions: `offset` from the push-off pose, or `pose`: a latent vector of a pose model, and an offset.
        gravity: m/s^2; 3.711 on Mars.
        landing: on which part the athlete may land, `any` or `feet`.
        take_off_leg: torque of the take-off leg's hip, knee and ankle over the usual one.
        spine: `free`, or `stiff`: it doesn't bend back.
        cast: which leg's knee is in a cast that keeps it all but straight: `none`, `take_off` or `swing`.
        run_up: whether the athlete runs up to the take-off state, and jumps from where that arrives; `support` only.
        run_up_clip: file of a captured run that ends in a jump from the right foot, which the run-up follows; None: the
            packaged run.
        poses: file of the pose model, of `halma poses train`; None: the model of the packaged clips.
    """

    task: ClassVar[str]
    parameters: ClassVar[Mapping[str, ParameterSpec]]
    formulation: Formulation = dataclasses.field(
        default="support", metadata={"rule": Rule("str", choices=("support", "flight"))}
    )
    feature: FeatureName = dataclasses.field(
        default="facing", metadata={"rule": Rule("str", choices=("facing", "rotation"))}
    )
    forward_speed: float = setting(3.5, Rule("float", 0.0, 10.0))
    rise: float | None = setting(None, Rule("float", -3.0, 6.0, optional=True))
    z_freeze: float | None = setting(None, Rule("float", 0.01, 10.0, optional=True))
    control_rate: int = setting(10, Rule("int", 1, 120))
    control_rate_hard: int | None = setting(None, Rule("int", 1, 120, optional=True))
    offset_easy: float = setting(rules.OFFSET_EASY, Rule("float", 0.1, 1000.0))
    offset_hard: float = setting(rules.OFFSET_HARD, Rule("float", 0.1, 1000.0))
    curriculum: CurriculumName = dataclasses.field(
        default="success", metadata={"rule": Rule("str", choices=("success", "reward"))}
    )
    reward_threshold: float = setting(30.0, Rule("float", 0.0, open_low=True))
    mat_height: float = setting(0.3, Rule("float", 0.01, 1.0))
    actions: Actions = dataclasses.field(default="offset", metadata={"rule": Rule("str", choices=("offset", "pose"))})
    gravity: float = setting(GRAVITY, Rule("float", 0.5, 30.0))
    landing: Landing = dataclasses.field(default="any", metadata={"rule": Rule("str", choices=("any", "feet"))})
    take_off_leg: float = setting(1.0, Rule("float", 0.1, 2.0))
    spine: Spine = dataclasses.field(default="free", metadata={"rule": Rule("str", choices=("free", "stiff"))})
    cast: Cast = dataclasses.field(
        default="none", metadata={"rule": Rule("str", choices=("none", "take_off", "swing"))}
    )
    run_up: bool = setting(False, Rule("bool"))
    run_up_clip: str | None = setting(None, Rule("path", optional=True))
    poses: str | None = setting(None, Rule("path", optional=True))

    @classmethod
    def parse(cls, settings: Mapping[str, JSON]) -> Self:
        """The settings over their defaults. Raises `BadSetting` naming the field, what was expected and found."""
        fields: dict[str, Rule] = {f.name: f.metadata["rule"] for f in dataclasses.fields(cls)}
        refuse_unknown(SECTION, "", settings, fields)
        values: dict[str, Any] = {key: fields[key].read(SECTION, key, value) for key, value in settings.items()}
        parsed = cls(**values)
        parsed.check()
        return parsed

    def check(self) -> None:
        """Refuse settings that don't go together (`BadSetting`)."""
        for name, rate in (("control_rate", self.control_rate), ("control_rate_hard", self.control_rate_hard)):
            if rate is not None and 120 % rate:
                raise BadSetting(SECTION, name, f"expected a divisor of 120 (the frames of a second), found {rate}")
        if self.control_rate_hard is not None and self.control_rate_hard < self.control_rate:
            raise BadSetting(
                SECTION,
                "control_rate_hard",
                f"expected at least control_rate, which is {self.control_rate}, found {self.control_rate_hard}",
            )
        if self.run_up and self.formulation != "support":
            raise BadSetting(
                SECTION, "run_up", "expected none with formulation: flight, which begins after it; write support"
            )
        if self.run_up_clip is not None:
            if not self.run_up:
                raise BadSetting(
                    SECTION, "run_up_clip", "expected none with run_up: false, found one; write run_up: true"
                )
            try:
                captured_run(self.run_up_clip)
            except BadClip as error:
                raise BadSetting(SECTION, "run_up_clip", str(error)) from None
        if self.poses is not None and self.actions != "pose":
            raise BadSetting(SECTION, "poses", "expected none with actions: offset, found one; write actions: pose")
        try:
            self.pose_model()
        except BadJob as error:
            raise BadSetting(SECTION, "poses", str(error)) from None

    def check_levels(self, first: str, lowest: str, highest: str) -> None:
        """Refuse levels that are not in order (`BadSetting`); the arguments are the names of their settings."""
        levels = self.levels
        for name, least in ((first, levels.first), (lowest, levels.lowest)):
            if levels.highest < least:
                message = f"expected at least {name}, which is {least:g}, found {levels.highest:g}"
                raise BadSetting(SECTION, highest, message)
        if not levels.first <= levels.last <= levels.highest:
            raise BadSetting(
                SECTION,
                "z_freeze",
                f"expected a level from {first}, {levels.first:g}, to {highest}, {levels.highest:g}, "
                f"found {levels.last:g}",
            )

    @property
    @abstractmethod
    def levels(self) -> Levels:
        """Its levels."""

    @property
    def obstacle(self) -> Callable[[float], float] | None:
        """Height of the obstacle by its width, which is the level, m; None where the level is the height of a bar."""
        return None

    @abstractmethod
    def hardness(self, level: float) -> float:
        """How hard a level is, from 0 to 1."""

    @abstractmethod
    def take_off(self, params: Mapping[str, Scalar]) -> TakeOff:
        """The take-off state of a candidate under these settings; parameters that it lacks are in their middle."""

    def new_curriculum(self) -> SuccessCurriculum | RewardCurriculum:
        """From the first level to the last."""
        levels = self.levels
        if self.curriculum == "reward":
            return RewardCurriculum(levels.first, levels.step, levels.last, self.reward_threshold)
        return SuccessCurriculum(levels.first, levels.step, levels.last)

    def upward(self) -> float:
        """Upward velocity of the root at the start, m/s."""
        if self.rise is not None:
            return self.rise
        return 1.2 if self.formulation == "support" else 3.5

    def joints(self) -> tuple[Joint, ...]:
        """The athlete's joints under the variations asked for."""
        return varied_joints(self.take_off_leg, self.spine, self.cast)

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

    @classmethod
    def check_parameters(cls, names: Any) -> None:
        """Refuse parameter names that are none of the take-off state's (`BadSetting`)."""
        refuse_unknown("space", "", names, cls.parameters)

    @classmethod
    def values_of(cls, params: Mapping[str, Scalar]) -> dict[str, float]:
        """All parameters of a candidate; those that it lacks are in the middle of their range.

        Raises `BadSetting` for one that no athlete takes off with (`least` and `most` of `parameters`; `low` and `high`
        are where a search looks by default: a published take-off state lies outside of them).
        """
        values = {
            name: float(params.get(name, (float(spec.low or 0) + float(spec.high or 0)) / 2))
            for name, spec in cls.parameters.items()
        }
        for name, value in values.items():
            spec = cls.parameters[name]
            if not float(spec.least or 0) <= value <= float(spec.most or 0):
                message = f"expected from {spec.least:g} to {spec.most:g} {spec.unit}, found {value:g}"
                raise BadSetting("space", name, message)
        return values


@functools.cache
def pose_model(path: str | None) -> PoseModel:
    """The pose model in a file, or the default one; read once in a process. Raises `BadJob`."""
    from workers.poses.training import default_model  # noqa: PLC0415 - torch takes seconds to import

    return default_model() if path is None else PoseModel.read(Path(path).expanduser())
