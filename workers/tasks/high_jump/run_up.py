"""The run-up: the athlete runs up to a take-off state, so that run-up and jump are one motion of one simulation.

The reference is a captured run, at the speed of the approach, that turns into the take-off state in its last stride:
the packaged one, which is straight and goes on for ever, or one from a file that ends in a jump, along its curve.
What follows it is found by sampling: targets for the PD controllers are tried, 50 ms at a time, and those that lead
closest to the reference are gone on from (Liu et al. 2010, "Sampling-based contact-rich motion control"). The last of
them are then improved together, by the cross-entropy method (Rubinstein 1999), for the state that they end in: what
counts is the take-off (Yin et al. 2021, equations 13 and 14), of which the targets before it know nothing. Yin et al.
2021 train a policy for it instead, for longer than two cores allow: after 40,000 samples one missed the take-off's
velocity by 2.6 m/s. A run-up is a function of the take-off state and the athlete: whoever asks for it again gets the
same one, and nothing of it needs to be kept.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.physics import clips, rotations
from workers.physics.athlete import SPHERICAL, Joint
from workers.physics.clips import Clip
from workers.physics.kinematics import skeleton
from workers.physics.limits import HUMAN
from workers.physics.rotations import Array
from workers.physics.world import FRAME, GRAVITY, Contacts, World
from workers.tasks.high_jump.captured import flight_span
from workers.tasks.high_jump.takeoff import (
    MID_SUPPORT_FRAME,
    RUN,
    TAKE_OFF_FOOT,
    StartState,
    TakeOff,
    apply,
    start_state,
)
from workers.tasks.imitation.reference import ENDS, Moment, Reference

SECONDS, _LEAST = 0.6, 0.4
"""How long it lasts at most, and at least: a stride, begun in the air."""
BLEND = 0.25
"""s before the take-off in which the run turns into it."""
WINDOW = 6
"""Frames (50 ms) that a target stays."""
_ACTIVATION: Array = np.array([[1 / 3], [2 / 3], [1.0]])
"""Share of a new target in its first frames: as in the jump, muscles take 25 ms to become active."""
CANDIDATES, KEPT = 500, 40
"""Targets tried in each window, and how many of them are gone on from."""
_SIGMA = 0.25
"""rad, of what is tried about the reference's pose."""
_PERSISTENCE = 0.5
"""Of the correction in the window before: what leans the body against a fall is needed for longer than one."""
ROUNDS = 12
"""Of the cross-entropy method."""
_SWARM, _BEST = 120, 20
"""Sequences of targets tried in each round, and how many of them the next one is drawn about."""
_LAST = 4
"""Targets, the last ones, that it improves: 0.2 s, in which the foot comes down and takes the weight."""
_WIDTH, _NARROWEST = 0.15, 0.02
"""rad, of what it tries: at first, and at least."""
_PUSH = 0.85
"""Of what a foot may push with; beyond that a candidate is penalised."""
_AFTER = 0.1
"""s that the reference goes on after the take-off state, at its velocities."""
_JUMP = 0.25
"""s in the air; a runner's stride has 0.15."""
_SUPPORT = 0.2
"""s before the flight in which the take-off foot bears on the ground."""
_SOLE = 0.027
"""Height of a foot's centre where it stands, m."""
_TURNED = 3 * len(SPHERICAL)


@dataclass(frozen=True, slots=True)
class Run:
    """A captured run that a run-up follows.

    Args:
        clip: it.
        frame: of the clip, in the middle of the support by the take-off foot that the run-up ends in.
        cyclic: whether it runs along x, and goes on from where it ends; else it is followed as it is, curves included.
    """

    clip: Clip
    frame: int
    cyclic: bool


