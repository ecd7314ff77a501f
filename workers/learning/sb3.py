"""Stable-Baselines3's PPO as the trainer of an environment (`training: {trainer: sb3}`), an extra.

It keeps our promises: a training is a function of its job, and goes on bit for bit from each of its iterations, in
tensors and JSON (its own files hold pickles). To that end each iteration begins with new episodes, and draws from a
stream of its own. The policy it leaves is one of ours (`Policy`), so that it is evaluated, handed on and replayed like
any other.

What of `training.ppo` it understands is in `NAMES`; what a study doesn't give has Stable-Baselines3's own default, not
ours. Observations are not normalised.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from workers.contracts import JSON, BadJob, BadSetting, Checkpoint, Context, Interrupted, Job
from workers.learning.learner import WarmStart, stream
from workers.learning.policy import ActionMap, Normaliser, Policy
from workers.learning.ppo import POLICY_ARTIFACT, Progress
from workers.learning.problem import Diverged, Problem, Trained
from workers.learning.rollout import NotFinite, action_map, in_words, observation_size
from workers.learning.settings import TrainingSettings

NAMES: Mapping[str, str] = {
    "actor_rate": "learning_rate",
    "minibatch": "batch_size",
    "epochs": "n_epochs",
    "clip": "clip_range",
    "gamma": "gamma",
    "gae_lambda": "gae_lambda",
    "grad_norm": "max_grad_norm",
    "kl_stop": "target_kl",
    "entropy_bonus": "ent_coef",
}
"""Our name -> Stable-Baselines3's. `environments`, `samples` (of an iteration) and `episode_limit` are ours alone."""
_NEVER = 2**62
_OURS = ("environments", "samples", "episode_limit")


def check(given: Mapping[str, JSON], names: Sequence[str]) -> None:
    """Refuse what this trainer can't do (`BadSetting`).

    Args:
        given: the study's `training`.
        names: parameters that the study searches over.
    """
    if importlib.util.find_spec("stable_baselines3") is None:
        raise BadSetting(
            "training",
            "trainer",
            "expected the package stable-baselines3 for trainer sb3, found that it is not installed; "
            "pip install 'halma[sb3]', or leave trainer out",
        )
    known = (*NAMES, *_OURS)
    for section, prefix, found in (("training", "ppo.", list(given.get("ppo") or {})), ("space", "", names)):
        for name in found:
            tail = name.removeprefix("ppo.")
            if (prefix or name.startswith("ppo.")) and tail not in known:
                raise BadSetting(
                    section, f"{prefix}{name}", f"no setting of trainer sb3; it knows {', '.join(known)}"
                )  # fmt: skip


