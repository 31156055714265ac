"""study.json: what made the numbers beside it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from study.pipeline.settings import StudySettings
from study.pipeline.versions import all_versions
from sysid.data.files import write_whole


def write_record(
    path: Path,
    settings: StudySettings,
    device: str,
    about: Mapping[str, Any],
    hours: float,
    versions: Iterable[Mapping[str, str]],
) -> None:
    """The command, the device, counts and the like `about` it, the hours that workers spent, versions and settings."""
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
