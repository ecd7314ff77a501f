"""The high jump: from a take-off state over a bar, in as many ways as there are."""

from workers.tasks.high_jump.task import HighJump, simulate

__all__ = ["HighJump", "simulate"]
