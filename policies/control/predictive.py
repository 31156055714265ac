"""The near-optimal policy for a machine whose commands act late: it acts on where the commands under way will lead.

    policy = design_predictive(model)              # model: fitted, with delay and lag
    print(evaluate(policy, plant, *start_states(seed=0)))

With a delay of d whole samples the command of sample k acts in sample k + d. What happens until then is decided by
commands that were given, so on a machine without noise the best command is that of the machine without delay, from the
state predicted:

    u_k = pi_{k+d}(x_{k+d}),   x_{k+1} = f(x_k, u_{k-d}),   0 where k + d is beyond the horizon

What is left of the delay below a sample, and a lag, are numbers that the input path remembers: axes of pi's table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from policies.control.design_model import without_dead_time
from policies.control.dynamic_programming import Grid, Optimal, solve
from sysid import Delay, Lag, Model, State
from sysid.physics.effects import InputEffect
from sysid.physics.ops import Array

FORGOTTEN = 1e-6
"""Share of a command's effect on a lag below which it is no longer looked back to."""


@dataclass(frozen=True, eq=False)
class Predictive:
    """pi, the optimum of the model without the d = `ahead` whole samples of delay; a policy for `evaluate`.

    history   how many past commands it needs: those under way, and those that the input path still remembers
    """

    optimal: Optimal
    ahead: int
    history: int

    def __call__(self, state: State, t: float, past_commands: Array | None = None) -> Array:
        """u (E,) [N m] for theta (E,), theta_dot (E,) and past_commands (E, history), the latest first."""
        model, none = self.optimal.model, np.zeros((*np.shape(state.theta), 0))
        commands = none if past_commands is None else past_commands
        memory = model.rest(np.asarray(state.theta))
        for i in reversed(range(self.ahead, self.history)):
            _, memory = model.drive(commands[..., i], memory)
        now = State(state.theta, state.theta_dot, memory)
        for i in reversed(range(self.ahead)):
            now = model.advance(now, commands[..., i], t + (self.ahead - 1 - i) * model.dt)
        then = t + self.ahead * model.dt
        if round(then / model.dt) >= self.optimal.horizon:
            return np.zeros(np.shape(state.theta))
        return self.optimal(now, then)


def design_predictive(
    model: Model, grid: Grid | None = None, horizon: int | None = None, draws: Sequence[Model] = ()
) -> Predictive:
    """The near-optimal policy for the machine (not the log) that the model describes; it acts on the joint's state.

    horizon   steps in an episode, by default those of 10 s
    draws     models that the machine may be, with the same input path: which one it is is drawn anew at every step

    Raises InvalidInput as `solve` does.
    """
    core, ahead = without_dead_time(model.machine)
    others = [without_dead_time(draw.machine)[0] for draw in draws]
    optimal = solve(core, grid, horizon, others)
    remembered = sum(_remembered(e, model.dt) for e in core.input_effects)
    return Predictive(optimal, ahead, ahead + int(min(remembered, optimal.horizon)))


def _remembered(effect: InputEffect, dt: float) -> int | float:
    """How many samples back the effect looks: a lag until it has forgotten, one of which nothing is known forever."""
    if isinstance(effect, Lag):
        return math.ceil(-math.log(FORGOTTEN) * effect.T / dt)
    if isinstance(effect, Delay) or not effect.rest(dt):
        return len(effect.rest(dt))
    return math.inf
