"""The hidden machine, the paper's rod of 2 kg and 1.5 m: as it moves, and as policies are designed on it."""

from __future__ import annotations

import dataclasses

from policies.control.design_model import has_third_axis
from policies.control.dynamic_programming import Grid
from policies.control.predictive import design_predictive
from policies.evaluation import Policy
from study.paper.protocol import paper_model
from study.trials.hidden_plant import HiddenPlant
from sysid import RK4, Effect, InvalidInput, Model

BLUNT = Grid(theta=120, theta_dot=121)
"""A table whose interpolation plans with a margin, as trained agents do (`effect_cost`)."""

SUBSTEPS = 10
"""The machine moves in steps of 5 ms, in which dry friction too is exact to 1e-5 rad."""

DESIGN_SUBSTEPS = 2
"""Policies are designed, and agents trained, on steps of 25 ms."""

PRIOR = dataclasses.replace(paper_model(), integrator=RK4(substeps=DESIGN_SUBSTEPS))
"""What an engineer would assume without data; the paper's numbers, integrated so that steps of 25 ms are no gap."""


def hidden_machine(effect: Effect | None = None, substeps: int = SUBSTEPS) -> Model:
    """The hidden machine, with an effect or as the paper has it."""
    plain = paper_model(m=2.0, l=1.5)
    model = plain if effect is None else plain.with_effect(effect)
    return dataclasses.replace(model, integrator=RK4(substeps=substeps))


def near_optimal(model: Model, grid: Grid = BLUNT) -> Policy:
    """The near-optimal policy for a machine, designed on steps of 25 ms; it knows the state.

    Raises InvalidInput for a machine with effects of the sensors, or one that no table can be made for.
    """
    if model.output_effects:
        raise InvalidInput(f"{model.output_effects[0].name} is of the sensors: expected a machine whose state is known")
    model = dataclasses.replace(model, integrator=RK4(substeps=DESIGN_SUBSTEPS))
    if has_third_axis(model):
        grid = dataclasses.replace(grid, u=11, memory=7)
    return design_predictive(model, grid)


def ground_truth(plant: HiddenPlant) -> Model:
    """The plant as a real machine moves."""
    return hidden_machine(plant.hidden_effect)


def oracle(plant: HiddenPlant) -> Model:
    """The plant in the steps that every agent trains on."""
    return hidden_machine(plant.hidden_effect, substeps=DESIGN_SUBSTEPS)
