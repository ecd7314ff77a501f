"""Pictures and videos of recorded jumps by Bullet's software renderer: no display, no GPU.

The wall that the athlete jumps over in training is drawn as what it stands for: a bar between two posts. An obstacle is
drawn as the box that it is.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import imageio.v3 as imageio
import numpy as np
import pybullet as bullet
from numpy.typing import NDArray
from PIL import Image

from workers.contracts import BadJob
from workers.physics.athlete import JOINTS, Athlete
from workers.physics.rotations import Array
from workers.physics.world import WALL_HALF_THICKNESS, quiet
from workers.replay import Replay

Picture = NDArray[np.uint8]
"""``[height, width, 3]``, RGB."""

_SKIN = (0.85, 0.66, 0.53, 1.0)
_COLOURS = {"left": (0.93, 0.49, 0.19, 1.0), "right": (0.16, 0.45, 0.74, 1.0), "trunk": (0.30, 0.33, 0.38, 1.0)}
_BAR_HALF_WIDTH = 2.0
_KINDS = {"sphere": bullet.GEOM_SPHERE, "capsule": bullet.GEOM_CAPSULE, "box": bullet.GEOM_BOX}
_EYE = np.array([-1.7, 0.55, 3.1])
"""From what is looked at to the camera, m: beside the bar, on the side that the athlete comes from."""
_EYE_BESIDE = np.array([-0.4, 0.75, 3.2])
"""The same for an obstacle: from the side, or the box would hide who lands behind it."""


@dataclass(frozen=True, slots=True)
class Size:
    """Of a picture, in pixels."""

    width: int = 480
    height: int = 360


class Scene:
    """A Bullet world with the moving figure, the bar and the mat of one replay, to be looked at.

    Args:
        replay: what to show.
        size: of its pictures.
    """

    def __init__(self, replay: Replay, size: Size) -> None:
        self._replay = replay
        self._size = size
        self._eye = _EYE_BESIDE if has_obstacle(replay) else _EYE
        with quiet():
            self._client = bullet.connect(bullet.DIRECT)
            self._k = {"physicsClientId": self._client}
            self._athlete = Athlete(self._client) if replay.header["joints"] == [j.name for j in JOINTS] else None
            self._solids = self._loose() if self._athlete is None else []
            self._colour()
            self._furnish()

    def close(self) -> None:
        """Free Bullet's memory."""
        bullet.disconnect(self._client)

    def _loose(self) -> list[int]:
        """The bodies of a figure that is not the athlete, each on its own."""
        shapes: list[int] = []
        header = self._replay.header
        for part in header["shapes"]:
            size, side = part["size"], header["bodies"][part["body"]].split("_", maxsplit=1)[0]
            measures: dict[str, Any] = {"halfExtents": [edge / 2 for edge in size]}
            if part["shape"] != "box":
                measures = dict(zip(("radius", "length"), size, strict=False))
            shape = bullet.createVisualShape(
                _KINDS[part["shape"]],
                **measures,
                rgbaColor=_COLOURS.get(side, _COLOURS["trunk"]),
                visualFramePosition=part["offset"],
                visualFrameOrientation=part["rotation"],
                **self._k,
            )
            shapes.append(bullet.createMultiBody(0, -1, shape, [0, 0, 0], **self._k))
        return shapes

    def _place(self, frame: int) -> None:
        """Put the figure where it was in a frame."""
        arrays = self._replay.arrays
        if self._athlete is None:
            for solid, part in zip(self._solids, self._replay.header["shapes"], strict=True):
                at, turned = arrays["position"][frame, part["body"]], arrays["orientation"][frame, part["body"]]
                bullet.resetBasePositionAndOrientation(solid, at.tolist(), turned.tolist(), **self._k)
            return
        self._athlete.place(arrays["position"][frame, 0].tolist(), arrays["orientation"][frame, 0].tolist())
        self._athlete.bend(arrays["pose"][frame].astype(np.float64), arrays["rates"][frame].astype(np.float64))
        self._athlete.links()

    def _colour(self) -> None:
        if self._athlete is None:
            return
        for index, name in enumerate(self._athlete.names):
            side = name.split("_", maxsplit=1)[0]
            colour = _SKIN if name == "neck" else _COLOURS.get(side, _COLOURS["trunk"])
            bullet.changeVisualShape(self._athlete.body, index - 1, rgbaColor=colour, **self._k)

    def _furnish(self) -> None:
        bar, mat = float(self._replay.header["bar"]), float(self._replay.header["mat_height"])
        if not mat > 0:  # no jump: a track, with a line across every metre
            self._box((20.0, 0.01, 1.5), (10.0, -0.01, 0.0), (0.80, 0.42, 0.33, 1.0))
            for x in range(-9, 30):
                self._box((0.015, 0.002, 1.5), (float(x), 0.0, 0.0), (0.9, 0.9, 0.9, 1.0))
            return
        self._box((3.1, 0.01, 6.0), (-3.0, -0.01, 0.0), (0.80, 0.42, 0.33, 1.0))
        if has_obstacle(self._replay):
            wall = float(self._replay.header["wall_half_thickness"])
            self._box((2.0, mat / 2, 3.0), (wall + 2.0, mat / 2, 0.0), (0.36, 0.60, 0.52, 1.0))
            self._box((wall, bar / 2, _BAR_HALF_WIDTH), (0.0, bar / 2, 0.0), (0.95, 0.80, 0.15, 1.0))
            return
        self._box((2.0, mat / 2, 3.0), (2.05, mat / 2, 0.0), (0.36, 0.60, 0.52, 1.0))
        self._box((0.02, 0.02, _BAR_HALF_WIDTH), (0.0, bar - 0.02, 0.0), (0.95, 0.80, 0.15, 1.0))
        for z in (-_BAR_HALF_WIDTH, _BAR_HALF_WIDTH):
            self._box((0.03, bar / 2 + 0.1, 0.03), (0.0, bar / 2 + 0.1, z), (0.9, 0.9, 0.9, 1.0))

    def _box(self, half: Sequence[float], centre: Sequence[float], colour: Sequence[float]) -> None:
        shape = bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=half, rgbaColor=colour, **self._k)
        bullet.createMultiBody(0, -1, shape, centre, **self._k)

    def look(self, time: float, at: Array) -> Picture:
        """The athlete `time` seconds into the jump (the nearest frame), the camera turned to `at` ``[3]``."""
        frame = int(np.clip(round(time / float(self._replay.header["frame_seconds"])), 0, self._replay.frames - 1))
        self._place(frame)
        width, height = self._size.width, self._size.height
        view = bullet.computeViewMatrix((at + self._eye).tolist(), at.tolist(), [0, 1, 0])
        projection = bullet.computeProjectionMatrixFOV(42, width / height, 0.1, 20)
        pixels = bullet.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=[-2, 4, 3],
            shadow=1,
            renderer=bullet.ER_TINY_RENDERER,
            **self._k,
        )[2]
        return np.asarray(pixels, np.uint8).reshape(height, width, 4)[:, :, :3]


