"""MuJoCo as a second machine: the same rod, with what its own joints and actuators offer (extra `[sim]`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.benchmarks.truth import STEP, Array, Feedback, Motion, known_numbers, stepped

# What MuJoCo has a word for: damping, frictionloss, stiffness, armature, gear, ctrlrange, gravity's direction.
EFFECTS = ("viscous", "coulomb", "spring", "saturation", "torque_bias", "tilt")
MORE = ("rotor_inertia", "torque_gain", "delay")  # which mass and length absorb, or which is the loop's, not MuJoCo's

WORLD = """
<mujoco>
  <option timestep="{step}" gravity="{gx} 0 {gz}" {option}/>
  <worldbody>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{viscous.b}" frictionloss="{coulomb.tau_c}"
             armature="{rotor_inertia.J}" stiffness="{spring.k}" springref="180" {friction}/>
      <inertial pos="0 0 {half}" mass="{m}" diaginertia="{own} {own} 1e-6"/>
    </body>
  </worldbody>
  <actuator><general joint="hinge" gear="{torque_gain.k}" {range}/></actuator>
</mujoco>
"""


OPTION = 'integrator="RK4" iterations="50" tolerance="1e-12"'
FRICTION = 'solreffriction="{stiff} 1" solimpfriction="0.9999 0.9999 0.001"'
DEFAULT_STEP = 2e-3  # [s]


def simulate(
    numbers: Mapping[str, float],
    u: Array,
    theta: Array,
    theta_dot: Array | float,
    dt: float,
    step: float = STEP,
    feedback: Feedback | None = None,
    option: str = OPTION,
    friction: str = FRICTION,
) -> Motion:
    """Run L rollouts of one machine under the commands u (L, N) [N m], as truth.simulate does.

    option and friction are MuJoCo's settings of the solver and of the dry friction. A delay is one of whole steps.
    Raises KeyError for numbers that MuJoCo's joint does not have, ImportError where mujoco is not installed.
    """
    import mujoco

    p = known_numbers(numbers, (*EFFECTS, *MORE), "MuJoCo's joint")
    model = mujoco.MjModel.from_xml_string(_xml(p, step, option, friction))
    rigs = [mujoco.MjData(model) for _ in np.atleast_2d(u)]
    for data, angle, speed in zip(rigs, *(np.broadcast_to(x, len(rigs)) for x in (theta, theta_dot)), strict=True):
        data.qpos[0], data.qvel[0] = angle, speed
        data.qfrc_applied[0] = p["torque_bias.tau_0"]
    rows, late = divmod(round(p["delay.T"] / step), round(dt / step))
    parts = ((rows + 1, late), (rows, round(dt / step) - late))  # rows back, and the steps under that row's command

    def sample(k: int, u: Array, *_: Array) -> tuple[Array, Array]:
        for data, commands in zip(rigs, u, strict=True):
            for back, steps in parts:
                data.ctrl[0] = commands[k - back] if k >= back else 0.0
                mujoco.mj_step(model, data, steps)
        return np.array([data.qpos[0] for data in rigs]), np.array([data.qvel[0] for data in rigs])

    return stepped(sample, u, theta, theta_dot, dt, feedback)


def simulate_by_default(
    numbers: Mapping[str, float],
    u: Array,
    theta: Array,
    theta_dot: Array | float,
    dt: float,
    step: float = DEFAULT_STEP,
    feedback: Feedback | None = None,
) -> Motion:
    """The same with MuJoCo's own step, integrator (semi-implicit Euler) and soft dry friction."""
    return simulate(numbers, u, theta, theta_dot, dt, step, feedback, "", "")


def _xml(p: Mapping[str, float], step: float, option: str, friction: str) -> str:
    """The machine in MuJoCo's words; its z axis points up, theta turns about y."""
    text = WORLD.replace("{option}", option).replace("{friction}", friction)
    limit = p["saturation.limit"]
    words = {
        "step": step,
        "gx": p["g"] * np.sin(p["tilt.alpha"]),
        "gz": -p["g"] * np.cos(p["tilt.alpha"]),
        "half": 0.5 * p["l"],
        "own": p["m"] * p["l"] ** 2 / 12.0,
        "stiff": 2.0 * step,
        "range": f'ctrllimited="true" ctrlrange="{-limit} {limit}"' if np.isfinite(limit) else "",
    } | dict(p)
    for key, value in words.items():
        text = text.replace("{" + key + "}", str(value))
    return text
