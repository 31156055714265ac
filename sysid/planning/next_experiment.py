"""Next experiment: which torque to play so as to tell apart what a log confuses, or to narrow the widest interval."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.data.noise import sensor_noise
from sysid.data.record import Record, extent_of
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.estimate import Estimate
from sysid.estimation.first_fit import first_fit
from sysid.estimation.fit import free
from sysid.estimation.linearisation import Samples
from sysid.estimation.solver import fit_parameters
from sysid.limits import PLANNED_ROLLOUTS, PLANNED_SAMPLES, check_size
from sysid.physics.effects import Effect
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.planning.design import (
    ROUGHLY,
    UNDETERMINED,
    Conditions,
    Hypothesis,
    Pool,
    expected_cost,
    precision,
    search,
    separation,
    yardsticks,
)
from sysid.planning.discrimination import (
    Hypotheses,
    checked_names,
    hypotheses_of,
    indistinguishable,
    separable,
    with_evidence,
)
from sysid.planning.excitation import Limits, rest_angle
from sysid.planning.non_torque_experiments import never, non_torque_experiment
from sysid.planning.planned_experiment import DECISIVE, LEAST_EVIDENCE, Experiment, HypothesisPair


def next_experiment(
    model: Model | Estimate,
    rivals: Sequence[str | Effect] = (),
    limits: Limits | None = None,
    sensor: Sensor | None = None,
    records: Sequence[Record] = (),
    rng: np.random.Generator | None = None,
    cost: Array | None = None,
) -> Experiment:
    """The torque signal, within the limits, that best tells rivals apart, or that best narrows the widest interval.

        evidence(i against j) = min_p |W (y_i - y_j(p))|^2

    where y_i are the readings that effect i, of its fitted size, would cause. W whitens them, because a random torque
    that the log shows will act again. Without rivals, the largest 1.96 sd_p / |p| of the Cramer-Rao bound is minimised.

    Parameters
    ----------
    model : Model or Estimate
        The machine as far as it is known; it may hold one of the rivals.
    rivals : sequence of str or Effect
        The effects that the log confuses: names, or effects with the sizes that they may have.
    limits : Limits, optional
        What the rig may do; by default what it did in the log: its torque, length and reach.
    sensor : Sensor, optional
        Noise of the readings; by default the estimate's, else found from the records.
    records : sequence of Record
        The log at hand: it gives the rivals' sizes and the random torque, and the answer says what it tells itself.
    rng : numpy.random.Generator, optional
        By default seeded with 0: the same question gets the same answer.
    cost : array (P, P), optional
        The weight W of the errors e of an estimate's parameters: their expected cost e'We is minimised in place of the
        widest interval. It excludes rivals.

    Returns
    -------
    Experiment
        Of kind "none" where nothing that is played tells more than the log.

    Raises
    ------
    InvalidInput
        For unknown names, where sizes, limits or noise cannot be known, and for a cost of another shape or beside
        rivals.
    """
    estimate = model if isinstance(model, Estimate) else None
    model, names = (model, free(model)) if isinstance(model, Model) else (model.model, model.names)
    records = (records,) if isinstance(records, Record) else tuple(records)
    rivals = (rivals,) if isinstance(rivals, str | Effect) else tuple(rivals)
    sensor = sensor or (estimate.sensor if estimate else None)
    if sensor is None and not records:
        raise InvalidInput("the noise of the readings is not known: give the sensor, or records to find it from")
    sensor = sensor or sensor_noise(records).sensor
    conditions = Conditions(_limits(limits, model, records), sensor)
    rng = np.random.default_rng(0) if rng is None else rng
    if cost is not None:
        _check_cost(cost, names, estimate, rivals)
    with np.errstate(over="ignore", invalid="ignore"):  # a motion may run away
        rival_names = checked_names(rivals)
        if never(rival_names):
            return non_torque_experiment(model, rival_names)
        if estimate is None and records:
            estimate = first_fit(Samples(model, records, sensor), model, names).estimate()
        model = model if estimate is None else estimate.model
        if rivals:
            return _telling(hypotheses_of(model, names, rivals, records, conditions), rival_names, rng)
        if estimate is not None:
            conditions = _after(conditions, estimate, records)
            if cost is not None:
                return _lowering(cost, estimate, conditions, rng)
        return _narrowing(model, names, estimate, conditions, rng)


def _check_cost(cost: Array, names: tuple[str, ...], estimate: Estimate | None, rivals: Sequence[str | Effect]) -> None:
    if rivals:
        raise InvalidInput("a cost of errors has no rivals: expected one or the other")
    if estimate is None or not np.all(np.isfinite(estimate.covariance)):
        raise InvalidInput("a cost of errors needs an estimate with a finite covariance: expected what `fit` returns")
    if np.shape(cost) != (len(names), len(names)):
        raise InvalidInput(f"cost has shape {np.shape(cost)}: expected {(len(names), len(names))}, those of {names}")


def _after(conditions: Conditions, estimate: Estimate, records: Sequence[Record]) -> Conditions:
    """The conditions with what an estimate leaves unexplained in its records or, if these are not at hand, by its own
    account: the noise of its residuals, if more than the sensor's, and its random torque, unless that only makes up for
    a noise that was told far too small."""
    if records:
        samples = Samples(estimate.model, records, conditions.sensor)
        return conditions.after([fit_parameters(samples, estimate.model, (), settings=ROUGHLY)])
    assumed = {c: getattr(conditions.sensor, c) for c in estimate.noise}
    louder = conditions.louder(
        {c: max(1.0, sd / assumed[c]) for c, sd in estimate.noise.items() if assumed[c] is not None}
    )
    if louder.much_louder(conditions) or not estimate.random_torque:
        return louder
    s = estimate.random_torque / float(estimate.model.inertia())
    return dataclasses.replace(conditions, disturbances=Disturbances(s, estimate.correlation_time))


def _limits(limits: Limits | None, model: Model, records: Sequence[Record]) -> Limits:
    if limits is None:
        if not records:
            raise InvalidInput("no limits are known: give Limits(u_max=...), or records to take them from")
        limits = limits_of(records, model)
    unit = model.plant.unit("N m")
    if limits.u_max > model.u_max * (1.0 + 1e-9):
        raise InvalidInput(
            f"limits: u_max = {limits.u_max:g} {unit} is beyond the model's own limit of {model.u_max:g} {unit}"
        )
    n = limits.duration / model.dt
    if round(min(n, 8.0)) < 8:
        raise InvalidInput(f"limits: {limits.duration:g} s hold {n:.3g} samples: expected at least 8")
    check_size("limits: rollouts =", limits.rollouts, PLANNED_ROLLOUTS)
    check_size("limits: samples of all rollouts:", n * limits.rollouts, PLANNED_SAMPLES, "in fewer or shorter ones")
    return limits


def limits_of(records: Sequence[Record], model: Model) -> Limits:
    """What the rig has done in a log: its largest torque, its reach, up to 8 rollouts of up to 8 s."""
    rest, turn = rest_angle(model), 2.0 * math.pi
    angles = [r.theta - rest for r in records if r.theta is not None and len(r.theta) > 1]
    if rest != 0.0:
        angles = [a - turn * round(float(a[0]) / turn) for a in angles]
    reach = max((float(np.max(np.abs(a))) for a in angles), default=3.0)
    release = max((abs(float(a[0])) for a in angles), default=0.0)
    did = extent_of(records)
    if did.u_max == 0.0:
        raise InvalidInput("the log has no torque: give Limits(u_max=...)")
    return Limits(
        min(did.u_max, model.u_max),
        min(8.0, did.duration),
        min(8, len(records)),
        start=min(release, math.pi),
        theta_max=max(reach, 1e-3),
    )


# ---- telling rivals apart --------------------------------------------------------------------------------------------


def _telling(fitted: Hypotheses, names: tuple[str, ...], rng: np.random.Generator) -> Experiment:
    hypotheses, conditions = fitted.hypotheses, fitted.conditions
    if fitted.absorbed:
        return non_torque_experiment(hypotheses[-1].model, fitted.absorbed)
    apart = separable(hypotheses, fitted.pairs, conditions, rng)
    if not apart:
        return non_torque_experiment(hypotheses[0].model, names)
    same = indistinguishable(fitted.pairs, apart)
    asked = tuple(c for c in apart if c.truth not in same and c.rival not in same)
    notes = [f"no torque tells {one} from {other}" for one, other in same.items()]
    pool = _best(hypotheses, asked, conditions, rng)
    pairs = with_evidence(pool, asked)
    hopeless = {(c.truth, c.rival) for c in pairs if c.after < LEAST_EVIDENCE}
    others = tuple(c for c in asked if (c.truth, c.rival) not in hopeless)
    if not others:
        return non_torque_experiment(hypotheses[0].model, names, min(c.after for c in pairs))
    if hopeless:  # they must not choose the signal for the others
        pool = _best(hypotheses, others, conditions, rng)
        pairs = with_evidence(pool, others)
        for truth in dict.fromkeys(t for t, _ in sorted(hopeless)):
            rivals = " and ".join(r for t, r in sorted(hopeless) if t == truth)
            notes.append(f"{truth} of the size found is not told from {rivals}")
    return _told(pool, pairs, notes)


def _best(
    hypotheses: tuple[Hypothesis, ...],
    pairs: tuple[HypothesisPair, ...],
    conditions: Conditions,
    rng: np.random.Generator,
) -> Pool:
    """The signals whose least evidence, over the pairs, is the largest."""
    compared = [h for h in hypotheses if any(h.name in (c.truth, c.rival) for c in pairs)]
    pools = search(separation([(c.truth, c.rival) for c in pairs]), compared, conditions, rng)
    return max(pools, key=lambda pool: min(c.after for c in with_evidence(pool, pairs, within=1.5)))


def _told(pool: Pool, pairs: tuple[HypothesisPair, ...], notes: Sequence[str]) -> Experiment:
    after = min(c.after for c in pairs)
    before = min((c.before for c in pairs if c.before is not None), default=None)
    shown = tuple(pool.hypotheses)
    whom = _whom(shown, {frozenset((c.truth, c.rival)) for c in pairs})
    if before is not None and after <= before:
        advice = "fit both" if before >= DECISIVE else "widen the limits"
        sentence = (
            f"the log at hand tells {whom} with {before:.3g} units of evidence, and no torque within these limits "
            f"brings more than {after:.3g}: {advice}"
        )
        description = f"{'; '.join((sentence, *notes))}."
        return Experiment("none", description, shown, before=before, pairs=pairs)
    sentence = f"it tells {whom} with {after:.3g} units of evidence"
    sentence += "" if before is None else f" where this log had {before:.2g}"
    worth = "; ".join((sentence, *notes))
    return _played(pool, worth, separates=shown, measure="evidence", before=before, after=after, pairs=pairs)


def _whom(shown: tuple[str, ...], pairs: set[frozenset[str]]) -> str:
    """Who is told from whom: all of them apart, or pair by pair."""
    if len(shown) == 2 or len(pairs) < len(shown) * (len(shown) - 1) // 2:
        return " and ".join(" from ".join(h for h in shown if h in pair) for pair in sorted(pairs, key=sorted))
    return f"{', '.join(shown)} apart"


# ---- narrowing intervals ---------------------------------------------------------------------------------------------


def _narrowing(
    model: Model,
    names: tuple[str, ...],
    estimate: Estimate | None,
    conditions: Conditions,
    rng: np.random.Generator,
) -> Experiment:
    scale = yardsticks(model, names)
    pool = search(precision(scale), [Hypothesis("model", model, names)], conditions, rng)[0]
    sd = pool.precision().together().sd()[0]
    if np.max(sd / scale) >= UNDETERMINED:
        lost = tuple(n for n, s in zip(names, sd, strict=True) if not math.isfinite(s))
        return non_torque_experiment(model, lost)
    had = sd if estimate is None else np.array([estimate.sd[n] for n in names])
    k = int(np.argmax(had / scale))
    before = 1.96 * float(had[k]) if estimate is not None and math.isfinite(had[k]) else None
    after, unit = 1.96 * float(sd[k]), model.parameters[names[k]].unit
    if before is not None and after >= before:
        sentence = (
            f"the log at hand has the widest 95 % interval, that of {names[k]}, at +-{before:.2g} {unit}, and no "
            f"torque within these limits makes it narrower than +-{after:.2g} {unit}: widen them."
        )
        return Experiment("none", sentence, names, "interval", before, widest=names[k])
    worth = f"it narrows the widest 95 % interval, that of {names[k]}, to +-{after:.2g} {unit}"
    worth += "" if before is None else f" where this log had +-{before:.2g}"
    return _played(pool, worth, separates=names, measure="interval", before=before, after=after, widest=names[k])


def _lowering(cost: Array, known: Estimate, conditions: Conditions, rng: np.random.Generator) -> Experiment:
    names, goal = known.names, expected_cost(cost, known.covariance)
    pool = search(goal, [Hypothesis("model", known.model, names)], conditions, rng)[0]
    normal = pool.precision().together()
    before, after = float(np.trace(cost @ known.covariance)), -float(goal.value([normal])[0])
    sentence = f"it lowers what the errors of {', '.join(names)} are expected to cost from {before:.2g} to {after:.2g}"
    return _played(pool, sentence, separates=names, measure="cost", before=before, after=after, information=normal.F[0])


def _played(pool: Pool, worth: str, **answer: Any) -> Experiment:
    """The experiment that plays a pool's signals, as its first hypothesis predicts it; `worth` says what it tells."""
    plant, seconds, many = pool.model.plant, pool.conditions.limits.duration, len(pool.signals) > 1
    kinds = {s.kind for s in pool.signals}
    orders = "; ".join(dict.fromkeys(s.sentence(plant) for s in pool.signals))
    what = f"{len(pool.signals)} rollouts of {seconds:g} s: {orders}" if many else f"{orders}, for {seconds:g} s"
    kind = kinds.pop() if len(kinds) == 1 else "mixed"
    theta, theta_dot = np.moveaxis(pool.states[0], -1, 0)
    reach = float(np.max(np.abs(pool.states[..., 0] - pool.rest)))
    motion = {"u": pool.u, "dt": pool.model.dt, "theta": theta, "theta_dot": theta_dot, "reach": reach}
    return Experiment(kind, f"{what}: {worth}.", unit=plant.unit("rad"), **motion, **answer)
