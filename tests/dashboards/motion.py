"""A short recorded motion for tests: the athlete thrown over the bar in a real world, untrained."""

from __future__ import annotations

from functools import cache

from workers.physics.rendering import render_frame
from workers.physics.world import World
from workers.replay import Recorder, Replay
from workers.tasks.high_jump.behaviour import over_the_bar


@cache
def thrown(spin=1.0, bar=0.7, frames=70):
    """`Replay` of half a second around the bar; with 130 frames down to the mat."""
    world = World(measure_torque=True)
    try:
        world.athlete.place([-0.8, 1.35, 0.0], [0.0, 0.0, 0.0, 1.0])
        world.athlete.push([2.6, 1.6, 0.0], [0.0, spin, -spin])
        world.set_bar(bar)
        recorder = Recorder("right_ankle", {"name": "high_jump"})
        recorder.start(world)
        for _ in range(frames):
            recorder.add(world, world.advance())
        return recorder.replay()
    finally:
        world.close()


def files(replay: Replay):
    """What a trial leaves of it."""
    crossing = over_the_bar(replay)
    assert crossing is not None
    return [("replay.bin", replay.to_bytes()), ("pose.png", render_frame(replay, crossing[0]))]
