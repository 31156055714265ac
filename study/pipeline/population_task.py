"""A population trained to its end by a task: progress said, checkpoints written, a wish to stop heard; and its trained
policies in one file of plain arrays, so that later evaluations need no training.

    policies = read_policies(Path("results/paper/policies/population_1.npz"))
    evaluate(policies[Cell("main", 50, 0.0, 0)], model, *start_states(7))

A study says which population, and what becomes of it. The file is a NumPy archive, loaded with allow_pickle=False:
nothing in it is executed. w0 (A, in, out), b0 (A, out), w1, ...; cells (A,): JSON of [point, n, w, seed], or of a text
that names what was trained; u_max; history: past commands that are observed.
"""

from __future__ import annotations

import io
import json
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


FOLDER = "policies"
"""Where they lie in a results folder."""


def write_policies(path: Path, cells: Sequence[tuple[Any, ...] | str], policies: Sequence[NetworkPolicy]) -> None:
    """Keep the policy of every cell; whole or not at all. Raises OSError."""
    arrays = {
        "cells": np.array([json.dumps(cell) for cell in cells]),
        "u_max": np.array([policy.u_max for policy in policies]),
        "history": np.array([policy.history for policy in policies]),
    }
    for i in range(len(policies[0].layers)):
        arrays[f"w{i}"] = np.stack([policy.layers[i][0] for policy in policies])
        arrays[f"b{i}"] = np.stack([policy.layers[i][1] for policy in policies])
    content = io.BytesIO()
    np.savez(content, **arrays)
    path.parent.mkdir(exist_ok=True)
    write_whole(path, content.getvalue())


def read_policies(path: Path) -> dict[tuple[Any, ...] | str, NetworkPolicy]:
    """The policies in such a file by cell, or by name; raises InvalidInput for another file."""
    from policies.network_policy import NetworkPolicy

    try:
        with np.load(path, allow_pickle=False) as stored:
            named = [json.loads(text) for text in stored["cells"].tolist()]
            cells = [name if isinstance(name, str) else tuple(name) for name in named]
            u_max = stored["u_max"].tolist()
            history = stored["history"].tolist() if "history" in stored.files else [0] * len(cells)
            layers = [(stored[f"w{i}"], stored[f"b{i}"]) for i in range(sum(name[0] == "w" for name in stored.files))]
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidInput(f"{path} is not a file of policies ({error}): expected one that a study wrote") from None
    return {
        cell: NetworkPolicy(tuple((w[a], b[a]) for w, b in layers), u_max[a], history[a])
        for a, cell in enumerate(cells)
    }


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
    def stem(self) -> str:
        """The population, in names of files."""
        return self.name.replace(" ", "_")

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
        return self.folder / f"{self.stem}.checkpoint"

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
        """The answers; the trained policies are in a file by then.

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
        write_policies(self.folder / FOLDER / f"{self.stem}.npz", self.keys, population.policies())
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
