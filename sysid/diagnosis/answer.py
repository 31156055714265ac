"""Diagnosis: the answer to "which effect is missing?" with its evidence, as data and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from sysid.data.json_file import plain, plain_fields
from sysid.data.record import Record, first_samples
from sysid.data.sensor import Sensor
from sysid.diagnosis.contacts import OUTSIDE, Contact
from sysid.diagnosis.findings import chance, dependence_on, fitted_numbers, numbers_in_words, quantity, with_numbers
from sysid.diagnosis.predictions import Prediction, typical
from sysid.diagnosis.ranked import Ranked
from sysid.diagnosis.residual_torque import ResidualTorque, residual_torque
from sysid.estimation.estimate import Estimate
from sysid.estimation.held_out import HeldOutError
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.torque_regression import FrictionAlong
from sysid.physics.effects import CATALOGUE
from sysid.physics.model import Model
from sysid.planning.planned_experiment import Experiment

if TYPE_CHECKING:
    from sysid.diagnosis.compare import Comparison

DIAGNOSIS_SCHEMA = "gapfinder/diagnosis/1"
DIAGNOSIS_FIELDS = (
    *("verdict", "sentence", "doubts", "steps", "conventions", "ranking", "remaining", "not_identifiable", "ruled_out"),
    *("held_out", "torque", "tolerance", "negligible", "unconfirmed", "next_experiment", "seconds"),
    *("shared_error", "alternatives"),
)
"""What plain data tell of a diagnosis under its own names."""
MOST_SHOWN = 12_000
"""Most samples of a log for which the residual torque is found once more, to show it."""
NOISIER = 2.0
"""Errors in units of the noise above which an answer that leaves nothing to explain says that the noise is larger."""
NOT_THE_DRIVE = (
    "something else moved the machine, or a sign, a zero or a unit is another; the fitted numbers mean little. Try a "
    "part of the log in which nothing touched it"
)
A_CONTROLLERS_PATH = (
    "the motion does not show how the machine answers to a torque, as where a controller follows a path: the fitted "
    "inertia means little, and so do predictions. Fix what is known (--set), or move it faster"
)


@dataclass(frozen=True)
class Alternative:
    """Effects with which the log is as likely as with some steps of the answer, in the place of these.

    effects      their names; instead: the names of the steps
    parameters   their numbers {effect: {name: {value, sd, unit}}} in their own fit
    """

    effects: tuple[str, ...]
    instead: tuple[str, ...]
    parameters: dict[str, dict[str, dict[str, Any]]]

    @property
    def in_words(self) -> str:
        """A phrase on what stands in place of what, or beside it."""
        if set(self.instead) < set(self.effects):
            return f"perhaps with {' and '.join(name for name in self.effects if name not in self.instead)}"
        return f"or {' and '.join(self.effects)} in place of {' and '.join(self.instead)}"

    @property
    def sentence(self) -> str:
        """What explains the log as well as what, with its numbers."""
        names = " and ".join(with_numbers(effect, self.parameters[effect]) for effect in self.effects)
        return f"{names} explain{'s' * (len(self.effects) == 1)} the log as well as {' and '.join(self.instead)}"


@dataclass(frozen=True, eq=False)
class Step:
    """An effect that was added.

    indistinguishable  effects that this log cannot tell from it, itself first
    rivals             those of them that other logs could tell from it
    parameters         its numbers {name: {value, sd, unit}} in the final fit
    error_before       held-out error of predictions before the step (error_after: after it), in units of the sensor
                       noise; effects that pay only together share one fall of the error
    p_value            of the likelihood ratio when it was added, without regard to its rarity
    """

    effect: str
    indistinguishable: tuple[str, ...]
    rivals: tuple[str, ...]
    parameters: dict[str, dict[str, Any]]
    error_before: float
    error_after: float
    p_value: float
    estimate: Estimate

    @property
    def decrease(self) -> float:
        """The decrease of the squared held-out error, in units of the sensor's variance."""
        decrease = self.error_before**2 - self.error_after**2
        return max(decrease, 0.0) if math.isfinite(decrease) else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        names = ("effect", "parameters", "error_before", "error_after", "p_value")
        return plain_fields(self, *names) | {"class": list(self.indistinguishable)}