@functools.cache
def captured_run(path: str | None) -> Run:
    """The run in a file in the DeepMimic form that ends in a jump, or the packaged one.

    Raises `BadClip`: there is no jump, it is not from the right foot, or too little comes before it.
    """
    if path is None:
        return Run(clips.load(RUN), MID_SUPPORT_FRAME, cyclic=True)
    clip = clips.read(Path(path).expanduser())
    left_the_ground, landed = flight_span(clip)
    if (landed - left_the_ground) * clip.period < _JUMP:
        raise clips.BadClip(
            f"{path}: expected a run that ends in a jump of {_JUMP:g} s or more, found at most "
            f"{(landed - left_the_ground) * clip.period:.2f} s in the air"
        )
    body = skeleton()
    position = body.forward(clip.pose, clip.root, clip.orientation).position
    right, left = (position[:, body.names.index(name)] for name in ("right_ankle", "left_ankle"))
    earliest = max(0, left_the_ground - round(_SUPPORT / clip.period))
    if (earliest + 1) * clip.period <= SECONDS:
        raise clips.BadClip(
            f"{path}: expected a run of {SECONDS + _SUPPORT:g} s or more before a jump, found its take-off at "
            f"{left_the_ground * clip.period:.2f} s"
        )
    support = slice(earliest, left_the_ground + 1)
    if right[support, 1].min() > left[support, 1].min():
        raise clips.BadClip(f"{path}: expected a take-off from the right foot, found one from the left")
    speed = np.linalg.norm(np.gradient(right, clip.period, axis=0), axis=1)
    # another skeleton was captured, whose legs are longer: let this one's feet reach the ground
    floats = float(np.quantile(np.minimum(right[:, 1], left[:, 1]), 0.05)) - _SOLE
    clip = replace(clip, root=clip.root - np.array([0.0, floats, 0.0]))
    return Run(clip, earliest + int(speed[support].argmin()), cyclic=False)


@dataclass(frozen=True, slots=True)
class Arrival:
    """How far from the take-off state a run-up ends.

    Args:
        velocity: of the root, m/s.
        spin: of the root, rad/s.
        turn: angle between the root's orientations, rad.
        place: of the root, m.
        joints: root mean square of the joints' angles, rad.
    """

    velocity: float
    spin: float
    turn: float
    place: float
    joints: float


@dataclass(frozen=True, slots=True)
class RunUp:
    """A run-up.

    Args:
        start: where it begins, in the middle of a stride.
        targets: poses that the PD controllers pull to, `WINDOW` frames each ``[n, 28]``.
    """

    start: StartState
    targets: Array

    def begin(self, world: World, shift: float = 0.0) -> None:
        """Put the world's athlete where the run-up begins, `shift` m further along x."""
        _begin(world, replace(self.start, position=self.start.position + np.array([shift, 0.0, 0.0])))

    def play(self, world: World, look: Callable[[Contacts], None] = lambda _: None) -> None:
        """Run, in a world in which it has begun; `look` is told the contacts of each frame."""
        before = self.start.pose
        for target in self.targets:
            _pull(world, before, target, look)
            before = target

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return len(self.targets) * WINDOW * FRAME


def _begin(world: World, start: StartState) -> None:
    """Put the world's athlete in the air, at the beginning of a run-up, and tell it to stay in its pose."""
    apply(world, start)
    world.settle()
    world.athlete.command(start.pose)


def _pull(world: World, before: Array, target: Array, look: Callable[[Contacts], None]) -> None:
    """One window towards a target; `look` is told the contacts of each frame."""
    commands = world.athlete.commands(before + (target - before) * _ACTIVATION)
    for frame in range(WINDOW):
        if frame < len(commands):
            world.athlete.follow(commands[frame])
        look(world.advance())


@functools.lru_cache(maxsize=16)
def run_up_to(
    state: TakeOff,
    joints: tuple[Joint, ...],
    gravity: float = GRAVITY,
    clip: str | None = None,
    *,
    seconds: float = SECONDS,
    candidates: int = CANDIDATES,
    kept: int = KEPT,
    rounds: int = ROUNDS,
) -> RunUp:
    """The run-up to a take-off state, found anew: 35 CPU seconds at the sizes that it has by default.

    Args:
        state: to arrive in.
        joints: of the athlete.
        gravity: m/s^2.
        clip: file of the run that it follows; None: the packaged one.
        seconds: how long it lasts at most.
        candidates: targets tried in each window.
        kept: how many of them are gone on from.
        rounds: of improving the last targets.
    """
    world = World(gravity=gravity, joints=joints)
    try:
        start, run = start_state(world, state), captured_run(clip)
        seconds = _in_the_air(reference_of(start, run, seconds), seconds)
        reference = reference_of(start, run, seconds)
        found = _sampled(world, reference, round(seconds / (WINDOW * FRAME)), candidates, kept)
        return _improved(world, reference, found, rounds)
    finally:
        world.close()


