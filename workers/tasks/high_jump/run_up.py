"""The run-up: the athlete runs up to a take-off state, so that run-up and jump are one motion of one simulation.

What leads to it is found by sampling: targets for the PD controllers are tried, 50 ms at a time, and those that lead
closest to the reference (see `approach`) are gone on from (Liu et al. 2010, "Sampling-based contact-rich motion
control"). The last of them are then improved together, by the cross-entropy method (Rubinstein 1999), for the state
that they end in: what counts is the take-off (Yin et al. 2021, equations 13 and 14), of which the targets before it
know nothing. Yin et al. train a policy for it instead, for longer than two cores allow: after 40,000 samples one missed
the take-off's velocity by 2.6 m/s. A run-up is a function of the take-off state and the athlete: whoever asks for it
again gets the same one, and nothing of it needs to be kept.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workers.physics import rotations
from workers.physics.athlete import SPHERICAL, Joint
from workers.physics.limits import HUMAN
from workers.physics.rotations import Array
from workers.physics.world import FRAME, GRAVITY, Contacts, World
from workers.tasks.high_jump.approach import SECONDS, captured_run, reference_of
from workers.tasks.high_jump.takeoff import TAKE_OFF_FOOT, StartState, TakeOff, apply, start_state
from workers.tasks.imitation.reference import ENDS, Moment, Reference

_LEAST = 0.4
"""s that it lasts at least: a stride, begun in the air."""
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
ROUNDS = 16
"""Of the cross-entropy method."""
_SWARM, _BEST = 150, 20
"""Sequences of targets tried in each round, and how many of them the next one is drawn about."""
_LAST = 6
"""Targets, the last ones, that it improves: 0.3 s, in which the foot swings forward, comes down and bears."""
_WIDTH, _NARROWEST = 0.15, 0.02
"""rad, of what it tries: at first, and at least."""
_PUSH = 0.85
"""Of what a foot may push with; beyond that a candidate is penalised."""
_TURNED = 3 * len(SPHERICAL)


@dataclass(frozen=True, slots=True)
class Arrival:
    """How far from the take-off state a run-up ends.

    Args:
        velocity: of the root, m/s.
        carried: of the centre of mass, m/s.
        spin: of the root, rad/s.
        turn: angle between the root's orientations, rad.
        place: of the root, m.
        joints: root mean square of the joints' angles, rad.
    """

    velocity: float
    carried: float
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
    """The run-up to a take-off state, found anew: a CPU minute at the sizes that it has by default.

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
        carried = _carried(world)
        world.rebuild()
        found = end_of(run_up, world).state
        return Arrival(
            velocity=float(np.linalg.norm(found.velocity - wanted.velocity)),
            carried=float(np.linalg.norm(_carried(world) - carried)),
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
    if not np.isfinite(cost):  # a world that has blown up; NaN would be sorted anywhere
        return np.inf
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


def _carried(world: World) -> Array:
    """Velocity of the athlete's centre of mass ``[3]``, m/s."""
    return world.athlete.centre_of_mass(world.athlete.links()[:, 7:10])


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
    # a root as fast as it should be, with legs that lag behind, does not leave the ground
    carried = athlete.centre_of_mass(links[:, 7:10]) - moment.com_velocity
    place = links[0, :3] - moment.root
    ends = [athlete.names.index(name) for name in ENDS]
    limbs = links[ends, :3] - links[0, :3] - moment.ends
    slower = rates - moment.rates
    return (
        0.3 * float(angles @ angles + hinges @ hinges)
        + 6.0 * turn * turn
        + (6.0 if last else 4.0) * float(velocity @ velocity)
        + (6.0 if last else 0.0) * float(carried @ carried)
        + (0.15 if last else 0.03) * float(spin @ spin)
        + 10.0 * float(place @ place)
        + 30.0 * float(place[1]) ** 2
        + (20.0 if last else 4.0) * float((limbs * limbs).sum())
        + 0.0005 * float(slower @ slower)
    )
