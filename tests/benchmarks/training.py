"""python -m tests.benchmarks.training: how fast agents train, beside Stable-Baselines3's SAC in the same run.

Agent-steps (an environment step, its replay, an update of all networks) per second of processor time, one thread a
process, on the paper's pendulum with the paper's settings and full memories. Contenders take turns, several rounds, so
that a busy machine slows all of them; medians are printed. Each runs in a process of its own: ours with its settings
of the processor (`policies.tune_cpu`), Stable-Baselines3 (extra `bench`) as it is installed, and once more with these
settings.

The share of the peak is the floating-point work of the products that an update cannot avoid, over the processor time,
as a share of what torch's best float32 product reaches on this machine in the same rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from importlib import metadata
from importlib.util import find_spec
from itertools import pairwise

from study.paper.protocol import paper_model
from tests.benchmarks import command

BATCH, CAPACITY = 256, 75_000
WARM = 5
OURS, SB3, SACLOSS, PEAK = "gapfinder", "Stable-Baselines3", "SACLoss", "peak"
SB3_TUNED = "Stable-Baselines3, tuned process"


def products(hidden: Sequence[int], observation: int = 3, action: int = 1) -> float:
    """Floating-point operations of the products of one agent's update.

    Forward: the actor at s and s', both critics and both targets, both critics again for the actor. Backward: weights
    and inputs of every layer of the critics and the actor (but inputs of no first layer), and inputs alone of the
    critics for the actor, down to the action.
    """
    actor, critic = [observation, *hidden, 2 * action], [observation + action, *hidden, 1]
    sizes = {name: [a * b for a, b in pairwise(layers)] for name, layers in (("actor", actor), ("critic", critic))}
    forward = {name: sum(weights) for name, weights in sizes.items()}
    learned = {name: 2 * sum(weights) - weights[0] for name, weights in sizes.items()}
    through = sum(sizes["critic"][1:]) + hidden[0] * action
    return 2.0 * BATCH * (2 * forward["actor"] + 6 * forward["critic"] + learned["actor"] + 2 * learned["critic"]
                          + 2 * through)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Let the contenders take turns, then print the table."""
    parser = command.parser("training", __doc__)
    parser.add_argument("--hidden", nargs="+", type=int, default=[64, 256], help="widths of the two hidden layers")
    parser.add_argument("--agents", nargs="+", type=int, default=[1, 5, 25, 125], help="sizes of our populations")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each turn, about")
    parser.add_argument("--one", nargs=3, metavar=("WHO", "HIDDEN", "AGENTS"), help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.one:
        who, hidden, agents = given.one
        print(json.dumps(CONTENDERS[who](int(hidden), int(agents), given.seconds)))
        return 0
    turns = [(PEAK, 0, 1)]
    for hidden in given.hidden:
        turns += [(SB3, hidden, 1), (SB3_TUNED, hidden, 1)] if find_spec("stable_baselines3") else []
        turns += [(who, hidden, agents) for agents in given.agents for who in (SACLOSS, OURS)]
    results = defaultdict(list)
    for lap in range(given.rounds):
        for who, hidden, agents in turns:
            print(f"\rround {lap + 1} of {given.rounds}: {who} {hidden} {agents}   ", end="", file=sys.stderr)
            results[who, hidden, agents].append(turn(who, hidden, agents, given.seconds))
    print(file=sys.stderr)
    print(_table(results))
    return 0


def turn(who: str, hidden: int, agents: int, seconds: float) -> dict[str, float]:
    """Rate [1/s] and memory [B] of a contender, from a process of its own."""
    words = ("-m", "tests.benchmarks.training", "--seconds", seconds, "--one", who, hidden, agents)
    process, env = [sys.executable, *map(str, words)], os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(process, env=env, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def _table(results: dict[tuple[str, int, int], list[dict[str, float]]]) -> str:
    rate = {key: statistics.median(turn["rate"] for turn in turns) for key, turns in results.items()}
    memory = {key: max(turn["memory"] for turn in turns) for key, turns in results.items()}
    peak = rate.pop((PEAK, 0, 1))
    first = rate.get((SB3, 256, 1))
    head = ("trainer", "networks", "agents", "agent-steps / CPU-second", "times SB3, same networks",
            "times SB3 at 256 x 256", "share of matmul peak", "memory")  # fmt: skip
    rows = []
    for (who, hidden, agents), speed in rate.items():
        times = _times(speed, rate.get((SB3, hidden, 1))), _times(speed, first)
        share = f"{100 * speed * products((hidden, hidden)) / peak:.0f} %"
        held = f"{memory[who, hidden, agents] / 2**30:.2f} GiB"
        rows.append((who, f"{hidden} x {hidden}", agents, f"{speed:.0f}", *times, share, held))
    table = command.markdown(head, ("---", "---", *["---:"] * 6), rows)
    versions = ", ".join(
        f"{p} {metadata.version(p)}" for p in ("torch", "torchrl", "stable_baselines3") if find_spec(p)
    )
    return f"{table}\n\n{peak / 1e9:.0f} GFLOP/s matmul peak; {_processor()}; {versions}"


def _times(speed: float, other: float | None) -> str:
    return f"{speed / other:.1f}" if other else "-"


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def _measured(advance: Callable[[int], None], per_step: float, seconds: float) -> dict[str, float]:
    """Units per second of processor time of advance(steps), after some warm steps."""
    advance(WARM)
    begin = time.process_time()
    advance(WARM)
    steps = max(WARM, int(seconds / max((time.process_time() - begin) / WARM, 1e-9)))
    begin = time.process_time()
    advance(steps)
    spent = time.process_time() - begin
    return {"rate": per_step * steps / spent, "memory": 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}


def _ours(hidden: int, agents: int, seconds: float, written_out: bool = True) -> dict[str, float]:
    import torch

    from policies import Band, SACPopulation, SACSettings, tune_cpu
    from policies.training.sac import StackedSACLoss

    class ByTorchRL(SACPopulation):
        loss_of = StackedSACLoss

    tune_cpu(threads=1)
    settings = SACSettings(hidden=(hidden, hidden), batch=BATCH, random_steps=10, steps=CAPACITY)
    bands = [Band({"m": 2.0, "l": 1.5}, w=0.2)] * agents
    population = (SACPopulation if written_out else ByTorchRL)(paper_model(), bands, range(agents), settings)
    population.train(10)
    storage = population.replay.storage
    storage.rows.normal_(generator=torch.Generator().manual_seed(0))
    storage.rows[..., -2:] = 0.0  # nothing is terminal
    storage.count.fill_(CAPACITY)
    return _measured(population.train, agents, seconds)


def _sacloss(hidden: int, agents: int, seconds: float) -> dict[str, float]:
    """The same loop with TorchRL's own SACLoss."""
    return _ours(hidden, agents, seconds, written_out=False)


def _sb3_tuned(hidden: int, agents: int, seconds: float) -> dict[str, float]:
    from policies import tune_cpu

    tune_cpu(threads=1)
    return _sb3(hidden, agents, seconds)


def _sb3(hidden: int, agents: int, seconds: float) -> dict[str, float]:
    import gymnasium
    import numpy as np
    import torch
    from stable_baselines3 import SAC

    import policies
    from policies import Band

    torch.set_num_threads(1)
    env = gymnasium.make(policies.ENV_ID, randomization=Band({"m": 2.0, "l": 1.5}, w=0.2))
    model = SAC(
        "MlpPolicy", env, learning_rate=1e-3, batch_size=BATCH, buffer_size=CAPACITY, gamma=0.99, tau=0.005,
        policy_kwargs={"net_arch": [hidden, hidden]}, learning_starts=0, device="cpu", seed=0,
    )  # fmt: skip
    rng, memory = np.random.default_rng(0), model.replay_buffer
    for numbers in (memory.observations, memory.next_observations, memory.rewards):
        numbers[:] = rng.standard_normal(numbers.shape)
    memory.actions[:] = rng.uniform(-1.0, 1.0, memory.actions.shape)
    memory.full = True

    def advance(steps: int) -> None:
        model.learn(steps, reset_num_timesteps=False)

    return _measured(advance, 1, seconds)


def _peak(hidden: int, agents: int, seconds: float) -> dict[str, float]:
    """The best of some float32 products [FLOP/s]."""
    import torch

    from policies import tune_cpu

    tune_cpu(threads=1)
    best = {"rate": 0.0, "memory": 0.0}
    for count, size in ((1, 2048), (1, 1024), (16, 256), (64, 128)):
        x, out = torch.rand(count, size, size), torch.empty(count, size, size)

        def advance(steps: int, x: torch.Tensor = x, out: torch.Tensor = out) -> None:
            for _ in range(steps):
                torch.bmm(x, x, out=out)

        best = max(best, _measured(advance, 2.0 * count * size**3, seconds / 8.0), key=lambda m: m["rate"])
    return best


CONTENDERS = {OURS: _ours, SB3: _sb3, SB3_TUNED: _sb3_tuned, SACLOSS: _sacloss, PEAK: _peak}


if __name__ == "__main__":
    raise SystemExit(main())
