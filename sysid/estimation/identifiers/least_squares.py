"""Output error: least squares of whole rollouts, the identifier that reaches the Cramer-Rao bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from sysid.data.record import Record, check_direct
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import NONE, Disturbances
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free_parameters
from sysid.estimation.linearisation import Samples, level
from sysid.estimation.prediction_error import Fit
from sysid.estimation.smoothed_start import parameter_starts
from sysid.estimation.solver import Settings, fit_parameters
from sysid.physics.model import Model
from sysid.physics.ops import Array

BEGUN = 0.03
"""The random acceleration beside which a fit begins, as a share of the motion's: rollouts need not be whole yet."""

HELD = Settings(iterations=10, sizes=False, vague=math.inf)
"""Nothing is known of the numbers beside the readings."""

EXACT = replace(
    HELD, iterations=100, patience=100, least_share=1.0, settled=1e-6, wanders=0.0, negligible=1e-3, widest=(0.0,) * 3
)
"""Slopes at a point: wider ones would move the optimum by some hundredths of an sd."""

DAMPED = replace(EXACT, patience=0)
"""Where rollouts hardly determine their start, whole Gauss-Newton steps may go to and fro about the optimum."""


@dataclass(frozen=True)
class LeastSquares:
    """Weighted least squares of whole rollouts with free initial states.

        min_{p, x_0}  sum_records sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    This is the prediction-error method without disturbances. A fit begins at the smoothed readings beside a small
    random torque, under which every instant has a state of its own as in multiple shooting, and ends without any. Every
    reading that the sensor vouches for counts, both of an instant that was read twice. The covariance is the inverse
    Fisher information.

    It begins at the model's own numbers, then at others, at most `starts` times, until the readings are explained to
    the sensor's noise or two starts agree. Where no start converges, as for a model that cannot follow a whole rollout,
    the answer is that beside a random torque, and says so.
    """

    parameters: Sequence[str] = ("m", "l")
    sensor: Sensor = Sensor(theta=0.01, theta_dot=1.0)
    starts: int = 4

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """The estimate; raises InvalidInput for unusable records, names or settings."""
        free = free_parameters(model, self.parameters)
        if self.starts < 1:
            raise InvalidInput(f"starts = {self.starts}: expected a positive count")
        check_direct(model, "LeastSquares")
        samples = Samples(model, records, self.sensor)
        found: list[Fit] = []
        for start in islice(parameter_starts(free), self.starts):
            here = self._from(samples, model, start)
            agreed = any(abs(_squares(other) / _squares(here) - 1.0) < 1e-6 for other in found if other.converged)
            found.append(here)
            if here.converged and (agreed or _misfit(here) < 1.0):
                break
        converged = [here for here in found if here.converged]
        if not converged:
            return self._beside_a_random_torque(samples, model, len(found))
        return _estimate(min(converged, key=_squares), len(found))

    def _from(self, samples: Samples, model: Model, start: Array) -> Fit:
        """The optimum that is reached from parameters `start` (P,)."""
        begun = model.with_parameters(dict(zip(self.parameters, start.tolist(), strict=True)))
        near = fit_parameters(samples, begun, self.parameters, None, Disturbances(BEGUN * level(samples)), HELD)
        whole = fit_parameters(samples, near.model, self.parameters, near, NONE, EXACT)
        return whole if whole.converged else fit_parameters(samples, near.model, self.parameters, near, NONE, DAMPED)

    def _beside_a_random_torque(self, samples: Samples, model: Model, used: int) -> Estimate:
        status = (
            f"no optimum of whole rollouts was found from {used} starts: these numbers are those beside a random "
            "torque; the model lacks something, or try other starting numbers"
        )
        answer = fit_parameters(samples, model, self.parameters).estimate("least squares")
        return replace(answer, success=False, status=status)


def _squares(found: Fit) -> float:
    """The sum of the whitened squares of the residuals."""
    return float(np.sum(found.linearised.system.r**2))


def _misfit(found: Fit, quantile: float = 3.7) -> float:
    """The sum of squares over its chi-square quantile (in sd above the mean); noise alone stays below 1."""
    degrees = max(1, found.samples.readings - len(found.names) - 2 * len(found.samples.records))
    return _squares(found) / (degrees + quantile * math.sqrt(2.0 * degrees))


def _estimate(best: Fit, used: int) -> Estimate:
    answer = best.estimate("least squares")
    if _misfit(best) < 1.0:
        status = f"converged at start {used}; the readings are explained to the sensor's noise"
    else:
        size = _misfit(best, quantile=0.0) ** 0.5
        status = (
            f"converged, but the best of {used} starts leaves {size:.2g} times the sensor's noise: "
            "the model lacks something, or the sensor's sd is too small"
        )
    return replace(answer, status=answer.status.replace("converged", status, 1))
