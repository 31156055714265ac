"""Planned experiment: what to play on a rig, and what it will be worth, as data, as a CSV and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sysid.data.files import save_csv
from sysid.data.json_file import plain, plain_fields
from sysid.errors import InvalidInput
from sysid.physics.ops import Array

EXPERIMENT_SCHEMA = "gapfinder/experiment/1"
SHOWN = (
    *("kind", "description", "separates", "measure", "widest", "before", "after", "gain", "seconds", "repeats"),
    *("start", "reach", "speed"),
)
"""The attributes of an experiment that its plain data hold as they are."""
DECISIVE = 16.0
"""Evidence from which two effects count as told apart: four standard deviations."""
LEAST_EVIDENCE = 0.5
"""An experiment with less evidence is not worth playing: more than thirty of it would be needed to decide."""


class HypothesisPair(NamedTuple):
    """Evidence for `truth`, were it true, against `rival`: on the log at hand (None: no log) and of the experiment."""

    truth: str
    rival: str
    before: float | None = None
    after: float = math.nan


@dataclass(frozen=True, eq=False, repr=False)
class Experiment:
    """What to do next on the rig, and what it will be worth.

    Attributes
    ----------
    kind : str
        "steps", "bang-bang", "chirp", "multisine", "free swing" or, for several of them, "mixed"; "none": nothing that
        is played helps (the sentence says what does), or nothing tells more than the log at hand.
    description : str
        One sentence.
    separates : tuple of str
        The effects or the parameters that it tells apart.
    measure : str
        "evidence": the expected decrease of -2 log likelihood, right effect against the best rival (16 decide);
        "interval": the half width of the widest 95 % interval, that of parameter `widest`; "cost": what the errors of
        the parameters are expected to cost.
    before : float or None
        The measure on the log at hand; None if there is no log, or the measure is infinite.
    after : float or None
        The measure that is expected of a log of this experiment alone (a cost: of both logs together), under the
        random torque that the log at hand shows. None where it is not known, or there is nothing to play.
    u : array (n, N)
        The torque of each rollout [N m], held over `dt` [s].
    theta, theta_dot : array (n, N+1)
        The predicted motion [rad], [rad/s]; a rollout starts at rest at theta[:, 0].
    reach : float
        The farthest that the predicted motion goes from rest [rad].
    pairs : tuple of HypothesisPair
        The evidence pair by pair; before and after are the least over all pairs.
    unit : str
        Of theta: "m" for a linear axis.
    information : array (P, P)
        The Fisher information on the free parameters, in inverse squares of their units; with measure "cost" only.
    """

    kind: str
    description: str
    separates: tuple[str, ...]
    measure: str = "evidence"
    before: float | None = None
    after: float | None = None
    u: Array = field(default_factory=lambda: np.zeros((0, 0)))
    dt: float = 0.0
    theta: Array = field(default_factory=lambda: np.zeros((0, 1)))
    theta_dot: Array = field(default_factory=lambda: np.zeros((0, 1)))
    reach: float = 0.0
    widest: str | None = None
    pairs: tuple[HypothesisPair, ...] = ()
    unit: str = "rad"
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def start(self) -> Array:
        """Start angles (n,) [rad], 0 upright."""
        return self.theta[:, 0]

    @property
    def speed(self) -> float:
        """The fastest predicted motion [rad/s]."""
        return float(np.max(np.abs(self.theta_dot), initial=0.0))

    @property
    def t(self) -> Array:
        """Instants (N+1,) [s]."""
        return np.asarray(self.dt * np.arange(self.theta.shape[1]), dtype=float)

    @property
    def seconds(self) -> float:
        """Time on the rig [s], without resets."""
        return self.u.size * self.dt

    @property
    def repeats(self) -> int | None:
        """How often to play it until the evidence decides; None: never. Evidence grows at least in proportion."""
        if self.measure != "evidence" or self.after is None:
            return 1
        return math.ceil(DECISIVE / self.after) if self.after >= LEAST_EVIDENCE else None

    @property
    def gain(self) -> float | None:
        """How many times better than the log at hand: evidence after / before, or interval before / after."""
        if self.before is None or self.after is None:
            return None
        better, worse = (self.after, self.before) if self.measure == "evidence" else (self.before, self.after)
        return better / worse if worse > 0.0 else None

    def to_dict(self) -> dict[str, Any]:
        """Plain data of schema "gapfinder/experiment/1", without the torques (those go into the CSV)."""
        return plain_fields(self, *SHOWN) | {
            "contests": plain(self.pairs),
            "schema": EXPERIMENT_SCHEMA,
            "rollouts": len(self.u),
            "u_peak": float(np.max(np.abs(self.u), initial=0.0)),
            "u_rms": float(np.sqrt(np.mean(self.u**2))) if self.u.size else 0.0,
        }

    def write_csv(self, path: str | Path) -> None:
        """Write what a rig plays: columns t [s] and torque [N m], held from that row's time; the last row lasts dt too.

        Several rollouts stand below one another, told apart by a column `rollout`. Raises InvalidInput where there is
        nothing to play, and for a file that cannot be written.
        """
        if not self.u.size:
            raise InvalidInput(f"nothing to play: {self.description}")
        rows = (
            (i, round(t, 9), torque)
            for i, u in enumerate(self.u.tolist())
            for t, torque in zip(self.t.tolist(), u, strict=False)
        )
        if len(self.u) > 1:
            save_csv(path, ("rollout", "t", "torque"), rows)
        else:
            save_csv(path, ("t", "torque"), (row[1:] for row in rows))

    def __repr__(self) -> str:
        lines = [self.description]
        if self.u.size:
            lines.append(
                f"  predicted motion: up to {self.reach:.3g} {self.unit} from rest and {self.speed:.3g} {self.unit}/s; "
                f"{len(self.u)} x {self.u.shape[1] * self.dt:.3g} s"
            )
        if self.repeats is not None and self.repeats > 1:
            lines.append(f"  play it {self.repeats} times: once is not decisive")
        return "\n".join(lines)
