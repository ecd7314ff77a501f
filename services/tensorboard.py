"""A study as TensorBoard's event files: a run for each trial, with its curves and hyperparameters.

Curves stand over the simulation samples that they had cost where those were reported, else over iterations. A metric's
time isn't kept, so wall times are spread evenly between a trial's beginning and its end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from services.curves import STEPS
from services.spec import Behaviour
from services.store.port import MetricRow, TrialRow


def write_events(
    trials: Sequence[TrialRow],
    metrics: Callable[[TrialRow], Sequence[MetricRow]],
    behaviour: Behaviour | None,
    folder: Path,
) -> int:
    """Write event files. Needs tensorboardX.

    Args:
        trials: of the study; those that never began are left out.
        metrics: reads the learning curve of one.
        behaviour: names its features.
        folder: where to; each trial gets a folder of its own in it, `trial-00007`.

    Returns:
        How many trials were written.
    """
    from tensorboardX import FileWriter  # type: ignore[import-untyped]  # noqa: PLC0415 - an extra, without types
    from tensorboardX.summary import hparams, scalar  # type: ignore[import-untyped]  # noqa: PLC0415 - as above

    begun = [trial for trial in trials if trial.started_at is not None]
    for trial in begun:
        writer = FileWriter(str(folder / f"trial-{trial.number:05d}"))
        rows = metrics(trial)
        times = _times(trial, len(rows))
        found = outcome(trial, behaviour)
        try:
            # The plug-in shows those results as metrics that it was told of before, and the last value of each.
            experiment, start, end = hparams(_hyperparameters(trial), found)
            for summary in (experiment, start, end):
                writer.add_summary(summary, walltime=times(0))
            for place, row in enumerate(rows, 1):
                for name, value in row.values.items():
                    if name != STEPS:
                        writer.add_summary(scalar(name, value), _step(row), times(place))
            for name, value in found.items():
                writer.add_summary(scalar(name, value), trial.samples, times(len(rows)))
        finally:
            writer.close()
    return len(begun)


def _hyperparameters(trial: TrialRow) -> dict[str, Any]:
    """Parameters, and what else tells one trial from another."""
    more = {"difficulty": trial.z, "stage": trial.stage}
    return dict(trial.params) | {name: value for name, value in more.items() if value is not None}


def outcome(trial: TrialRow, behaviour: Behaviour | None) -> dict[str, float]:
    """The figures that came of a trial: value, cost, and its behaviour by name."""
    names = behaviour.names if behaviour is not None else ()
    found = {"halma/value": trial.value, "halma/samples": float(trial.samples), "halma/seconds": trial.seconds}
    found |= {f"halma/{name}": value for name, value in zip(names, trial.features or (), strict=False)}
    return {name: value for name, value in found.items() if value is not None and math.isfinite(value)}


def _step(row: MetricRow) -> int:
    samples = row.values.get(STEPS)
    return row.iteration if samples is None or not math.isfinite(samples) else round(samples)


def _times(trial: TrialRow, rows: int) -> Callable[[int], float]:
    """Wall time of each row, seconds since the epoch: 0 is the beginning, `rows` the end."""
    begin = trial.started_at.timestamp() if trial.started_at else 0.0
    end = trial.finished_at.timestamp() if trial.finished_at else begin + trial.seconds
    return lambda place: begin + (end - begin) * place / max(rows, 1)
