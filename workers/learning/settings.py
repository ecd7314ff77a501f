"""Training settings: budget, network and PPO, frozen and checked.

A study file's `training` is a mapping like

    budget: {samples: 200000, iterations: 300}      # whichever is spent first; one of them is enough
    network: {hidden: [256, 128], activation: relu}
    ppo: {samples: 700, clip: 0.2, actor_rate: 0.0003}

What it leaves out has the task's default.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from workers.contracts import JSON, BadSetting
from workers.learning.policy import Activation

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Rule:
    """What a setting may be.

    Args:
        kind: `int`, `float`, `bool`, `str`, `path` or `widths` (a list of layer widths).
        low, high: inclusive bounds; `open_low` makes the lower one exclusive.
        choices: of `str`.
        optional: whether None is allowed.
    """

    kind: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    choices: tuple[str, ...] = ()
    optional: bool = False

    def expected(self) -> str:
        """In words, for messages."""
        if self.kind == "bool":
            return "true or false"
        if self.kind == "path":
            return "the path of a file"
        if self.kind == "str":
            return " or ".join(self.choices)
        if self.kind == "widths":
            return "a list of whole numbers from 1 to 8192"
        noun = "a whole number" if self.kind == "int" else "a number"
        above = f"above {self.low:g}" if self.open_low else f"of at least {self.low:g}"
        if math.isinf(self.high):
            return noun if math.isinf(self.low) else f"{noun} {above}"
        return (
            f"{noun} {above} and at most {self.high:g}"
            if self.open_low
            else f"{noun} from {self.low:g} to {self.high:g}"
        )

    def read(self, section: str, name: str, value: JSON) -> Any:
        """The value, in its own type. Raises `BadSetting`."""
        if value is None and self.optional:
            return None
        if self.kind == "widths" and isinstance(value, list | tuple):
            width = Rule("int", 1, 8192)
            return tuple(width.read(section, f"{name}[{i}]", v) for i, v in enumerate(value))
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        fits = (
            (self.kind == "bool" and isinstance(value, bool))
            or (self.kind == "str" and value in self.choices)
            or (self.kind == "path" and isinstance(value, str) and bool(value.strip()))
            or (self.kind == "float" and is_number and self._within(value))
            or (self.kind == "int" and is_number and value == int(value) and self._within(value))
        )
        if not fits:
            raise BadSetting(section, name, f"expected {self.expected()}, found {_shown(value)}")
        return {"int": int, "float": float}.get(self.kind, lambda v: v)(value)

    def _within(self, value: float) -> bool:
        return (self.low < value if self.open_low else self.low <= value) and value <= self.high


def _shown(value: JSON) -> str:
    """A found value for a message. YAML 1.1 reads 1e-4 and 1.0e4 as text, which deserves a hint."""
    if isinstance(value, str):
        number = re.fullmatch(r"([-+]?\d+)(\.\d*)?[eE]([-+]?)(\d+)", value)
        if number is None:
            return f"the text {value!r}"
        whole, fraction, sign, exponent = number.groups()
        return f"the text {value!r} (in YAML write {whole}{fraction or '.0'}e{sign or '+'}{exponent})"
    if isinstance(value, bool):
        return str(value).lower()
    return "nothing" if value is None else repr(value)


def setting(default: T, rule: Rule) -> T:
    """A dataclass field with its rule."""
    return field(default=default, metadata={"rule": rule})


def _rate(default: float) -> float:
    return setting(default, Rule("float", 0.0, 1.0, open_low=True))


@dataclass(frozen=True, slots=True)
class Budget:
    """When a training ends at the latest: after the first iteration that reaches either.

    Args:
        samples: control steps.
        iterations: PPO iterations.
    """

    samples: int | None = setting(None, Rule("int", 1, optional=True))
    iterations: int | None = setting(None, Rule("int", 1, optional=True))

    def part(self, share: float) -> Budget:
        """A share in (0, 1] of it, at least one sample and one iteration."""
        samples, iterations = (
            None if whole is None else max(1, round(share * whole)) for whole in (self.samples, self.iterations)
        )
        return Budget(samples, iterations)


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Both networks, actor and critic, each on its own.

    Args:
        hidden: widths of the hidden layers.
        activation: of the hidden layers, `relu` or `tanh`.
    """

    hidden: tuple[int, ...] = setting((256, 128), Rule("widths"))
    activation: Activation = field(default="relu", metadata={"rule": Rule("str", choices=("relu", "tanh"))})


