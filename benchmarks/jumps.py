"""How soon a jump is learnt, and how natural it looks, under each of several settings, in one run.

    OMP_NUM_THREADS=1 python -m benchmarks.jumps                        # P-VAE actions beside plain ones
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --print --pictures poses.png      # what that looks like
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --compare variations   # a weak leg, a stiff spine, a cast, Mars, ...
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --compare curriculum   # by success, by reward as published, ...
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --compare rate         # 10 Hz throughout, 10 -> 30 Hz by difficulty
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --compare evaluation --states all --seeds 5 --samples 100000
    OMP_NUM_THREADS=1 python -m benchmarks.jumps --compare run_up       # the curved sprint needs ../shared/mocap/jumps
    python -m benchmarks.jumps --compare evaluation --print             # what is on file

Each training begins from one of the published take-off states of the high jump (Yin et al. 2021) and ends when the bar
at z_freeze is mastered, or its samples are spent. Printed for each: CPU minutes, the bar that the curriculum came to,
the highest bar cleared in an audited jump, how the athlete faces over it (rad), and how far the jump's poses are from
captured ones: for each frame of the flight the nearest captured pose, bodies relative to the root and in its frame,
mean distance, m; of the packaged clips (`far`), and of the CMU clips as well where ../shared/mocap/poses is (`far
CMU`). Each training leaves a picture in `benchmarks/results/jumps-COMPARE`; `--pictures FILE` puts them on one sheet. A
training has reached z_freeze once it has mastered it (half an iteration's jumps). Variants alternate within each seed,
so that whatever else the machine does hits all alike; CPU seconds of this process.

A training is a row, a JSON line, appended to `benchmarks/figures/jumps-COMPARE.jsonl` when it is over, with the
revision of the code; what has a row for the same bounds is not trained again. A comparison may take several sittings,
and several of them at once where they have other states. `--print` shows all rows, whatever their bounds.

Below the medians, how alike the jumps of one take-off state with other seeds are, against those of other states: the
distances (rad) by facing and by rotation. What counts as another strategy must lie between the two.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.search.diversity import RESULTS
from benchmarks.tuning import PHYSICS, read, revision
from services.contact_sheet import POSE, Tile, draw
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.physics import clips
from workers.physics.kinematics import skeleton
from workers.poses.training import default_model, gather, write
from workers.poses.training import train as train_poses
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
MOCAP = Path(__file__).resolve().parents[2] / "shared" / "mocap"
CLIPS = MOCAP / "jumps"
CMU = MOCAP / "poses"
CMU_MODEL = RESULTS / "poses-cmu.safetensors"
VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "poses": {
        "offset": {},
        "pose": {"actions": "pose"},
        "pose, CMU": {"actions": "pose", "poses": str(CMU_MODEL)},
    },
    "curriculum": {
        "success": {},
        "reward 30": {"curriculum": "reward", "bar_step": 0.01},
        "reward 1": {"curriculum": "reward", "bar_step": 0.02, "reward_threshold": 1.0},
    },
    "rate": {"10 Hz": {}, "10 -> 30 Hz": {"control_rate_hard": 30}},
    "evaluation": {"pose": {"actions": "pose"}},
    "variations": {
        "none": {"actions": "pose"},
        "weak leg": {"actions": "pose", "take_off_leg": 0.6},
        "stiff spine": {"actions": "pose", "spine": "stiff"},
        "cast": {"actions": "pose", "cast": "swing"},
        "on the feet": {"actions": "pose", "landing": "feet"},
        "Mars": {"actions": "pose", "gravity": 3.711},
        "no P-VAE": {},
    },
    "run_up": {
        "none": {},
        "packaged run": {"run_up": True},
        "curved sprint": {"run_up": True, "run_up_clip": str(CLIPS / "VC5_sprint__curves_03.txt")},
    },
}
FIGURES = Path(__file__).parent / "figures"


def captured_poses() -> dict[str, cKDTree]:
    """Of the packaged clips, and with the CMU clips where they are: places of the bodies in the root's frame."""
    packaged = places(gather(clips.packaged()))
    trees = {"far": cKDTree(packaged)}
    if CMU.is_dir():
        trees["far_cmu"] = cKDTree(np.concatenate([packaged, places(gather(cmu_clips()))]))
    return trees


