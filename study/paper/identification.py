"""n rollouts of a hidden plant become theta_hat, by the identifier of the operating point.

    rng(seed) -> n rollouts of the plant -> theta_hat = (m [kg], l [m])

Widths share the estimate, and all identifiers of a plant, a noise and a seed see the same rollouts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from study.paper.presets import Point, Theta
from study.pipeline.executor import Brief, Link
from sysid import GridSearch, Identifier, InvalidInput, LeastSquares, Model, Sensor, UnscentedKalman, paper_model
from sysid.planning.excitation import paper_rollouts

FIRST_ANGLE = 0.001
"""sd [rad] of the first angle of a rollout, as least squares and the Kalman filter are told."""


class Estimated(NamedTuple):
    """theta_hat (m [kg], l [m]) of a point, a budget and a seed, and what it took [s]."""

    point: str
    n: int
    seed: int
    theta: Theta
    seconds: float


def hidden_plant(truth: Theta) -> Model:
    """The plant that stands for the real robot."""
    m, l = truth  # noqa: E741
    return paper_model(m, l)


def identify(point: Point, n: int, seed: int) -> Theta:
    """theta_hat from n rollouts of the point's hidden plant; the prior for n = 0.

    grid            the paper's grid search; every angle enters it, without noise, as a regressor
    least_squares   the sensor's speeds with sd sigma and of every rollout the first angle alone
    unscented       the same readings, by a Kalman filter

    All begin at the model's own (1, 1) and stay within the paper's bounds [0.3, 3.0], which the model's parameters
    carry; a training band that reaches beyond them is clipped where it is sampled. Raises InvalidInput for an unknown
    identifier.
    """
    if n == 0:
        return point.prior
    records = paper_rollouts(hidden_plant(point.truth), n, np.random.default_rng(seed), sigma=point.sigma)
    found = _identifier(point).fit(paper_model(), records).values
    return found["m"], found["l"]


def _identifier(point: Point) -> Identifier:
    names = ("m", "l")
    speeds = Sensor(theta=None, theta_dot=point.sigma, theta_0=FIRST_ANGLE)
    known: dict[str, Identifier] = {
        "grid": GridSearch(names),
        "least_squares": LeastSquares(names, sensor=speeds),
        "unscented": UnscentedKalman(names, sensor=speeds),
    }
    if point.identifier not in known:
        raise InvalidInput(f"identifier {point.identifier!r}: expected one of {', '.join(known)}")
    return known[point.identifier]


@dataclass(frozen=True)
class IdentificationTask(Brief):
    """The estimates of all budgets of an operating point, for one seed."""

    point: Point
    seed: int
    activity: ClassVar[str] = "identification"

    @property
    def name(self) -> str:
        return f"identification at {self.point.name}, seed {self.seed}"

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core; only the time left is computed from it."""
        rollout = {"grid": 0.007, "least_squares": 0.03, "unscented": 0.2}.get(self.point.identifier, 0.1)
        return 1.0 + rollout * sum(self.point.budgets)

    def run(self, link: Link) -> list[Estimated]:
        """One estimate a budget."""
        answer = []
        for k, n in enumerate(self.point.budgets):
            begin = time.monotonic()
            theta = identify(self.point, n, self.seed)
            answer.append(Estimated(self.point.name, n, self.seed, theta, time.monotonic() - begin))
            link.progress((k + 1) / len(self.point.budgets))
        return answer
