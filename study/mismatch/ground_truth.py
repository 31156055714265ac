"""The hidden machine, the paper's rod of 2 kg and 1.5 m: as it moves, is measured, and as policies are designed on it.

Two effects that real machines have and the catalogue does not are among what it hides: what a diagnosis may only call
unknown, or imitate. Rollouts are 10 s of random torque, read by an encoder and a poor tachometer.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from policies.control.design_model import table_shape
from policies.control.dynamic_programming import Grid
from policies.control.predictive import design_predictive
from policies.evaluation import Policy
from study.mismatch.plan import HiddenPlant, Plan
from study.paper.protocol import paper_model
from sysid import (
    RK4,
    Effect,
    InputEffect,
    InvalidInput,
    Joint,
    JointEffect,
    Model,
    Record,
    Sensor,
    effect,
    ops,
    simulate,
)
from sysid.physics.effects.effect import Memory
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter


@dataclass(frozen=True, eq=False)
class Magnet(JointEffect):
    """tau = -k d exp((1 - d^2) / 2), d = wrap(theta - place) / width: pulls towards `place` with up to k [N m].

    place, width [rad]: k acts at a distance of one width.
    """

    formula: ClassVar[str] = "tau = -k d exp((1 - d^2) / 2), d = wrap(theta - place) / width"
    k: Value = parameter(0.0, unit="N m", bounds=(-10.0, 10.0), neutral=0.0)
    place: Value = parameter(0.4, unit="rad", bounds=(-7.0, 7.0))
    width: Value = parameter(0.3, unit="rad", bounds=(0.01, 3.0))

    def torque(self, joint: Joint) -> Value:
        d = ops.wrap(joint.theta - self.place) / self.width
        return -self.k * d * ops.exp(0.5 * (1.0 - d * d))


@dataclass(frozen=True, eq=False)
class SlewLimit(InputEffect):
    """z moves towards the signal s by at most `rate` [N m/s]; drive = z: a drive that cannot change its torque at once.

    z' = z + clip(s - z, -rate h, rate h), mean over the substep h = (z + z') / 2; after delay and lag.
    """

    formula: ClassVar[str] = "|drive_dot| <= rate"
    stage: ClassVar[int] = 3
    rate: Value = parameter(1e6, unit="N m/s", bounds=(1e-3, 1e6), neutral=1e6)

    def rest(self, dt: float) -> Memory:
        return (0.0,)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """Substep means of the limited signal, and z at the end of the interval."""
        most = self.rate * dt / len(signal)
        (z,) = memory
        limited = []
        for s in signal:
            after = z + ops.clip(s - z, -most, most)
            limited.append(0.5 * (z + after))
            z = after
        return tuple(limited), (z,)


OUT_OF_CATALOGUE: dict[str, type[Effect]] = {kind.name: kind for kind in (Magnet, SlewLimit)}


BLUNT = Grid(theta=120, theta_dot=121)
"""A table whose interpolation plans with a margin, as trained agents do (`effect_cost`)."""

DESIGN_SUBSTEPS = 2
"""Policies are designed, and agents trained, on steps of 25 ms."""

PRIOR = dataclasses.replace(paper_model(), integrator=RK4(substeps=DESIGN_SUBSTEPS))
"""What an engineer would assume without data; the paper's numbers, integrated so that steps of 25 ms are no gap."""


def hidden_machine(effect: Effect | None = None, substeps: int | None = None) -> Model:
    """The hidden machine; by default in steps of 5 ms, or of 0.2 ms where something makes it stick."""
    plain = paper_model(m=2.0, l=1.5)
    model = plain if effect is None else plain.with_effect(effect)
    fine = 250 if model.dry_frictions else 10
    return dataclasses.replace(model, integrator=RK4(substeps=fine if substeps is None else substeps))


def design(model: Model, grid: Grid = BLUNT) -> Policy:
    """The near-optimal policy for a machine, designed on steps of 25 ms; it knows the state.

    Raises InvalidInput for a machine with effects of the sensors, or one that no table can be made for.
    """
    if model.output_effects:
        raise InvalidInput(f"{model.output_effects[0].name} is of the sensors: expected a machine whose state is known")
    model = dataclasses.replace(model, integrator=RK4(substeps=DESIGN_SUBSTEPS))
    turns, third_axis = table_shape(model)
    if third_axis:
        grid = dataclasses.replace(grid, u=11, memory=7)
    return design_predictive(model, dataclasses.replace(grid, turns=turns))


def effect_of(plant: HiddenPlant) -> Effect | None:
    """What the plant has and the prior lacks. Raises InvalidInput for an unknown effect."""
    numbers = dict(plant.numbers)
    if plant.effect in OUT_OF_CATALOGUE:
        return OUT_OF_CATALOGUE[plant.effect](**numbers)
    return None if plant.effect is None else effect(plant.effect, **numbers)


def ground_truth(plant: HiddenPlant) -> Model:
    """The plant as a real machine moves."""
    return hidden_machine(effect_of(plant))


def oracle(plant: HiddenPlant) -> Model:
    """The plant in the steps that every agent trains on."""
    return hidden_machine(effect_of(plant), substeps=DESIGN_SUBSTEPS)


def sensor(plan: Plan) -> Sensor:
    """The sensor that reads the hidden plant."""
    return Sensor(theta=plan.sd[0], theta_dot=plan.sd[1])


def rollouts(plan: Plan, plant: HiddenPlant, seed: int) -> list[Record]:
    """The largest budget's rollouts; smaller budgets are its first ones. Torques are uniform within +-u_max."""
    n, rng = max(plan.budgets), np.random.default_rng(seed)
    if n < 1:
        raise InvalidInput(f"budgets {plan.budgets}: expected at least one rollout")
    model = ground_truth(plant)
    u = rng.uniform(-model.u_max, model.u_max, (n, plan.length))
    theta, theta_dot = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)
    return sensor(plan).measure(simulate(model, u, theta, theta_dot), rng)
