"""Versions of this distribution, and of what its numbers depend on."""

from __future__ import annotations

import platform
from collections.abc import Iterable


def installed_version(package: str) -> str:
    """The version of a distribution, or "not installed"."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def version() -> str:
    """The name and the version of this distribution, as it was installed."""
    return f"gapfinder {installed_version('gapfinder')}"


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """Python, the processor's architecture, and distributions."""
    here = {"python": platform.python_version(), "machine": platform.machine()}
    return here | {package: installed_version(package) for package in packages}
