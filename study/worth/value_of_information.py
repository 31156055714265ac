"""The value of information: what further rollouts are expected to add to the return of the policy made after them.

With parameters p known as a posterior, and R(a, p) the return on the machine p of the policy made for the numbers a:

    now            V0 = E_p R(b, p)            b what is believed: the mean of p, or several draws of it alike
    perfect        V* = E_p R(p, p)            V* - V0 bounds what any measurement can be worth (EVPI)
    h rollouts     Vh = E_p E_y R(b | y, p)    y what they will show of p; Vh - V0 is their worth (EVSI)

Expectations are means over draws of p, the same for all; y is what the linearised fit will be told: information F of p
with normal noise. A rollout like those at hand tells a share of what they told, F = C^-1 / n; a designed one what its
torque was chosen for, where errors of the parameters cost most.
Source: Raiffa & Schlaifer, Applied Statistical Decision Theory, 1961 (preposterior analysis).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from study.formatting import MINUS
from study.statistics import sem
from study.worth.decision import SwingUpDecision
from study.worth.posterior import BoundedNormal
from sysid import Estimate, InvalidInput
from sysid.limits import check_size
from sysid.physics.ops import Array
from sysid.planning.planned_experiment import Experiment

Design = Callable[[Array], Experiment]
"""The rollout that lowers what errors of the parameters cost; W (P, P) are those costs, E e'We."""

SCHEMA = "gapfinder/worth/1"
AS_BEFORE, DESIGNED = "like those of the log", "designed"
MOST_DRAWS = 10_000
SEVERAL = 6
"""Draws that a policy for the whole posterior is made for."""

NEGLIGIBLE_SHARE = 1e-3
"""Share of the return below which nothing is looked for: a table of the optimum is no finer."""

SURE = 2.0
"""Standard errors from which a difference counts."""


@dataclass(frozen=True)
class Mean:
    """A mean over the draws, and its standard error."""

    value: float
    sem: float

    @classmethod
    def of(cls, values: Array) -> Mean:
        return cls(float(np.mean(values)), sem(values))

    def __str__(self) -> str:
        return f"{self.value:+.3g} ± {self.sem:.2g}".replace("-", MINUS)


@dataclass(frozen=True)
class Further:
    """What so many further rollouts of a kind are expected to add to the return."""

    kind: str
    rollouts: int
    gain: Mean


@dataclass(frozen=True)
class Worth:
    """The answer.

    rollouts     how many the estimate came from; part of one may have been held out
    now          return expected of the policy made now
    randomized   whether it is made for the whole posterior (`policies train --randomize posterior`), or for its mean
    perfect      what knowing the machine would add: the most that any measurement can
    further      what more rollouts would add; empty where perfect knowledge settles it
    price        what one costs, in units of the return; None: not told
    experiment   the designed rollout
    """

    names: tuple[str, ...]
    rollouts: float
    now: Mean
    randomized: bool
    perfect: Mean
    further: tuple[Further, ...] = ()
    price: float | None = None
    experiment: Experiment | None = None

    @property
    def settled(self) -> bool:
        """Whether perfect knowledge is worth so little that no rollout has to be asked about."""
        least = max(self.price or 0.0, NEGLIGIBLE_SHARE * abs(self.now.value))
        return self.perfect.value + SURE * self.perfect.sem <= least

    @property
    def break_even(self) -> float:
        """The price of a rollout below which measuring pays."""
        return max([0.0, *(further.gain.value / further.rollouts for further in self.further)])

    @property
    def best(self) -> Further | None:
        """What to measure first where a rollout has a price; None: nothing."""
        if self.price is None or not self.further or self.perfect.value <= self.price:
            return None
        ranked = max(self.further, key=self._net)
        return ranked if self._net(ranked) > 0.0 else None

    def _net(self, further: Further) -> float:
        return further.gain.value - (self.price or 0.0) * further.rollouts

    @property
    def policy(self) -> str:
        """How to train, as an option of `policies train`."""
        return "--randomize posterior" if self.randomized else "--randomize none"

    @property
    def advice(self) -> str:
        """What to do, as one sentence with its numbers."""
        train = f"Train now, with {self.policy}"
        if self.best is not None:
            cost = (self.price or 0.0) * self.best.rollouts
            settled = self._net(self.best) > SURE * self.best.gain.sem
            doubt = "" if settled else "; so few draws do not settle it (--draws)"
            return (
                f"Measure first: {counted(self.best)}, for {cost:g}, would add {self.best.gain} to the return{doubt}."
            )
        if self.price is not None and (self.perfect.value <= self.price or not self.further):
            return f"{train}: perfect knowledge would add {self.perfect}, and one rollout costs {self.price:g}."
        if not self.further:
            return f"{train}: perfect knowledge would add {self.perfect}, next to nothing of the return."
        if self.price is not None:
            nearest = max(self.further, key=self._net)
            cost = self.price * nearest.rollouts
            return f"{train}: {counted(nearest)} would add {nearest.gain}, and cost {cost:g}."
        if self.break_even <= 0.0:
            return f"{train}: no number of further rollouts that was tried would add anything."
        measure = f"Measure while a rollout costs less than {self.break_even:.2g} of return"
        return f"{measure}; else train now, with {self.policy}."

    def to_dict(self) -> dict[str, Any]:
        """Plain data of schema "gapfinder/worth/1"."""
        return {
            "schema": SCHEMA,
            "parameters": list(self.names),
            "rollouts": self.rollouts,
            "return_now": asdict(self.now),
            "policy": self.policy,
            "perfect": asdict(self.perfect),
            "further": [asdict(further) for further in self.further],
            "price": self.price,
            "break_even": self.break_even,
            "advice": self.advice,
            "experiment": None if self.experiment is None else self.experiment.to_dict(),
        }

    def __str__(self) -> str:
        lines = [
            f"expected return of a policy trained now: {self.now.value:.4g} ± {self.now.sem:.2g}".replace("-", MINUS),
            f"knowing {', '.join(self.names)} perfectly would add {self.perfect}: no measurement is worth more",
        ]
        lines += [f"  {counted(further)}: {further.gain}" for further in self.further]
        return "\n".join([*lines, "(± one standard error, over machines that the log leaves possible)", self.advice])


