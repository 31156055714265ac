"""Least squares of whole rollouts (output error), which reaches the Cramer-Rao bound if the model is right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from sysid.data.record import Record, check_direct
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import NO_DISTURBANCE, Disturbances
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free_parameters
from sysid.estimation.linearisation import Samples, level
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import continued
from sysid.estimation.smoothed_start import parameter_starts
from sysid.estimation.solver import Settings, fit_parameters
from sysid.physics.model import Model
from sysid.physics.ops import Array

BEGUN = 0.03
"""The random acceleration beside which a fit begins, as a share of the motion's: rollouts may leave the model then."""

HELD = Settings(iterations=10, sizes=False, vague=math.inf)
"""Settings of the first fit: disturbances of a given size, and no prior for the plant's numbers."""

EXACT = replace(
    HELD, iterations=100, patience=100, least_share=1.0, settled=1e-6, wanders=0.0, negligible=1e-3, widest=(0.0,) * 3
)
"""Settings of the second fit: slopes at a point, since wider ones move the optimum by some hundredths of an sd."""

LOST = 0.05
"""Share of the readings' variation that an optimum may leave and still follow the rollouts. One that leaves more is one
of the many at which a model swings over at other times than the machine; which of them is found is chance."""

DAMPED = replace(EXACT, patience=0)
"""The same with at most half steps: where rollouts hardly determine their start, whole ones may go to and fro."""


@dataclass(frozen=True)
class LeastSquares:
    """Weighted least squares of whole rollouts with free initial states.

        min_{p, x_0}  sum_records sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    This is the prediction-error method without disturbances. A fit begins at the smoothed readings beside a small
    random torque, which frees the state of every instant as multiple shooting does; it ends without any. Every reading
    that the sensor has a noise for counts, also two of one instant. The covariance is the inverse Fisher information.

    Fits begin at the model's own numbers, then at others, at most `starts` times, until one explains the readings to
    the sensor's noise or two agree. If none converges where it follows the readings, as for a model that cannot follow
    a whole rollout, the answer is the fit beside a random torque, and its status says so.

    Parameters
    ----------
    parameters : sequence of str, default ("m", "l")
        The names of the parameters to fit.
    sensor : Sensor, default Sensor(theta=0.01, theta_dot=1.0)
        Noise of the readings, by which the residuals are weighted.
    starts : int, default 4
        The number of starts at most, at least 1.
    """

    parameters: Sequence[str] = ("m", "l")
    sensor: Sensor = Sensor(theta=0.01, theta_dot=1.0)
    starts: int = 4

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """Fit the parameters to the records.

        Parameters
        ----------
        model : Model
            The model at whose numbers the first fit begins; parameters that are not fitted keep their numbers.
        records : sequence of Record
            At least one rollout.

        Returns
        -------
        Estimate
            The best of the fits; `success` is False where no optimum of whole rollouts was found.

        Raises
        ------
        InvalidInput
            For unusable records, names or settings, and a model with an effect at the sensors or in the stamps of the
            torques.
        """
        free = free_parameters(model, self.parameters)
        if not (isinstance(self.starts, int | np.integer) and self.starts >= 1):
            raise InvalidInput(f"starts = {self.starts!r}: expected a positive count")
        check_direct(model, "LeastSquares")
        samples = Samples(model, records, self.sensor)
        fits: list[Fit] = []
        for start in islice(parameter_starts(free), self.starts):
            here = self._from(samples, model, start)
            agreed = any(abs(_squares(other) / _squares(here) - 1.0) < 1e-6 for other in fits if _follows(other))
            fits.append(here)
            if _follows(here) and (agreed or _misfit(here) < 1.0):
                break
        following = [here for here in fits if _follows(here)]
        if not following:
            return self._beside_a_random_torque(samples, model, len(fits))
        return _estimate(min(following, key=_squares), len(fits))

    def _from(self, samples: Samples, model: Model, start: Array) -> Fit:
        """The optimum that is reached from the parameters `start` (P,)."""
        begun = model.with_numbers(self.parameters, start.tolist())
        near = fit_parameters(samples, begun, self.parameters, None, Disturbances(BEGUN * level(samples)), HELD)
        whole = continued(near, NO_DISTURBANCE, EXACT)
        if whole.converged:
            return whole
        return continued(near, NO_DISTURBANCE, DAMPED)

    def _beside_a_random_torque(self, samples: Samples, model: Model, used: int) -> Estimate:
        status = (
            f"no optimum of whole rollouts was found from {used} starts: these numbers are those beside a random "
            "torque; the model lacks something, or try other starting numbers"
        )
        answer = fit_parameters(samples, model, self.parameters).estimate("least squares")
        return replace(answer, success=False, status=status)


def _follows(fit: Fit) -> bool:
    """Whether a fit has converged to an optimum at which the model follows the rollouts, or to twice the noise."""
    y, weight = fit.samples.y, fit.samples.weight**2
    middle = np.sum(weight * y, axis=0) / np.maximum(np.sum(weight, axis=0), 1e-300)
    variation = float(np.sum(weight * (y - middle) ** 2))
    return fit.converged and _squares(fit) < LOST * variation + 4.0 * fit.samples.readings


def _squares(fit: Fit) -> float:
    """The sum of the squared residuals, in units of the sensor's variance."""
    return float(np.sum(fit.linearised.system.r**2))


def _misfit(fit: Fit, quantile: float = 3.7) -> float:
    """The sum of squares divided by a chi-squared quantile, `quantile` sd above its mean; noise alone stays below 1."""
    degrees = max(1, fit.samples.readings - len(fit.names) - 2 * len(fit.samples.records))
    return _squares(fit) / (degrees + quantile * math.sqrt(2.0 * degrees))


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
