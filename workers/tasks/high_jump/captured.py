"""How far is a jump from those that an athlete was captured at?

The distance of two flights is the root mean square distance (m) of the bodies' positions relative to the root, the one
flight time-warped onto the other (dynamic time warping in its symmetric form: Sakoe and Chiba 1978, equation 11),
turned about the vertical as a whole, and mirrored where that brings it nearer. Turned, because a clip does not say
where its bar stood; mirrored, because a flop from the left foot is a flop. It is symmetric, and 0 for a flight and
itself.

    d^2 = min over path, theta, mirror of  sum w_ij mean_b |a_ib - R(theta) b_jb|^2 / (n + m)

Path and theta are found by turns, each the best for the other, from eight angles: neither step makes d larger.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workers.physics import clips
from workers.physics.clips import Clip
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.physics.world import GRAVITY
from workers.replay import Replay

FOLDER = "HALMA_CLIPS"
"""Environment variable that names the folder of captured jumps. Without one, jumps have no distance to any."""
PERIOD = 1 / 30
"""Seconds between two frames that are compared."""
LIKE = 0.45
"""m within which a jump may be called like a captured one. Those captured of one athlete are 0.54 to 0.63 m apart."""
CLEARLY = 0.1
"""m that it must be nearer to it than to the next one."""
_STARTS = 8
_TITLES = {"fosbury_flop": "Fosbury flop", "scissor": "scissor kick", "straddle": "straddle"}
_FILES = re.compile(r"(?:.*_)?high_jump_+(?P<name>.+?)(?:_\d+)?\.txt")
Flight = Array
"""Bodies' positions relative to the root while in the air ``[frame, 13, 3]``, m, `PERIOD` apart."""


@dataclass(frozen=True, slots=True)
class Likeness:
    """The captured jump nearest to a jump.

    Args:
        name: of the captured jump.
        distance: to it, m.
    """

    name: str
    distance: float


def captured_jumps(folder: Path | None = None) -> Mapping[str, Flight]:
    """The captured high jumps by name, of a folder or that which `HALMA_CLIPS` names; empty where there is none.

    Files are named `*high_jump__NAME_NN.txt`; others are left alone. Raises `BadClip` for one that can't be read.
    """
    place = folder or Path(os.environ.get(FOLDER) or "")
    return _jumps_in(place.expanduser().absolute()) if folder or os.environ.get(FOLDER) else {}


@functools.cache
def _jumps_in(folder: Path) -> Mapping[str, Flight]:
    found = {}
    for path in sorted(folder.glob("*.txt")):
        match = _FILES.fullmatch(path.name)
        if match is None:
            continue
        name = _TITLES.get(match["name"], match["name"].replace("_", " "))
        found[name] = flight_of_clip(clips.read(path))
    return found


def flight_of_replay(replay: Replay) -> Flight:
    """The flight of a recorded jump: from its last touch of the ground to its first of the mat."""
    start, end = flight_frames(replay)
    position = replay.arrays["position"][start:end].astype(np.float64)
    return _relative(position, float(replay.header["frame_seconds"]))


def flight_frames(replay: Replay) -> tuple[int, int]:
    """First frame of a recorded jump's flight, and the one behind its last."""
    ground, mat = replay.arrays["touching"][:, 0] > 0, replay.arrays["touching"][:, 2] > 0
    end = int(np.argmax(mat)) if mat.any() else replay.frames
    before = np.flatnonzero(ground[:end])
    return (int(before[-1]) + 1 if len(before) else 0), end


def flight_of_clip(clip: Clip) -> Flight:
    """The flight of a captured jump (see `flight_span`). Raises `BadClip` where there is none."""
    start, end = flight_span(clip)
    return _relative(skeleton().forward(clip.pose, clip.root, clip.orientation).position[start:end], clip.period)


def flight_span(clip: Clip) -> tuple[int, int]:
    """First frame of a captured jump's flight, and the one behind its last: where its centre of mass falls longest.

    Capture tells no contacts, and its second derivative is rough: what counts as falling freely is half of gravity.
    Raises `BadClip` where there is no such stretch.
    """
    body = skeleton()
    height = body.centre_of_mass(body.forward(clip.pose, clip.root, clip.orientation).position)[:, 1]
    free = np.gradient(np.gradient(height, clip.period), clip.period) < -GRAVITY / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], free, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    if len(starts) == 0:
        raise clips.BadClip("captured jump: expected a flight, found none in which the centre of mass falls freely")
    longest = int((ends - starts).argmax())
    return int(starts[longest]), int(ends[longest])


