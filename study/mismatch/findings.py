"""What the experiment found: returns of every strategy at every plant and budget, contrasts, and parts of a gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from study.mismatch.experiment import OPTIMUM, PLAIN, model_key
from study.mismatch.mismatch_results import Designed, Fitted, Trained
from study.mismatch.naming_results import names
from study.mismatch.plan import CONTRASTS, FREE, STRATEGIES, HiddenPlant, Plan, StrategyKey, TrialKey
from study.mismatch.trainings import TrainingSetup, agents_of, training_setup_of
from study.statistics import Contrast, holm, paired_t, sem, student
from sysid import InvalidInput

Array = NDArray[np.float64]


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
class StrategyOutcome:
    """What a condition came to: returns (S,) of the seeds, each a mean over its start states, optima (S,) from the same
    start states, and the parts of the gap; None where no table stands for what was trained on."""

    condition: TrialCondition
    seeds: tuple[int, ...]
    returns: Array
    optima: Array
    split: Split | None

    @property
    def mean(self) -> Contrast:
        """The mean with Student's interval over seeds."""
        return student(float(np.mean(self.returns)), sem(self.returns), len(self.returns))

    @property
    def median(self) -> float:
        """Single failed trainings do not move it."""
        return float(np.median(self.returns))

    @property
    def gap(self) -> float:
        """J(optimum) - J(agent) from the same start states."""
        return float(np.mean(self.optima - self.returns))


@dataclass(frozen=True)
class TrialContrast:
    """A pre-registered contrast J(a) - J(b) over matched seeds; p: Holm's over the whole family; median of the
    differences."""

    plant: str
    n: int
    a: str
    b: str
    contrast: Contrast
    median: float
    p: float

    @property
    def certain(self) -> bool:
        """Whether it stands after Holm."""
        return self.p < 0.05


@dataclass(frozen=True, eq=False)
class MismatchFindings:
    """The experiment's answer.

    outcomes   by condition; optima: mean return of the near-optimal policy by plant
    compared   the pre-registered contrasts, in the plan's order
    verdicts   of the diagnoses by (plant, n): how often each
    hours      what workers spent
    """

    plan: Plan
    outcomes: dict[TrialCondition, StrategyOutcome]
    optima: dict[str, float]
    compared: tuple[TrialContrast, ...]
    verdicts: dict[tuple[str, int], Counter[Verdict]]
    hours: float

    def difference(self, plant: str, a: str, b: str, n: int) -> Contrast | None:
        """J(a) - J(b) over the seeds that both have, planned or not; None where a strategy is not in the plan."""
        one, other = (self.outcomes.get(TrialCondition(plant, key, n)) for key in (a, b))
        if one is None or other is None:
            return None
        shared = sorted(set(one.seeds) & set(other.seeds))
        return paired_t(*(o.returns[[o.seeds.index(s) for s in shared]] for o in (one, other)))

    def together(self, rows: Sequence[TrialContrast]) -> Contrast:
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
        outcomes[condition] = StrategyOutcome(condition, tuple(t.seed for t in own), returns, optima, split)
    return MismatchFindings(
        plan=plan,
        outcomes=outcomes,
        optima={p.name: float(np.mean([designed[p.name, OPTIMUM, s] for s in plan.seeds])) for p in plan.plants},
        compared=tuple(_compared(plan, outcomes)),
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
    wanted = {(plant.name, model, seed) for plant in plan.plants for model in (OPTIMUM, PLAIN) for seed in plan.seeds}
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
        fitted = designed.get((plant.name, model_key(setup), seed))
        if fitted is None:
            continue
        lacks = plant.effect is not None and not names(plant, [e.name for e in setup.model.effects])
        allowed = designed[plant.name, PLAIN, seed] if lacks else optimum
        rows.append((optimum - allowed, allowed - fitted, fitted - reached))
    return Split(*np.mean(rows, axis=0).tolist(), len(rows)) if rows else None


def _compared(plan: Plan, outcomes: Mapping[TrialCondition, StrategyOutcome]) -> list[TrialContrast]:
    found = []
    for plant in plan.plants:
        for a, b in CONTRASTS:
            if a not in plan.strategies or b not in plan.strategies:
                continue
            for n in (0,) if a in FREE and b in FREE else plan.budgets:
                one, other = (outcomes[TrialCondition.of(plant.name, strategy, n)].returns for strategy in (a, b))
                found.append((plant.name, n, a, b, paired_t(one, other), float(np.median(one - other))))
    adjusted = holm({k: row[4].p for k, row in enumerate(found)})
    return [TrialContrast(*row, adjusted[k]) for k, row in enumerate(found)]


def _verdicts(fits: Sequence[Fitted]) -> dict[tuple[str, int], Counter[Verdict]]:
    found: dict[tuple[str, int], Counter[Verdict]] = {}
    for f in fits:
        if f.strategy == StrategyKey.MENDED:
            verdict = Verdict(f.payload["verdict"], tuple(f.payload["steps"]), f.payload["about"].get("believed", True))
            found.setdefault((f.plant, f.n), Counter())[verdict] += 1
    return found
