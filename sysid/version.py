"""The version of this distribution."""

from __future__ import annotations


def version() -> str:
    """The name and the version of this distribution, as it was installed."""
    from importlib import metadata

    try:
        return f"gapfinder {metadata.version('gapfinder')}"
    except metadata.PackageNotFoundError:
        return "gapfinder, not installed"
