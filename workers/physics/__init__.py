"""How does the athlete move? Rotations, the humanoid, its world, and pictures of it; nothing of tasks or learning."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _quiet() -> Iterator[None]:
    """Bullet prints the time it was built, from C and to the error stream, the first time that it is imported."""
    sys.stderr.flush()
    kept = os.dup(2)
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(silent)


with _quiet():
    import pybullet  # noqa: F401 - imported here once, so that every later import is silent
