"""Proximal policy optimisation: what learns from an iteration's episodes.

Glossary (Schulman et al. 2017, "Proximal Policy Optimization Algorithms"; 2016, "High-Dimensional Continuous Control
Using Generalized Advantage Estimation"):

    A_t     advantage of the action taken at step t
    V       value of a state, the critic's output
    r_t     probability ratio of the new policy to the one that sampled
    delta_t temporal-difference residual
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from workers.contracts import BadJob, Job
from workers.learning.networks import Network
from workers.learning.policy import ActionMap, Normaliser, Policy
from workers.learning.rollout import Episode, NotFinite, collect
from workers.learning.settings import TrainingSettings

KL_SAMPLES = 256
"""Samples that an estimate of the divergence after a gradient step is the mean of, at least."""


def stream(job: Job, purpose: str, iteration: int) -> np.random.Generator:
    """The random numbers of one purpose in one iteration, independent of all others."""
    entropy = job.seed_sequence(purpose).entropy
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(iteration,)))


def advantages(
    rewards: Sequence[float], values: Sequence[float], bootstrap: float, gamma: float, gae_lambda: float
) -> NDArray[np.float64]:
    """Generalised advantage estimates ``[T]`` of one episode (2016, equation 16, by its backward recursion).

    Args:
        rewards: r_0 ... r_{T-1}.
        values: V(s_0) ... V(s_{T-1}).
        bootstrap: V(s_T): 0 where the episode ended by itself, the critic's value where it was truncated.
        gamma: discount.
        gae_lambda: 0 trusts the critic, 1 the rewards.
    """
    result = np.empty(len(rewards))
    advantage, following = 0.0, bootstrap
    for t in reversed(range(len(rewards))):
        delta = rewards[t] + gamma * following - values[t]
        advantage = delta + gamma * gae_lambda * advantage
        result[t] = advantage
        following = values[t]
    return result


def discounted_returns(rewards: Sequence[float], gamma: float) -> NDArray[np.float64]:
    """sum_k gamma^k r_{t+k} for each step of an episode ``[T]``."""
    return advantages(rewards, [0.0] * len(rewards), 0.0, gamma, 1.0)


@dataclass(frozen=True, slots=True)
class Batch:
    """An iteration's samples, ``n`` of them.

    Args:
        observations: normalised ``[n, observation]``.
        actions: in network units ``[n, size]``, or choices ``[n]``.
        advantages: normalised to mean 0, deviation 1 ``[n]``.
        returns: the critic's targets ``[n]``.
    """

    observations: torch.Tensor
    actions: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor


@dataclass(frozen=True, slots=True)
class WarmStart:
    """What a training took over from its parent.

    Args:
        networks: whether actor and critic were; the observation statistics always are.
        message: in a sentence, for people.
    """

    networks: bool
    message: str


class Learner:
    """Both networks, their optimisers and the statistics: what learns.

    Args:
        job: for its seed.
        settings: network and PPO.
        size: of an observation.
        actions: of the environment.
    """

    def __init__(self, job: Job, settings: TrainingSettings, size: int, actions: ActionMap) -> None:
        ppo, network = settings.ppo, settings.network
        self.ppo = ppo
        self.activation = network.activation
        self.actions = actions
        learns_sigma = actions.kind == "continuous" and ppo.sigma == "learnt"
        self.actor = Network(
            "actor",
            (size, *network.hidden, actions.size),
            network.activation,
            rate=ppo.actor_rate,
            weight_decay=ppo.weight_decay,
            rng=stream(job, "actor", 0),
            last_scale=0.01,
            sigma_start=ppo.sigma_start if learns_sigma else None,
        )
        self.critic = Network(
            "critic",
            (size, *network.hidden, 1),
            network.activation,
            rate=ppo.critic_rate,
            weight_decay=ppo.weight_decay,
            rng=stream(job, "critic", 0),
        )
        self.normaliser = Normaliser.identity(size, ppo.observation_clip)
        self.reward_statistics = Normaliser.identity(1)
        self.annealed = 0.0
        """Share of the annealing that was over before this training began."""
        self.explored = np.zeros(0, np.float32)
        """Noise of the newest update ``[size]``, empty before any."""

    def sigma(self, iteration: int) -> NDArray[np.float32]:
        """Standard deviation of the action noise ``[size]`` in this iteration (from 1), in network units."""
        if self.actor.log_sigma is not None:
            learnt: NDArray[np.float32] = np.exp(self.actor.log_sigma.detach().numpy())
            return learnt
        done = min(1.0, self.annealed + (iteration - 1) / self.ppo.sigma_iterations)
        sigma = self.ppo.sigma_start + (self.ppo.sigma_end - self.ppo.sigma_start) * done
        return np.full(self.actions.size, sigma, np.float32)

    def policy(self, *, shared: bool = False) -> Policy:
        """The policy as it is now; `shared` changes with the learner, for rollouts."""
        actor, critic = (n.view() if shared else n.snapshot() for n in (self.actor, self.critic))
        sigma = self.explored if len(self.explored) else None
        return Policy(self.activation, self.actions, self.normaliser, actor, critic, sigma)

    def rollout(
        self, envs: Sequence[Any], job: Job, iteration: int, *, sampling: int, level: float | None
    ) -> list[Episode]:
        """Play with exploration. The streams are those of `sampling`: the iteration, or 0 for the warm-up."""
        rng, seeds = stream(job, "actions", sampling), stream(job, "episodes", sampling)
        sigma = self.sigma(iteration)

        def explore(output: NDArray[np.float32]) -> NDArray[Any]:
            return output + sigma * rng.standard_normal(output.shape, np.float32)

        def choose(logits: NDArray[np.float32]) -> NDArray[Any]:
            cumulative = np.cumsum(np.exp(logits - logits.max(1, keepdims=True)), 1)
            drawn = rng.random((len(logits), 1), np.float32) * cumulative[:, -1:]
            choices: NDArray[np.int64] = np.minimum((cumulative <= drawn).sum(1), self.actions.size - 1)
            return choices

        return collect(
            envs,
            self.policy(shared=True),
            choose if self.actions.kind == "discrete" else explore,
            samples=self.ppo.samples,
            level=level,
            seeds=lambda: int(seeds.integers(2**31)),
            episode_limit=self.ppo.episode_limit,
        )

    def batch(self, episodes: Sequence[Episode]) -> Batch:
        """Normalised observations, advantages and value targets. Updates the reward statistics."""
        ppo = self.ppo
        observations = _tensor(self.normaliser(np.concatenate([e.observations for e in episodes])))
        lasts = _tensor(self.normaliser(np.stack([e.last for e in episodes])))
        with torch.no_grad():
            values: list[float] = self.critic(observations)[:, 0].tolist()
            last_values: list[float] = self.critic(lasts)[:, 0].tolist()
        scale = 1.0
        if ppo.normalise_rewards:
            seen = np.concatenate([discounted_returns(e.rewards, ppo.gamma) for e in episodes])
            self.reward_statistics = self.reward_statistics.updated(seen[:, None])
            scale = 1 / float(np.sqrt(self.reward_statistics.var[0] + 1e-8))
        estimates, start = [], 0
        for episode, last_value in zip(episodes, last_values, strict=True):
            end = start + len(episode)
            bootstrap = 0.0 if episode.terminated else last_value
            rewards = [scale * r for r in episode.rewards]
            estimates.append(advantages(rewards, values[start:end], bootstrap, ppo.gamma, ppo.gae_lambda))
            start = end
        A = np.concatenate(estimates)
        returns = A + np.array(values)
        A = (A - A.mean()) / (A.std() + 1e-6)
        chosen = np.concatenate([e.actions for e in episodes])
        return Batch(observations, _tensor(chosen), _tensor(A.astype(np.float32)), _tensor(returns.astype(np.float32)))

    def update(self, batch: Batch, iteration: int, rng: np.random.Generator) -> dict[str, float]:
        """The iteration's gradient steps.

        Returns:
            `kl` from the sampling policy, averaged over the last epoch, or over the last samples where every step is
            checked; `critic_loss`; `entropy` (discrete) or `sigma`.

        Raises:
            NotFinite: where a loss or a weight is.
        """
        ppo = self.ppo
        sigma = torch.tensor(self.sigma(iteration))
        with torch.no_grad():
            old, _ = self._log_probability(batch.observations, batch.actions, sigma)
        n = len(old)
        kl = critic_loss = entropy = 0.0
        recent: deque[float] = deque(maxlen=math.ceil(KL_SAMPLES / ppo.minibatch))
        for _ in range(ppo.epochs):
            kls, losses, entropies = [], [], []
            order = torch.from_numpy(rng.permutation(n))
            for start in range(0, n, ppo.minibatch):
                rows = order[start : start + ppo.minibatch]
                if start > 0 and len(rows) < ppo.minibatch // 2:
                    break  # a tail of a few samples would be a step as long as any, and noisier
                observations, A = batch.observations[rows], batch.advantages[rows]
                log_probability, disorder = self._log_probability(observations, batch.actions[rows], sigma)
                log_r = log_probability - old[rows]
                r = log_r.exp()
                # 2017, equation 7: the pessimistic one of the ratio and the clipped ratio.
                objective = torch.min(r * A, r.clamp(1 - ppo.clip, 1 + ppo.clip) * A).mean()
                actor_loss = -(objective + ppo.entropy_bonus * disorder)
                value_loss = torch.nn.functional.mse_loss(self.critic(observations)[:, 0], batch.returns[rows])
                for loss in (actor_loss, value_loss):
                    if not torch.isfinite(loss):
                        raise NotFinite("loss", float(loss.detach()))
                self.actor.descend(actor_loss, ppo.grad_norm)
                self.critic.descend(value_loss, ppo.grad_norm)
                # E[(r - 1) - log r] is an unbiased estimate of KL(old, new) that is never negative.
                kls.append(float((r.detach() - 1 - log_r.detach()).mean()))
                losses.append(float(value_loss.detach()))
                entropies.append(float(disorder.detach()))
                recent.append(kls[-1])
                if ppo.kl_check == "step" and float(np.mean(recent)) > ppo.kl_stop:
                    break
            kl = float(np.mean(recent if ppo.kl_check == "step" else kls))
            critic_loss, entropy = float(np.mean(losses)), float(np.mean(entropies))
            if kl > ppo.kl_stop:
                break
        if not (self.actor.finite() and self.critic.finite()):
            raise NotFinite("weights", np.nan)
        if self.actions.kind == "continuous":
            self.explored = self.sigma(iteration)
        spread = {"entropy": entropy} if self.actions.kind == "discrete" else {"sigma": float(sigma.mean())}
        return {"kl": kl, "critic_loss": critic_loss, **spread}

    def _log_probability(
        self, observations: torch.Tensor, actions: torch.Tensor, sigma: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Log-probability of the actions ``[n]`` up to a constant, and the mean entropy up to a constant."""
        output = self.actor(observations)
        if self.actions.kind == "discrete":
            log_p = torch.log_softmax(output, 1)
            return log_p.gather(1, actions[:, None])[:, 0], -(log_p.exp() * log_p).sum(1).mean()
        if self.actor.log_sigma is None:
            return -0.5 * ((actions - output) / sigma).square().sum(1), torch.zeros(())
        log_sigma = self.actor.log_sigma
        z = (actions - output) * (-log_sigma).exp()
        return -0.5 * z.square().sum(1) - log_sigma.sum(), log_sigma.sum()

    def warm_start(self, parent: Policy) -> WarmStart:
        """Take over a parent's networks and statistics; tells what was taken.

        Raises `BadJob` where observations or actions are of other sizes. With other hidden layers only the statistics
        can be taken over.
        """
        wanted = (len(self.normaliser.mean), self.actions.kind, self.actions.size)
        found = (parent.observation_size, parent.actions.kind, parent.actions.size)
        if wanted != found:
            raise BadJob(
                "expected a policy of {} observations and {} actions of size {}, found {}, {}, {}; "
                "start from a trial of the same task and settings".format(*wanted, *found)
            )
        self.normaliser = Normaliser(
            parent.normaliser.mean, parent.normaliser.var, parent.normaliser.count, self.ppo.observation_clip
        )
        hidden = tuple(len(bias) for _, bias in self.actor.layers[:-1])
        if (parent.hidden, parent.activation) != (hidden, self.activation):
            return WarmStart(
                networks=False,
                message=f"the parent's networks are {parent.activation} {list(parent.hidden)}, ours {self.activation} "
                f"{list(hidden)}: started from new networks, with the parent's observation statistics",
            )
        self.actor.put(parent.actor)
        self.critic.put(parent.critic)
        if self.ppo.sigma_child == "parent" and parent.sigma is not None:
            self._go_on_exploring(parent.sigma)
        return WarmStart(networks=True, message="started from the parent's policy")

    def _go_on_exploring(self, sigma: NDArray[np.float32]) -> None:
        """Take the noise of a parent over: as it was learnt, or as far as its annealing had got."""
        if self.actor.log_sigma is not None:
            with torch.no_grad():
                self.actor.log_sigma.copy_(torch.log(_tensor(sigma)))
            return
        whole = self.ppo.sigma_end - self.ppo.sigma_start
        done = (float(sigma.mean()) - self.ppo.sigma_start) / whole if whole else 1.0
        self.annealed = min(1.0, max(0.0, done))

    def tensors(self) -> dict[str, NDArray[Any]]:
        """All that learns, for the checkpoint."""
        found = {**self.actor.tensors(), **self.critic.tensors()}
        for name, statistics in (("normaliser", self.normaliser), ("rewards", self.reward_statistics)):
            found |= {
                f"{name}.mean": statistics.mean,
                f"{name}.var": statistics.var,
                f"{name}.count": np.array(statistics.count),
            }
        return found | {"sigma.annealed": np.array(self.annealed), "sigma.explored": self.explored}

    def load(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `tensors` gave. Raises `BadJob` where it is of other sizes."""
        self.actor.load(tensors)
        self.critic.load(tensors)
        self.normaliser, self.reward_statistics = (
            Normaliser(tensors[f"{n}.mean"], tensors[f"{n}.var"], float(tensors[f"{n}.count"]), old.clip)
            for n, old in (("normaliser", self.normaliser), ("rewards", self.reward_statistics))
        )
        if "sigma.annealed" in tensors:  # checkpoints of halma 0.1.0 don't tell
            self.annealed, self.explored = float(tensors["sigma.annealed"]), tensors["sigma.explored"]


def _tensor(array: NDArray[Any]) -> torch.Tensor:
    """A copy in torch's own aligned memory: alignment can decide the last bit of a matrix product."""
    return torch.tensor(array)
