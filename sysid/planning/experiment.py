"""Experiment: which torque to play next, so that what a log confuses comes apart, or the widest interval shrinks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from sysid.effects import Effect
from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.fit import fit, free
from sysid.model import Model
from sysid.planning.contest import Match, separable, twins
from sysid.planning.design import (
    UNDETERMINED,
    Hypothesis,
    Pool,
    foresee,
    precision,
    search,
    separation,
    yardsticks,
)
from sysid.planning.needed import needed_experiment, never
from sysid.planning.protocol import HOPELESS, Experiment
from sysid.planning.rivals import Pair, Rivals, names_of, rivals_of
from sysid.planning.signals import Limits, Signal, rest_angle
from sysid.records import Record
from sysid.sensor import Sensor


def next_experiment(
    model: Model | Estimate,
    rivals: Sequence[str | Effect] = (),
    limits: Limits | None = None,
    sensor: Sensor | None = None,
    records: Sequence[Record] = (),
    rng: np.random.Generator | None = None,
) -> Experiment:
    """The torque signal, within the limits, that best tells rivals apart, or that best narrows the widest interval.

        evidence(i against j) = min_p |y_i - y_j(p)|^2 / sd^2    with y_i what effect i, of its fitted size, would show

    which for a small effect is lambda_i (1 - rho_ij^2); the smallest over the pairs is made large. Without rivals, the
    largest 1.96 sd_p / |p| of the Cramer-Rao bound is made small.

    model     a model or an estimate; it may hold one of the rivals
    rivals    effects that the log confuses: names, or effects with the sizes that they may have
    limits    by default those of the log's own torque, length and reach
    sensor    noise of the readings; by default the estimate's, else found from the records
    records   the log at hand: sizes of the rivals come from it, and what it holds itself is said
    rng       by default seeded with 0: the same question gets the same answer

    Raises InvalidInput for unknown names and where sizes, limits or noise cannot be known.
    """
    estimate = model if isinstance(model, Estimate) else None
    model = model.model if isinstance(model, Estimate) else model
    records = (records,) if isinstance(records, Record) else tuple(records)
    sensor = sensor or (estimate.sensor if estimate is not None else None) or _noise(records)
    limits = _limits(limits, model, records)
    rng = np.random.default_rng(0) if rng is None else rng
    names = estimate.names if estimate is not None else free(model)
    with np.errstate(over="ignore", invalid="ignore"):  # a fit may try numbers with which the motion runs away
        if rivals:
            if never(names_of(rivals)):
                return needed_experiment(model, names_of(rivals), limits, sensor, rng)
            found = rivals_of(model, names, rivals, records, sensor, limits)
            return _telling(found, names_of(rivals), limits, _louder(sensor, found.excess), rng)
        if estimate is None and records:
            estimate = fit(model, records, sensor, names)
        if estimate is not None:
            model, sensor = estimate.model, _louder(sensor, _excess(estimate, sensor))
        return _narrowing(model, names, estimate, limits, sensor, rng)


def _noise(records: Sequence[Record]) -> Sensor:
    if not records:
        raise InvalidInput("the noise of the readings is not known: give the sensor, or records to find it from")
    from sysid.noise import sensor_noise

    return sensor_noise(records).sensor


def _louder(sensor: Sensor, share: float) -> Sensor:
    """The sensor with so many times the noise: what no model explains will be there in the next log, too."""
    sd = {f.name: getattr(sensor, f.name) for f in dataclasses.fields(sensor)}
    return Sensor(**{name: None if value is None else share * value for name, value in sd.items()})


def _excess(estimate: Estimate, sensor: Sensor) -> float:
    """RMS of the estimate's residuals over the channels, in units of the sensor's noise; 1 at least."""
    ratios = [sd / noise for c, sd in estimate.noise.items() if (noise := getattr(sensor, c, None)) is not None]
    return max(1.0, math.sqrt(sum(r * r for r in ratios) / len(ratios))) if ratios else 1.0


def _limits(limits: Limits | None, model: Model, records: Sequence[Record]) -> Limits:
    if limits is None:
        if not records:
            raise InvalidInput("no limits are known: give Limits(u_max=...), or records to take them from")
        limits = limits_of(records, model)
    if limits.u_max > model.u_max * (1.0 + 1e-9):
        raise InvalidInput(
            f"limits: u_max = {limits.u_max:g} N m is beyond the model's own limit of {model.u_max:g} N m"
        )
    n = round(limits.duration / (limits.dt or model.dt))
    if n < 8:
        raise InvalidInput(f"limits: {limits.duration:g} s hold {n} samples: expected at least 8")
    return limits


def limits_of(records: Sequence[Record], model: Model) -> Limits:
    """What the rig has done in a log: its largest torque, its reach, up to 8 rollouts of up to 8 s."""
    rest, turn = rest_angle(model), 2.0 * math.pi
    angles = [r.theta - rest for r in records if r.theta is not None and len(r.theta) > 1]
    if rest != 0.0:
        angles = [a - turn * round(float(a[0]) / turn) for a in angles]
    reach = max((float(np.max(np.abs(a))) for a in angles), default=3.0)
    release = max((abs(float(a[0])) for a in angles), default=0.0)
    peak = max(float(np.max(np.abs(r.u))) for r in records)
    if peak == 0.0:
        raise InvalidInput("the log has no torque: give Limits(u_max=...)")
    duration = min(8.0, max(len(r) * r.dt for r in records))
    return Limits(
        min(peak, model.u_max), duration, min(8, len(records)), start=min(release, math.pi), theta_max=max(reach, 1e-3)
    )


def _at(h: Hypothesis, dt: float | None) -> Hypothesis:
    return h if dt is None else dataclasses.replace(h, model=dataclasses.replace(h.model, dt=dt))


def _impossible(limits: Limits) -> InvalidInput:
    reach = "" if limits.theta_max is None else f", {limits.theta_max:g} rad from rest"
    speed = "" if limits.theta_dot_max is None else f", {limits.theta_dot_max:g} rad/s"
    return InvalidInput(f"no signal keeps to the limits ({limits.u_max:g} N m{reach}{speed}): widen them")


# telling rivals apart ----------------------------------------------------------------------------------------


def _telling(
    found: Rivals, names: tuple[str, ...], limits: Limits, sensor: Sensor, rng: np.random.Generator
) -> Experiment:
    if found.absorbed:
        return needed_experiment(found.base.model, found.absorbed, limits, sensor, rng)
    hypotheses = tuple(_at(h, limits.dt) for h in (*found.hypotheses, found.base))
    apart = separable(hypotheses, found.pairs, limits, sensor, rng)
    if not apart:
        return needed_experiment(hypotheses[0].model, names, limits, sensor, rng)
    same = twins(found.pairs, apart)
    pairs = tuple(p for p in apart if p.truth not in same and p.rival not in same)
    notes = [f"no torque tells {hypotheses[j].name} from {hypotheses[i].name}" for j, i in same.items()]
    best = _best(hypotheses, pairs, limits, sensor, rng)
    hopeless = {(c.truth, c.rival) for c in best.contests() if c.after < HOPELESS}
    others = tuple(p for p in pairs if (hypotheses[p.truth].name, hypotheses[p.rival].name) not in hopeless)
    if not others:
        after = min(c.after for c in best.contests())
        return needed_experiment(hypotheses[0].model, names, limits, sensor, rng, after)
    if hopeless:  # they must not choose the signal for the others
        best = _best(hypotheses, others, limits, sensor, rng)
        for truth in dict.fromkeys(t for t, _ in sorted(hopeless)):
            rivals = " and ".join(r for t, r in sorted(hopeless) if t == truth)
            notes.append(f"{truth} of the size found is not told from {rivals}")
    return _told(best, notes)


def _best(
    hypotheses: tuple[Hypothesis, ...],
    pairs: tuple[Pair, ...],
    limits: Limits,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Match:
    choices = search(separation([(p.truth, p.rival) for p in pairs]), hypotheses[:-1], limits, sensor, rng)
    if not choices:
        raise _impossible(limits)
    return max((Match(hypotheses, pairs, c.signals, limits, sensor) for c in choices), key=lambda m: m.worth)


def _told(match: Match, notes: Sequence[str]) -> Experiment:
    contests = match.contests()
    after = min(c.after for c in contests)
    before = min((c.before for c in contests if c.before is not None), default=None)
    asked = tuple(h for h in match.hypotheses if any(h.name in (c.truth, c.rival) for c in contests))
    shown = tuple(h.name for h in asked)
    told = {frozenset((c.truth, c.rival)) for c in contests}
    whom = f"{', '.join(shown)} apart"
    if len(shown) == 2 or len(told) < len(shown) * (len(shown) - 1) // 2:
        whom = " and ".join(" from ".join(h for h in shown if h in pair) for pair in sorted(told, key=sorted))
    sentence = f"it tells {whom} with {after:.3g} units of evidence"
    sentence += "" if before is None else f" where this log had {before:.2g}"
    sentence = "; ".join((sentence, *notes))
    answer = _answer(match.signals, sentence, shown, "evidence", before, after, asked, match.limits, match.sensor)
    return dataclasses.replace(answer, contests=contests)


# narrowing intervals -----------------------------------------------------------------------------------------


def _narrowing(
    model: Model,
    names: tuple[str, ...],
    estimate: Estimate | None,
    limits: Limits,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Experiment:
    scale = yardsticks(model, names)
    hypotheses = [_at(Hypothesis("model", model, names), limits.dt)]
    choices = search(precision(scale), hypotheses, limits, sensor, rng)
    if not choices:
        raise _impossible(limits)
    pool = Pool(hypotheses, choices[0].signals, limits, sensor)
    sd = precision(scale).parts(pool)[0].together().sd()[0]
    if np.max(sd / scale) >= UNDETERMINED:
        lost = tuple(n for n, s in zip(names, sd, strict=True) if not math.isfinite(s))
        return needed_experiment(model, lost, limits, sensor, rng)
    had = np.array([estimate.sd[n] for n in names]) if estimate is not None else np.full(len(names), np.inf)
    k = (
        int(np.argmax(np.where(np.isfinite(had), had, np.inf) / scale))
        if estimate is not None
        else int(np.argmax(sd / scale))
    )
    before = 1.96 * float(had[k]) if math.isfinite(had[k]) else None
    after, unit = 1.96 * float(sd[k]), model.parameters[names[k]].unit
    told = f"it narrows the widest 95 % interval, that of {names[k]}, to +-{after:.2g} {unit}"
    told += "" if before is None else f" where this log had +-{before:.2g}"
    return _answer(choices[0].signals, told, names, "interval", before, after, hypotheses, limits, sensor, names[k])


def _answer(
    signals: Sequence[Signal],
    told: str,
    separates: tuple[str, ...],
    measure: str,
    before: float | None,
    after: float,
    hypotheses: Sequence[Hypothesis],
    limits: Limits,
    sensor: Sensor,
    widest: str | None = None,
) -> Experiment:
    runs = [foresee(h.model, signals, limits, sensor) for h in hypotheses]
    kinds = {s.kind for s in signals}
    orders = "; ".join(dict.fromkeys(s.sentence for s in signals))
    many = f"{len(signals)} rollouts of {limits.duration:g} s: " if len(signals) > 1 else ""
    length = "" if many else f", for {limits.duration:g} s"
    return Experiment(
        kind=kinds.pop() if len(kinds) == 1 else "mixed",
        description=f"{many}{orders}{length}: {told}.",
        separates=separates,
        measure=measure,
        before=before,
        after=after,
        u=runs[0].u,
        dt=hypotheses[0].model.dt,
        theta=runs[0].theta,
        theta_dot=runs[0].theta_dot,
        reach=max(float(np.max(np.abs(r.theta - rest_angle(hypotheses[0].model)))) for r in runs),
        widest=widest,
    )
