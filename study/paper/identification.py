"""n rollouts of a hidden plant become theta_hat, by the identifier of the operating point.

    rng(seed) -> n rollouts of the plant -> theta_hat = (m [kg], l [m])

Widths share the estimate, and all identifiers of a plant, a noise and a seed see the same rollouts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from study.paper.presets import Point, Theta
from study.paper.protocol import PaperRollout, averaged_sensor, paper_model, paper_rollouts, transitions
from study.pipeline.executor import Brief, Link
from study.pipeline.tables import Table
from sysid import Estimate, GridSearch, InvalidInput, LeastSquares, Model, UnscentedKalman

WHOLE_ROLLOUTS = {"least_squares": LeastSquares, "unscented": UnscentedKalman}


class Estimated(NamedTuple):
    """theta_hat (m [kg], l [m]) of a point, a budget and a seed, and what it took [s]."""

    point: str
    n: int
    seed: int
    theta: Theta
    seconds: float


ESTIMATES = Table("estimates", Estimated, "point TEXT, n INTEGER, seed INTEGER, m REAL, l REAL, seconds REAL", keys=3)


def hidden_plant(truth: Theta) -> Model:
    m, l = truth  # noqa: E741
    return paper_model(m, l)


def identify(point: Point, n: int, seed: int) -> Theta:
    """theta_hat from n rollouts of the point's hidden plant; the prior for n = 0.

    grid            the paper's grid search over single steps; every angle enters it, without noise, as a regressor
    least_squares   whole rollouts: the speeds, and of every rollout the first angle alone
    unscented       the same readings, by a Kalman filter

    All begin at the model's own (1, 1) and stay within the paper's bounds [0.3, 3.0], which the model's parameters
    carry; a training band that reaches beyond them is clipped where it is sampled. Raises InvalidInput for an unknown
    identifier.
    """
    if n == 0:
        return point.prior
    rollouts = paper_rollouts(hidden_plant(point.truth), n, np.random.default_rng(seed), sigma=point.sigma)
    found = _estimate(point, rollouts).values
    return found["m"], found["l"]


def _estimate(point: Point, rollouts: list[PaperRollout]) -> Estimate:
    if point.identifier == "grid":
        return GridSearch().fit(paper_model(), transitions(rollouts))
    if point.identifier not in WHOLE_ROLLOUTS:
        known = ", ".join(("grid", *WHOLE_ROLLOUTS))
        raise InvalidInput(f"identifier {point.identifier!r}: expected one of {known}")
    identifier = WHOLE_ROLLOUTS[point.identifier](("m", "l"), sensor=averaged_sensor(point.sigma))
    return identifier.fit(paper_model(), [rollout.averaged for rollout in rollouts])


@dataclass(frozen=True)
class IdentificationTask(Brief):
    """The estimates of all budgets of an operating point, for one seed."""

    point: Point
    seed: int
    activity: ClassVar[str] = "identification"
    table: ClassVar[Any] = ESTIMATES

    @property
    def name(self) -> str:
        return f"identification at {self.point.name}, seed {self.seed}"

    @property
    def work(self) -> float:
        rollout = {"grid": 0.007, "least_squares": 0.03, "unscented": 0.2}.get(self.point.identifier, 0.1)
        return 1.0 + rollout * sum(self.point.budgets)

    def run(self, link: Link) -> list[Estimated]:
        answer = []
        for k, n in enumerate(self.point.budgets):
            begin = time.monotonic()
            theta = identify(self.point, n, self.seed)
            answer.append(Estimated(self.point.name, n, self.seed, theta, time.monotonic() - begin))
            link.progress((k + 1) / len(self.point.budgets))
        return answer
