"""The high jump and the obstacle jump: from a take-off state over a bar or a box, in as many ways as there are."""

from workers.tasks.high_jump.task import HighJump, ObstacleJump, simulate

__all__ = ["HighJump", "ObstacleJump", "simulate"]
