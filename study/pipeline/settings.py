"""What results are tied to: the settings of an experiment, as frozen plain data, the device that trains, and the
versions of this distribution and of the packages that do the arithmetic.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from sysid.version import installed_versions

T = TypeVar("T")


@dataclass(frozen=True)
class RunOptions:
    """How an experiment is run: where and with what, other people's results, and a choice of strategies."""

    folder: Path
    device: str = "cpu"
    checkpoint_seconds: float = 60.0
    imported: Path | None = None
    published: Path | None = None
    strategies: tuple[str, ...] = ()


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
    """Version of the results folder: raised whenever stored numbers or tables change their meaning."""
    kind: ClassVar[str] = ""
    """What tells its results folders from those of other kinds."""
    experiment: ClassVar[str]
    """The module whose `open_experiment` runs it."""

    @property
    def format(self) -> str:
        """The kind of results folder, and its version."""
        return f"{self.kind} {self.layout}".strip()

    def to_dict(self) -> dict[str, Any]:
        """Every setting as plain JSON values."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @property
    def arguments(self) -> str:
        """What `study.main` is called with to run it."""
        return f"--preset {self.name}"

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


ON_A_GPU = 500
"""Agents that train together at most: their memory fits, and their random numbers are drawn as fast as they move."""


def partition(items: Sequence[T], size: int, device: str) -> Iterator[tuple[T, ...]]:
    """What trains together: on a CPU `size` in a row, elsewhere ON_A_GPU. It depends on neither workers nor on what is
    left to do."""
    size = size if device_type(device) == "cpu" else ON_A_GPU
    return (tuple(items[i : i + size]) for i in range(0, len(items), size))


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


PACKAGES = ("gapfinder", "numpy", "scipy", "torch", "torchrl", "tensordict", "control")


def versions() -> dict[str, str]:
    """Python, the processor's architecture and PACKAGES."""
    return installed_versions(PACKAGES)


def all_versions(made_with: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Every version of each package that took part."""
    together: dict[str, set[str]] = {}
    for packages in made_with:
        for package, number in packages.items():
            together.setdefault(package, set()).add(number)
    return {package: " and ".join(sorted(numbers)) for package, numbers in together.items()}
