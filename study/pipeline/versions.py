"""What produced a number: the versions of this distribution and of the packages that do the arithmetic; study.json."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from study.pipeline.settings import StudySettings

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


def write_record(
    path: Path,
    settings: StudySettings,
    device: str,
    about: Mapping[str, Any],
    hours: float,
    versions: Iterable[Mapping[str, str]],
) -> None:
    """Write study.json: the command, the device, counts and the like `about` it, the hours that workers spent, versions
    and settings."""
    from sysid.data.files import write_whole

    record = {
        "command": f"python -m study.main --preset {settings.name}",
        "device": device,
        **about,
        "worker_hours": round(hours, 3),
        "versions": all_versions(versions),
        "fingerprint": settings.fingerprint,
        "settings": settings.to_dict(),
    }
    write_whole(path, json.dumps(record, indent=1) + "\n")


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
