"""python -m tests.benchmarks.random_torque: an effect of the catalogue beside a random torque of known size.

No machine lacks exactly what a catalogue offers. Here a Gaussian process acts beside a planted effect,

    d(t + dt) = exp(-dt / T) d(t) + w,   sd s [N m], correlation time T [s]

Is the effect named all the same, does its 95 % interval hold its number as often as it says (within the 99 % band of a
binomial), and is s found? Answers are kept in --out, one JSON line a log; a run that was stopped goes on.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binom

from policies.environments.randomization import Fixed, RandomForce
from tests.benchmarks import command
from tests.benchmarks.cases import Case, records
from tests.benchmarks.experiments import EXPERIMENTS, LOGS, World, plan
from tests.benchmarks.hidden import numbers_of
from tests.benchmarks.runner import Row, add_options, answered
from tests.benchmarks.score import indistinguishable

EFFECTS = ("coulomb", "viscous", "tilt", "drag", "spring")
CLOSE = 0.2
"""The share of s by which what is found may be off."""


def case(seed: int, s: float, T: float) -> Case:
    """Effects and experiments in turn; the log is clean, and its key tells s and T."""
    effect, experiment = EFFECTS[seed % len(EFFECTS)], EXPERIMENTS[seed // len(EFFECTS) % len(EXPERIMENTS)]
    return Case(f"random torque of {s:g} N m, {T:g} s", (effect,), "medium", experiment, "clean", seed)


def world(case: Case, s: float, T: float) -> World:
    """The world of a case, with the random torque as its wind."""
    log = LOGS[case.log]
    made = plan(case.experiment, log, case.rng("plan"))
    peak = float(np.max(np.abs(made.u)))
    rng, forced = case.rng("random torque"), RandomForce(Fixed(), s, T)
    wind = np.stack([forced.torques(rng, len(rows), log.dt) for rows in made.wind])
    return World(replace(made, wind=wind), numbers_of(case.hidden[0], case.size, log.dt, peak), 1.0, log)


def solve(case: Case, methods: Sequence[str], known: Row | None) -> tuple[Row, dict[str, Row]]:
    """What is said of one log: the effects, their numbers with intervals, and the size of the random torque."""
    from sysid import Model, RodPendulum, diagnose

    began = time.perf_counter()
    s, T = (float(word.split()[0]) for word in case.column.removeprefix("random torque of ").split(", "))
    made = world(case, s, T)
    diagnosis = diagnose(Model(RodPendulum(g=9.81), dt=made.log.dt), records(case, made))
    row = {
        "verdict": diagnosis.verdict,
        "named": [list(step.indistinguishable) for step in diagnosis.steps],
        "intervals": {k: list(v) for k, v in diagnosis.estimate.interval(0.95).items()},
        "truth": dict(made.numbers),
        "random_torque": diagnosis.estimate.random_torque,
        "depends_on": list(diagnosis.remaining.depends_on) if diagnosis.remaining else [],
        "unconfirmed": list(diagnosis.unconfirmed),
        "seconds": time.perf_counter() - began,
    }
    return {}, {m: row for m in methods}


def report(cases: Sequence[Case], rows: Mapping[str, Row], s: float) -> list[str]:
    """Shares, with the band that coverage should lie in, and the cases that are wrong."""
    asked = [c for c in cases if c.key in rows]
    hits, alone, covered, close, wrong = 0, 0, list[bool](), 0, list[str]()
    for case in asked:
        row = rows[case.key]
        effects = {name for group in row["named"] for name in group}
        named = bool(indistinguishable(case.hidden[0]) & effects)
        right = named and len(row["named"]) == 1
        held = [
            row["intervals"][k][0] <= v <= row["intervals"][k][1]
            for k, v in row["truth"].items()
            if k in row["intervals"]
        ]
        size = row["random_torque"] / s
        hits, alone, close = hits + named, alone + right, close + (abs(size - 1.0) <= CLOSE)
        covered += held
        if not right or not all(held) or abs(size - 1.0) > CLOSE:
            own_numbers = {k: [round(x, 4) for x in row["intervals"].get(k, ())] for k in row["truth"]}
            said = f"{row['verdict']} {row['named']} {own_numbers} of {row['truth']}, {size:.2f} s"
            wrong.append(f"  {case.hidden[0]} {case.experiment} {case.seed}: {said} {row['unconfirmed']}")
    n, m = len(asked), len(covered)
    if not n:
        return []
    low, high = binom.ppf([0.005, 0.995], m, 0.95) / max(m, 1)
    sizes = np.array([rows[c.key]["random_torque"] for c in asked]) / s
    return [
        f"{cases[0].column}: named {hits} of {n}, and nothing beside it {alone}",
        f"  its 95 % interval holds its number: {np.mean(covered):.3f} of {m}  (band {low:.3f} .. {high:.3f})",
        f"  the size of the random torque within {CLOSE:.0%}: {close} of {n}; found over true: median "
        f"{np.median(sizes):.2f}, 5 % .. 95 %: {np.quantile(sizes, 0.05):.2f} .. {np.quantile(sizes, 0.95):.2f}",
        *wrong,
    ]


def main(arguments: list[str] | None = None) -> int:
    """Run, then print."""
    parser = command.parser("random_torque", __doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--sd", type=float, default=0.1, help="of the random torque [N m]")
    parser.add_argument("--time", type=float, default=0.3, help="its correlation time [s]")
    add_options(parser, "results/random_torque")
    given = parser.parse_args(arguments)
    cases = [case(seed, given.sd, given.time) for seed in range(given.seeds)]
    print("\n".join(report(cases, answered(given, cases, solve=solve).read("ours"), given.sd)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