class _Watched(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Says at once where an environment gives NaN, which Stable-Baselines3 would learn from."""

    steps = 0

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        reward = float(reward)
        self.steps += 1
        for quantity, value in (("reward", reward), ("observation", float(np.sum(observation)))):
            if not math.isfinite(value):
                raise NotFinite(quantity, value)
        return observation, reward, terminated, truncated, info


@contextmanager
def _drawing_from(rng: np.random.Generator) -> Iterator[None]:
    """Stable-Baselines3 draws from the global generators of numpy and torch: lend it a stream, and give back theirs."""
    kept = np.random.get_state()  # noqa: NPY002 - it is the global one that is lent
    with torch.random.fork_rng(devices=[]):
        np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002 - as above
        torch.manual_seed(int(rng.integers(2**63)))
        try:
            yield
        finally:
            np.random.set_state(kept)  # noqa: NPY002 - as above


def train(
    job: Job, context: Context, problem: Problem, settings: TrainingSettings, given: Mapping[str, JSON]
) -> Trained:
    """`workers.learning.ppo.train` by Stable-Baselines3.

    Args:
        job: whose training it is.
        context: for checkpoints, reports and the parent's policy.
        problem: makes the environments; without a curriculum.
        settings: budget and network.
        given: what the study and its candidate say of `training`: the rest is left to Stable-Baselines3.
    """
    torch.set_num_threads(1)
    training = _Training(job, context, problem, settings, given.get("ppo") or {})
    try:
        return training.run()
    finally:
        training.envs.close()


class _Training:
    """One call of `train`."""

    def __init__(
        self, job: Job, context: Context, problem: Problem, settings: TrainingSettings, ppo: Mapping[str, Any]
    ) -> None:
        from stable_baselines3 import PPO  # noqa: PLC0415 - an extra
        from stable_baselines3.common.logger import Logger  # noqa: PLC0415 - as above
        from stable_baselines3.common.monitor import Monitor  # noqa: PLC0415 - as above
        from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: PLC0415 - as above

        self.job, self.context, self.settings = job, context, settings
        count = int(ppo.get("environments", 4))
        self.envs = DummyVecEnv([lambda: Monitor(_Watched(problem.make_env()))] * count)
        steps = max(2, int(ppo.get("samples", 2048)) // count)
        chosen = {theirs: ppo[ours] for ours, theirs in NAMES.items() if ours in ppo}
        hidden = list(settings.network.hidden)
        activation = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.network.activation]
        first = self.envs.envs[0]
        self.size, self.actions = observation_size(first), _actions(first)
        chosen["batch_size"] = min(int(chosen.get("batch_size", 64)), steps * count)
        with _drawing_from(stream(job, "sb3", 0)):
            self.model = PPO(
                "MlpPolicy",
                self.envs,
                n_steps=steps,
                device="cpu",
                policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": activation},
                **chosen,
            )
        self.model.set_logger(Logger(None, []))
        self.progress = Progress()
        self.before = 0
        self.metrics: Mapping[str, float] = {}
        self.lineage: Mapping[str, JSON] = {}

    def run(self) -> Trained:
        mark = time.perf_counter()
        self.begin()
        progress, budget = self.progress, self.settings.budget

        def spent() -> bool:
            samples, iterations = budget.samples, budget.iterations
            return (samples is not None and progress.samples >= samples) or (
                iterations is not None and progress.iteration >= iterations
            )

        while not spent():
            try:
                self.metrics = self.iterate()
            except NotFinite as error:
                progress.seconds += time.perf_counter() - mark
                progress.samples = self.played()
                raise Diverged(progress.iteration + 1, error.quantity, in_words(error.value), progress.cost) from error
            elapsed = time.perf_counter() - mark
            mark += elapsed
            progress.seconds += elapsed
            progress.iteration += 1
            self.context.report(progress.iteration, self.metrics, progress.cost)
            self.context.save_checkpoint(self.checkpoint())
            if not spent() and self.context.stop_requested():
                raise Interrupted(f"stopped at the checkpoint of iteration {progress.iteration}")
        return Trained(
            self.policy(), progress.iteration, progress.cost, None, None, False, self.metrics, self.lineage
        )  # fmt: skip

    def played(self) -> int:
        """Steps that the environments have made since they were built, and those before the checkpoint."""
        return self.before + sum(int(env.get_wrapper_attr("steps")) for env in self.envs.envs)

    def begin(self) -> None:
        """From the checkpoint, from the parent, or from scratch."""
        checkpoint = self.context.load_checkpoint()
        if checkpoint is not None:
            self.restore(checkpoint)
        elif self.job.parent is not None:
            try:
                taken = self.warm_start(Policy.from_bytes(self.context.parent_artifact(POLICY_ARTIFACT)))
            except BadJob as error:
                raise BadJob(f"warm start from trial {self.job.parent}: {error}") from None
            self.context.log(f"trial {self.job.parent}: {taken.message}")
            self.lineage = {"warm_start": {"parent": self.job.parent, **dataclasses.asdict(taken)}}

    def iterate(self) -> dict[str, float]:
        """One rollout from new episodes and its updates. Returns its metrics."""
        iteration = self.progress.iteration + 1
        model, samples = self.model, self.model.n_steps * self.model.n_envs
        self.envs.seed(int(stream(self.job, "episodes", iteration).integers(2**31)))
        self.envs.set_options({"fresh": True})
        model._last_obs = None  # so that it begins with new episodes
        model.ep_info_buffer = None
        with _drawing_from(stream(self.job, "sb3", iteration)):
            model.learn(samples, log_interval=_NEVER, reset_num_timesteps=False)
        for name, tensor in model.policy.state_dict().items():
            if not bool(torch.isfinite(tensor).all()):
                raise NotFinite(f"weights ({name})", math.nan)
        self.progress.samples += samples
        told = model.logger.name_to_value
        infos: Any = model.ep_info_buffer or ()
        ended = [float(each["r"]) for each in infos]
        metrics = {"return_mean": float(np.mean(ended))} if ended else {}
        metrics |= {"kl": float(told["train/approx_kl"]), "critic_loss": float(told["train/value_loss"])}
        return {**metrics, "episodes": float(len(ended)), "samples": float(self.progress.samples)}

    def warm_start(self, parent: Policy) -> WarmStart:
        """Take over a parent's networks; `Learner.warm_start` says when not."""
        wanted = (self.size, self.actions.kind, self.actions.size)
        found = (parent.observation_size, parent.actions.kind, parent.actions.size)
        if wanted != found:
            raise BadJob(
                "expected a policy of {} observations and {} actions of size {}, found {}, {}, {}; "
                "start from a trial of the same task and settings".format(*wanted, *found)
            )
        network = self.settings.network
        same = (parent.hidden, parent.activation) == (tuple(network.hidden), network.activation)
        if not same or parent.normaliser.mean.any():
            return WarmStart(networks=False, message="the parent's networks are other ones: started from new networks")
        with torch.no_grad():
            for linears, layers in zip(self.layers(), (parent.actor, parent.critic), strict=True):
                for linear, (weight, bias) in zip(linears, layers, strict=True):
                    linear.weight.copy_(torch.tensor(weight.T))
                    linear.bias.copy_(torch.tensor(bias))
        return WarmStart(networks=True, message="started from the parent's policy")

    def layers(self) -> tuple[list[torch.nn.Linear], list[torch.nn.Linear]]:
        """The linear layers of actor and critic, input first."""
        policy: Any = self.model.policy
        towers = (
            (policy.mlp_extractor.policy_net, policy.action_net),
            (policy.mlp_extractor.value_net, policy.value_net),
        )
        actor, critic = (
            [*(layer for layer in tower if isinstance(layer, torch.nn.Linear)), head] for tower, head in towers
        )
        return actor, critic

    def policy(self) -> Policy:
        """The policy as one of ours."""
        actor, critic = (
            [(_array(linear.weight.T), _array(linear.bias)) for linear in linears] for linears in self.layers()
        )
        # statistics that change nothing, with nothing clipped
        still = Normaliser(np.zeros(self.size), np.full(self.size, 1 - 1e-6), 1.0, math.inf)
        return Policy(self.settings.network.activation, self.actions, still, actor, critic)

    def checkpoint(self) -> Checkpoint:
        """All that the next iteration needs."""
        tensors: dict[str, NDArray[Any]] = {
            f"policy.{name}": _array(tensor) for name, tensor in self.model.policy.state_dict().items()
        }
        for i, state in self.model.policy.optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{i}.{name}": _array(value) for name, value in state.items()}
        state = {
            "progress": dataclasses.asdict(self.progress),
            "metrics": dict(self.metrics),
            "lineage": dict(self.lineage),
        }
        return Checkpoint(self.progress.iteration, tensors, state)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        weights: dict[str, torch.Tensor] = {}
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for name, array in checkpoint.tensors.items():
            kind, _, rest = name.partition(".")
            if kind == "policy":
                weights[rest] = torch.tensor(array)
            else:
                i, _, what = rest.partition(".")
                moments.setdefault(int(i), {})[what] = torch.tensor(array)
        self.model.policy.load_state_dict(weights)
        optimizer = self.model.policy.optimizer
        optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
        self.progress = Progress(**checkpoint.state["progress"])
        self.before = self.progress.samples
        self.metrics, self.lineage = checkpoint.state["metrics"], checkpoint.state["lineage"]


def _actions(env: gymnasium.Env[Any, Any]) -> ActionMap:
    """Stable-Baselines3's networks give actions in the environment's own unit."""
    ours = action_map(env)
    if ours.kind == "discrete":
        return ours
    zeros = np.zeros(ours.size, np.float32)
    return ActionMap("continuous", ours.size, zeros, zeros + 1, ours.low, ours.high)


def _array(tensor: torch.Tensor) -> NDArray[Any]:
    return np.ascontiguousarray(tensor.detach().numpy()).copy()
