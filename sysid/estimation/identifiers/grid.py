"""Grid search on the one-step speed error: the paper's identifier."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Record, check_direct, check_records
from sysid.data.sensor import Sensor, check_sensor
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free_parameters
from sysid.physics.model import Drives, Model
from sysid.physics.ops import Array

_BLOCK = 1_500_000


@dataclass(frozen=True)
class GridSearch:
    """A grid search over the parameters' bounds for the cell with the least mean squared one-step speed error.

        argmin_p mean_k (theta_dot[k+1] - f(theta[k], theta_dot[k], u[k]; p))^2

    Of equal cells the first counts; the first parameter varies slowest. The measured theta[k] and theta_dot[k] are
    regressors, so that their noise matters: with a factor of one (m and l of a rod) it scatters the estimate, and it
    biases a parameter that multiplies the speed, such as viscous.b. The covariance is linearised, with the grid's
    rounding added; it ignores that bias. A record of one interval is one step.

    Parameters
    ----------
    parameters : sequence of str, default ("m", "l")
        The names of the parameters to fit; each one needs finite bounds.
    points : int, default 61
        The number of grid points between the bounds of each parameter, ends included, at least 2.
    sensor : Sensor, default Sensor(theta_dot=1.0)
        Noise of the readings: the status says that the model lacks something where the one-step errors tell of a noise
        of more than 1.5 times the sd of theta_dot.

    References
    ----------
    Paper, Sec. II-B, with 61 x 61 points on [0.3, 3.0]^2.
    """

    parameters: Sequence[str] = ("m", "l")
    points: int = 61
    sensor: Sensor = Sensor(theta_dot=1.0)

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """Find the best cell.

        Parameters
        ----------
        model : Model
            The model whose parameters are fitted; the other parameters keep their numbers.
        records : sequence of Record
            At least one rollout, with the angle and the speed of every instant.

        Returns
        -------
        Estimate
            The model with the numbers of the best cell; `success` is False where one of them is at the edge of the
            grid.

        Raises
        ------
        InvalidInput
            For infinite bounds, missing channels, over a million cells, fewer than two points, unknown names, unusable
            records, and a model with an effect at the sensors or in the stamps of the torques.
        """
        free = free_parameters(model, self.parameters)
        check_direct(model, "GridSearch")
        records = check_records(model, records)
        check_sensor(self.sensor)
        if not (isinstance(self.points, int | np.integer) and self.points >= 2):
            raise InvalidInput(f"points = {self.points!r}: expected at least 2")
        axes = [self._axis(p.name, p.bounds) for p in free]
        if self.points ** len(axes) > 1_000_000:
            raise InvalidInput(f"{self.points}^{len(axes)} cells are too many for a grid: use LeastSquares")
        cells = [c.reshape(-1, 1) for c in np.meshgrid(*axes, indexing="ij")]
        names = tuple(self.parameters)
        grid = model.with_numbers(names, cells)
        total = np.zeros(len(cells[0]))
        steps = _Steps(records)
        drives, count = steps.drives(grid), len(steps.u)
        width = max(1, _BLOCK // len(cells[0]))
        for begin in range(0, count, width):
            total += np.sum(steps.errors(grid, drives, slice(begin, begin + width)) ** 2, axis=1)
        best = int(np.argmin(total))
        fitted = model.with_numbers(names, [float(c[best, 0]) for c in cells])
        return self._estimate(fitted, names, axes, steps, total[best] / count)

    def _axis(self, name: str, bounds: tuple[float, float]) -> Array:
        if not math.isfinite(bounds[1] - bounds[0]):
            raise InvalidInput(
                f"{name} has no finite bounds {bounds}: a grid needs them, as Viscous(bounds={{'b': (0, 1)}}) has; "
                "use LeastSquares"
            )
        return np.linspace(*bounds, self.points)

    def _estimate(
        self,
        fitted: Model,
        names: tuple[str, ...],
        axes: list[Array],
        steps: _Steps,
        mean_square: float,
    ) -> Estimate:
        spacing = np.array([a[1] - a[0] for a in axes])
        columns = []
        for name, h in zip(names, 1e-4 * spacing, strict=True):
            value, ends = fitted.parameters[name].value, []
            sides = np.clip([value - h, value + h], *fitted.parameters[name].bounds).tolist()
            for side in sides:
                moved = fitted.with_parameters({name: side})
                ends.append(steps.errors(moved, steps.drives(moved), slice(None)).ravel())
            columns.append((ends[1] - ends[0]) / (sides[1] - sides[0]))
        jacobian = np.stack(columns, axis=1)
        covariance = mean_square * np.linalg.pinv(jacobian.T @ jacobian) + np.diag(spacing**2 / 12.0)
        # both speeds of a step are noisy, and the earlier one enters through df/dtheta_dot, which is near 1
        noise = math.sqrt(mean_square / 2.0)
        edge = [n for n, a in zip(names, axes, strict=True) if fitted.parameters[n].value in (a[0], a[-1])]
        status = (
            f"best of {self.points ** len(axes)} cells; noise in the measured speed enters on both sides of this fit"
        )
        if edge:
            status += f"; {' and '.join(edge)} ended at the edge of the grid"
        expected = self.sensor.theta_dot
        if expected is not None and noise > 1.5 * expected:
            times = f"{noise / expected:.1f} times the sensor's sd"
            status += f"; one-step errors are {times}: the model lacks something"
        return Estimate(
            model=fitted,
            names=names,
            covariance=covariance,
            noise={"theta_dot": noise},
            success=not edge,
            status=status,
            cost=math.nan,
            n_readings=2 * len(steps.u),
            method="grid search",
        )


class _Steps:
    """The K steps of all records: t, theta, speed `before` and u at each step's beginning, and the speed `after` it."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        columns = zip(*(_columns(record) for record in records), strict=True)
        self.t, self.theta, self.before, self.after, self.u = (np.concatenate(c) for c in columns)

    def errors(self, model: Model, drives: Drives, k: slice) -> Array:
        """One-step speed errors (cells, K) of a model whose numbers are arrays of cells."""
        _, predicted = model.move(self.theta[k], self.before[k], tuple(d[..., k] for d in drives), self.t[k])
        return np.atleast_2d(predicted - self.after[k])

    def drives(self, model: Model) -> Drives:
        """Drive torques, an array (..., K) for each substep."""
        if not model.input_effects:
            return (self.u,) * model.integrator.substeps
        substeps = zip(*(_drives(model, record) for record in self.records), strict=True)
        return tuple(np.concatenate(substep, axis=-1) for substep in substeps)


def _columns(record: Record) -> tuple[Array, ...]:
    if record.theta is None or record.theta_dot is None:
        lacking = "theta" if record.theta is None else "theta_dot"
        raise InvalidInput(f"{record.name} has no {lacking}: a grid search needs angles and speeds")
    n = len(record)
    if len(record.theta) < n:
        raise InvalidInput(f"{record.name} has the start angle alone: a grid search needs the angle of every instant")
    return record.time_since_start[:n], record.theta[:n], record.theta_dot[:n], record.theta_dot[1:], record.u


def _drives(model: Model, record: Record) -> Drives:
    """Drive torques over a whole record, an array (..., N) for each substep."""
    columns = list(model.drives(record.commands.tolist()))[len(record.previous_commands) :]
    return tuple(
        np.concatenate([np.reshape(drive[j], (-1, 1)) for drive in columns], axis=1)
        for j in range(model.integrator.substeps)
    )
