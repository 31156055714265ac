"""The hidden plants and how they are measured: 10 s of random torque, read by an encoder and a poor tachometer."""

from __future__ import annotations

import dataclasses

import numpy as np

from study.mismatch.out_of_catalogue import OUT_OF_CATALOGUE
from study.mismatch.plan import HiddenPlant, Plan
from study.mismatch.rod import DESIGN_SUBSTEPS, machine
from study.paper.protocol import paper_model
from sysid import RK4, Effect, InvalidInput, Model, Record, Sensor, effect, simulate

PRIOR = dataclasses.replace(paper_model(), integrator=RK4(substeps=DESIGN_SUBSTEPS))
"""What an engineer would assume without data; the paper's numbers, integrated so that steps of 25 ms are no gap."""


def effect_of(plant: HiddenPlant) -> Effect | None:
    """What the plant has and the prior lacks. Raises InvalidInput for an unknown effect."""
    if plant.effect is None:
        return None
    numbers = dict(plant.numbers)
    return (
        OUT_OF_CATALOGUE[plant.effect](**numbers)
        if plant.effect in OUT_OF_CATALOGUE
        else effect(plant.effect, **numbers)
    )


def ground_truth(plant: HiddenPlant) -> Model:
    """The plant as a real machine moves: in steps of 5 ms, and of 0.2 ms where something makes it stick."""
    return machine(effect_of(plant))


def oracle(plant: HiddenPlant) -> Model:
    """The plant in the steps that every agent trains on."""
    return machine(effect_of(plant), substeps=DESIGN_SUBSTEPS)


def sensor(plan: Plan) -> Sensor:
    theta, theta_dot = plan.sd
    return Sensor(theta=theta, theta_dot=theta_dot)


def rollouts(plan: Plan, plant: HiddenPlant, seed: int) -> list[Record]:
    """The largest budget's rollouts; smaller budgets are its first ones. Torques are uniform within +-u_max."""
    n, rng = max(plan.budgets), np.random.default_rng(seed)
    if n < 1:
        raise InvalidInput(f"budgets {plan.budgets}: expected at least one rollout")
    model = ground_truth(plant)
    u = rng.uniform(-model.u_max, model.u_max, (n, plan.length))
    theta, theta_dot = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)
    return sensor(plan).measure(simulate(model, u, theta, theta_dot), rng)
