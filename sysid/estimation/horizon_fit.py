"""Horizon fit: the numbers with which a model predicts best over a horizon, where it lacks something."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from sysid.estimation.held_out import Refit, refit, refit_windows
from sysid.estimation.output_error import Response
from sysid.estimation.prediction import windows_of
from sysid.estimation.prediction_error import CHECKED, Fit, inverse, jackknife
from sysid.estimation.solver import HELD, fit_parameters
from sysid.estimation.windows import Window
from sysid.physics.ops import Array

EVALUATIONS = 12
"""Most evaluations of the errors."""
PROBE = 0.1
"""Step of a finite difference, in standard deviations of the number."""
LARGEST_PROBE = 0.01
"""Largest such step, as a share of the number's `scale`."""
NEGLIGIBLE_FALL = 1e-4
"""Share of the sum of squares by which the last step, or all of the IDLE last evaluations, may still lower it."""
IDLE = 4
"""After so many evaluations that bring nothing a search has ended."""
EXPLAINED = 1.05
"""RMS of the innovations, in units of the noise, up to which a model without a random torque explains its log."""
FARTHEST_INERTIA = 2.0
"""Factor from the likeliest inertia beyond which numbers that predict best imitate what is missing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class HorizonFit(Fit):
    """A fit whose numbers predict best over a horizon.

        min_p  sum_k min_x |e_k(p, x)|^2,    e_k the errors of window k, x the state at its first instant

    Likelihood weighs what happens from one reading to the next. If what a model lacks is no random torque, its numbers
    bend until they imitate that, and predictions over a second suffer. These numbers weigh the predictions themselves.

    windows        the K windows
    errors (K, R)  their errors in units of the noise, with the states refitted
    J (K, R, P)    how the errors change with the numbers, with the states refitted

    Shook, Mohtadi, Shah, "Identification for long-range predictive control", IEE Proceedings D 138 (1991) 75; Farina,
    Piroddi, "Identification of polynomial input/output recursive models with simulation error minimisation methods",
    International Journal of Systems Science 43 (2012) 319.
    """

    windows: tuple[Window, ...]
    errors: Array
    J: Array

    @cached_property
    def likelihood_covariance(self) -> Array:
        """The covariance (P, P) if the errors were white and as large as the noise."""
        return inverse(np.einsum("krp,krq->pq", self.J, self.J))

    @cached_property
    def wider(self) -> Array:
        """The factor (P,), at least 1, by which the sd of a jackknife over the windows exceeds that of the noise."""
        expected = np.diag(self.likelihood_covariance)
        if not np.all(np.isfinite(expected)):
            return np.ones(len(self.names))
        K, R, P = self.J.shape
        windows = [slice(k * R, (k + 1) * R) for k in range(K)]
        moved = jackknife(self.J.reshape(-1, P), self.errors.ravel(), windows, CHECKED, np.zeros((0, P)))
        return np.sqrt(np.maximum((1.0 - 1.0 / K) * np.sum(np.square(moved), axis=0) / expected, 1.0))


def horizon_fit(fit: Fit, seconds: float) -> HorizonFit | None:
    """The numbers that predict best over windows of some `seconds`, begun at those of a fit.

    There are none if nothing is free, if the model explains the log, so that likelihood decides, if it runs away, or if
    the inertia would be another by FARTHEST_INERTIA.
    """
    from scipy.optimize import least_squares

    explains = fit.undisturbed and float(np.sqrt(np.mean(fit.e**2))) < EXPLAINED
    if explains or not fit.names:
        return None
    predictions = _Predictions(fit, windows_of(fit, seconds))
    if not np.all(np.isfinite(predictions.errors(fit.values))):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        solution = least_squares(
            predictions.errors,
            fit.values,
            predictions.slopes,
            (predictions.low, predictions.high),
            x_scale="jac",
            ftol=NEGLIGIBLE_FALL,
            max_nfev=EVALUATIONS,
        )
    model = fit.model.with_numbers(fit.names, solution.x.tolist())
    if abs(math.log(float(model.inertia()) / fit.inertia)) > math.log(FARTHEST_INERTIA):
        return None
    held = fit_parameters(fit.samples, model, (), fit, settings=HELD)
    at = {f.name: getattr(held, f.name) for f in fields(Fit)}
    K, P = len(predictions.windows), len(fit.names)
    return HorizonFit(
        **at
        | {"names": fit.names, "prior": fit.prior}
        | {"converged": fit.converged and (solution.status > 0 or predictions.stay)}
        | {"Z": held.filter.whiten(*held.linearised.changes(fit.names))},
        windows=predictions.windows,
        errors=solution.fun.reshape(K, -1),
        J=solution.jac.reshape(K, -1, P),
    )


class _Predictions:
    """The errors of a model's predictions over windows as functions of its numbers, with the states refitted."""

    def __init__(self, fit: Fit, windows: tuple[Window, ...]) -> None:
        self.fit, self.windows = fit, windows
        self.at = refit_windows(fit.model, fit.samples, windows)
        self.values, self.starts, self.squares = fit.values, self.at.starts, [float(np.sum(self.at.lin.e**2))]
        parameters = [fit.model.parameters[n] for n in fit.names]
        self.low, self.high = np.array([p.bounds for p in parameters]).T
        sd = np.nan_to_num(np.sqrt(np.diag(fit.likelihood_covariance)), nan=np.inf)
        largest = LARGEST_PROBE * np.array([p.scale for p in parameters])
        self.probes = np.where(sd > 0.0, np.minimum(PROBE * sd, largest), largest)

    @property
    def stay(self) -> bool:
        """Whether the last evaluations have found no lower sum of squares than those before. Where a joint sticks now
        and then, slopes promise more than steps keep, and SciPy's criteria do not end the search."""
        return min(self.squares) >= (1.0 - NEGLIGIBLE_FALL) * min(self.squares[:-IDLE])

    def errors(self, values: Array) -> Array:
        """The errors (K R,)."""
        return self._refitted(values).lin.e.ravel()

    def slopes(self, values: Array) -> Array:
        """The derivatives (K R, P) of the errors. To first order the refitted states take from the change of the errors
        what lies in their span."""
        at, columns = self._refitted(values), []
        for i, probe in enumerate(self.probes):
            moved = values.copy()
            moved[i] += probe if values[i] + probe <= self.high[i] else -probe
            change = np.nan_to_num(self._response(moved).linearise(at.starts).e - at.lin.e) / (moved[i] - values[i])
            along = np.einsum("krs,kr->ks", at.basis, change)
            columns.append((change - np.einsum("krs,ks->kr", at.basis, along)).ravel())
        return np.stack(columns, axis=-1)

    def _refitted(self, values: Array) -> Refit:
        """The windows with their states refitted, begun at the best states until now."""
        if not np.array_equal(values, self.values):
            self.at, self.values = refit(self._response(values), self.starts), values.copy()
            squares = float(np.sum(self.at.lin.e**2))
            if squares < min(self.squares):
                self.starts = self.at.starts
            self.squares.append(squares)
        return self.at

    def _response(self, values: Array) -> Response:
        return Response(self.fit.model.with_numbers(self.fit.names, values.tolist()), self.fit.samples, self.windows)
