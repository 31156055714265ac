"""From a log to a verdict, to a policy, to the return that it promised and the one that a machine gave it.

    python examples/sim_to_real.py                    the optimal policies: a minute
    python examples/sim_to_real.py --train 1000000    trained ones, which the machine gets as ONNX: some minutes

The machine is an arm in another simulator, MuJoCo. Its joint has damping and dry friction, each command acts 0.12 s
late, the angle comes in an encoder's steps and the speed with noise. The rest of this file knows that from nowhere but
a log of random torques. Needs the extra [sim], and [onnx] for --train.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import sys
from collections import deque
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import sysid
from policies.control.dynamic_programming import Grid
from policies.control.predictive import design_predictive
from policies.environments import task
from policies.environments.machine import machine_of, past_commands_needed
from policies.evaluation import Evaluation, Policy, evaluate, fresh_start_states
from policies.limits import EPISODES
from sysid.limits import check_size
from sysid.planning.excitation import steps

DT, U_MAX = 0.02, 2.0  # the log's interval [s], the largest torque [N m]
ROLLOUTS, SAMPLES = 4, 500  # of the log
STEP, LATE = 0.001, 120  # MuJoCo's step [s], and how many of them a command is late
COUNT, SPEED_NOISE = 2.0 * math.pi / 4096, 0.05  # the encoder's step [rad], the tachometer's noise [rad/s]
GRID = Grid(theta=180, theta_dot=181, theta_dot_max=12.0)  # of the optimum; from the upright the arm falls with 9 rad/s
ARM = f"""
<mujoco>
  <option timestep="{STEP}" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05" frictionloss="0.2"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.8" size="0.02" mass="1"/>
  </body></worldbody>
  <actuator><motor joint="hinge" ctrllimited="true" ctrlrange="{-U_MAX} {U_MAX}"/></actuator>