def _in_the_air(reference: Reference, seconds: float) -> float:
    """For how long of at most `seconds` to run up, so that it begins in the middle of a stride.

    An athlete who is put onto the ground at full speed stumbles.
    """
    step = WINDOW * FRAME
    skipped = range(max(1, round((seconds - _LEAST) / step) + 1))

    def feet(windows: int) -> float:
        moment = reference.at(windows * step)
        return float(moment.root[1] + moment.ends[[ENDS.index("right_ankle"), ENDS.index("left_ankle")], 1].min())

    return seconds - max(skipped, key=feet) * step


@dataclass(frozen=True, slots=True)
class End:
    """What a run-up ends in.

    Args:
        state: of the athlete.
        since_ground: see `World.since_ground`.
        push: strongest of the ground on the way, N.
        seen: see `Athlete.seen`, of each frame.
    """

    state: StartState
    since_ground: float
    push: float
    seen: tuple[Sequence[Any], ...]

    def apply(self, world: World, shift: float = 0.0) -> None:
        """Put the world's athlete there, `shift` m further along x: a rehearsal, without running up each time."""
        apply(world, replace(self.state, position=self.state.position + np.array([shift, 0.0, 0.0])))
        world.resume(self.since_ground)


def end_of(run_up: RunUp, world: World) -> End:
    """What the run-up ends in, in a world as it is."""
    push: list[float] = []
    seen: list[Sequence[Any]] = []

    def look(contacts: Contacts) -> None:
        push.append(contacts.ground_force)
        seen.append(world.athlete.seen)

    run_up.begin(world)
    run_up.play(world, look)
    return End(_now(world), world.since_ground, max(push), tuple(seen))


def arrival(run_up: RunUp, state: TakeOff, joints: tuple[Joint, ...], gravity: float = GRAVITY) -> Arrival:
    """How near the run-up gets to its take-off state, in a new world."""
    world = World(gravity=gravity, joints=joints)
    try:
        wanted = start_state(world, state)
        world.rebuild()
        found = end_of(run_up, world).state
        return Arrival(
            velocity=float(np.linalg.norm(found.velocity - wanted.velocity)),
            spin=float(np.linalg.norm(found.angular_velocity - wanted.angular_velocity)),
            turn=float(rotations.angle_between(found.orientation, wanted.orientation)),
            place=float(np.linalg.norm(found.position - wanted.position)),
            joints=float(np.sqrt(np.mean((found.pose - wanted.pose) ** 2))),
        )
    finally:
        world.close()


@dataclass(frozen=True, slots=True)
class _Tried:
    """A candidate: what it costs, the state that it leads to, and the corrections that led there."""

    cost: float
    state: StartState
    since_ground: float
    corrections: tuple[Array, ...]
    target: Array


def _sampled(world: World, reference: Reference, windows: int, candidates: int, kept: int) -> RunUp:
    rng = np.random.default_rng(0)
    start = _at(reference.at(0.0))
    _begin(world, start)
    sunk = world.sunk()
    start = replace(start, position=start.position + np.array([0.0, sunk, 0.0]))
    beam = [_Tried(0.0, start, np.inf, (), start.pose)]
    for window in range(1, windows + 1):
        moment = reference.at(window * WINDOW * FRAME)
        tried = []
        for i in range(candidates):
            parent = beam[i % len(beam)]
            correction = np.zeros(len(moment.pose))
            if i >= len(beam):
                correction = _SIGMA * rng.standard_normal(len(moment.pose))
                if parent.corrections:
                    correction += _PERSISTENCE * parent.corrections[-1]
            target = moment.pose + correction
            apply(world, parent.state)
            world.resume(parent.since_ground)
            seen: list[Contacts] = []
            _pull(world, parent.target, target, seen.append)
            cost = _cost(world, moment, seen, last=window == windows) + 0.002 * float(correction @ correction)
            tried.append(_Tried(cost, _now(world), world.since_ground, (*parent.corrections, correction), target))
        tried.sort(key=lambda each: each.cost)
        beam = tried[:kept]
    moments = [reference.at(window * WINDOW * FRAME).pose for window in range(1, windows + 1)]
    return RunUp(start, np.stack(moments) + np.stack(beam[0].corrections))


