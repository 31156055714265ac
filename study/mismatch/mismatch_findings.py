"""What the experiment found: returns of every strategy at every plant and budget, contrasts, and parts of a gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from study.mismatch.mismatch_plan import CONTRASTS, FREE, STRATEGIES, Plan, StrategyKey, TrialKey
from study.mismatch.naming_results import names
from study.mismatch.trial_setups import Fitted, agents_of
from study.statistics import Contrast, paired_t
from study.trials.designs import OPTIMUM, PLAIN_ROD, Designed
from study.trials.hidden_plant import HiddenPlant
from study.trials.outcomes import Array, Outcome, Place, PlannedContrast, planned_contrasts
from study.trials.populations import Trained
from study.trials.training_setup import TrainingSetup, training_setup_of
from sysid import InvalidInput


class TrialCondition(NamedTuple):
    """A strategy at a plant and a budget (0 for strategies without rollouts)."""

    plant: str
    strategy: str
    n: int

    @classmethod
    def of(cls, plant: str, strategy: str, n: int) -> TrialCondition:
        """With n rollouts where the strategy spends any."""
        return cls(plant, strategy, 0 if strategy in FREE else n)


class Verdict(NamedTuple):
    """What a diagnosis said: the verdict, the effects that it added, and whether they were believed."""

    verdict: str
    named: tuple[str, ...] = ()
    believed: bool = True

    def __str__(self) -> str:
        text = self.verdict + (f": {' + '.join(self.named)}" if self.named else "")
        return text if self.believed or not self.named else f"{text}, not believed"


@dataclass(frozen=True)
class Split:
    """Where the gap to the optimum comes from, in return: means over the seeds for whose models a table stands. The
    three parts add up to the gap of these seeds."""

    structure: float
    identification: float
    training: float
    seeds: int

    @property
    def model(self) -> float:
        """J(optimum) - J(fitted): what is left where training is perfect."""
        return self.structure + self.identification

    @property
    def gap(self) -> float:
        """J(optimum) - J(agent)."""
        return self.model + self.training


@dataclass(frozen=True, eq=False)
class SplitOutcome(Outcome):
    """With the parts of the gap; None where no table stands for what was trained on."""

    split: Split | None


@dataclass(frozen=True, eq=False)
class MismatchFindings:
    """The experiment's answer.

    outcomes   by condition; optima: mean return of the near-optimal policy by plant
    compared   the pre-registered contrasts, in the plan's order
    verdicts   of the diagnoses by (plant, n): how often each
    hours      what workers spent
    """

    plan: Plan
    outcomes: dict[TrialCondition, SplitOutcome]
    optima: dict[str, float]
    compared: tuple[PlannedContrast, ...]
    verdicts: dict[tuple[str, int], Counter[Verdict]]
    hours: float

    def difference(self, plant: str, a: str, b: str, n: int) -> Contrast | None:
        """J(a) - J(b) over the seeds that both have, planned or not; None where a strategy is not in the plan."""
        one, other = (self.outcomes.get(TrialCondition(plant, key, n)) for key in (a, b))
        if one is None or other is None:
            return None
        difference = one.less(other)
        return paired_t(difference, np.zeros_like(difference))

    def together(self, rows: Sequence[PlannedContrast]) -> Contrast:
        """The mean of some of the plan's contrasts: paired over seeds, each seed's differences averaged first. It was
        not pre-registered."""
        sides = (
            [self.outcomes[TrialCondition.of(row.plant, strategy, row.n)].returns for row in rows]
            for strategy in (rows[0].a, rows[0].b)
        )
        return paired_t(*(np.mean(side, axis=0) for side in sides))


def mismatch_findings(
    plan: Plan, fits: Sequence[Fitted], trained: Sequence[Trained], designs: Sequence[Designed]
) -> MismatchFindings:
    """The answer from the results; raises InvalidInput where some are missing."""
    _check(plan, fits, trained, designs)
    keys, _ = agents_of(plan, fits)
    agents = {agent.key: agent for agent in trained}
    models = {f.trial: training_setup_of(f.payload) for f in fits}
    designed = {(d.plant, d.model, d.seed): float(np.mean(d.returns)) for d in designs}
    trials: dict[TrialCondition, list[TrialKey]] = {}
    for trial in plan.trials:
        trials.setdefault(TrialCondition(*trial[:3]), []).append(trial)
    outcomes = {}
    for condition, own in trials.items():
        returns = np.array([float(np.mean(agents[keys[t]].returns[t.plant])) for t in own])
        split = _split(plan.plant(condition.plant), own, returns, models, designed)
        optima = np.array([designed[condition.plant, OPTIMUM, t.seed] for t in own])
        outcomes[condition] = SplitOutcome(tuple(t.seed for t in own), returns, optima, split)
    return MismatchFindings(
        plan=plan,
        outcomes=outcomes,
        optima={p.name: float(np.mean([designed[p.name, OPTIMUM, s] for s in plan.seeds])) for p in plan.plants},
        compared=planned_contrasts(_family(plan, outcomes)),
        verdicts=_verdicts(fits),
        hours=sum([f.seconds for f in fits] + [t.seconds for t in trained] + [d.seconds for d in designs]) / 3600.0,
    )


def _check(plan: Plan, fits: Sequence[Fitted], trained: Sequence[Trained], designs: Sequence[Designed]) -> None:
    """Raise InvalidInput unless every trial was fitted, trained and held against the optimum."""
    unfitted = set(plan.trials) - {f.trial for f in fits}
    if unfitted:
        raise InvalidInput(f"{len(unfitted)} of {len(plan.trials)} trials have no fit: expected a finished experiment")
    untrained = {agent.key for agent in agents_of(plan, fits)[1]} - {agent.key for agent in trained}
    if untrained:
        raise InvalidInput(f"{len(untrained)} agents are not trained: expected a finished experiment")
    wanted = {
        (plant.name, model, seed) for plant in plan.plants for model in (OPTIMUM, PLAIN_ROD) for seed in plan.seeds
    }
    undesigned = wanted - {(d.plant, d.model, d.seed) for d in designs}
    if undesigned:
        raise InvalidInput(f"{len(undesigned)} optima are missing: expected a finished experiment")


def _split(
    plant: HiddenPlant,
    trials: Sequence[TrialKey],
    returns: Array,
    training_setups: Mapping[TrialKey, TrainingSetup],
    designed: Mapping[tuple[str, str, int], float],
) -> Split | None:
    """The mean parts over the seeds for whose models a table stands; None where none does."""
    strategy = trials[0].strategy
    rows = []
    for trial, reached in zip(trials, returns, strict=True):
        seed, optimum = trial.seed, designed[plant.name, OPTIMUM, trial.seed]
        if strategy == StrategyKey.ORACLE:
            rows.append((0.0, 0.0, optimum - reached))
            continue
        if not STRATEGIES[strategy].center:
            return None
        setup = training_setups[trial._replace(strategy=STRATEGIES[strategy].center)]
        fitted = designed.get((plant.name, setup.model_key, seed))
        if fitted is None:
            continue
        lacks = plant.effect is not None and not names(plant, [e.name for e in setup.model.effects])
        allowed = designed[plant.name, PLAIN_ROD, seed] if lacks else optimum
        rows.append((optimum - allowed, allowed - fitted, fitted - reached))
    return Split(*np.mean(rows, axis=0).tolist(), len(rows)) if rows else None


def _family(plan: Plan, outcomes: Mapping[TrialCondition, Outcome]) -> Iterator[tuple[Place, Outcome, Outcome]]:
    for plant in plan.plants:
        for a, b in CONTRASTS:
            if a in plan.strategies and b in plan.strategies:
                for n in (0,) if a in FREE and b in FREE else plan.budgets:
                    one, other = (outcomes[TrialCondition.of(plant.name, strategy, n)] for strategy in (a, b))
                    yield (plant.name, "", n, a, b), one, other


def _verdicts(fits: Sequence[Fitted]) -> dict[tuple[str, int], Counter[Verdict]]:
    found: dict[tuple[str, int], Counter[Verdict]] = {}
    for f in fits:
        if f.strategy == StrategyKey.MENDED:
            verdict = Verdict(f.payload["verdict"], tuple(f.payload["steps"]), f.payload["about"].get("believed", True))
            found.setdefault((f.plant, f.n), Counter())[verdict] += 1
    return found
