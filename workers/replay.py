"""A jump as it happened: poses over time and what they touched, in a file that a browser can read.

The file `replay.bin`, little-endian throughout::

    uint32             length of the header in bytes (a multiple of 4)
    header             JSON (UTF-8), padded with spaces
    float32 ...        the arrays, one after the other, C order, in the order of the header's `arrays`

The header names each array with its shape and its offset (bytes from the end of the header), so that a reader needs no
knowledge of this module: `new Float32Array(buffer, 4 + length + offset, count)`. See `Replay` for what they hold.
"""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workers.contracts import JSON, BadJob
from workers.physics.athlete import COORDINATES, JOINTS, Joint
from workers.physics.world import FRAME, GRAVITY, Contacts, World

FORMAT = "halma-replay"
VERSION = 1
ARRAYS: Mapping[str, tuple[int | str, ...]] = {
    "position": ("frame", "body", 3),
    "orientation": ("frame", "body", 4),
    "pose": ("frame", "coordinate"),
    "rates": ("frame", "coordinate"),
    "torque": ("frame", "coordinate"),
    "com": ("frame", 3),
    "com_velocity": ("frame", 3),
    "ground_force": ("frame",),
    "ground_peak": ("frame",),
    "penetration": ("frame",),
    "overlap": ("frame",),
    "touching": ("frame", 3),
    "contact_force": ("frame", "body", 3),
    "contact_point": ("frame", "body", 3),
}
"""Arrays of a replay with the meaning of their axes."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A recorded jump.

    `header` holds `format`, `version`, `frames`, `frame_seconds`, `bodies` (names), `joints` (names), `shapes` (of the
    bodies, see `World.body_shapes`), `masses` (of the bodies, kg), `bar`, `mat_height`, `wall_half_thickness` (m),
    `foot` (name of the take-off foot), `gravity` (m/s^2, where it is not the Earth's), `changed_joints` (fields of each
    `Joint` that is not the usual one, where there are any), and whatever the task adds under `task`.

    `arrays`, float32, world frame (x through the bar, y up):

    - `position` (m) and `orientation` (x y z w) of each body's centre of mass ``[frame, 13, 3 | 4]``
    - `pose` and `rates` of the joints ``[frame, 28]`` (rad, rad/s), `torque` at its start ``[frame, 28]`` (N m)
    - `com`, `com_velocity`: of the whole body ``[frame, 3]`` (m, m/s)
    - `ground_force`, `ground_peak`: normal force of the ground, mean and peak of the frame ``[frame]`` (N)
    - `penetration`, `overlap`: deepest overlap with the surroundings, and of the body with itself ``[frame]`` (m)
    - `touching`: number of bodies on ground, wall and mat ``[frame, 3]``
    - `contact_force`: of ground, wall and mat together on each body, mean over the frame ``[frame, 13, 3]`` (N)
    - `contact_point`: where it acts: the mean of the contact points, weighted by their normal forces
      ``[frame, 13, 3]`` (m); 0 where nothing is touched

    A file without the last two (written before they were recorded) reads as one without contact.
    """

    header: Mapping[str, JSON]
    arrays: Mapping[str, NDArray[np.float32]]

    def joints(self) -> tuple[Joint, ...]:
        """What the athlete's joints could do. Raises `BadJob` where the header says something else than that."""
        changed = {}
        try:
            for given in self.header.get("changed_joints", ()):
                changed[given["name"]] = Joint(**{**given, "low": tuple(given["low"]), "high": tuple(given["high"])})
        except (KeyError, TypeError) as error:
            raise BadJob(
                f"replay: expected the changed joints of an athlete, found something else ({error})"
            ) from error
        return tuple(changed.get(joint.name, joint) for joint in JOINTS)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.arrays["com"])

    @property
    def seconds(self) -> float:
        """Duration."""
        return (self.frames - 1) * float(self.header["frame_seconds"])

    def to_bytes(self) -> bytes:
        """The container; equal replays give equal bytes."""
        layout: list[JSON] = []
        offset = 0
        for name in ARRAYS:
            array = self.arrays[name]
            layout.append({"name": name, "shape": list(array.shape), "offset": offset})
            offset += 4 * array.size
        text = json.dumps({**self.header, "arrays": layout}, sort_keys=True, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        body = b"".join(np.ascontiguousarray(self.arrays[name], "<f4").tobytes() for name in ARRAYS)
        return struct.pack("<I", len(text)) + text + body

    @classmethod
    def from_bytes(cls, data: bytes) -> Replay:
        """What `to_bytes` gave. Raises `BadJob` where it is something else, or cut short."""
        try:
            (length,) = struct.unpack_from("<I", data)
            header = json.loads(data[4 : 4 + length])
            if header["format"] != FORMAT or header["version"] != VERSION:
                raise BadJob(
                    f"replay: expected {FORMAT} version {VERSION}, found {header['format']} version {header['version']}"
                )
            arrays = {
                entry["name"]: np.frombuffer(
                    data, "<f4", int(np.prod(entry["shape"])), 4 + length + entry["offset"]
                ).reshape(entry["shape"])
                for entry in header.pop("arrays")
            }
            for name in ("contact_force", "contact_point"):
                arrays.setdefault(name, np.zeros(arrays["position"].shape, np.float32))
            return cls(header, {name: arrays[name] for name in ARRAYS})
        except (struct.error, KeyError, TypeError, ValueError) as error:
            raise BadJob(f"replay: expected a replay.bin written by halma, found something else ({error})") from error


@dataclass(slots=True)
class Recorder:
    """Collects the frames of an episode.

    Args:
        foot: name of the body that may touch the ground.
        task: what the task wants to keep in the header.
        frame_seconds: between two frames.
    """

    foot: str
    task: Mapping[str, JSON] = field(default_factory=dict)
    frame_seconds: float = FRAME
    _rows: dict[str, list[NDArray[np.float32]]] = field(default_factory=dict, init=False)
    _header: dict[str, JSON] = field(default_factory=dict, init=False)

    def start(self, world: World) -> None:
        """Forget what was recorded and note how the world is built."""
        self._rows = {name: [] for name in ARRAYS}
        self._header = {
            "format": FORMAT,
            "version": VERSION,
            "frame_seconds": self.frame_seconds,
            "bodies": list(world.athlete.names),
            "joints": [joint.name for joint in JOINTS],
            "shapes": world.body_shapes(),
            "masses": world.athlete.mass.tolist(),
            "bar": world.bar,
            "mat_height": world.mat_height,
            "wall_half_thickness": world.wall_half_thickness,
            "foot": self.foot,
        }
        if world.gravity != GRAVITY:  # replays on Earth stay what they were, bit for bit
            self._header["gravity"] = world.gravity
        changed = [
            dataclasses.asdict(joint) for joint, usual in zip(world.joints, JOINTS, strict=True) if joint != usual
        ]
        if changed:
            self._header["changed_joints"] = changed

    def add(self, world: World, contacts: Contacts) -> None:
        """Record the world as it stands after a frame, with that frame's contacts."""
        athlete = world.athlete
        links = athlete.links()
        pose, rates = athlete.pose()
        row = {
            "position": links[:, :3],
            "orientation": links[:, 3:7],
            "pose": pose,
            "rates": rates,
            "torque": np.zeros(COORDINATES) if contacts.torque is None else contacts.torque,
            "com": athlete.centre_of_mass(links),
            "com_velocity": athlete.centre_of_mass(links[:, 7:10]),
            "ground_force": contacts.ground_force,
            "ground_peak": contacts.ground_peak,
            "penetration": contacts.penetration,
            "overlap": contacts.overlap,
            "touching": [len(contacts.ground), len(contacts.wall), len(contacts.mat)],
            **_contact_rows(contacts, len(links)),
        }
        for name, values in row.items():
            self._rows[name].append(np.asarray(values, np.float32))

    def replay(self) -> Replay:
        """The episode recorded since `start`."""
        arrays = {name: np.stack(rows) for name, rows in self._rows.items()}
        return Replay({**self._header, "frames": len(arrays["com"]), "task": dict(self.task)}, arrays)


def _contact_rows(contacts: Contacts, bodies: int) -> dict[str, NDArray[np.float64]]:
    """Force on each body and where it acts, ``[body, 3]`` each."""
    force, point = np.zeros((bodies, 3)), np.zeros((bodies, 3))
    for link, push in contacts.pushes.items():
        force[link + 1] = push[:3]
        if push[3] > 0:
            point[link + 1] = push[4:] / push[3]
    return {"contact_force": force, "contact_point": point}
