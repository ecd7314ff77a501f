"""Which halma this is."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def halma_version() -> str:
    """Version of the installed distribution."""
    try:
        return version("halma")
    except PackageNotFoundError:
        return "0+uninstalled"
