"""python -m tests.benchmarks.calibration: many seeds on the fit and the score tests alone.

Are 95 % intervals right, does the fit reach the Cramer-Rao bound (of an independent linearisation), also with an effect
in the model, and how often does a score test raise a false alarm where nothing is hidden? Each share stands with its
99 % band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, chi2

from sysid import Model, RodPendulum, effect, fit
from tests.benchmarks import command
from tests.benchmarks.decidability import Family, Motions
from tests.benchmarks.experiments import EXPERIMENTS, LOGS, World, move, plan, write
from tests.benchmarks.rivals import rivals
from tests.benchmarks.truth import NEUTRAL, Array

ADDED = {"": "", "viscous": "b", "coulomb": "tau_c", "torque_bias": "tau_0"}  # with their parameter
NUMBERS = {"viscous.b": 0.02, "coulomb.tau_c": 0.03, "torque_bias.tau_0": 0.05}


@dataclass(frozen=True)
class Trial:
    """One seed: which intervals hold the truth, e' F e with the bound's F and with the fit's own, false alarms."""

    covered: dict[str, bool]
    bound: float
    stated: float
    dimension: int
    alarm: bool | None = None  # an effect of the catalogue promises more than its price
    structure: bool | None = None  # a random torque is needed beside the right model


def trial(name: str, log: str, seed: int) -> Trial:
    """Fit a log of a machine with (or without) an effect by the right model."""
    rng = np.random.default_rng([seed, *name.encode()])
    key = f"{name}.{ADDED[name]}"
    form = LOGS[log]
    world = World(plan(EXPERIMENTS[seed % 3], form, rng), {key: NUMBERS[key]} if name else {}, 0.0, form)
    (motion,) = move([world])
    records = write(motion, world.plan, form, rng)
    model = Model(RodPendulum(g=NEUTRAL["g"]), (effect(name),) if name else (), dt=form.dt)
    estimate = fit(model, records)
    truth = {"m": NEUTRAL["m"], "l": NEUTRAL["l"], key: NUMBERS.get(key, 0.0)}
    error = np.array([estimate.values[k] - truth[k] for k in estimate.names])
    covered = {k: low <= truth[k] <= high for k, (low, high) in estimate.interval(0.95).items()}
    F = information(world, name)
    alarm, structure = alarms(model, records) if not name else (None, None)
    stated = float(error @ np.linalg.solve(estimate.covariance, error))
    return Trial(covered, float(error @ F @ error), stated, len(error), alarm, structure)


def information(world: World, name: str) -> Array:
    """The Fisher information of (m, l) and the effect's number, start states free."""
    motions = Motions(world)
    m, length, g = (NEUTRAL[k] for k in "mlg")
    sine = motions.cells(np.sin(motions.theta))
    inertia = -np.diff(motions.theta_dot, axis=1) / motions.h
    families = [Family(np.stack([inertia, sine]))]
    families += rivals(motions)[name] if name else []
    rows = np.vstack(motions.rows(families))
    samples = np.zeros((len(rows), len(rows)))  # of (J, G, ...) with respect to (m, l, ...)
    samples[:2, :2] = [[length**2 / 3.0, 2.0 * m * length / 3.0], [0.5 * g * length, 0.5 * m * g]]
    samples[2:, 2:] = np.eye(len(rows) - 2)
    F: Array = samples.T @ (rows @ rows.T) @ samples
    return F


def alarms(model: Model, records: Sequence) -> tuple[bool, bool]:
    """Whether the score tests about the right model find an effect that pays, and whether a random torque is needed."""
    from sysid.data.noise import sensor_noise
    from sysid.diagnosis.search_settings import DEFAULT
    from sysid.estimation.first_fit import first_fit
    from sysid.estimation.fit import free
    from sysid.estimation.linearisation import Samples
    from sysid.estimation.scores import price, scores

    fitted = first_fit(Samples(model, records, sensor_noise(records).sensor), model, free(model))
    tested = scores(fitted)
    pays = any(s.lm > price(n, DEFAULT.price, s.shapes) for n, s in tested.items() if s.visible)
    return pays, not fitted.undisturbed


def report(trials: Sequence[Trial]) -> list[str]:
    """Shares and ratios with the bands that they should lie in."""
    n = len(trials)
    low, high = binom.ppf([0.005, 0.995], n, 0.95) / n
    lines = [
        f"coverage of {k}: {np.mean([t.covered[k] for t in trials]):.3f}  (band {low:.3f} .. {high:.3f})"
        for k in trials[0].covered
    ]
    freedom = n * trials[0].dimension
    band = np.sqrt(chi2.ppf([0.005, 0.995], freedom) / freedom)
    for word, values in (("Cramer-Rao bound", [t.bound for t in trials]), ("own bars", [t.stated for t in trials])):
        ratio = np.sqrt(np.sum(values) / freedom)
        lines.append(f"error over {word}: {ratio:.3f}  (band {band[0]:.3f} .. {band[1]:.3f})")
    if trials[0].alarm is not None:
        alarm, structure = (sum(bool(getattr(t, k)) for t in trials) for k in ("alarm", "structure"))
        at_most = binom.ppf(0.995, n, 0.05)
        said = f"effects {alarm}/{n}, random torque {structure}/{n}  (at most {at_most:.0f} at 5 %)"
        lines.append(f"false alarms: {said}")
    return lines


def main() -> None:
    """Run and print."""
    parser = command.parser("calibration", __doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--log", choices=tuple(LOGS), default="clean")
    parser.add_argument(
        "--models", nargs="+", choices=[n or "none" for n in ADDED], default=[n or "none" for n in ADDED]
    )
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    with command.processes(given.workers) as pool:
        for word in given.models:
            name = "" if word == "none" else word
            trials = list(pool.map(trial, [name] * given.seeds, [given.log] * given.seeds, range(given.seeds)))
            print(f"{given.log}, {given.seeds} seeds, effect in the model: {word}")
            print("\n".join("  " + line for line in report(trials)), flush=True)


if __name__ == "__main__":
    main()
