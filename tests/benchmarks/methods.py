"""The methods that are scored, each as a function (records, told noise) -> Answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from sysid import Log, Record

ClaimedNoise = tuple[float, float] | None


@dataclass(frozen=True)
class Answer:
    """What a method says of a log.

    verdict      "adequate", "missing", "partly", "unknown" or "cannot tell"; methods without verdicts say the first two
    ranking      effects, best first (six of them); the first is what it would name if it had to name one
    alike        effects that the method says it cannot tell from the first, the first among them
    named        effects that it says are missing, with those it cannot tell from each
    small        effects with which it says the log is likelier, and predictions no better
    depends_on   of what is left unexplained: some of theta, theta_dot, torque, time, history
    error_after  held-out error at the end, in units of the noise; None where the method has none
    """

    verdict: str
    ranking: tuple[str, ...] = ()
    alike: tuple[str, ...] = ()
    named: tuple[tuple[str, ...], ...] = ()
    depends_on: tuple[str, ...] = ()
    error_after: float | None = None
    small: tuple[str, ...] = ()
    seconds: float = 0.0
    failure: str = ""


def thinned(records: Sequence[Record]) -> Log:
    """The log at the rate at which the command line takes it."""
    return Log(tuple(records), (), records[0].dt).thinned()


def ours(records: Sequence[Record], claimed: ClaimedNoise) -> Answer:
    """sysid.diagnose, beginning at the default rod; gravity is known, as it is on earth."""
    from sysid import CATALOGUE, Model, RodPendulum, Sensor, diagnose, sensor_noise

    log = thinned(records)
    model = Model(RodPendulum(g=9.81), dt=log.dt)
    if claimed is None:
        sensor = sensor_noise(records).sensor
    else:
        sensor = Sensor(theta=claimed[0], theta_dot=claimed[1] if records[0].theta_dot is not None else None)
    diagnosis = diagnose(model, log, sensor)
    ranked = [r for r in diagnosis.ranking if not CATALOGUE[r.effect].of_log]
    if diagnosis.conventions:  # the first round ranked what was left of them too
        ranked = [*diagnosis.steps, *ranked]
    return Answer(
        verdict=diagnosis.verdict,
        ranking=tuple(r.effect for r in ranked),
        alike=tuple(ranked[0].indistinguishable) if ranked else (),
        named=tuple(tuple(s.indistinguishable) for s in diagnosis.steps),
        depends_on=tuple(diagnosis.remaining.depends_on) if diagnosis.remaining is not None else (),
        error_after=diagnosis.error.ratio,
        small=diagnosis.negligible,
    )


def baseline(records: Sequence[Record], claimed: ClaimedNoise) -> Answer:
    """Regression of smoothed acceleration; it has no use for a claimed noise."""
    from tests.benchmarks.baseline import find

    finding = find(thinned(records))
    ranking = tuple(name for name, _ in finding.ranking if name != "stamp")
    first = ranking[:1]
    if finding.chosen:
        first = finding.chosen[:1]
        ranking = first + tuple(n for n in ranking if n not in first)
    return Answer(
        verdict="missing" if finding.chosen else "adequate",
        ranking=ranking,
        alike=first,
        named=tuple((name,) for name in finding.chosen),
    )


METHODS: Mapping[str, Callable[[Sequence[Record], ClaimedNoise], Answer]] = {"ours": ours, "baseline": baseline}


def ask(method: str, records: Sequence[Record], claimed: ClaimedNoise) -> Answer:
    """A method's answer and the seconds it took; one that raises has no answer."""
    began = time.perf_counter()
    try:
        answer = METHODS[method](records, claimed)
    except Exception as error:
        answer = Answer("failed", failure=f"{type(error).__name__}: {error}")
    return replace(answer, ranking=answer.ranking[:6], seconds=time.perf_counter() - began)