@dataclass(frozen=True, slots=True)
class PPOSettings:
    """Proximal policy optimisation (Schulman et al. 2017) with generalised advantage estimation (Schulman et al. 2016).

    Args:
        environments: stepped in turn, their inference batched.
        samples: an iteration plays whole episodes until it has at least so many control steps.
        minibatch: samples a gradient step.
        epochs: passes over an iteration's samples.
        clip: epsilon of the clipped objective (2017, equation 7).
        actor_rate, critic_rate: learning rates of the two Adam optimisers.
        weight_decay: decoupled (AdamW), of both networks.
        gamma: discount.
        gae_lambda: lambda of the advantage estimate (2016, equation 16).
        grad_norm: a longer gradient is shortened to this.
        kl_stop: an iteration's updates end early beyond this KL divergence from the policy that sampled.
        kl_check: when that is looked at: after each `epoch`, from its mean, or after each gradient `step`, from the
            last 256 samples. With small minibatches an epoch is many steps, and ends far beyond the bound.
        entropy_bonus: weight of the entropy in the actor's objective (learnt sigma and discrete actions).
        sigma: `annealed` falls from `sigma_start` to `sigma_end` over `sigma_iterations`; `learnt` starts at
            `sigma_start`, one for each action coordinate.
        sigma_start, sigma_end: standard deviation of the action noise, in the policy's own unit.
        sigma_iterations: length of the annealing.
        sigma_child: where the noise of a training that goes on from a parent's policy begins: at the `start`, or where
            the `parent`'s ended.
        normaliser_iterations: the observation statistics settle after so many iterations.
        observation_clip: bound of a normalised observation.
        normalise_rewards: divide rewards by the running standard deviation of the discounted return.
        episode_limit: an environment whose episode is longer never ends, and is refused.
    """

    environments: int = setting(8, Rule("int", 1, 1024))
    samples: int = setting(700, Rule("int", 2))
    minibatch: int = setting(128, Rule("int", 2))
    epochs: int = setting(5, Rule("int", 1, 1000))
    clip: float = setting(0.2, Rule("float", 0.0, 1.0, open_low=True))
    actor_rate: float = _rate(3e-4)
    critic_rate: float = _rate(1e-3)
    weight_decay: float = setting(0.0, Rule("float", 0.0, 1.0))
    gamma: float = setting(1.0, Rule("float", 0.0, 1.0))
    gae_lambda: float = setting(0.95, Rule("float", 0.0, 1.0))
    grad_norm: float = setting(1.0, Rule("float", 0.0, open_low=True))
    kl_stop: float = setting(0.05, Rule("float", 0.0, open_low=True))
    kl_check: str = setting("epoch", Rule("str", choices=("epoch", "step")))
    entropy_bonus: float = setting(0.0, Rule("float", 0.0, 1.0))
    sigma: str = setting("annealed", Rule("str", choices=("annealed", "learnt")))
    sigma_start: float = setting(0.4, Rule("float", 0.0, 10.0, open_low=True))
    sigma_end: float = setting(0.12, Rule("float", 0.0, 10.0, open_low=True))
    sigma_iterations: int = setting(80, Rule("int", 1))
    sigma_child: str = setting("start", Rule("str", choices=("start", "parent")))
    normaliser_iterations: int = setting(30, Rule("int", 0))
    observation_clip: float = setting(8.0, Rule("float", 0.0, open_low=True))
    normalise_rewards: bool = setting(False, Rule("bool"))
    episode_limit: int = setting(10_000, Rule("int", 1))


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """All that a training depends on besides its problem and its job's seed."""

    budget: Budget = field(default_factory=Budget)
    network: NetworkSettings = field(default_factory=NetworkSettings)
    ppo: PPOSettings = field(default_factory=PPOSettings)
    trainer: str = "halma"

    @classmethod
    def parse(
        cls,
        training: Mapping[str, JSON],
        defaults: TrainingSettings | None = None,
        *,
        trainers: tuple[str, ...] = ("halma",),
    ) -> TrainingSettings:
        """The settings that a study's `training` gives, over a task's defaults.

        A budget given replaces the default budget as a whole. Raises `BadSetting` with section `training` and the
        dotted field for an unknown key (naming the nearest known one), a wrong type, a value out of range, or no
        budget at all. `trainers` are those that the task can be trained by.
        """
        base = cls() if defaults is None else defaults
        refuse_unknown("training", "", training, ("budget", "network", "ppo", "trainer"))
        trainer = Rule("str", choices=trainers).read("training", "trainer", training.get("trainer", "halma"))
        budget = _section("budget", training, Budget() if training.get("budget") else base.budget)
        if budget.samples is None and budget.iterations is None:
            raise BadSetting("training", "budget", "expected samples, iterations or both, found neither")
        return cls(budget, _section("network", training, base.network), _section("ppo", training, base.ppo), trainer)

    def to_json(self) -> dict[str, JSON]:
        """As `training` in a study file, all defaults written out."""
        value = dataclasses.asdict(self)
        value["network"]["hidden"] = list(self.network.hidden)
        value["budget"] = {name: v for name, v in value["budget"].items() if v is not None}
        return value


