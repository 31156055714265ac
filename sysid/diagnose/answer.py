"""Diagnosis: the answer to "which effect is missing?", with its evidence, as data and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sysid.comparison.held_out import HeldOutError, finite
from sysid.estimate import Estimate
from sysid.model import Model
from sysid.sensor import Sensor
from sysid.smoothing.touched import Touched

SCHEMA = "gapfinder/diagnosis/1"
VERDICTS = ("adequate", "missing", "unknown", "cannot tell")


@dataclass(frozen=True, eq=False)
class Step:
    """An effect that was added.

    alike          effects that this log cannot tell from it, itself first
    rivals         those of them that are something else to other logs
    parameters     its numbers {name: {value, sd, unit}} at the end of the loop
    error_before   held-out error before and after, in units of the sensor noise
    p_value        Holm's, over all candidates of the round
    """

    effect: str
    alike: tuple[str, ...]
    rivals: tuple[str, ...]
    parameters: dict[str, dict[str, Any]]
    error_before: float
    error_after: float
    p_value: float
    estimate: Estimate

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "effect": self.effect,
            "class": list(self.alike),
            "parameters": {name: {**v, "sd": finite(v["sd"])} for name, v in self.parameters.items()},
            "error_before": finite(self.error_before),
            "error_after": finite(self.error_after),
            "p_value": self.p_value,
        }


@dataclass(frozen=True)
class Ranked:
    """A candidate of the first round: its score (expected decrease of -2 log likelihood), Holm's p-value, the
    held-out error with it (None: not refitted), and those that the log cannot tell from it."""

    effect: str
    alike: tuple[str, ...]
    score: float
    p_value: float
    error_after: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "effect": self.effect,
            "class": list(self.alike),
            "score": self.score,
            "p_value": self.p_value,
            "error_after": finite(self.error_after),
        }


@dataclass(frozen=True)
class Remaining:
    """What no step explains: its share of the squared held-out error, what it depends on, and where it lives."""

    share: float
    depends_on: tuple[str, ...]
    where: str

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"share": self.share, "depends_on": list(self.depends_on), "where": self.where}


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the model lacks.

    verdict           "adequate": nothing was missing; "missing": the steps explain everything; "unknown": something
                      remains after the steps, if any; "cannot tell": a step's class does not separate on this log
    base              the model as it came, refitted
    steps             effects that were added, in order; those of the log itself (torque stamps) in `conventions`
    ranking           the candidates of the first round, best first
    remaining         what is left, where something is
    not_identifiable  groups of parameters and effects that this motion cannot separate
    ruled_out         {effect: size}: an effect above that size would have been found
    touched           stretches of the log that no state of the joint explains, such as a hand's push
    held_out          names of the rollouts that no fit has seen; errors are theirs, in units of the sensor noise
    """

    verdict: str
    base: Estimate
    base_error: HeldOutError
    error: HeldOutError
    steps: tuple[Step, ...]
    conventions: tuple[Step, ...]
    ranking: tuple[Ranked, ...]
    remaining: Remaining | None
    not_identifiable: tuple[tuple[str, ...], ...]
    ruled_out: dict[str, dict[str, Any]]
    sensor: Sensor
    held_out: tuple[str, ...]
    estimate: Estimate
    touched: tuple[Touched, ...]
    next_experiment: dict[str, Any] | None
    seconds: float

    @property
    def best(self) -> Diagnosis:
        """The end of the loop: `diagnosis.best.estimate` is the mended model."""
        return self

    @property
    def model(self) -> Model:
        """The mended model."""
        return self.estimate.model

    def to_dict(self) -> dict[str, Any]:
        """Plain data of schema "gapfinder/diagnosis/1": errors are held-out, in units of the sensor noise, and a number
        that is not finite becomes None."""
        parameters = self.estimate.model.parameters
        sd = self.estimate.sd
        return {
            "schema": SCHEMA,
            "plant": type(self.model.plant).__name__,
            "parameters": {
                name: {"value": value, "sd": finite(sd[name]), "unit": parameters[name].unit}
                for name, value in self.estimate.values.items()
            },
            "noise": {"theta": self.sensor.theta, "theta_dot": self.sensor.theta_dot},
            "held_out": list(self.held_out),
            "base_error": finite(self.base_error.ratio),
            "error": finite(self.error.ratio),
            "verdict": self.verdict,
            "steps": [s.to_dict() for s in self.steps],
            "conventions": [s.to_dict() for s in self.conventions],
            "ranking": [r.to_dict() for r in self.ranking],
            "remaining": None if self.remaining is None else self.remaining.to_dict(),
            "not_identifiable": [list(group) for group in self.not_identifiable],
            "ruled_out": self.ruled_out,
            "touched": [{"record": t.name, "begin": t.t_begin, "end": t.t_end, "peak": t.peak} for t in self.touched],
            "next_experiment": self.next_experiment,
            "seconds": self.seconds,
        }

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        before, after = self.base_error.ratio, self.error.ratio
        names = " and ".join(self._named(s) for s in self.steps)
        went = "falls" if after <= before else "rises"
        fell = f"the error on held-out data {went} from {before:.3g} to {after:.3g} times the sensor noise"
        if self.verdict == "adequate":
            return f"adequate: the model lacks nothing that this log can show ({after:.3g} times the sensor noise)."
        if self.verdict == "missing":
            return f"missing: {names}; {fell}, and nothing else is visible in this log."
        left = "" if self.remaining is None else self._left(self.remaining)
        if self.verdict == "unknown":
            return f"unknown: {names + '; ' + fell + '; ' if names else ''}{left}."
        classes = "; ".join(" or ".join(s.alike) for s in self.steps if len(s.alike) > 1)
        return f"cannot tell: {classes} explain this log equally well; {fell}{'; ' + left if left else ''}."

    def _left(self, remaining: Remaining) -> str:
        on = " and ".join(remaining.depends_on) or "nothing that was tried"
        return (
            f"something is missing that no known effect explains: {remaining.share:.0%} of the squared error; "
            f"it depends on {on}{', ' + remaining.where if remaining.where else ''}"
        )

    @staticmethod
    def _named(step: Step) -> str:
        numbers = ", ".join(
            f"{name.split('.')[-1]} = {v['value']:.4g} +- {v['sd']:.2g} {v['unit']}".removesuffix(" 1")
            for name, v in step.parameters.items()
        )
        return f"{step.effect} ({numbers})"

    def __str__(self) -> str:
        lines = [self.sentence]
        for step in (*self.conventions, *self.steps):
            fell = f"error {step.error_before:.3g} -> {step.error_after:.3g}"
            lines.append(
                f"  + {self._named(step)}: {fell}, p = {step.p_value:.1g}"
                + (f"; this log cannot tell it from {', '.join(step.alike[1:])}" if len(step.alike) > 1 else "")
            )
        lines.extend(f"  cannot be told apart by this motion: {', '.join(group)}" for group in self.not_identifiable)
        return "\n".join(lines)
