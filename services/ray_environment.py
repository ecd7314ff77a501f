"""What Ray reads from the environment. It reads some of it when it is imported, so this comes before."""

from __future__ import annotations

import os
import secrets


def prepare(address: str | None = None) -> None:
    """Set what is not set yet.

    Args:
        address: of a cluster to join, whose token this user already has; None for a local Ray, which gets a secret
            of its own, so that nobody else on the machine can hand it code.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Without it Ray empties CUDA_VISIBLE_DEVICES for workers that asked for no GPU, and warns that it will not.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    if address is None and os.environ["RAY_AUTH_MODE"] == "token":
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