def has_obstacle(replay: Replay) -> bool:
    """Whether there is a box to be jumped over whole, and no bar."""
    return float(replay.header["wall_half_thickness"]) > WALL_HALF_THICKNESS


@contextmanager
def _scene(replay: Replay, size: Size) -> Iterator[Scene]:
    scene = Scene(replay, size)
    try:
        yield scene
    finally:
        scene.close()


def _centre_of_mass(replay: Replay, time: float) -> Array:
    """Where the body is at a time ``[3]``."""
    frame = int(np.clip(round(time / float(replay.header["frame_seconds"])), 0, replay.frames - 1))
    return np.asarray(replay.arrays["com"][frame], np.float64)


def render_frame(replay: Replay, time: float, size: Size | None = None) -> bytes:
    """A PNG of the jump at `time` (s), the athlete in its middle."""
    with _scene(replay, size or Size()) as scene:
        return _png(scene.look(time, _centre_of_mass(replay, time)))


def render_video(
    replay: Replay,
    *,
    kind: Literal["gif", "mp4"] = "gif",
    slower: float = 3.0,
    rate: int = 25,
    size: Size | None = None,
) -> bytes:
    """A GIF or an MP4 (H.264) of the whole jump.

    Args:
        replay: what to show.
        kind: which.
        slower: seconds of video for a second of jump; a jump takes less than one.
        rate: pictures a second of video. GIF counts in hundredths of a second, so a divisor of 100 plays right.
        size: in pixels; both even for MP4.
    """
    if kind not in {"gif", "mp4"}:
        raise BadJob(f"video: expected gif or mp4, found {kind!r}")
    size = size or Size()
    count = max(2, round(replay.seconds * slower * rate))
    # The camera goes along, at one height, halfway between the take-off and the highest point, so that a rise is seen.
    height = float(replay.arrays["com"][0, 1] + replay.arrays["com"][:, 1].max()) / 2
    with _scene(replay, size) as scene:
        pictures = []
        for time in np.linspace(0, replay.seconds, count):
            x, _, z = _centre_of_mass(replay, time)
            pictures.append(scene.look(time, np.array([x, height, z])))
    # the last picture stays for half a second
    pictures += [pictures[-1]] * (rate // 2)
    return _gif(pictures, rate) if kind == "gif" else _mp4(pictures, rate)


def _png(picture: Picture) -> bytes:
    return _encoded(Image.fromarray(picture))


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _gif(pictures: Sequence[Picture], rate: int) -> bytes:
    # one palette for all pictures, or the background flickers
    palette = Image.fromarray(pictures[len(pictures) // 2]).quantize(128)
    frames = [Image.fromarray(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    buffer = io.BytesIO()
    frames[0].save(buffer, "GIF", save_all=True, append_images=frames[1:], duration=round(1000 / rate), loop=0)
    return buffer.getvalue()


def _mp4(pictures: Sequence[Picture], rate: int) -> bytes:
    data: Any = imageio.imwrite(
        "<bytes>", np.stack(pictures), extension=".mp4", plugin="FFMPEG", fps=rate, codec="libx264", macro_block_size=2
    )
    return bytes(data)
