"""What results are tied to: the settings of an experiment, as frozen plain data, and the device that trains."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from typing import Any, ClassVar


class StudySettings:
    """Everything that the numbers of a study depend on, under a name, as frozen plain data: a preset, a plan.

    algorithm                            that trains its agents, "sac" or "shac"
    hidden, steps, batch, random_steps   how; `policies.SACSettings` says what each number is
    """

    name: str
    algorithm: str = "sac"
    hidden: tuple[int, ...]
    steps: int
    batch: int
    random_steps: int
    layout: ClassVar[int]
    """FORMAT of the results folder."""

    def to_dict(self) -> dict[str, Any]:
        data = json.loads(json.dumps(dataclasses.asdict(self)))  # type: ignore[call-overload]
        if data.get("algorithm") == "sac":  # results from before there was another do not name it
            del data["algorithm"]
        return data

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
