"""Output error by multiple shooting: the identifier that reaches the Cramer-Rao bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from sysid.data.record import Record, check_records
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.estimation.identifiers.identifier import free_parameters
from sysid.estimation.identifiers.multiple_shooting import MultipleShooting, Solution
from sysid.estimation.identifiers.sensitivity import LONGEST_SEGMENT, Segments
from sysid.estimation.smoothed_start import parameter_starts, smooth_states
from sysid.physics.model import Model
from sysid.physics.ops import Array


@dataclass(frozen=True)
class LeastSquares:
    """Weighted least squares of whole rollouts with free initial states.

        min_{p, x_0}  sum_records sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    Solved by multiple shooting (Bock & Plitt, 1984): nodes every `segment` [s], 50 samples at most, are variables
    too, tied by continuity constraints, so the optimum is that of whole rollouts and the nodes only help to find it.
    IPOPT takes exact first and second derivatives from CasADi. Every reading that the sensor vouches for counts,
    both of an instant that was read twice. The covariance is the inverse Fisher information.

    Where angles are read, a fit begins with smoothed states and free windows; where only speeds are, with the first
    half second, and the horizon grows. It begins at the model's own numbers, then at others, at most `starts`
    times, until the readings are explained to the sensor's noise or two starts agree. Where no start
    converges, as for a model that cannot follow a whole rollout, the answer is that of free windows, and says so.
    """

    parameters: Sequence[str] = ("m", "l")
    sensor: Sensor = Sensor(theta=0.01, theta_dot=1.0)
    segment: float = 1.0
    starts: int = 4

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """The estimate; raises InvalidInput for unusable records, names or settings."""
        free = free_parameters(model, self.parameters)
        records = check_records(model, records)
        if not self.segment > 0.0 or self.starts < 1:
            raise InvalidInput(f"segment = {self.segment} s, starts = {self.starts}: expected a positive time, count")
        search = _Search(self, model, records)
        found: list[Solution] = []
        for start in islice(parameter_starts(free), self.starts):
            solution = search.run(start, refine=len(found) % 2 == 1)
            agreed = solution.success and any(abs(f.cost / solution.cost - 1.0) < 1e-6 for f in found if f.success)
            found.append(solution)
            if solution.success and (agreed or search.misfit(solution) < 1.0):
                break
        converged = [f for f in found if f.success]
        if converged:
            best = min(converged, key=lambda f: f.cost)
            return self._estimate(model, search, best, self._status(search, best, len(found)))
        window = search.segments.length * model.dt
        status = (
            f"no optimum of whole rollouts was found from {len(found)} starts: these numbers are those of free "
            f"windows of {window:g} s; the model lacks something, or try other starting numbers"
        )
        return self._estimate(model, search, search.windows(next(parameter_starts(free))), status)

    def _status(self, search: _Search, best: Solution, used: int) -> str:
        if search.misfit(best) < 1.0:
            return f"converged at start {used}; the readings are explained to the sensor's noise"
        size = search.misfit(best, quantile=0.0) ** 0.5
        return (
            f"converged, but the best of {used} starts leaves {size:.2g} times the sensor's noise: "
            "the model lacks something, or the sensor's sd is too small"
        )

    def _estimate(self, model: Model, search: _Search, best: Solution, status: str) -> Estimate:
        names, segments = tuple(self.parameters), search.segments
        blocks = segments.blocks(best.p, best.nodes)
        information = segments.information(blocks, whole=best.success)
        covariance = _inverse(information)
        known = bool(np.all(np.isfinite(covariance)))
        if not known:
            status = f"{status}; yet the records do not determine {', '.join(names)}"
        free_states = len(segments.records) if best.success else segments.size
        squares = blocks.squares
        total = int(segments.n_readings.sum())
        sds = (("theta", self.sensor.theta), ("theta_dot", self.sensor.theta_dot))
        return Estimate(
            model=model.with_parameters(dict(zip(names, best.p.tolist(), strict=True))),
            names=names,
            covariance=covariance,
            noise={
                channel: sd * math.sqrt(squares[row] / segments.n_readings[row] * total / search.degrees(free_states))
                for row, (channel, sd) in enumerate(sds)
                if sd is not None
            },
            success=best.success and known,
            status=status,
            cost=float(np.sum(squares)),
            n_readings=total,
            method="least squares",
        )


def _inverse(information: Array) -> Array:
    """The covariance (P, P), scaled before it is inverted; infinite where some direction is not determined."""
    size = np.sqrt(np.diag(information))
    if np.all(size > 0.0):
        scaled = information / np.outer(size, size)
        if np.linalg.eigvalsh(scaled)[0] > 1e-12:
            inverse: Array = np.linalg.inv(scaled) / np.outer(size, size)
            return 0.5 * (inverse + inverse.T)
    return np.full_like(information, np.inf)


class _Search:
    """The way from a starting point to a local optimum of whole rollouts."""

    def __init__(self, settings: LeastSquares, model: Model, records: Sequence[Record]) -> None:
        self.settings, self.model, self.records = settings, model, records
        self.parameters = free_parameters(model, settings.parameters)
        self.states = [smooth_states(r, settings.sensor) for r in records]
        longest = max(len(r) for r in records)
        length = max(1, round(min(settings.segment / model.dt, LONGEST_SEGMENT, longest)))
        self.segments = Segments(model, settings.parameters, records, settings.sensor, length)
        self.problem = MultipleShooting(self.segments, self.parameters)

    def degrees(self, free_states: int) -> int:
        """Readings less fitted numbers, of which each free state has two."""
        return max(1, int(self.segments.n_readings.sum()) - len(self.parameters) - 2 * free_states)

    def misfit(self, solution: Solution, quantile: float = 3.7) -> float:
        """The sum of squares over its chi-square quantile (in sd above the mean); noise alone stays below 1."""
        degrees = self.degrees(len(self.records))
        return 2.0 * solution.cost / (degrees + quantile * math.sqrt(2.0 * degrees))

    def run(self, p: Array, refine: bool) -> Solution:
        """From parameters p (P,) to whole rollouts; `refine` takes another, slower way there."""
        if self.settings.sensor.theta is None or not all(r.has_angles for r in self.records):
            return self._grow(p, np.array([s[0] for s in self.states]), factor=1.25 if refine else 1.6)
        windows = self.windows(p)
        if refine:
            return self._grow(windows.p, windows.nodes[self.segments.first], factor=1.6)
        return self.problem.solve(windows.p, windows.nodes)

    def windows(self, p: Array) -> Solution:
        """Segments with free states of their own, begun at smoothed ones."""
        nodes = [s[: len(r) : self.segments.length] for s, r in zip(self.states, self.records, strict=True)]
        problem = MultipleShooting(self.segments, self.parameters, continuity=False)
        return replace(problem.solve(p, np.concatenate(nodes)), success=False)

    def _grow(self, p: Array, starts: Array, factor: float) -> Solution:
        horizon, longest = max(2.0, 0.5 / self.model.dt), max(len(r) for r in self.records)
        while horizon < longest:
            head = self.segments.head(round(horizon))
            stage = MultipleShooting(head, self.parameters, max_iterations=30, tolerance=1e-4)
            found = stage.solve(p, head.roll(p, starts))
            p, starts = found.p, found.nodes[head.first]
            horizon *= factor
        return self.problem.solve(p, self.segments.roll(p, starts))