def refuse_unknown(section: str, prefix: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise `BadSetting` for the first key that isn't known, naming the nearest one that is."""
    names = list(known)
    for key in given:
        if key in names:
            continue
        near = difflib.get_close_matches(str(key), names, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names) or 'none'}"
        raise BadSetting(section, f"{prefix}{key}", f"unknown setting; {hint}")


_SEARCHED: Mapping[str, tuple[str, ...]] = {
    "ppo": tuple(f.name for f in dataclasses.fields(PPOSettings)),
    "network": ("activation",),
}


def check_searched(name: str) -> None:
    """Refuse a parameter that is no setting of the learner (`ppo.clip`, `network.activation`); `BadSetting`."""
    head, _, tail = name.partition(".")
    if tail not in _SEARCHED.get(head, ()):
        known = [f"{h}.{t}" for h, names in _SEARCHED.items() for t in names]
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
        raise BadSetting("space", name, f"no setting of the learner{hint}")


def with_searched(training: Mapping[str, JSON], params: Mapping[str, JSON]) -> dict[str, JSON]:
    """A study's `training` with a candidate's settings of the learner laid over it. Raises `BadSetting`."""
    merged: dict[str, JSON] = dict(training)
    for name, value in params.items():
        check_searched(name)
        head, _, tail = name.partition(".")
        merged[head] = {**(merged.get(head) or {}), tail: value}
    return merged


_Section = TypeVar("_Section", Budget, NetworkSettings, PPOSettings)


def _section(name: str, training: Mapping[str, JSON], base: _Section) -> _Section:
    """One of the three sections over its defaults."""
    given = training.get(name)
    if given is None:
        given = {}
    if not isinstance(given, Mapping):
        raise BadSetting("training", name, f"expected a mapping, found {_shown(given)}")
    rules = {f.name: f.metadata["rule"] for f in dataclasses.fields(base)}
    refuse_unknown("training", f"{name}.", given, rules)
    values = {key: rules[key].read("training", f"{name}.{key}", value) for key, value in given.items()}
    return dataclasses.replace(base, **values)
