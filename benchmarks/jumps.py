"""How soon a jump is learnt, and how natural it looks, under each of several settings, in one run.

    OMP_NUM_THREADS=1 python benchmarks/jumps.py                        # P-VAE actions beside plain ones
    OMP_NUM_THREADS=1 python benchmarks/jumps.py --compare curriculum   # by success, by reward as published, ...
    OMP_NUM_THREADS=1 python benchmarks/jumps.py --compare rate         # 10 Hz throughout, 10 -> 30 Hz by difficulty
    OMP_NUM_THREADS=1 python benchmarks/jumps.py --compare evaluation --states all --seeds 5

Each training begins from one of the published take-off states of the high jump (Yin et al. 2021) and ends when the bar
at z_freeze is mastered, or its samples are spent. Printed for each: CPU minutes, the bar that the curriculum came to,
the highest bar cleared in an audited jump, how the athlete faces over it (rad), and how far the jump's poses are from
captured ones: for each frame of the flight the nearest captured pose (packaged clips), bodies relative to the root and
in its frame, mean distance, m. A training has reached z_freeze once it has mastered it (half an iteration's jumps).
Variants alternate within each seed, so that whatever else the machine does hits all alike; CPU seconds of this process.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from workers.contracts import Job
from workers.local_context import LocalContext
from workers.physics import clips
from workers.physics.kinematics import skeleton
from workers.replay import Replay
from workers.run import run
from workers.tasks.high_jump.captured import flight_frames

STATES: dict[str, dict[str, float]] = {
    "Fosbury flop": {"v_z": -2.40, "omega_x": -3.00, "omega_z": 1.00, "alpha": -0.05},
    "Western roll": {"v_z": -0.50, "omega_x": 1.00, "omega_z": -1.00, "alpha": 2.09},
    "straddle": {"v_z": -2.21, "omega_x": 1.00, "omega_z": 0.88, "alpha": 1.65},
    "front kick": {"v_z": -0.52, "omega_x": 1.00, "omega_z": -0.26, "alpha": 0.45},
    "side dive": {"v_z": -1.83, "omega_x": -2.78, "omega_z": -0.32, "alpha": 1.18},
    "side jump": {"v_z": -1.99, "omega_x": -1.44, "omega_z": 0.44, "alpha": 0.70},
}
VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "poses": {
        "offset": {},
        "pose": {"actions": "pose"},
        "pose 12 -> 8": {"actions": "pose", "offset_easy": 12.0, "offset_hard": 8.0},
    },
    "curriculum": {
        "success": {},
        "reward 30": {"curriculum": "reward", "bar_step": 0.01},
        "reward 1": {"curriculum": "reward", "bar_step": 0.02, "reward_threshold": 1.0},
    },
    "rate": {"10 Hz": {}, "10 -> 30 Hz": {"control_rate_hard": 30}},
    "evaluation": {"pose": {"actions": "pose"}},
}


def captured_poses() -> cKDTree:
    """All poses of the packaged clips, as positions of the bodies in the root's frame."""
    return cKDTree(np.concatenate([places(clips.read(path).pose) for path in clips.packaged()]))


def places(pose: np.ndarray) -> np.ndarray:
    """Bodies in poses ``[n, 28]`` relative to the root and in its frame ``[n, 39]``, m."""
    n = len(pose)
    position = skeleton().forward(pose, np.zeros((n, 3)), np.tile([0.0, 0, 0, 1], (n, 1))).position
    return np.asarray(position.reshape(n, -1))


def unnaturalness(replay: Replay, captured: cKDTree) -> float:
    """Mean over the flight of the distance to the nearest captured pose: root mean square over the bodies, m."""
    start, end = flight_frames(replay)
    distance, _ = captured.query(places(replay.arrays["pose"][start:end].astype(np.float64)))
    return float(np.mean(distance) / np.sqrt(len(skeleton().names)))


def train(state: str, settings: dict[str, Any], samples: int, seed: int, captured: cKDTree) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        context = LocalContext(Path(folder))
        start = time.process_time()
        training = {"budget": {"samples": samples}}
        outcome = run(Job("benchmark", 0, "high_jump", STATES[state], seed, settings, training), context)
        spent = (time.process_time() - start) / 60
        curve = [(int(r["metrics"]["samples"]), float(r["metrics"]["level"])) for r in context.reports()]
        mastered = max((float(r["metrics"].get("level_mastered", 0.0)) for r in context.reports()), default=0.0)
        far = None
        if outcome.status == "complete":
            far = unnaturalness(Replay.from_bytes(context.artifact("replay.bin")), captured)
        return {
            "minutes": spent, "curve": curve, "level": outcome.details.get("level"), "value": outcome.value,
            "facing": outcome.details.get("facing"), "samples": outcome.cost.samples,
            "reached": mastered >= settings["z_freeze"], "far": far,
            "name": outcome.details.get("name") or outcome.message,
        }  # fmt: skip


def show(figure: float | None, digits: int) -> str:
    return "-" if figure is None else f"{figure:.{digits}f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compare", choices=list(VARIANTS), default="poses")
    parser.add_argument("--states", default="side jump", help="names, separated by commas, or all")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--samples", type=int, default=15_000)
    parser.add_argument("--z-freeze", type=float, default=1.0)
    parser.add_argument("--json", type=Path, help="write everything there, curves too")
    options = parser.parse_args()
    states = list(STATES) if options.states == "all" else [name.strip() for name in options.states.split(",")]
    variants = VARIANTS[options.compare]
    captured = captured_poses()
    if options.compare in {"poses", "evaluation"}:
        from workers.poses.training import default_model  # noqa: PLC0415 - trained once, outside of the timings

        default_model()
    print(f"{'state':14}{'variant':14}{'seed':>5}{'CPU min':>9}{'level':>7}{'bar':>7}{'facing':>8}{'far (m)':>9}  name")
    rows: list[dict[str, Any]] = []
    for seed in range(1, options.seeds + 1):
        for state in states:
            for name, settings in variants.items():
                asked = {"z_freeze": options.z_freeze, **settings}
                row = {"state": state, "variant": name, "seed": seed}
                row |= train(state, asked, options.samples, seed, captured)
                rows.append(row)
                print(
                    f"{state:14}{name:14}{seed:5d}{row['minutes']:9.2f}{show(row['level'], 2):>7}"
                    f"{show(row['value'], 2):>7}{show(row['facing'], 2):>8}{show(row['far'], 3):>9}  {row['name']}",
                    flush=True,
                )
                if options.json:
                    options.json.write_text(json.dumps(rows))
    print("\nmedians, and the range of the minutes")
    print(f"{'variant':14}{'reached':>9}{'CPU min':>17}{'level':>7}{'bar':>7}{'far (m)':>9}")
    for name in variants:
        own = [row for row in rows if row["variant"] == name]
        minutes = [row["minutes"] for row in own]
        spread = f"{statistics.median(minutes):.2f} ({min(minutes):.1f}-{max(minutes):.1f})"

        def middle(key: str, own: list[dict[str, Any]] = own) -> float | None:
            known = [row[key] for row in own if row[key] is not None]
            return statistics.median(known) if known else None

        print(
            f"{name:14}{sum(row['reached'] for row in own):>6}/{len(own)}{spread:>17}{show(middle('level'), 2):>7}"
            f"{show(middle('value'), 2):>7}{show(middle('far'), 3):>9}"
        )


if __name__ == "__main__":
    main()