</mujoco>
"""


class Arm:
    """The machine: it is read, and told a torque for some time."""

    def __init__(self, theta: float, theta_dot: float, rng: np.random.Generator) -> None:
        import mujoco

        self.model, self.step, self.rng = mujoco.MjModel.from_xml_string(ARM), mujoco.mj_step, rng
        self.data, self.late = mujoco.MjData(self.model), deque([0.0] * LATE)
        self.data.qpos[0], self.data.qvel[0] = theta, theta_dot

    def state(self) -> sysid.State:
        """The true theta [rad] and theta_dot [rad/s], each (1,)."""
        return sysid.State(self.data.qpos.copy(), self.data.qvel.copy())

    def read(self) -> sysid.State:
        """The same as the encoder and the tachometer show it."""
        theta, theta_dot, _ = self.state()
        return sysid.State(COUNT * np.round(theta / COUNT), theta_dot + SPEED_NOISE * self.rng.standard_normal(1))

    def hold(self, u: float, seconds: float) -> None:
        """Command u [N m] for so long."""
        for _ in range(round(seconds / STEP)):
            self.late.append(u)
            self.data.ctrl[0] = self.late.popleft()
            self.step(self.model, self.data)


def record(u: np.ndarray, rng: np.random.Generator) -> sysid.Record:
    """The log of one rollout under torques u (N,) [N m], from near the hanging position."""
    arm = Arm(math.pi + rng.uniform(-0.5, 0.5), 0.0, rng)
    seen = [arm.read()]
    for command in u:
        arm.hold(command, DT)
        seen.append(arm.read())
    theta, theta_dot = np.array([(reading.theta[0], reading.theta_dot[0]) for reading in seen]).T
    return sysid.Record(DT * np.arange(len(seen)), u, theta, theta_dot)


def optimal(model: sysid.Model) -> Policy:
    """The best policy on the model, by dynamic programming, from the state at which the commands under way will end."""
    return design_predictive(model, GRID)


def trained(model: sysid.Model, seed: int, steps: int) -> Policy:
    """An agent that was trained on the model, as ONNX; it observes the commands that are under way."""
    from onnx.reference import ReferenceEvaluator

    from policies.environments.randomization import Fixed
    from policies.storage.onnx_file import onnx_model
    from policies.training.program import settings_for, train

    def policy(state: sysid.State, t: float, past_commands: np.ndarray | None = None) -> np.ndarray:
        fractions = () if past_commands is None else past_commands.T / U_MAX
        observation = np.stack(task.observation(state, fractions), -1).astype(np.float32)
        return network.run(None, {"observation": observation})[0][:, 0]

    policy.history = past_commands_needed(model)
    agent = train(model, Fixed(), settings_for(model, steps=steps), [seed], policy.history).policy
    network = ReferenceEvaluator(onnx_model(agent, model.dt))
    return policy


def measure(policy: Policy, dt: float, starts: tuple[np.ndarray, np.ndarray], rng: np.random.Generator) -> Evaluation:
    """The returns on the machine, a command every dt [s]. The policy sees readings; the true motion is paid for."""
    theta, theta_dot = starts
    returns = np.zeros(len(theta))
    for i, start in enumerate(zip(theta, theta_dot, strict=True)):
        arm, past_commands = Arm(*start, rng), np.zeros((1, policy.history))
        for k in range(task.horizon(dt)):
            u = np.clip(policy(arm.read(), k * dt, past_commands), -U_MAX, U_MAX)
            returns[i] += task.reward(arm.state(), u, dt)[0]
            arm.hold(u[0], dt)
            past_commands = np.column_stack((u, past_commands))[:, : policy.history]
    return Evaluation(returns)


def main(arguments: Sequence[str] | None = None) -> int:
    """Record, diagnose, design on the model as it came and on the mended one, and play both on the machine."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0, help="of torques, starts and noise (default: %(default)s)")
    parser.add_argument("--episodes", type=int, default=20, help="of 10 s, of each policy (default: %(default)s)")
    parser.add_argument("--train", type=int, default=0, metavar="STEPS", help="train the policies for so many steps")
    options = parser.parse_args(arguments)
    if options.seed < 0 or options.train < 0 or options.episodes < 2:
        parser.error("expected a seed and steps of 0 or more, and at least 2 episodes")
    try:
        check_size("--episodes", options.episodes, EPISODES)
    except sysid.InvalidInput as error:
        parser.error(str(error))
    for package, extra in (("mujoco", "sim"), *([("onnx", "onnx")] if options.train else [])):
        if importlib.util.find_spec(package) is None:
            parser.error(f"the package {package} is not installed: pip install 'gapfinder[{extra}]'")

    rng = np.random.default_rng(options.seed)
    log = [record(steps(rng, SAMPLES, DT, U_MAX, hold=0.4), rng) for _ in range(ROLLOUTS)]
    print(f"the machine has played {ROLLOUTS} rollouts of {SAMPLES * DT:g} s under random torques\n", flush=True)
    fitted = sysid.fit(sysid.Model(sysid.RodPendulum(g=9.81), dt=DT, u_max=U_MAX), log)
    print(diagnosis := sysid.diagnose(fitted, log), end="\n\n", flush=True)

    starts = fresh_start_states(options.seed, options.episodes)
    print(f"{'policy designed on':20}{'return promised':>20}{'measured':>20}{'difference':>20}")
    for name, estimate in (("the fitted model", fitted), ("the mended model", diagnosis.estimate)):
        model = machine_of(estimate.model)
        policy = trained(model, options.seed, options.train) if options.train else optimal(model)
        promised, measured = evaluate(policy, model, *starts), measure(policy, model.dt, starts, rng)
        answers = (promised, measured, Evaluation(measured.returns - promised.returns))
        print(f"{name:20}" + "".join(f"{f'{a.mean:.1f} +- {a.sem:.1f}':>20}" for a in answers), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
