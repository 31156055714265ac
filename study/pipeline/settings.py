"""What results are tied to: the settings of an experiment, as frozen plain data, and the device that trains."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from typing import Any, ClassVar, Protocol


class StudySettings(Protocol):
    """Everything that the numbers of a study depend on, under a name: a preset, a plan."""

    @property
    def name(self) -> str: ...
    @property
    def fingerprint(self) -> str:
        """Text that changes with any setting."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        ...


class Fingerprinted:
    """Frozen plain data that results are tied to."""

    layout: ClassVar[int]
    """FORMAT of the results folder."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return json.loads(json.dumps(dataclasses.asdict(self)))  # type: ignore[call-overload]

    @property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits that change with any setting and with the layout."""
        return digest({"format": self.layout, **self.to_dict()})


def digest(data: Any) -> str:
    """Sixteen hexadecimal digits of plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]


def device_type(device: str) -> str:
    """ "cuda" of "cuda:1": what the partition into populations depends on."""
    return device.partition(":")[0]


def check_device(device: str) -> None:
    """Raise InvalidInput for a device that torch does not have here."""
    if device == "cpu":
        return
    import torch

    from sysid import InvalidInput

    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InvalidInput(f"device {device!r} cannot be used: {reason}; 'cpu' always can") from None
