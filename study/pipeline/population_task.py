"""A population trained to its end by a task: progress said, checkpoints written, a wish to stop heard; and its trained
policies as files of plain arrays, so that later evaluations need no training.

    policy = read_policy(Path("results/paper"), Cell("main", 50, 0.0, 0))
    evaluate(policy, model, *start_states(7))

A study says which population, and what becomes of it. A policy's file is a NumPy archive, loaded with
allow_pickle=False: nothing in it is executed. w0 (in, out), b0 (out,), w1, ...; u_max; history: past commands that are
observed.
"""

from __future__ import annotations

import io
import sys
import time
import zipfile
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from study.pipeline.executor import Link, Stopped, Task
from study.pipeline.settings import StudySettings, device_type
from sysid import InvalidInput
from sysid.data.files import partial, write_whole

if TYPE_CHECKING:
    from policies import Population, SACSettings
    from policies.network_policy import NetworkPolicy


POLICY_FOLDER = "policies"
"""Where they lie in a results folder."""


def policy_file(folder: Path, key: tuple[Any, ...] | str) -> Path:
    """Where the policy of a cell, or of that name, lies in a results folder."""
    return folder / POLICY_FOLDER / f"{key if isinstance(key, str) else '_'.join(map(str, key))}.npz"


def write_policy(folder: Path, key: tuple[Any, ...] | str, policy: NetworkPolicy) -> None:
    """Keep a policy; whole or not at all. Raises OSError."""
    arrays = {
        f"{kind}{i}": array for i, layer in enumerate(policy.layers) for kind, array in zip("wb", layer, strict=True)
    }
    content, path = io.BytesIO(), policy_file(folder, key)
    np.savez(content, u_max=policy.u_max, history=policy.history, **arrays)
    path.parent.mkdir(exist_ok=True)
    write_whole(path, content.getvalue())


def read_policy(folder: Path, key: tuple[Any, ...] | str) -> NetworkPolicy | None:
    """The policy of a cell or of that name, None where there is none; raises InvalidInput for another file."""
    from policies.network_policy import NetworkPolicy

    path = policy_file(folder, key)
    try:
        with np.load(path, allow_pickle=False) as stored:
            layers = tuple((stored[f"w{i}"], stored[f"b{i}"]) for i in range(len(stored.files) // 2 - 1))
            return NetworkPolicy(layers, float(stored["u_max"]), int(stored["history"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidInput(f"{path} is not the file of a policy ({error}): expected one that a study wrote") from None


CHUNK = 20
"""Training steps between two looks at the clock and at the driver."""


@dataclass(frozen=True, kw_only=True)
class PopulationTask(Task):
    """A task that trains one population; it goes on from its checkpoint where that file exists.

    plan: the preset or plan of its agents; folder: where checkpoint and trained policies lie, on a disk that all
    workers share.
    """

    plan: Any = field(kw_only=False)
    folder: Path
    checkpoint_seconds: float = 60.0
    device: str = "cpu"
    saves: ClassVar[bool] = True
    activity: ClassVar[str] = "training"

    @property
    @abstractmethod
    def name(self) -> str:
        """The population, to people."""

    @property
    def settings(self) -> StudySettings:
        return self.plan

    @property
    @abstractmethod
    def keys(self) -> Sequence[tuple[Any, ...] | str]:
        """What each agent's policy is stored under."""

    @abstractmethod
    def population(self) -> Population:
        """The agents before their first step."""

    @abstractmethod
    def answers(self, population: Population, seconds: float) -> Any:
        """What the driver gets of the trained population, each agent of which took so many seconds."""

    @property
    def checkpoint(self) -> Path:
        """Where an unfinished population is kept."""
        return self.folder / f"{self.name.replace(' ', '_')}.checkpoint"

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core, or on a GPU; only the time left is computed from it."""
        weights, sac = sum(a * b for a, b in pairwise(self.settings.hidden)), self.settings.algorithm == "sac"
        if self.gpus:
            together, alone = (0.5e-3, 3.7e-10 * weights) if sac else (8e-5, 1.3e-10 * weights)
        else:
            together, alone = 0.0, 0.5e-3 + 5.5e-8 * weights if sac else 2e-6 + 1e-9 * weights
        return self.settings.steps * (together + len(self.keys) * alone)

    @property
    def gpus(self) -> int:
        return int(device_type(self.device) == "cuda")

    def discard(self) -> None:
        """Remove the checkpoint and what a process leaves that dies while it writes one."""
        for path in (self.checkpoint, partial(self.checkpoint)):
            path.unlink(missing_ok=True)

    def run(self, link: Link) -> Any:
        """The answers; the trained policies are in their files by then.

        Raises Stopped once a checkpoint is written on request, and OSError where it cannot be written.
        """
        from policies import tune_cpu

        tune_cpu(threads=1)
        population = self.population()
        if self.checkpoint.exists():
            try:
                population.resume(self.checkpoint)
            except InvalidInput as error:  # a spoilt one costs its minutes, not the study
                print(f"{self.name} begins anew: {error}", file=sys.stderr)
        self._finish(population, link)
        for key, policy in zip(self.keys, population.policies(), strict=True):
            write_policy(self.folder, key, policy)
        return self.answers(population, population.seconds / len(self.keys))

    def _finish(self, population: Population, link: Link) -> None:
        """Train all steps that are left."""
        steps = population.settings.steps
        now = saved = time.monotonic()
        while population.steps_done < steps:
            population.train(CHUNK)
            link.progress(population.steps_done / steps)
            before, now = now, time.monotonic()
            population.seconds += now - before
            stop = link.stop_asked()
            if stop or now - saved >= self.checkpoint_seconds:
                population.save(self.checkpoint)
                saved = time.monotonic()
                link.saved()
            if stop:
                raise Stopped


def sac_settings(settings: StudySettings) -> SACSettings:
    """Of the agents of a preset or plan; what these do not name is the paper's."""
    from policies import SACSettings

    return SACSettings(
        hidden=settings.hidden, steps=settings.steps, batch=settings.batch, random_steps=settings.random_steps
    )
