"""Tests that need what a machine may not have."""

from __future__ import annotations

import os

import pytest


def without(what):
    """Skip a test for want of a program; in CI, which installs what tests need, that is a failure."""
    if os.environ.get("CI"):
        pytest.fail(what)
    pytest.skip(what)