def _improved(world: World, reference: Reference, run_up: RunUp, rounds: int) -> RunUp:
    """The run-up with its last targets improved for the state that it ends in."""
    rng = np.random.default_rng(1)
    first = max(0, len(run_up.targets) - _LAST)
    run_up.begin(world)
    replace(run_up, targets=run_up.targets[:first]).play(world)
    start, since_ground = _now(world), world.since_ground
    before = run_up.targets[first - 1] if first else run_up.start.pose
    arrived = reference.at(len(run_up.targets) * WINDOW * FRAME)

    def cost(targets: Array) -> float:
        apply(world, start)
        world.resume(since_ground)
        seen: list[Contacts] = []
        for pulled, target in zip((before, *targets), targets, strict=False):
            _pull(world, pulled, target, seen.append)
        return _cost(world, arrived, seen, last=True)

    mean = best = run_up.targets[first:]
    width = np.full(mean.shape, _WIDTH)
    for _ in range(rounds):
        tried = mean + width * rng.standard_normal((_SWARM, *mean.shape))
        tried[0] = best
        elite = tried[np.argsort([cost(targets) for targets in tried], kind="stable")[:_BEST]]
        best, mean = elite[0], elite.mean(0)
        # slowly, and not all the way, or it settles on the first good ones
        width = (width + np.maximum(1.1 * elite.std(0), _NARROWEST)) / 2
    return replace(run_up, targets=np.concatenate([run_up.targets[:first], best]))


def _cost(world: World, moment: Moment, seen: Sequence[Contacts], *, last: bool) -> float:
    """How far the athlete is from the reference, and what was `seen` on the way that a run-up must not have."""
    cost = _distance(world, moment, last=last)
    # in body weights; a foot that strikes too hard is no run-up that the audit would believe
    push = max(contacts.ground_force for contacts in seen) / (float(world.athlete.mass.sum()) * GRAVITY)
    cost += 5.0 * max(0.0, push - _PUSH * HUMAN.push) ** 2
    # a jump in which anything but the take-off foot touches the ground has failed
    foot, other = world.athlete.link[TAKE_OFF_FOOT], world.athlete.link["left_ankle"]
    return cost + (20.0 if seen[-1].ground - ({foot} if last else {foot, other}) else 0.0)


def _at(moment: Moment) -> StartState:
    return StartState(moment.root, moment.orientation, moment.velocity, moment.spin, moment.pose, moment.rates)


def _now(world: World) -> StartState:
    root, (pose, rates) = world.athlete.links()[0], world.athlete.pose()
    return StartState(root[:3].copy(), root[3:7].copy(), root[7:10].copy(), root[10:13].copy(), pose, rates)


def _distance(world: World, moment: Moment, *, last: bool) -> float:
    """How far the athlete is from the reference: less of joints than of the root's way, which the jump lives on."""
    athlete = world.athlete
    links = athlete.links()
    pose, rates = athlete.pose()
    turns = rotations.from_rotation_vector(pose[:_TURNED].reshape(-1, 3))
    angles = 2 * np.arccos(np.minimum(np.abs(np.einsum("ij,ij->i", turns, moment.turns)), 1.0))
    hinges = pose[_TURNED:] - moment.pose[_TURNED:]
    turn = float(rotations.angle_between(links[0, 3:7], moment.orientation))
    velocity, spin = links[0, 7:10] - moment.velocity, links[0, 10:13] - moment.spin
    place = links[0, :3] - moment.root
    ends = [athlete.names.index(name) for name in ENDS]
    limbs = links[ends, :3] - links[0, :3] - moment.ends
    slower = rates - moment.rates
    return (
        0.3 * float(angles @ angles + hinges @ hinges)
        + 6.0 * turn * turn
        + (6.0 if last else 4.0) * float(velocity @ velocity)
        + (0.15 if last else 0.03) * float(spin @ spin)
        + 10.0 * float(place @ place)
        + 30.0 * float(place[1]) ** 2
        + 4.0 * float((limbs * limbs).sum())
        + 0.0005 * float(slower @ slower)
    )


