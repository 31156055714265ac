"""Does it pay to follow `study.worth`? Hidden pendulums, whose rollouts have a price.

    python -m tests.benchmarks.rollout_worth --seeds 200 --csv worth.csv     goes on if stopped; tells what is in it

A hidden plant is the paper's, m and l uniform within their bounds (0.3 to 3 kg and m), and is measured with its random
torques. What is lost on it is the optimum less the return of the policy made for the estimate, and the price of the
rollouts. Whoever follows the advice begins with one rollout, measures as many more as it says until it says to train,
and trains on what it says; the others measure a fixed number, and train at the mean. Policies are made by dynamic
programming, on the same tables for all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from policies.control.dynamic_programming import Grid
from study.paper.protocol import BOUNDS, PaperRollout, averaged_sensor, paper_model, paper_rollouts, transitions
from study.pipeline.tables import read_table, write_table
from study.worth.decision import SwingUpDecision
from study.worth.posterior import BoundedNormal
from study.worth.value_of_information import SEVERAL, worth_of_rollouts
from sysid import Estimate, GridSearch, fit
from tests.benchmarks import command

FIXED = (1, 2, 5, 10, 25)
MOST = 25
FURTHER, DRAWS, EPISODES, TABLE = (1, 4), 24, 20, Grid(80, 81, u=5)
NAMES = ("m", "l")


@dataclass(frozen=True)
class Case:
    """A hidden plant, what a policy loses on it after the advised rollouts, and after fixed numbers (fixed_n)."""

    identifier: str
    seed: int
    price: float
    m: float
    l: float  # noqa: E741
    optimum: float
    advised_n: int
    advised: float
    fixed_1: float
    fixed_2: float
    fixed_5: float
    fixed_10: float
    fixed_25: float


def identified(identifier: str, rollouts: list[PaperRollout]) -> Estimate:
    """What an identifier makes of the rollouts."""
    if identifier == "grid":
        return GridSearch().fit(paper_model(), transitions(rollouts))
    return fit(paper_model(), [r.averaged for r in rollouts], averaged_sensor(1.0), NAMES)


def case(identifier: str, seed: int, price: float) -> Case:
    """One hidden plant. The losses are without the price."""
    rng = np.random.default_rng([seed, 77])
    truth = rng.uniform(*BOUNDS, 2)
    rollouts = paper_rollouts(paper_model(*truth), MOST, rng)
    estimates: dict[int, Estimate] = {}

    def after(n: int) -> Estimate:
        if n not in estimates:
            estimates[n] = identified(identifier, rollouts[:n])
        return estimates[n]

    decision = SwingUpDecision.of(after(1).model, NAMES, episodes=EPISODES, table=TABLE)
    n, rng = 1, np.random.default_rng(seed)
    while True:
        advice = worth_of_rollouts(after(n), n, decision, price=price, further=FURTHER, draws=DRAWS)
        if advice.best is None or n == MOST:
            break
        n = min(MOST, n + advice.best.rollouts)
    known = BoundedNormal.of(after(n))
    deployed = known.draws(rng, SEVERAL) if advice.randomized else known.centre[None]
    tried = [truth[None], deployed, *(BoundedNormal.of(after(k)).centre[None] for k in FIXED)]
    returns = [float(decision.returns(believed[None], truth[None])[0]) for believed in tried]
    losses = [returns[0] - value for value in returns[1:]]
    return Case(identifier, seed, price, *truth.tolist(), returns[0], n, *losses)


def summary(cases: list[Case]) -> str:
    """Mean losses, the price included, with standard errors, and how far the advice is from each fixed number."""
    lines = []
    groups = {name: [c for c in cases if c.identifier == name] for name in sorted({c.identifier for c in cases})}
    if len(groups) > 1:
        groups["either"] = cases
    for identifier, group in groups.items():
        price = group[0].price
        advised = np.array([c.advised + price * c.advised_n for c in group])
        counts = np.array([c.advised_n for c in group])
        lines.append(f"{identifier}, {len(group)} plants, a rollout costs {price:g}")
        lines.append(f"  advised: {_mean(advised)}; rollouts: median {np.median(counts):g}, mean {np.mean(counts):.1f}")
        for n in FIXED:
            fixed = np.array([getattr(c, f"fixed_{n}") + price * n for c in group])
            lines.append(f"  {n:>2} rollouts: {_mean(fixed)}; advised less {_mean(fixed - advised)}")
    return "\n".join(lines)


def _mean(values: np.ndarray) -> str:
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.1f}"


def main() -> None:
    """Measure what is not in the table yet, and tell it."""
    parser = command.parser("rollout_worth", __doc__)
    parser.add_argument("--seeds", type=int, default=0, help="hidden plants of each identifier")
    parser.add_argument("--price", type=float, default=3.0, help="of a rollout, in units of the return")
    parser.add_argument("--csv", type=Path, default=Path(__file__).with_suffix(".csv"))
    options = parser.parse_args()
    cases = list(read_table(Case, options.csv, "cases", optional=True))
    done = {(c.identifier, c.seed) for c in cases}
    for seed in range(options.seeds):
        for identifier in ("least squares", "grid"):
            if (identifier, seed) not in done:
                cases.append(case(identifier, seed, options.price))
                write_table(Case, options.csv, cases)
    print(summary(cases))


if __name__ == "__main__":
    main()
