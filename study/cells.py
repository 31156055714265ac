"""One (n, w, seed): measure the hidden plant, identify it, train on the estimate, evaluate on the hidden plant.

    rng(seed) -> n rollouts of the plant -> theta_hat -> agent trained on U(theta_hat (1 - w), theta_hat (1 + w))
              -> mean return of 20 episodes on the plant

Cells that share n and seed share the estimate; cells that share a seed share training streams and start states.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from policies import evaluate
from study.config import Cell, Preset
from study.versions import versions
from sysid import GridSearch, InvalidInput, Model, paper_model, paper_rollouts

Theta = tuple[float, float]
"""(m [kg], l [m])."""

CHUNK = 20
"""Training steps between two looks at the clock and at the parent process."""


class Stopped(Exception):
    """The parent process asked this one to end; what there was to save is saved."""


class Link(Protocol):
    """A worker's line to the process that started it."""

    def progress(self, done: float) -> None:
        """Say how much of the task is done, from 0 to 1."""

    def saved(self, seconds: float) -> None:
        """Say that a checkpoint holds the work of so many seconds."""

    def stop_asked(self) -> bool:
        """Whether the parent wants this task to save and end."""


@dataclass(frozen=True)
class Run:
    """A finished cell, with everything its number depends on.

    theta_hat (m [kg], l [m]); id_error = ||theta_hat - truth||; returns (E,) of the evaluation episodes;
    curve: (env steps done, return) of the training episodes; seconds: the run's share of its population's time.
    """

    cell: Cell
    population: int
    theta_hat: Theta
    id_error: float
    returns: tuple[float, ...]
    curve: tuple[tuple[int, float], ...]
    settings: dict[str, Any]
    versions: dict[str, str]
    seconds: float

    @property
    def evaluation(self) -> evaluate.Evaluation:
        """The episodes' returns with their mean and spread."""
        return evaluate.Evaluation(np.array(self.returns))

    @property
    def mean(self) -> float:
        """Mean return."""
        return self.evaluation.mean


def hidden_plant(preset: Preset) -> Model:
    """The plant that stands for the real robot."""
    m, l = preset.truth  # noqa: E741
    return paper_model(m, l)


def identify(preset: Preset, n: int, seed: int) -> Theta:
    """theta_hat from n rollouts of the hidden plant by the paper's grid search; the prior for n = 0."""
    if n == 0:
        return preset.prior
    records = paper_rollouts(hidden_plant(preset), n, np.random.default_rng(seed), sigma=preset.sigma)
    found = GridSearch().fit(paper_model(), records).values
    return found["m"], found["l"]


def start_states(preset: Preset, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The paper's evaluation start states theta (E,) [rad], theta_dot (E,) [rad/s] of a seed."""
    return evaluate.start_states(seed, preset.episodes)


@dataclass(frozen=True)
class PopulationTask:
    """Train and evaluate the cells of one population; goes on from `checkpoint` where that file exists."""

    preset: Preset
    index: int
    estimates: tuple[Theta, ...]
    checkpoint: Path
    checkpoint_seconds: float = 60.0
    seconds_before: float = 0.0
    device: str = "cpu"
    saves: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return f"population {self.index + 1} of {len(self.preset.populations)}"

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The runs it makes."""
        return self.preset.populations[self.index]

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core; only the time left is computed from it."""
        weights = sum(a * b for a, b in zip(self.preset.hidden[:-1], self.preset.hidden[1:], strict=True))
        return self.preset.steps * len(self.cells) * (0.5e-3 + 5.5e-8 * weights)

    def run(self, link: Link) -> list[Run]:
        """The finished runs, in the order of the cells. Raises Stopped once a checkpoint is written on request."""
        from policies import tune_cpu

        tune_cpu(threads=1)
        population = self._population()
        begin = saved = time.monotonic()
        while population.steps_done < self.preset.steps:
            population.train(CHUNK)
            link.progress(population.steps_done / self.preset.steps)
            now = time.monotonic()
            stop = link.stop_asked()
            if stop or now - saved >= self.checkpoint_seconds:
                population.save(self.checkpoint)
                saved = time.monotonic()
                link.saved(self.seconds_before + saved - begin)
            if stop:
                raise Stopped
        return self._evaluate(population, self.seconds_before + time.monotonic() - begin)

    def _population(self) -> Any:
        from policies import Band, Population, SACSettings

        settings = SACSettings(
            hidden=self.preset.hidden,
            steps=self.preset.steps,
            batch=self.preset.batch,
            random_steps=self.preset.random_steps,
        )
        bands = [
            Band({"m": m, "l": l}, w=cell.w)
            for cell, (m, l) in zip(self.cells, self.estimates, strict=True)  # noqa: E741
        ]
        seeds = [cell.seed for cell in self.cells]
        arguments = (paper_model(), bands, seeds, settings, self.device)
        if self.checkpoint.exists():
            # one that is damaged or of other software costs its minutes, not the study
            with contextlib.suppress(InvalidInput):
                return Population.load(self.checkpoint, *arguments)
        return Population(*arguments)

    def _evaluate(self, population: Any, seconds: float) -> list[Run]:
        plant, found = hidden_plant(self.preset), versions()
        runs = []
        for a, (cell, policy) in enumerate(zip(self.cells, population.policies(), strict=True)):
            answer = evaluate.evaluate(policy, plant, *start_states(self.preset, cell.seed))
            settings = {
                "preset": self.preset.name,
                "device": self.device,
                "sac": dataclasses.asdict(population.settings),
                "randomization": population.env.randomizations[a].to_json(),
                "sigma": self.preset.sigma,
                "truth": list(self.preset.truth),
                "population": [list(c) for c in self.cells],
            }
            runs.append(
                Run(
                    cell=cell,
                    population=self.index,
                    theta_hat=self.estimates[a],
                    id_error=math.dist(self.estimates[a], self.preset.truth),
                    returns=tuple(answer.returns.tolist()),
                    curve=tuple((int(step), float(value)) for step, value in population.curves[a]),
                    settings=settings,
                    versions=found,
                    seconds=seconds / len(self.cells),
                )
            )
        return runs


def estimates(preset: Preset, cells: Sequence[Cell]) -> dict[tuple[int, int], Theta]:
    """theta_hat by (n, seed) of all these cells."""
    return {(n, seed): identify(preset, n, seed) for n, seed in dict.fromkeys((c.n, c.seed) for c in cells)}


def check_device(device: str) -> None:
    """Raise InvalidInput for a device that torch does not have here."""
    if device == "cpu":
        return
    import torch

    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InvalidInput(f"device {device!r} cannot be used: {reason}; 'cpu' always can") from None
