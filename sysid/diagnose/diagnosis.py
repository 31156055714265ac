"""diagnose: from a model and a log to the effect that is missing, with the evidence."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from sysid.comparison.held_out import HeldOutError, error_of, held_out_error, lead_of, refit_windows
from sysid.comparison.whiteness import whiteness
from sysid.diagnose.answer import Diagnosis, Ranked, Remaining, Step
from sysid.diagnose.refits import LEAD, at_horizon, reduce_by
from sysid.diagnose.screen import alikeness
from sysid.diagnose.search import SAME, Round, Search
from sysid.diagnose.whereabouts import whereabouts
from sysid.effects import CATALOGUE, effect
from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.fit import free
from sysid.identify.gauss_newton import HORIZONS, Fit, fit_longest
from sysid.model import Model
from sysid.records import Record, check_records, told_apart
from sysid.sensor import Sensor
from sysid.smoothing.touched import Touched
from sysid.windows import cut

EXCESS = 1.2
"""Multiple of the sensor noise from which errors that hang together mean that something is missing."""

MOST_RESTARTS = 2
"""What a hand touched is left out and the search begun anew, at most so often."""

POWER = 3.9
"""Size, in its standard deviations, that is found in 80 % of logs at the level that Holm leaves to 25 candidates."""


def diagnose(
    model: Model | Estimate,
    records: Sequence[Record],
    sensor: Sensor | None = None,
    hold_out: float | None = None,
    effects: Iterable[str] | None = None,
) -> Diagnosis:
    """Which physical effect is missing?

    Fits the model, screens every effect of the catalogue at once by a score test, confirms the best by refit and
    cross-validation, adds it, and goes on until nothing more is warranted; then says what remains.

    model      a model, or an estimate: its free parameters are refitted, the others keep their numbers
    records    at least one rollout; `hold_out` (a share, or a count) of them is never fitted and only reports;
               stretches that a hand touched are left out of the search, and named
    sensor     noise of the readings; by default the estimate's, else found from the records without any model
    effects    names of the effects that may be missing; by default the whole catalogue

    Raises InvalidInput for unusable records and unknown names.
    """
    from sysid.logs import leave_out, split

    began = time.perf_counter()
    records = told_apart(check_records(model.model if isinstance(model, Estimate) else model, records))
    names = model.names if isinstance(model, Estimate) else free(model)
    if isinstance(model, Estimate):
        sensor, model = sensor or model.sensor, model.model
    chosen = None if effects is None else _known(effects)
    if sensor is None:
        from sysid.noise import sensor_noise

        sensor = sensor_noise(records).sensor
    training, held_out = split(records, hold_out)
    touched: tuple[Touched, ...] = ()
    for restarts_left in reversed(range(MOST_RESTARTS + 1)):
        base = fit_longest(model, names, training, sensor, lead=LEAD)
        search = Search(training, chosen)
        end = search.run(base)
        found = _touched(end) if restarts_left and _perhaps_touched(search.rounds[-1]) else ()
        rest = leave_out(training, [(t.name, t.t_begin, t.t_end) for t in found])
        if not found or sum(map(len, rest)) < 0.6 * sum(map(len, training)):
            break
        touched, training = (*touched, *found), rest
    return _Report(search, base, end, held_out, sensor, touched).diagnosis(began)


def _perhaps_touched(last: Round) -> bool:
    """Whether what remains depends on time, or on nothing that was tried, or the model follows the log nowhere long."""
    kinds, unexplained = last.structured, last.left or last.fit.variance > EXCESS**2
    return unexplained and (not kinds or kinds[0] == "time" or last.fit.horizon <= HORIZONS[0])


def _touched(fit: Fit) -> tuple[Touched, ...]:
    """Stretches in which something acts that no state of the joint explains, judged by the scatter about the fit:
    a vibration that no rigid joint makes would hide every hand."""
    from sysid.smoothing.residual_torque import residual_torque

    return residual_torque(fit.model, fit.response.records, Sensor(**fit.residual_sd())).touched


def _known(effects: Iterable[str]) -> tuple[str, ...]:
    names = (effects,) if isinstance(effects, str) else tuple(effects)
    for name in names:
        if name not in CATALOGUE:
            effect(name)  # raises, and says which names are near
    if not names:
        raise InvalidInput("no effects were named: leave them out to try the whole catalogue")
    return names


def _share(error: HeldOutError) -> float:
    """Of the squared error, what is beyond the sensors' noise."""
    return max(0.0, 1.0 - 1.0 / max(error.ratio, 1e-9) ** 2)