def counted(further: Further) -> str:
    """So many rollouts of a kind, in words."""
    noun = "rollout" if further.rollouts == 1 else "rollouts"
    if further.kind == DESIGNED:
        return f"{further.rollouts} designed {noun}"
    return f"{further.rollouts} {noun} {further.kind}"


def worth_of_rollouts(
    estimate: Estimate,
    rollouts: float,
    decision: SwingUpDecision,
    design: Design | None = None,
    price: float | None = None,
    further: Sequence[int] = (1, 3, 10),
    draws: int = 32,
    rng: np.random.Generator | None = None,
) -> Worth:
    """What further rollouts are worth to a policy that is made for an estimate of so many rollouts.

    design   plans the next rollout for what errors cost; by default only rollouts like those at hand are asked about
    price    what a rollout costs, in units of the return
    further  the numbers of further rollouts that are tried
    draws    machines drawn from the posterior: standard errors fall as their root
    rng      by default seeded with 0: the same question gets the same answer

    The policy is the one for the posterior's mean, or one for several draws of it alike where that is better for sure
    now; after further rollouts it is of the same kind. Raises InvalidInput for an estimate without finite covariance,
    and numbers that make no sense.
    """
    check_question(price, further, draws)
    if not 0.0 < rollouts < math.inf:
        raise InvalidInput(f"rollouts = {rollouts}: expected a positive number, those that the estimate came from")
    posterior, rng = BoundedNormal.of(estimate), np.random.default_rng(0) if rng is None else rng
    true, noise = posterior.draws(rng, draws), rng.standard_normal((draws, len(posterior.mean)))
    best = decision.returns(true[:, None], true)
    for_mean = _for_all_machines(decision, posterior.centre[None], true)
    for_several = _for_all_machines(decision, posterior.draws(rng, SEVERAL), true)
    better = Mean.of(for_several - for_mean)
    randomized = better.value > SURE * better.sem
    now = for_several if randomized else for_mean
    answer = Worth(estimate.names, rollouts, Mean.of(now), randomized, Mean.of(best - now), price=price)
    if answer.settled:
        return answer

    information = {AS_BEFORE: np.linalg.pinv(estimate.covariance, hermitian=True) / rollouts}
    experiment = None
    if design is not None:
        experiment = design(cost_of_errors(posterior, true, best - for_mean))
        information[DESIGNED] = experiment.information
    gains = [
        Further(kind, h, Mean.of(decision.returns(_after(posterior, h * F, true, noise, randomized), true) - now))
        for kind, F in information.items()
        for h in further
    ]
    return replace(answer, further=tuple(gains), experiment=experiment)


def check_question(price: float | None, further: Sequence[int], draws: int) -> None:
    """Raise InvalidInput for a price, numbers of rollouts or draws that make no sense."""
    if not further or any(not 1 <= h <= 10_000 for h in further):
        raise InvalidInput(f"further rollouts {tuple(further)}: expected whole numbers from 1 to 10000")
    check_size("draws =", draws, MOST_DRAWS)
    if draws < 4:
        raise InvalidInput(f"draws = {draws}: expected at least 4")
    if price is not None and not 0.0 <= price < math.inf:
        raise InvalidInput(f"price = {price}: expected what a rollout costs in units of the return, 0 or more")


def cost_of_errors(posterior: BoundedNormal, true: Array, loss: Array) -> Array:
    """W (P, P) of loss ~ e'We for errors e of the parameters, small ones.

    In the coordinates of the posterior it is a sum over its principal axes, with weights that are not negative. Where
    nothing is lost yet every axis counts alike.
    """
    numbers, inverse = posterior.coordinates.numbers, np.linalg.pinv(posterior.root)
    share, _ = nnls(((numbers(true) - numbers(posterior.centre)) @ inverse.T) ** 2, np.maximum(loss, 0.0))
    axes = inverse @ posterior.coordinates.slope
    return axes.T @ np.diag(share if np.any(share > 0.0) else np.ones(len(share))) @ axes


def _for_all_machines(decision: SwingUpDecision, believed: Array, true: Array) -> Array:
    """The returns (K,) of one policy, made for believed (D, P)."""
    return decision.returns(np.broadcast_to(believed, (len(true), *believed.shape)), true)


def _after(posterior: BoundedNormal, information: Array, true: Array, noise: Array, randomized: bool) -> Array:
    """What the policies (K, D, P) will be made for, each after the log of its machine: its mean, or several draws."""
    known = [posterior.after(information, p, z) for p, z in zip(true, noise, strict=True)]
    if not randomized:
        return np.array([normal.centre[None] for normal in known])
    return np.array([normal.draws(np.random.default_rng(i), SEVERAL) for i, normal in enumerate(known)])
