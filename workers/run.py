"""How is one trial run? `run(job, context) -> Outcome`; all that the services need to know of this room."""

from __future__ import annotations

from workers.contracts import BadJob, Context, Job, Outcome
from workers.learning.problem import Diverged
from workers.registry import load_task


def run(job: Job, context: Context) -> Outcome:
    """Run one trial from its newest checkpoint to its end.

    What the job itself brings about is an outcome: a divergence is `diverged`; a job that can't be run as it stands is
    `failed` with ``details["retry"] == False``.

    Raises:
        Interrupted: the context asked for it; the checkpoint is safe.
        Exception: whatever else went wrong (the user's environment, a full disk), as it is: a failed attempt.
    """
    try:
        task = load_task(job.task)
        task.validate(job.task_settings, job.training, list(job.params))
        return task.run(job, context)
    except Diverged as error:
        details = {"iteration": error.iteration, "quantity": error.quantity}
        return Outcome("diverged", cost=error.cost, message=str(error), details=details)
    except BadJob as error:
        context.log(str(error))
        return Outcome("failed", message=str(error), details={"retry": False})
