"""Output error by multiple shooting: the identifier that reaches the Cramer-Rao bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.identify.identifier import free_parameters
from sysid.identify.multiple_shooting import MultipleShooting, Solution
from sysid.identify.start import parameter_starts, smooth_states
from sysid.model import Model
from sysid.records import Array, Record, check_records
from sysid.sensitivity import Segments
from sysid.sensor import Sensor


@dataclass(frozen=True)
class LeastSquares:
    """Weighted least squares of whole rollouts with free initial states.

        min_{p, x_0}  sum_records sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    Solved by multiple shooting (Bock & Plitt, 1984): nodes every `segment` [s] are variables too, tied by
    continuity constraints, so the optimum is that of whole rollouts and the nodes only help to find it. IPOPT takes
    exact first derivatives and the Gauss-Newton Hessian from CasADi. Every reading that the sensor vouches for
    counts, both of an instant that was read twice. The covariance is the inverse Fisher information.

    Where angles are read, a fit begins with smoothed states and free windows; where only speeds are, with the first
    half second, and the horizon grows. It begins at the model's own numbers, and again at others of their
    bounds, at most `starts` times, until the readings are explained to the sensor's noise.
    """

    parameters: Sequence[str] = ("m", "l")
    sensor: Sensor = Sensor(theta=0.01, theta_dot=1.0)
    segment: float = 1.0
    starts: int = 5

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """The estimate; raises InvalidInput for unusable records, names or settings."""
        free = free_parameters(model, self.parameters)
        records = check_records(model, records)
        if not self.segment > 0.0 or self.starts < 1:
            raise InvalidInput(f"segment = {self.segment} s, starts = {self.starts}: expected a positive time and count")
        search = _Search(self, model, records)
        best: Solution | None = None
        used = 0
        for start in parameter_starts(free):
            found = search.run(start, refine=used % 2 == 1)
            used += 1
            if best is None or (found.success, -found.cost) > (best.success, -best.cost):
                best = found
            if used == self.starts or (best.success and search.misfit(best) < 1.0):
                return self._estimate(model, search, best, used)
        raise AssertionError("parameter_starts is endless")

    def _estimate(self, model: Model, search: _Search, best: Solution, used: int) -> Estimate:
        names, segments = tuple(self.parameters), search.segments
        blocks = segments.blocks(best.p, best.nodes)
        information = segments.information(blocks)
        if np.linalg.matrix_rank(information, hermitian=True) < len(names):
            covariance = np.full_like(information, np.inf)
        else:
            covariance = np.linalg.inv(information)
        squares = blocks.squares + segments.scatter
        total = int(segments.n_readings.sum())
        share = max(1, search.degrees) / total
        noise = {
            channel: sd * float(np.sqrt(squares[row] / (share * segments.n_readings[row])))
            for row, (channel, sd) in enumerate((("theta", self.sensor.theta), ("theta_dot", self.sensor.theta_dot)))
            if sd is not None
        }
        if not best.success:
            status = f"did not converge from {used} starts ({best.message}): try other numbers or a shorter segment"
        elif search.misfit(best) < 1.0:
            status = f"converged at start {used}; the readings are explained to the sensor's noise"
        else:
            size = float(np.sqrt(np.sum(squares) / max(1, search.degrees)))
            status = (
                f"converged, but the best of {used} starts leaves {size:.2g} times the sensor's noise: "
                "the model lacks something, or the sensor's sd is too small"
            )
        return Estimate(
            model=model.with_parameters(dict(zip(names, best.p.tolist(), strict=True))),
            names=names,
            covariance=covariance,
            noise=noise,
            success=best.success,
            status=status,
            cost=float(np.sum(squares)),
            n_readings=total,
            method="least squares",
        )


class _Search:
    """The way from a starting point to a local optimum of whole rollouts."""

    def __init__(self, settings: LeastSquares, model: Model, records: Sequence[Record]) -> None:
        self.settings, self.model, self.records = settings, model, records
        self.parameters = free_parameters(model, settings.parameters)
        self.states = [smooth_states(r, settings.sensor) for r in records]
        self.segments = self._segments(records)
        self.problem = MultipleShooting(self.segments, self.parameters)
        self.degrees = int(self.segments.n_readings.sum()) - len(self.parameters) - 2 * len(records)

    def _segments(self, records: Sequence[Record]) -> Segments:
        length = max(1, round(self.settings.segment / self.model.dt))
        return Segments(self.model, self.settings.parameters, records, self.settings.sensor, length)

    def misfit(self, solution: Solution) -> float:
        """The sum of squares over what the sensor's noise alone stays below in all but one of 10,000 data sets."""
        d = max(1, self.degrees)
        return (2.0 * solution.cost + float(np.sum(self.segments.scatter))) / (d + 3.7 * np.sqrt(2.0 * d) + 9.0)

    def run(self, p: Array, refine: bool) -> Solution:
        """From parameters p (P,); `refine` takes smaller steps in the horizon."""
        if self.settings.sensor.theta is not None:
            nodes = np.concatenate(
                [s[: len(r) : self.segments.length] for s, r in zip(self.states, self.records, strict=True)]
            )
            windows = MultipleShooting(self.segments, self.parameters, continuity=False).solve(p, nodes)
            return self.problem.solve(windows.p, windows.nodes)
        return self._grow(p, factor=1.25 if refine else 1.6)

    def _grow(self, p: Array, factor: float) -> Solution:
        starts = np.array([s[0] for s in self.states])
        horizon, longest = max(2.0, 0.5 / self.model.dt), max(len(r) for r in self.records)
        while horizon < longest:
            head = self._segments([r.head(round(horizon)) for r in self.records])
            stage = MultipleShooting(head, self.parameters, max_iterations=30, tolerance=1e-4)
            found = stage.solve(p, head.roll(p, starts))
            p, starts = found.p, found.nodes[head.first]
            horizon *= factor
        return self.problem.solve(p, self.segments.roll(p, starts))
