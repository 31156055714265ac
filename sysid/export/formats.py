"""Which language a model is exported in."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from sysid.errors import InvalidInput
from sysid.export.exported import Exported
from sysid.export.mjcf import to_mjcf
from sysid.export.urdf import to_urdf
from sysid.physics.model import Model

LANGUAGES = {".xml": "mjcf", ".urdf": "urdf"}
"""What a file of each ending holds."""


def export(
    model: Model,
    path: Path,
    language: Literal["mjcf", "urdf"] | None = None,
    joint: str = "hinge",
    into: Path | None = None,
) -> Exported:
    """The model in a language, by default that of the path's ending.

    Raises InvalidInput as `to_mjcf` and `to_urdf` do, for another ending, and where a file of the user's is no MJCF.
    """
    found = language or LANGUAGES.get(path.suffix.lower())
    if found is None:
        raise InvalidInput(f"{path.name} ends with none of {', '.join(LANGUAGES)}: expected one of these, or --format")
    if found == "mjcf":
        return to_mjcf(model, joint, into)
    if into is not None:
        raise InvalidInput(f"--into changes a file of MJCF: expected --to FILE.xml, not {path.name}")
    return to_urdf(model, joint)
