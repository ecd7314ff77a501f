"""A walk as it happened, in the file that jumps are kept in (`workers.replay`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON
from workers.physics.rotations import Array
from workers.replay import ARRAYS, FORMAT, VERSION, Replay
from workers.tasks.walker.body import HINGES
from workers.tasks.walker.world import CONTROL, WalkerWorld


@dataclass(slots=True)
class WalkRecorder:
    """Collects the frames of an episode: every second control step, which is 30 a second.

    Args:
        task: what the task wants to keep in the header.
    """

    task: Mapping[str, JSON] = field(default_factory=dict)
    every: int = 2
    _rows: dict[str, list[NDArray[np.float32]]] = field(default_factory=dict, init=False)
    _header: dict[str, JSON] = field(default_factory=dict, init=False)
    _steps: int = field(default=0, init=False)

    def start(self, world: WalkerWorld) -> None:
        """Forget what was recorded, note how the walker is built, and record how it stands."""
        figure = world.figure
        self._rows = {name: [] for name in ARRAYS}
        self._header = {
            "format": FORMAT,
            "version": VERSION,
            "frame_seconds": CONTROL * self.every,
            "bodies": [body.name for body in figure.bodies],
            "joints": [hinge.name for hinge in HINGES],
            "shapes": figure.shapes(),
            "masses": [body.solid.mass for body in figure.bodies],
            "bar": 0.0,
            "mat_height": 0.0,
            "wall_half_thickness": 0.0,
            "foot": "right_foot",
        }
        self._steps = -1
        self.add(world, np.zeros(len(HINGES)))

    def add(self, world: WalkerWorld, torques: Array) -> None:
        """Record the world as it stands after a control step, where it is this one's turn."""
        self._steps += 1
        if self._steps % self.every:
            return
        links = world.links()
        angles, rates = world.joints()
        force, point = world.contacts()
        share = np.array(self._header["masses"]) / sum(self._header["masses"])
        push = float(force[:, 1].sum())
        row = {
            "position": links[:, :3],
            "orientation": links[:, 3:7],
            "pose": angles,
            "rates": rates,
            "torque": torques,
            "com": share @ links[:, :3],
            "com_velocity": share @ links[:, 7:10],
            "ground_force": push,
            "ground_peak": push,
            "penetration": 0.0,
            "overlap": 0.0,
            "touching": [np.count_nonzero(force[:, 1]), 0, 0],
            "contact_force": force,
            "contact_point": point,
        }
        for name, values in row.items():
            self._rows[name].append(np.asarray(values, np.float32))

    def replay(self) -> Replay:
        """The episode recorded since `start`."""
        arrays = {name: np.stack(rows) for name, rows in self._rows.items()}
        return Replay({**self._header, "frames": len(arrays["com"]), "task": dict(self.task)}, arrays)
