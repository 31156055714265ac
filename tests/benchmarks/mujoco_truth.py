"""MuJoCo as a second machine: the same rod, with what its own joints and actuators offer (extra `[sim]`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.benchmarks.truth import NEUTRAL, STEP, Array, Motion

# What MuJoCo has a word for: damping, frictionloss, stiffness, armature, gear, ctrlrange, gravity's direction.
EFFECTS = ("viscous", "coulomb", "spring", "saturation", "torque_bias", "tilt")

WORLD = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="{gx} 0 {gz}" iterations="50" tolerance="1e-12"/>
  <worldbody>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{viscous.b}" frictionloss="{coulomb.tau_c}"
             armature="{rotor_inertia.J}" stiffness="{spring.k}" springref="180"
             solreffriction="{stiff} 1" solimpfriction="0.9999 0.9999 0.001"/>
      <inertial pos="0 0 {half}" mass="{m}" diaginertia="{own} {own} 1e-6"/>
    </body>
  </worldbody>
  <actuator><general joint="hinge" gear="{torque_gain.k}" {range}/></actuator>
</mujoco>
"""


def simulate(
    numbers: Mapping[str, float], u: Array, theta: Array, theta_dot: Array | float, dt: float, step: float = STEP
) -> Motion:
    """Run L rollouts of one machine under the commands u (L, N) [N m], as truth.simulate does.

    Raises KeyError for numbers that MuJoCo's joint does not have, ImportError where mujoco is not installed.
    """
    import mujoco

    known = {k for k in NEUTRAL if k.split(".")[0] in (*EFFECTS, "rotor_inertia", "torque_gain", "m", "l", "g")}
    foreign = [k for k in numbers if k not in known]
    if foreign:
        raise KeyError(f"MuJoCo's joint has no {foreign[0]!r}")
    p = NEUTRAL | dict(numbers)
    model = mujoco.MjModel.from_xml_string(_xml(p, step))
    u = np.atleast_2d(u)
    L, N = u.shape
    per_sample = round(dt / step)
    angles, speeds = np.empty((L, N + 1)), np.empty((L, N + 1))
    angles[:, 0], speeds[:, 0] = theta, theta_dot
    for i in range(L):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = angles[i, 0], speeds[i, 0]
        data.qfrc_applied[0] = p["torque_bias.tau_0"]
        for k in range(N):
            data.ctrl[0] = u[i, k]
            mujoco.mj_step(model, data, per_sample)
            angles[i, k + 1], speeds[i, k + 1] = data.qpos[0], data.qvel[0]
    return Motion(dt * np.arange(N + 1), angles, speeds, angles, speeds)


def _xml(p: Mapping[str, float], step: float) -> str:
    """The machine in MuJoCo's words; its z axis points up, theta turns about y."""
    text = WORLD
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