@dataclass(frozen=True)
class Remaining:
    """What no step explains.

    share       its share of the squared held-out error
    torque      RMS of the random torque that is still needed [N m]
    depends_on  some of "theta", "theta_dot", "torque", "time", "history"; where: over which stretch of these it acts
    unseen      whether it shows in held-out data alone
    """

    share: float
    depends_on: tuple[str, ...]
    where: str
    torque: float = 0.0
    unseen: bool = False


@dataclass(frozen=True)
class MissingTorque:
    """The size of what a model lacks: RMS of the torque [N m] that has to act beside it to produce the log.

    `drive` is that of the drive torque. Torques `before` and `after` the steps are smoothed under the same prior; what
    is faster than 0.4 s is averaged out, since it hardly moves a prediction.
    """

    drive: float
    before: float
    after: float

    @property
    def explained(self) -> float:
        """1 - after^2 / before^2, the share of the missing torque that the steps explain; 0 if none was missing."""
        return max(0.0, 1.0 - (self.after / self.before) ** 2) if self.before > 0.0 else 0.0

    @property
    def overwhelms(self) -> bool:
        """Whether what remains is larger than the drive's torque."""
        return 0.0 < self.drive < self.after

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return plain_fields(self, "drive", "before", "after", "explained")


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What the model lacks, with the evidence, and the mended model.

    Attributes
    ----------
    verdict : str
        - "adequate": nothing that matters was missing.
        - "missing": the steps explain all that matters.
        - "partly": the steps are sure, but something that matters remains; or, beside delays at most, `friction`
          explains the drive's torque.
        - "unknown": something that matters is missing, and no known effect pays.
        - "cannot tell": this log cannot say which effect it is that lowers the error most.
    base : Estimate
        The model as it came, refitted.
    base_error, error : HeldOutError
        Errors of the model as it came and of the mended one, over the horizon, on data that no fit has seen.
    steps, conventions : tuple of Step
        Effects that were added, in order; those that belong to the log itself (torque stamps) are conventions.
    ranking : tuple of Ranked
        The candidates of the first round, best first.
    remaining : Remaining or None
        What the steps do not explain, if anything matters in it.
    not_identifiable : tuple of tuple of str
        Groups of parameters and effects that this motion cannot separate.
    ruled_out : dict
        {effect: size}: an effect above that size would have been found.
    sensor : Sensor
        The noise in whose units errors are given; it includes the `shared_error`.
    records, unseen : tuple of Record
        The whole log, and the part that no fit has seen.
    estimate : Estimate
        The mended model's fit.
    contacts : tuple of Contact
        Stretches of the log that no state of the joint explains, such as a hand's push.
    next_experiment : Experiment or None
        The experiment to play next, if this log cannot tell effects apart.
    seconds : float
        How long the diagnosis took.
    torque : MissingTorque
        The size of the missing torque before and after the steps.
    negligible : tuple of str
        Effects with which the log is likelier, but predictions are not better by what matters.
    unconfirmed : tuple of str
        Effects that the fitted part of the log asked for and that are not believed: the held-out part does not confirm
        them, or they are a part of something unknown over the same quantity.
    tolerance : float
        An effect matters if it lowers the error of predictions by this share.
    notes : tuple of str
        Notes that were made when the log was read.
    friction : FrictionAlong or None
        Friction and load in the drive's torque, if no model explains how the motion follows from the torque.
    alternatives : tuple of Alternative
        Other sets of common frictions, and refinements such as asymmetric friction, that explain the log as well as
        steps do.
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
    records: tuple[Record, ...]
    unseen: tuple[Record, ...]
    estimate: Estimate
    contacts: tuple[Contact, ...]
    next_experiment: Experiment | None
    seconds: float
    torque: MissingTorque = MissingTorque(0.0, 0.0, 0.0)
    negligible: tuple[str, ...] = ()
    unconfirmed: tuple[str, ...] = ()
    tolerance: float = 0.02
    notes: tuple[str, ...] = ()
    friction: FrictionAlong | None = None
    alternatives: tuple[Alternative, ...] = ()

    @property
    def held_out(self) -> tuple[str, ...]:
        """The names of the rollouts, or of parts of them, that no fit has seen."""
        return tuple(r.name for r in self.unseen)

    @property
    def mended(self) -> bool:
        """Whether something was added."""
        return bool(self.steps or self.conventions)

    @property
    def models(self) -> tuple[Model, ...]:
        """The model as it came, refitted, and the mended one if anything was added."""
        return (self.base.model, self.model) if self.mended else (self.model,)

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """How far off each of the models is on the data that no fit has seen."""
        from sysid.diagnosis.compare import compare  # many an answer is read without

        return tuple(compare(model, self.unseen, self.sensor) for model in self.models)

    @cached_property
    def residual_torques(self) -> tuple[ResidualTorque, ...]:
        """The torque that must act beyond each of the models, over the first MOST_SHOWN samples of the log.

        If the joint vibrates, the scatter of the readings about the fit counts as the noise; otherwise the vibration
        would drown all else.
        """
        if not self.vibrates:
            before = (residual_torque(m, self._shown, self.sensor) for m in self.models[:-1])
            return (*before, self._beyond_the_model)
        return tuple(residual_torque(m, self._shown, Sensor(**self.estimate.noise)) for m in self.models)

    @property
    def vibrates(self) -> bool:
        """Whether the readings hold a vibration that no rigid joint has."""
        return self._beyond_the_model.restless

    @cached_property
    def _beyond_the_model(self) -> ResidualTorque:
        return residual_torque(self.model, self._shown, self.sensor)

    @cached_property
    def _shown(self) -> tuple[Record, ...]:
        return first_samples(self.records, MOST_SHOWN)

    @cached_property
    def predictions(self) -> tuple[Prediction, ...]:
        """A typical stretch of the data that no fit has seen, predicted by each of the models (`ahead` at a time)."""
        return typical(self.models, self.unseen, self.sensor, self.ahead)

    @property
    def ahead(self) -> float:
        """The horizon [s] of `predictions`: 2 s if the model still lacks something, else the whole stretch."""
        return math.inf if self.remaining is None else 2.0

    @property
    def model(self) -> Model:
        """The mended model."""
        return self.estimate.model

    def to_dict(self) -> dict[str, Any]:
        """Plain data of schema "gapfinder/diagnosis/1"; errors are held-out, in units of the sensor noise; None stands
        for a number that is not finite."""
        others = {
            "schema": DIAGNOSIS_SCHEMA,
            "plant": type(self.model.plant).__name__,
            "parameters": fitted_numbers(self.estimate),
            "noise": plain_fields(self.sensor, *CHANNELS),
            "base_error": self.base_error.ratio,
            "error": self.error.ratio,
            "prediction": {"before": self.base_error, "after": self.error},
            "converged": self.estimate.success,
            "status": self.estimate.status,
            "friction_along_the_motion": self.friction,
            "touched": [{"record": t.name, "begin": t.t_begin, "end": t.t_end, "peak": t.peak} for t in self.contacts],
        }
        return dict(plain(others)) | plain_fields(self, *DIAGNOSIS_FIELDS)

    @property
    def sentence(self) -> str:
        """The verdict and the finding, in one sentence."""
        return f"{self.verdict}: {self.finding}"

    @property
    def finding(self) -> str:
        """What was found, with its evidence."""
        names = " and ".join(" or ".join([with_numbers(s.effect, s.parameters), *s.rivals]) for s in self.steps)
        names += "".join(f", {a.in_words}" for a in self.alternatives)
        left = [] if self.remaining is None else [self._left(self.remaining)]
        share = self._share()
        several = len(self.steps) > 1 or self.alternatives
        explains = share and f"{',' * bool(self.alternatives)} explain{'' if several else 's'} {share}"
        if self.verdict == "adequate":
            parts = ["the model lacks nothing that matters in this log", self._predicted()]
        elif self.friction is not None:
            added = [f"{names}{explains}"] if self.steps else []
            parts = [*added, self._friction_alone(self.friction), self._predicted()]
        elif self.verdict == "unknown":
            beside = " and ".join(step.effect for step in self.conventions)
            parts = [f"no known effect pays{beside and f' beside {beside}'}", self._predicted(), *left]
        elif self.verdict == "cannot tell":
            classes = "; ".join(" or ".join(s.indistinguishable) for s in self.steps if s.rivals)
            parts = [f"{classes} explain this log equally well{share and f', {share}'}", self._predicted(), *left]
        else:
            none_left = "" if left else ", and nothing else that matters is left"
            parts = [f"{names}{explains}", f"{self._predicted()}{none_left}", *left]
        return f"{'; '.join(parts)}."

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons not to trust the numbers, a sentence each."""
        doubts = [] if self.estimate.success else [f"the fit did not end well: {self.estimate.status}"]
        if self.friction is not None:
            doubts.append(A_CONTROLLERS_PATH)
        elif self.remaining is not None and self.torque.overwhelms:
            what, unit = quantity("torque", self.error.units), self.error.units["torque"]
            drive = f"{what} of the drive (rms {self.torque.drive:.2g} {unit})"
            doubts.append(f"what remains is larger than the {drive}: {NOT_THE_DRIVE}")
        return tuple(doubts)

    @property
    def other_effects(self) -> tuple[str, ...]:
        """Sentences on effects that do as well as those named, that do not matter, or that are not believed."""
        said = [a.sentence for a in self.alternatives]
        if self.negligible:
            likelier = ", ".join(self.negligible)
            said.append(f"likelier with these, and predictions no better by what matters: {likelier}")
        if self.unconfirmed:
            left_out = ", ".join(self.unconfirmed)
            said.append(f"left out, since the held-out data or what remains speak against it: {left_out}")
        return tuple(said)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on `other_effects`, and on data that no fit has used."""
        remarks = list(self.other_effects)
        if self.contacts:
            remarks.append(f"no fit has used what may be {OUTSIDE}: {'; '.join(map(str, self.contacts))}")
        if self.shared_error:
            remarks.append(self.shared_error_in_words)
        if self.noisier:
            remarks.append(self.noisier)
        return tuple(remarks)

    @property
    def noisier(self) -> str:
        """A phrase that the readings are noisier than was found, if nothing is left that would explain their errors."""
        if self.remaining is not None or not self.error.ratio > NOISIER:
            return ""
        return "no torque explains the errors that are left: the readings are noisier, at least in places"

    @property
    def shared_error(self) -> float:
        """The sd of the error of the angle that neighbouring readings share, as far as it counts as the sensor's: what
        the noise of `sensor` has more than that of the estimate's."""
        alone = self.estimate.sensor
        if alone is None or alone.theta is None or self.sensor.theta is None:
            return 0.0
        return math.sqrt(max(self.sensor.theta**2 - alone.theta**2, 0.0))

    @property
    def shared_error_in_words(self) -> str:
        """A phrase on the `shared_error`."""
        what, unit = quantity("theta", self.error.units), self.error.units["theta"]
        size = f"{self.shared_error:.2g} {unit}"
        return f"neighbouring readings of the {what} share an error of {size}, which counts as the sensor's"

    def _share(self) -> str:
        """The share of the missing torque that the steps explain, with its size, in words; empty if it is 0."""
        torque, unit = self.torque, self.model.plant.unit("N m")
        if not self.steps or not torque.explained > 0.0:
            return ""
        return f"{torque.explained:.0%} of the missing torque (rms {torque.before:.2g} -> {torque.after:.2g} {unit})"

    def _predicted(self) -> str:
        """The error of predictions over the horizon, on data that no fit has seen, in words."""
        before, after = self.base_error, self.error
        channel = "theta" if after.theta is not None else "theta_dot"
        size, came = getattr(after, channel), getattr(before, channel)
        fell = f", before {came:.3g}" if self.mended else ""
        return (
            f"over {after.window:g} s of held-out data the {quantity(channel, after.units)} is predicted to {size:.3g} "
            f"{after.units[channel]}{fell} ({after.ratio:.3g} times the sensor noise"
            f"{f', before {before.ratio:.3g}' if fell else ''})"
        )

    def _friction_alone(self, friction: FrictionAlong) -> str:
        """Friction, load and inertia in the torque along the motion, in words; only what is three standard errors from
        0, and an inertia that is sure enough to be told."""
        plant = self.model.plant
        torque, slope = plant.unit("N m"), plant.unit("N m s/rad")
        (b, b_sd), falls = friction.viscous, friction.viscous[0] < 0.0
        dry = "dry or viscous friction" if friction.one_speed else "dry friction"
        dry += ", or a constant load, of" if friction.one_way else " of"
        terms = (
            (dry, *friction.coulomb, torque),
            ("friction that falls with speed by" if falls else "viscous friction of", abs(b), b_sd, slope),
            ("a constant load of", *friction.load, torque),
        )
        parts = [f"{what} {x:.3g} +- {sd:.2g} {unit}" for what, x, sd, unit in terms if abs(x) > 3.0 * sd]
        if friction.tells_inertia:
            J, J_sd = friction.inertia
            parts.append(f"an inertia of {J:.3g} +- {J_sd:.2g} {plant.unit('kg m^2')}")
        *some, last = parts
        sure, explain = (f"{', '.join(some)} and {last}", "explain") if some else (last, "explains")
        return (
            f"along the motion {sure} {explain} {friction.share:.0%} of how the drive's "
            f"{quantity('torque', self.error.units)} varies (rms {self.torque.drive:.2g} {torque} in all)"
        )

    def _left(self, remaining: Remaining) -> str:
        if remaining.unseen:
            return "what was fitted to is explained, held-out data are not: they show what the rest of the log does not"
        what, unit = quantity("torque", self.error.units), self.error.units["torque"]
        many = f"{len(self.contacts)} stretches that were left out"
        where = f"in {many if len(self.contacts) > 1 else self.contacts[0]}" if self.contacts else ""
        on = dependence_on(remaining.depends_on, where, remaining.where)
        return f"a {what} of rms {remaining.torque:.2g} {unit} remains that no known effect explains; {on}"

    def __repr__(self) -> str:
        lines = [self.sentence, *(f"  but {doubt}" for doubt in self.doubts)]
        gone = [name for name in self.base.model.effect_names if name not in self.model.effect_names]
        for step in (*self.conventions, *self.steps):
            fell = f"error {step.error_before:.3g} -> {step.error_after:.3g}"
            place = "".join(f" in place of {name}" for name in gone if name in CATALOGUE[step.effect].contains)
            others = ", ".join(step.indistinguishable[1:])
            apart = f"; this log cannot tell it from {others}" if others else ""
            effect = with_numbers(step.effect, step.parameters)
            lines.append(f"  + {effect}{place}: {fell}, {chance(step.p_value)}{apart}")
        added = {step.effect for step in (*self.conventions, *self.steps)}
        given = [name for name in self.estimate.model.effect_names if name not in added]
        begun = [(name, numbers) for name in ("", *given) if (numbers := fitted_numbers(self.estimate, name))]
        if begun:
            parts = (with_numbers(name, numbers) if name else numbers_in_words(numbers) for name, numbers in begun)
            lines.append(f"  with {', '.join(parts)}")
        lines.extend(f"  cannot be told apart by this motion: {', '.join(group)}" for group in self.not_identifiable)
        lines.extend(f"  {remark}" for remark in self.remarks)
        if self.next_experiment is not None:
            lines.append(f"  the next experiment: {self.next_experiment}".replace("\n", "\n  "))
        lines.append(
            f"  what matters: an effect that lowers the error of {self.error.window:g} s predictions by "
            f"{self.tolerance:.0%}; +- is one standard deviation"
        )
        return "\n".join(lines)