def reference_of(start: StartState, run: Run, seconds: float = SECONDS) -> Reference:
    """The run that ends in a take-off state.

    Args:
        start: the take-off state.
        run: what it is made of.
        seconds: how long it lasts; the reference goes on a little longer, at the velocities of the take-off.
    """
    clip, period = run.clip, 1 / 240
    count = round((seconds + _AFTER) / period)
    before = (np.arange(count + 1) * period - seconds)[:, None]  # the take-off is at 0
    weight = _smooth(1 + before / BLEND)
    captured = Reference(clip, cyclic=run.cyclic)
    speed = float(np.hypot(start.velocity[0], start.velocity[2]))
    took_off = run.frame * clip.period
    tempo = speed / _speed(captured, took_off)
    times = took_off + tempo * before[:, 0]
    moments = [captured.at(t % captured.seconds if run.cyclic else max(t, 0.0)) for t in times]
    # along the curve of the clip, as far as it has turned since, at the speed of the take-off
    turned, last = _course(moments, before[:, 0])
    turned = (1 - weight[:, 0]) * turned
    end = math.atan2(-start.velocity[2], start.velocity[0])
    way = speed * np.stack([np.cos(end + turned), np.zeros(len(turned)), -np.sin(end + turned)], 1) * period
    root = np.cumsum(way, 0)
    root = start.position + root - root[int(np.argmin(np.abs(before)))] + start.velocity * before * [0, 1, 0]
    height = np.array([moment.root[1] for moment in moments])[:, None]
    root[:, 1:2] = (1 - weight) * height + weight * root[:, 1:2]
    heading = rotations.from_rotation_vector(np.array([0, end - last, 0]))
    running = rotations.multiply(heading, np.stack([moment.orientation for moment in moments]))
    turning = rotations.multiply(
        rotations.from_rotation_vector(start.angular_velocity * np.maximum(before, -BLEND)), start.orientation
    )
    pose = np.stack([moment.pose for moment in moments])
    towards = start.pose + start.rates * np.maximum(before, -BLEND / 2)
    turns = rotations.to_rotation_vector(_mixed(_turns(pose), _turns(towards), weight[:, None]))
    angles = (1 - weight) * pose[:, _TURNED:] + weight * towards[:, _TURNED:]
    blended = np.concatenate([turns.reshape(len(turns), -1), angles], 1)
    motion = Clip(period, root, _mixed(running, turning, weight), blended, np.zeros_like(blended))
    return Reference(motion, cyclic=False)


def _speed(captured: Reference, took_off: float) -> float:
    """Of a captured run, m/s: of a cycle, or of the stride before the take-off, which slows the body down."""
    if captured.cyclic:
        return float(np.linalg.norm(captured.advance)) / captured.seconds
    way = captured.at(took_off - _SUPPORT).root - captured.at(took_off - SECONDS).root
    return float(np.hypot(way[0], way[2])) / (SECONDS - _SUPPORT)


def _course(moments: Sequence[Moment], before: NDArray[Any]) -> tuple[Array, float]:
    """Where a run leads at each moment: its angle about the vertical from that of the take-off on (rad), and that one.

    The root sways with each step, so both are means over a tenth of a second.
    """
    velocity = np.stack([moment.velocity for moment in moments])
    angle = np.unwrap(np.arctan2(-velocity[:, 2], velocity[:, 0]))
    width = min(24, len(angle))
    padded = np.pad(angle, (width // 2, width - 1 - width // 2), mode="edge")
    smooth = np.convolve(padded, np.full(width, 1 / width), mode="valid")
    last = float(smooth[np.abs(before) < _SUPPORT / 2].mean())
    return smooth - last, last


def _smooth(x: NDArray[Any]) -> Array:
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x), np.float64)


def _turns(pose: Array) -> Array:
    return rotations.from_rotation_vector(pose[:, :_TURNED].reshape(len(pose), -1, 3))


def _mixed(a: Array, b: Array, share: Array) -> Array:
    """Rotations on the way from `a` to `b` (slerp)."""
    way = rotations.to_rotation_vector(rotations.multiply(b, rotations.conjugate(a)))
    return rotations.multiply(rotations.from_rotation_vector(share * way), a)