def cmu_clips() -> list[Path]:
    return sorted(CMU.rglob("*.txt"))


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


def train(
    state: str, settings: dict[str, Any], samples: int, seed: int, captured: dict[str, cKDTree], picture: Path
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        context = LocalContext(Path(folder))
        start = time.process_time()
        training = {"budget": {"samples": samples}}
        outcome = run(Job("benchmark", 0, "high_jump", STATES[state], seed, settings, training), context)
        spent = (time.process_time() - start) / 60
        curve = [(int(r["metrics"]["samples"]), float(r["metrics"]["level"])) for r in context.reports()]
        mastered = max((float(r["metrics"].get("level_mastered", 0.0)) for r in context.reports()), default=0.0)
        far: dict[str, float] = {}
        if outcome.status == "complete":
            replay = Replay.from_bytes(context.artifact("replay.bin"))
            far = {name: unnaturalness(replay, tree) for name, tree in captured.items()}
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes(context.artifact(POSE))
        return {
            "minutes": spent, "curve": curve, "level": outcome.details.get("level"), "value": outcome.value,
            "facing": outcome.details.get("facing"), "rotation": outcome.details.get("rotation"),
            "samples": outcome.cost.samples,
            "reached": mastered >= settings["z_freeze"], "far": None, **far,
            "name": outcome.details.get("name") or outcome.message,
        }  # fmt: skip


def show(figure: float | None, digits: int) -> str:
    return "-" if figure is None else f"{figure:.{digits}f}"


def apart(one: dict[str, Any], other: dict[str, Any]) -> tuple[float, float]:
    """How differently two jumps face and are turned over the bar, rad."""
    alike = abs(float(np.dot(one["rotation"], other["rotation"])))
    return abs(one["facing"] - other["facing"]), 2 * float(np.arccos(min(alike, 1.0)))


def print_rows(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        print(
            f"{row['state']:14}{row['variant']:14}{row['seed']:5d}{row['minutes']:9.2f}{row['samples']:9,}"
            f"{show(row['level'], 2):>7}{show(row['value'], 2):>7}{show(row['facing'], 2):>8}{show(row['far'], 3):>9}"
            f"{show(row.get('far_cmu'), 3):>9}"
            f"  {row['name']}",
            flush=True,
        )


def print_medians(rows: list[dict[str, Any]]) -> None:
    print(
        f"\n{'variant':14}{'state':14}{'reached':>9}{'CPU min':>19}{'bar':>7}{'far (m)':>9}{'far CMU':>9}"
        "   medians, and their range"
    )
    for variant in dict.fromkeys(row["variant"] for row in rows):
        of_variant = [row for row in rows if row["variant"] == variant]
        for state in [*dict.fromkeys(row["state"] for row in of_variant), "all"]:
            own = [row for row in of_variant if state in {"all", row["state"]}]
            minutes = [row["minutes"] for row in own]
            spread = f"{statistics.median(minutes):.2f} ({min(minutes):.2f}-{max(minutes):.2f})"
            print(
                f"{variant:14}{state:14}{sum(row['reached'] for row in own):>6}/{len(own)}{spread:>19}"
                f"{show(_middle(own, 'value'), 2):>7}{show(_middle(own, 'far'), 3):>9}"
                f"{show(_middle(own, 'far_cmu'), 3):>9}"
            )


def _middle(rows: list[dict[str, Any]], key: str) -> float | None:
    known = [row[key] for row in rows if row.get(key) is not None]
    return statistics.median(known) if known else None


def print_distances(rows: list[dict[str, Any]]) -> None:
    print(f"\n{'variant':14}{'pairs':>16}{'facing: median, 90 %':>24}{'rotation: median, 90 %':>26}")
    for variant in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == variant and row["rotation"] is not None]
        pairs = [(a["state"] == b["state"], apart(a, b)) for a, b in combinations(own, 2)]
        for same, name in ((True, "of one state"), (False, "of two states")):
            found = np.array([distance for alike, distance in pairs if alike is same])
            if len(found):
                (f50, r50), (f90, r90) = np.quantile(found, [0.5, 0.9], axis=0)
                print(f"{variant:14}{len(found):4d} {name}{f50:16.2f} {f90:7.2f}{r50:18.2f} {r90:7.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compare", choices=list(VARIANTS), default="poses")
    parser.add_argument("--states", default="side jump", help="names, separated by commas, or all")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--samples", type=int, default=15_000)
    parser.add_argument("--z-freeze", type=float, default=1.0)
    parser.add_argument("--results", type=Path, help="where rows are; default: benchmarks/figures/jumps-COMPARE.jsonl")
    parser.add_argument("--print", action="store_true", help="only print what is on file")
    parser.add_argument("--pictures", type=Path, help="PNG: what each training came to, where its picture is kept")
    options = parser.parse_args()
    states = list(STATES) if options.states == "all" else [name.strip() for name in options.states.split(",")]
    path = options.results or FIGURES / f"jumps-{options.compare}.jsonl"
    bounds = {"physics": PHYSICS, "samples_allowed": options.samples, "z_freeze": options.z_freeze}
    print(f"{'state':14}{'variant':14}{'seed':>5}{'CPU min':>9}{'samples':>9}", end="")
    print(f"{'level':>7}{'bar':>7}{'facing':>8}{'far (m)':>9}{'far CMU':>9}  name")
    rows = [row for row in read(path) if options.print or bounds.items() <= row.items()]
    print_rows(rows)
    if not options.print:
        _train_what_is_missing(options.compare, states, options.seeds, bounds, rows, path)
    if rows:
        print_medians(rows)
        print_distances(rows)
    if options.pictures:
        tiles = [tile for row in rows if (tile := _tile(options.compare, row))]
        print(f"Picture: {draw(tiles, options.pictures)}" if tiles else "Picture: none is kept")


def kept_picture(compare: str, row: dict[str, Any]) -> Path:
    name = "-".join(str(row[key]) for key in ("state", "variant", "seed")).replace(" ", "_").replace(",", "")
    return RESULTS / f"jumps-{compare}" / f"{name}.png"


def _tile(compare: str, row: dict[str, Any]) -> Tile | None:
    path = kept_picture(compare, row)
    if not path.exists():
        return None
    title = f"{row['state']}, {row['variant']}, seed {row['seed']}"
    return Tile(
        path.read_bytes(), title, f"bar {show(row['value'], 2)} m, poses {show(row['far'], 3)} m; {row['name']}"
    )


def _train_what_is_missing(
    compare: str, states: list[str], seeds: int, bounds: dict[str, Any], rows: list[dict[str, Any]], path: Path
) -> None:
    captured = captured_poses()
    _train_pose_models(compare)
    path.parent.mkdir(parents=True, exist_ok=True)
    known = {(row["state"], row["variant"], row["seed"]) for row in rows}
    for seed in range(1, seeds + 1):
        for state in states:
            for variant, settings in VARIANTS[compare].items():
                if settings.get("poses") == str(CMU_MODEL) and not CMU_MODEL.exists():
                    continue
                if (state, variant, seed) in known:
                    continue
                asked = {"z_freeze": bounds["z_freeze"], **settings}
                row = {"state": state, "variant": variant, "seed": seed, **bounds, "revision": revision()}
                row |= train(state, asked, bounds["samples_allowed"], seed, captured, kept_picture(compare, row))
                rows.append(row)
                with path.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print_rows([row])


def _train_pose_models(compare: str) -> None:
    """Once, outside of the timings."""
    used = VARIANTS[compare].values()
    if any(settings.get("actions") == "pose" for settings in used):
        default_model()
    if any("poses" in settings for settings in used) and CMU.is_dir() and not CMU_MODEL.exists():
        write(train_poses(gather(cmu_clips())), CMU_MODEL)


if __name__ == "__main__":
    main()
