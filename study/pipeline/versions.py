"""What produced a number: the versions of this distribution and of the packages that do the arithmetic."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path

PACKAGES = ("gapfinder", "numpy", "scipy", "torch", "torchrl", "tensordict", "control")


def installed_version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def versions() -> dict[str, str]:
    """Python, the processor's architecture and PACKAGES."""
    return {"python": platform.python_version(), "machine": platform.machine()} | {
        p: installed_version(p) for p in PACKAGES
    }


def all_versions(found: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Every version of each package that took part."""
    together: dict[str, set[str]] = {}
    for own in found:
        for package, number in own.items():
            together.setdefault(package, set()).add(number)
    return {package: " and ".join(sorted(numbers)) for package, numbers in together.items()}


def foreign_sysid() -> str | None:
    """A sentence where a foreign distribution named `sysid` is installed; it has files of our package's name."""
    found = installed_version("sysid")
    if found == "not installed":
        return None
    return (
        f"the foreign distribution 'sysid' {found} is installed beside gapfinder and overwrites files of its package "
        "sysid: run `pip uninstall sysid`, then install gapfinder again with --force-reinstall"
    )


def wrong_sysid() -> str | None:
    """A sentence where `import sysid` finds another package than the one that came with this study."""
    import sysid

    ours = Path(__file__).resolve().parents[2]
    place = Path(sysid.__file__ or ".").resolve().parents[1]
    if place == ours and "diagnose" in dir(sysid):  # which loads nothing yet
        return None
    return f"`import sysid` finds {place / 'sysid'}, expected {ours / 'sysid'}: another package comes first"