def _relative(position: Array, period: float) -> Flight:
    """Positions ``[frame, 13, 3]`` relative to the root, `PERIOD` apart."""
    relative = position - position[:, :1]
    count = max(1, round((len(position) - 1) * period / PERIOD) + 1)
    at = np.minimum(np.arange(count) * PERIOD / period, len(position) - 1)
    before = np.minimum(at.astype(int), max(len(position) - 2, 0))
    after = np.minimum(before + 1, len(position) - 1)
    share = (at - before)[:, None, None]
    return np.asarray((1 - share) * relative[before] + share * relative[after])


def mirrored(flight: Flight) -> Flight:
    """The flight of an athlete whose left is its right."""
    names = skeleton().names
    other = [names.index(_other_side(name)) for name in names]
    return np.asarray(flight[:, other] * np.array([1.0, 1.0, -1.0]))


def _other_side(name: str) -> str:
    for side, opposite in (("left_", "right_"), ("right_", "left_")):
        if name.startswith(side):
            return opposite + name.removeprefix(side)
    return name


def distance(a: Flight, b: Flight) -> float:
    """Distance of two flights, m (see the module)."""
    return min(_turned_distance(a, b), _turned_distance(a, mirrored(b)))


def _turned_distance(a: Flight, b: Flight) -> float:
    """Smallest distance over all turns of `b` about the vertical."""
    bodies = a.shape[1] - 1  # all but the root, which lies at 0 in both
    square = (a**2).sum((1, 2))[:, None] + (b**2).sum((1, 2))[None]
    ax, ay, az = np.moveaxis(a, 2, 0)
    bx, by, bz = np.moveaxis(b, 2, 0)
    # a . R(theta) b = along cos(theta) + across sin(theta) + upright
    along, across, upright = ax @ bx.T + az @ bz.T, ax @ bz.T - az @ bx.T, ay @ by.T
    best = np.inf
    for theta in np.arange(_STARTS) * (2 * np.pi / _STARTS):
        found = np.inf
        while True:
            cost = np.maximum(square - 2 * (along * np.cos(theta) + across * np.sin(theta) + upright), 0.0) / bodies
            total, weights = warp(cost)
            if not total < found - 1e-12:
                break
            found = total
            theta = np.arctan2((weights * across).sum(), (weights * along).sum())  # noqa: PLW2901 - it is refined
        best = min(best, found)
    return float(np.sqrt(best / (len(a) + len(b))))


def warp(cost: Array) -> tuple[float, Array]:
    """The cheapest monotone path through a cost matrix ``[n, m]``, from its first to its last element.

    Returns its cost and its weights ``[n, m]``: 2 for the first element and those reached diagonally, 1 for those
    reached by a step in one direction, 0 off the path; they add up to n + m.
    """
    n, m = cost.shape
    rows = cost.tolist()  # plain Python: elements one by one are several times dearer in numpy
    totals = [[np.inf] * m for _ in range(n)]
    came: list[list[int]] = [[0] * m for _ in range(n)]  # 0 diagonally (or at the start), 1 from above, 2 from the left
    for i in range(n):
        for j in range(m):
            c = rows[i][j]
            if i == 0 and j == 0:
                totals[0][0] = 2 * c
                continue
            diagonal = totals[i - 1][j - 1] + 2 * c if i and j else np.inf
            above = totals[i - 1][j] + c if i else np.inf
            left = totals[i][j - 1] + c if j else np.inf
            least = min(diagonal, above, left)
            totals[i][j] = least
            came[i][j] = 0 if least == diagonal else 1 if least == above else 2
    weights = np.zeros((n, m))
    i, j = n - 1, m - 1
    while i or j:
        way = came[i][j]
        weights[i, j] = 1.0 if way else 2.0
        i, j = i - (way != 2), j - (way != 1)
    weights[0, 0] = 2.0
    return float(totals[-1][-1]), weights


def distances(replay: Replay, jumps: Mapping[str, Flight]) -> dict[str, float]:
    """Distance (m) of a recorded jump to each captured one, by name; empty where it has no flight to compare."""
    flight = flight_of_replay(replay)
    return {name: distance(flight, jump) for name, jump in jumps.items()} if len(flight) > 1 else {}


def likeness(found: Mapping[str, float]) -> Likeness | None:
    """The nearest captured jump, where it is near enough to lend its name, and clearly nearer than the others."""
    if not found:
        return None
    (nearest, name), *others = sorted((metres, name) for name, metres in found.items())
    clear = not others or others[0][0] - nearest >= CLEARLY
    return Likeness(name, nearest) if nearest <= LIKE and clear else None
