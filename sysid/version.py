"""The version of this distribution."""

from __future__ import annotations

from importlib import metadata


def version() -> str:
    """The name and the version of this distribution, as it was installed."""
    try:
        return f"gapfinder {metadata.version('gapfinder')}"
    except metadata.PackageNotFoundError:
        return "gapfinder, not installed"