class _Report:
    """Puts the way of a search into words and numbers; errors are held-out."""

    def __init__(
        self,
        search: Search,
        base: Fit,
        end: Fit,
        held_out: Sequence[Record],
        sensor: Sensor,
        touched: tuple[Touched, ...],
    ) -> None:
        self.search, self.base, self.end, self.held_out, self.sensor = search, base, end, held_out, sensor
        self.touched = touched
        self.last, self.first = search.rounds[-1], search.rounds[0]

    def error(self, fit: Fit) -> HeldOutError:
        return held_out_error(fit.model, self.held_out, self.sensor)

    def diagnosis(self, began: float) -> Diagnosis:
        """The answer; `began` is when the question was asked."""
        base_error, error = self.error(self.base), self.error(self.end)
        steps = self._steps(base_error)
        machine = tuple(s for s in steps if not CATALOGUE[s.effect].of_log)
        remaining = self._remaining(error)
        verdict = "adequate" if not machine else "missing"
        if any(s.rivals for s in machine):
            verdict = "cannot tell"
        if remaining is not None:
            verdict = "unknown"
        return Diagnosis(
            verdict=verdict,
            base=self.base.estimate(),
            base_error=base_error,
            error=error,
            steps=machine,
            conventions=tuple(s for s in steps if CATALOGUE[s.effect].of_log),
            ranking=self._ranking(),
            remaining=remaining,
            not_identifiable=self._not_identifiable(),
            ruled_out=self._ruled_out(),
            sensor=self.sensor,
            held_out=tuple(r.name for r in self.held_out),
            estimate=self.end.estimate(),
            touched=self.touched,
            next_experiment=self._experiment(verdict, machine),
            seconds=time.perf_counter() - began,
        )

    def _experiment(self, verdict: str, machine: tuple[Step, ...]) -> dict[str, Any] | None:
        """What to play next where a class does not separate."""
        if verdict != "cannot tell":
            return None
        from sysid.planning.experiment import next_experiment

        alike = next(s.alike for s in machine if s.rivals)
        try:
            return next_experiment(
                self.end.estimate(), alike, sensor=self.sensor, records=self.search.records
            ).to_dict()
        except InvalidInput:  # no torque in the log, or rivals that exclude each other
            return None

    def _steps(self, base_error: HeldOutError) -> tuple[Step, ...]:
        estimate = self.end.estimate()
        sd, steps, before = estimate.sd, [], base_error.ratio
        for k, addition in enumerate(self.search.additions):
            fit = self._after(k)
            after = self.error(fit).ratio
            numbers = {
                name: {"value": value, "sd": sd[name], "unit": estimate.model.parameters[name].unit}
                for name, value in estimate.values.items()
                if name.startswith(f"{addition.name}.")
            }
            alike = (addition.name, *addition.same, *addition.close)
            steps.append(
                Step(addition.name, alike, addition.close, numbers, before, after, addition.p_value, fit.estimate())
            )
            before = after
        return tuple(steps)

    def _after(self, k: int) -> Fit:
        """The fit with the first k + 1 additions and no other: where one was dropped or swapped since, fitted anew."""
        additions = self.search.additions
        if k == len(additions) - 1:
            return self.end
        fit, wanted = additions[k].fit, {e.name for e in self.base.model.effects} | {a.name for a in additions[: k + 1]}
        if {e.name for e in fit.model.effects} == wanted:
            return fit
        fit = at_horizon(self.end, self.base.horizon)
        for later in reversed(additions[k + 1 :]):
            fit = reduce_by(fit, later.name)
        return fit

    def _ranking(self) -> tuple[Ranked, ...]:
        """The first round: those that were refitted by what came out, then the others by their expected merit."""
        fitted = {t.name: t for t in self.search.first_trials}
        variance = min((t.fit.variance for t in fitted.values()), default=1.0)
        order = sorted(fitted, key=lambda n: fitted[n].merit(variance), reverse=True)
        if self.search.first_choice in order:
            order.remove(self.search.first_choice)
            order.insert(0, self.search.first_choice)
        visible = [n for n, s in self.first.scores.items() if s.visible]
        order += sorted((n for n in visible if n not in fitted), key=self.first.merit, reverse=True)
        return tuple(
            Ranked(
                name,
                (name, *self._same(self.first, name)),
                self.first.merit(name),
                self.first.adjusted[name],
                self.error(fitted[name].fit).ratio if name in fitted else None,
            )
            for name in order
        )

    @staticmethod
    def _same(now: Round, name: str) -> tuple[str, ...]:
        own = now.scores[name]
        return tuple(
            n
            for n, s in now.scores.items()
            if n != name and s.visible and len(s.sizes) == len(own.sizes) and alikeness(s, own) > SAME
        )

    def _remaining(self, error: HeldOutError) -> Remaining | None:
        structured = self.last.structured
        if not self.last.left and not self.touched:
            return self._misread(error)
        depends_on = self.last.flexible[structured[0]].depends_on if structured else ()
        where = whereabouts(self.end, self.last.flexible[structured[0]]) if structured else ""
        if self.touched:
            depends_on = (*(q for q in depends_on if q != "time"), "time")
            where = f"in {'; '.join(map(str, self.touched))}" + (f"; {where}" if where else "")
        return Remaining(_share(error), depends_on, where)

    def _misread(self, error: HeldOutError) -> Remaining | None:
        """Errors clearly above the noise that hang together, while no torque of any kind would make them smaller."""
        records, model = self.search.records, self.end.model
        refitted = refit_windows(model, records, self.sensor, cut(records, 1.0, lead_of(model)))
        excess = [c for c, ratio in error_of(refitted, 1.0).ratios.items() if ratio > EXCESS]
        if not excess:
            return None
        white = whiteness(refitted)
        coloured = [c for c in excess if c in white and white[c].p_value < 1e-6]
        if not coloured:
            return None
        return Remaining(_share(error), (), f"in what is read as {' and '.join(coloured)}, whatever the torque")

    def _not_identifiable(self) -> tuple[tuple[str, ...], ...]:
        """Parameters that no log of this kind separates, and effects that the free parameters absorb."""
        groups = []
        plant = tuple(n for n in self.end.names if "." not in n)
        absorbed = tuple(n for n, s in self.first.scores.items() if s.absorbed)
        if absorbed:
            groups.append((*plant, *absorbed))
        groups.extend((a.name, *a.same) for a in self.search.additions if a.same)
        F = self.end.reduced.information
        size = np.sqrt(np.maximum(np.diag(F), 1e-300))
        values, vectors = np.linalg.eigh(F / np.outer(size, size))
        for value, v in zip(values, vectors.T, strict=True):
            if value < 1e-9:
                groups.append(tuple(n for n, c in zip(self.end.names, v, strict=True) if abs(c) > 0.2))
        return tuple(groups)

    def _ruled_out(self) -> dict[str, dict[str, Any]]:
        """Sizes above which effects that were not found would have been found."""
        found = {}
        for name, s in self.last.scores.items():
            if not s.visible or s.best is None or len(s.sizes) != 1 or not math.isfinite(s.sd[0]):
                continue
            p = s.best.neutral.parameters[s.best.magnitudes[0]]
            if name != "saturation":
                found[name] = {"parameter": p.name, "size": POWER * s.sd[0], "unit": p.unit}
        return found
