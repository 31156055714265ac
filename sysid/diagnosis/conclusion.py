"""Conclusion: the answer of a diagnosis, made from a search and from what of it is confirmed."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from sysid.data.record import Record
from sysid.diagnosis.answer import Alternative, Diagnosis, Step
from sysid.diagnosis.confirmation import Confirmation
from sysid.diagnosis.criteria import is_plausible
from sysid.diagnosis.findings import fitted_numbers
from sysid.diagnosis.ranked import Ranked
from sysid.errors import InvalidInput
from sysid.estimation.energy_balance import FRICTIONS
from sysid.estimation.likelihood import p_value
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import settled
from sysid.physics.effects import CATALOGUE
from sysid.planning.planned_experiment import Experiment

DETECTABLE = 3.9
"""Size of an effect, in standard deviations, that is found in 80 % of logs at the price that an effect has to pay."""
FELL = 5e-3
"""A fall of the held-out error by less than this share is reported together with that of the next step."""


def conclusion(confirmed: Confirmation, records: tuple[Record, ...], notes: tuple[str, ...], began: float) -> Diagnosis:
    """The answer that a confirmation leads to; `notes` are those of reading the records, and `began` is the clock [s]
    when the question was asked."""
    return _Conclusion(confirmed, records, notes).diagnosis(began)


class _Conclusion:
    """Makes the Diagnosis from a search and its confirmation."""

    def __init__(self, confirmed: Confirmation, records: tuple[Record, ...], notes: tuple[str, ...]) -> None:
        self.confirmed, self.evidence = confirmed, confirmed.evidence
        self.search, self.base = self.evidence.search, self.evidence.base
        self.records, self.notes = records, notes

    def diagnosis(self, began: float) -> Diagnosis:
        """The answer."""
        now, bare = self.confirmed.now, self.confirmed.explanation(())
        end, steps = now.fit, self._steps(now.fit)
        machine = tuple(s for s in steps if not CATALOGUE[s.effect].of_log)
        verdict = "adequate" if not machine else "missing"
        if sum(s.decrease for s in machine if s.rivals) > 0.5 * sum(s.decrease for s in machine):
            verdict = "cannot tell"
        elif now.remaining is not None:
            verdict = "partly" if machine or self.confirmed.friction else "unknown"
        named = (*now.names, *self.confirmed.unconfirmed)
        return Diagnosis(
            verdict=verdict,
            base=bare.fit.estimate(),
            base_error=bare.error,
            error=now.error,
            steps=machine,
            conventions=tuple(s for s in steps if CATALOGUE[s.effect].of_log),
            ranking=self._ranking(now.torque.before),
            remaining=now.remaining,
            not_identifiable=self._not_identifiable(end),
            ruled_out=self._ruled_out(),
            sensor=self.evidence.sensor,
            records=self.records,
            unseen=tuple(self.evidence.held_out),
            notes=self.notes,
            friction=self.confirmed.friction,
            alternatives=tuple(self._alternatives(end)),
            estimate=end.estimate(),
            contacts=self.evidence.contacts,
            next_experiment=self._experiment(machine, end),
            seconds=time.perf_counter() - began,
            torque=now.torque,
            negligible=tuple(n for n in self.search.negligible if n not in named),
            unconfirmed=tuple(self.confirmed.unconfirmed),
            tolerance=self.search.settings.tolerance,
        )

    def _experiment(self, machine: tuple[Step, ...], end: Fit) -> Experiment | None:
        """The experiment to play next if an effect has rivals that this log cannot tell from it."""
        indistinguishable = next((s.indistinguishable for s in machine if s.rivals), None)
        if indistinguishable is None:
            return None
        from sysid.planning.next_experiment import next_experiment

        try:
            return next_experiment(
                end.estimate(), indistinguishable, sensor=self.search.sensor, records=self.search.records
            )
        except InvalidInput:  # no torque in the log, or rivals that exclude each other
            return None

    def _alternatives(self, end: Fit) -> Iterator[Alternative]:
        """Other sets of common frictions with which the log is about as likely; and refinements tried at first with
        which it is as likely as with the additions, simpler forms of them."""
        names = self.confirmed.now.names
        common = tuple(n for n in FRICTIONS if n in names)
        for other in self.confirmed.as_likely:
            yield _alternative(other.fit, tuple(n for n in FRICTIONS if n in other.names), common)
        for trial in self.search.trials:
            name = trial.single
            if name and len(names) > 1 and set(names) in map(set, CATALOGUE[name].refines):
                fit = settled(trial.fit)
                if fit.deviance - end.deviance < self.search.settings.close_deviance and is_plausible(fit, (name,)):
                    yield _alternative(fit, (name,), tuple(a.name for a in self.confirmed.additions))

    def _steps(self, end: Fit) -> tuple[Step, ...]:
        """The additions as steps, in their order; effects that pay only together share one fall of the error."""
        estimate, additions = end.estimate(), self.confirmed.additions
        errors = [self.confirmed.explanation(additions[:k]).error.ratio for k in range(len(additions) + 1)]
        steps, first = list[Step](), 0
        for k, addition in enumerate(additions):
            falls = (j for j in range(k + 1, len(errors)) if errors[j] < errors[first] * (1.0 - FELL))
            last = next(falls, len(errors) - 1)
            steps.append(
                Step(
                    effect=addition.name,
                    indistinguishable=(addition.name, *addition.same, *addition.close),
                    rivals=addition.close,
                    parameters=fitted_numbers(estimate, addition.name),
                    error_before=errors[first],
                    error_after=errors[last],
                    p_value=addition.p_value,
                    estimate=self.confirmed.explanation(additions[: k + 1]).fit.estimate(),
                )
            )
            first = last if last == k + 1 else first
        return tuple(steps)

    def _ranking(self, missing: float) -> tuple[Ranked, ...]:
        """First the effects that stayed, then others that were fitted, by merit, then the rest, by expected merit."""
        first = self.search.first
        stayed = [a for a in self.confirmed.additions if a.name in first]
        fits = {t.single: t.fit for t in self.search.trials if t.single}
        merit = {n: s.merit(self.search.settings.price) for n, s in first.items()}
        merit |= {t.single: t.merit for t in self.search.trials if t.single}
        fits |= {a.name: self.confirmed.explanation([a]).fit for a in stayed if a.name not in fits}
        fitted = sorted(fits, key=merit.__getitem__, reverse=True)
        others = sorted((n for n, s in first.items() if s.visible), key=merit.__getitem__, reverse=True)
        order = dict.fromkeys((*(a.name for a in stayed), *fitted, *others))
        return tuple(
            Ranked(
                name,
                (name, *self.search.inseparable(name)),
                merit[name],
                min(1.0, p_value(first[name].lm, max(len(first[name].sizes), 1)) * len(first)),
                error_after=self.evidence.error(fits[name]).ratio if name in fits else None,
                fit=fits.get(name),
                needed=self.evidence.needed,
                missing=missing,
            )
            for name in order
        )

    def _not_identifiable(self, end: Fit) -> tuple[tuple[str, ...], ...]:
        """Groups that no log of this kind separates: parameters with each other, and effects with what absorbs them."""
        groups = []
        plant = end.model.plant.parameters
        absorbed = [n for n, s in self.search.first.items() if s.absorbed]
        damped = end.model.damping in end.names
        excluded = () if end.model.actuator is None else end.model.actuator.excludes
        by_damping = [n for n in absorbed if damped and not CATALOGUE[n].inertial]
        if len(absorbed) > len(by_damping):
            groups.append((*(n for n in end.names if n in plant), *(n for n in absorbed if n not in by_damping)))
        groups.extend((a.name, *a.same) for a in self.confirmed.additions if a.same)
        if damped:
            others = (n for n, kind in CATALOGUE.items() if kind.brakes and n not in excluded)
            groups.append((end.model.damping, *others, *by_damping))
        F = end.Z.T @ end.Z
        size = np.sqrt(np.maximum(np.diag(F), 1e-300))
        values, vectors = np.linalg.eigh(F / np.outer(size, size)) if len(size) else (np.zeros(0), np.zeros((0, 0)))
        for value, v in zip(values, vectors.T, strict=True):
            if value < 1e-9:
                groups.append(tuple(n for n, c in zip(end.names, v, strict=True) if abs(c) > 0.2))
        return tuple(groups)

    def _ruled_out(self) -> dict[str, dict[str, Any]]:
        """For effects that were not found, the sizes above which they would have been."""
        sizes = {}
        for name, s in self.search.last.items():
            if not s.visible or len(s.sizes) != 1 or not math.isfinite(s.sd[0]):
                continue
            p = s.best.neutral.parameters[s.best.magnitudes[0]]
            if not p.never:
                unit = self.base.model.plant.unit(p.unit)
                sizes[name] = {"parameter": p.name, "size": DETECTABLE * s.sd[0], "unit": unit}
        return sizes


def _alternative(fit: Fit, effects: tuple[str, ...], instead: tuple[str, ...]) -> Alternative:
    """The alternative of some effects, with their numbers in a fit."""
    estimate = fit.estimate()
    return Alternative(effects, instead, {name: fitted_numbers(estimate, name) for name in effects})
