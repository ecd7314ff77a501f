"""Would a stored policy's jump be believed? Its best jump judged once more, and how surely it succeeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workers.audit import Audit, Check, audit
from workers.contracts import Job
from workers.learning.policy import Policy
from workers.learning.rollout import collect
from workers.learning.settings import TrainingSettings
from workers.tasks.high_jump.settings import TRAINING
from workers.tasks.high_jump.task import JumpProblem, bar_of, recorded_jump


def audit_policy(problem: JumpProblem, job: Job, policy: bytes, rollouts: int) -> Audit:
    """The audit of a stored policy.

    Args:
        problem: what the job trained.
        job: of the trial that learnt it.
        policy: its artifact `policy.safetensors`.
        rollouts: how many jumps with noise (of `sigma_end`, that of a finished training) are tried over the same bar;
            their share of failures is told, without a bound: the value of a trial is what it clears without noise.

    Raises `BadJob` where the policy is of another task or never cleared a bar.
    """
    bar = bar_of(policy)
    learnt = Policy.from_bytes(policy)
    jump = recorded_jump(problem, learnt, bar)
    missed = Check("deterministic_failure", float(jump is None), 0.0, "jumps")
    checks = () if jump is None else audit(jump.replay).checks
    sigma = TrainingSettings.parse(job.training, TRAINING).ppo.sigma_end
    rng = job.rng("audit")

    def explore(output: NDArray[np.float32]) -> NDArray[np.float32]:
        return output + np.float32(sigma) * rng.standard_normal(output.shape, np.float32)

    env = problem.env(None)
    cleared = 0
    try:
        for _ in range(rollouts):
            (episode,) = collect([env], learnt, explore, samples=1, level=bar, seeds=lambda: 0, episode_limit=1000)
            cleared += bool(episode.success)
    finally:
        env.close()
    rate = Check("stochastic_success", cleared / rollouts, None, f"of {rollouts} jumps") if rollouts else None
    return Audit((*checks, missed, *(() if rate is None else (rate,))))
