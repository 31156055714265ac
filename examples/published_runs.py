"""Eight runs of the paper again, with its settings, beside the returns that it published for the same seeds.

    python examples/published_runs.py                  256 x 256 networks, 75,000 steps: about 51 min on one busy core
    python examples/published_runs.py --steps 20000    less training, most of the way there

The measurement, the estimate and the start states are the published ones; only the training draws differ.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from policies import Band, Population, SACSettings, start_states, tune_cpu
from policies.evaluate import evaluate
from sysid import GridSearch, InvalidInput, paper_model, paper_rollouts

PUBLISHED = {
    (0, 0.0, 0): -774.7,
    (5, 0.0, 0): -428.1,
    (5, 0.0, 1): -361.7,
    (50, 0.0, 0): -341.2,
    (50, 0.0, 1): -356.3,
    (50, 0.0, 2): -349.5,
    (50, 0.5, 0): -499.3,
    (50, 0.5, 2): -590.7,
}
"""Mean return by (n, w, seed): eval_return_mean of results/summary.csv, github.com/YTomar79/sim2real_budget."""


def identify(n: int, seed: int) -> dict[str, float]:
    """The published estimate of n rollouts of the hidden plant; the prior for n = 0."""
    records = paper_rollouts(paper_model(2.0, 1.5), n, np.random.default_rng(seed))
    return GridSearch().fit(paper_model(), records).values if n else {"m": 1.0, "l": 1.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Train, and print a line a run; exit code 2 for settings that cannot be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=75_000, help="training steps an agent (default: %(default)s)")
    parser.add_argument("--hidden", type=int, default=256, help="width of the two hidden layers (default: %(default)s)")
    options = parser.parse_args(arguments)
    tune_cpu(threads=1)
    try:
        settings = SACSettings(hidden=(options.hidden, options.hidden), steps=options.steps)
    except InvalidInput as error:
        parser.error(str(error))
    plant = paper_model(2.0, 1.5)
    estimates = [identify(n, seed) for n, _, seed in PUBLISHED]
    bands = [Band(estimate, w=w) for estimate, (_, w, _) in zip(estimates, PUBLISHED, strict=True)]
    population = Population(paper_model(), bands, [seed for *_, seed in PUBLISHED], settings)
    while population.steps_done < settings.steps:
        population.train(max(1, settings.steps // 15))
        print(f"{population.steps_done} of {settings.steps} steps", file=sys.stderr, flush=True)
    print(f"{'n':>3} {'w':>4} {'seed':>4}  {'m [kg]':>6} {'l [m]':>6}  {'return':>8} {'published':>10}")
    for (key, published), estimate, policy in zip(PUBLISHED.items(), estimates, population.policies(), strict=True):
        (n, w, seed), (m, l) = key, estimate.values()  # noqa: E741
        mean = evaluate(policy, plant, *start_states(seed)).mean
        print(f"{n:3d} {w:4.1f} {seed:4d}  {m:6.3f} {l:6.3f}  {mean:8.1f} {published:10.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
