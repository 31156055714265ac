"""The cases of the benchmark, column by column; each is a world that a seed makes up."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sysid import Record
from tests.benchmarks import coarse_truth, mujoco_truth, truth
from tests.benchmarks.experiments import EXPERIMENTS, LOGS, SERVOS, Engine, World, move, plan, played, write
from tests.benchmarks.hidden import ARM, CATALOGUE, FLEXIBLE, SIZES, STRANGERS, numbers_of

INVISIBLE = ("torque_gain", "rotor_inertia")  # absorbed by m and l: no log of this kind shows them
VISIBLE = tuple(n for n in CATALOGUE if n not in INVISIBLE)
FAST = ("200 Hz", "1 kHz", "encoder", "differences 200 Hz", "differences 1 kHz")
PAIRS = (
    ("viscous", "coulomb"),
    ("viscous", "delay"),
    ("viscous", "tilt"),
    ("viscous", "saturation"),
    ("viscous", "ripple"),
    ("coulomb", "lag"),
    ("coulomb", "torque_bias"),
    ("coulomb", "dead_zone"),
    ("coulomb", "spring"),
    ("coulomb", "velocity_gain"),
    ("coulomb", "backlash"),
    ("coulomb", "drift"),
    ("drag", "torque_bias"),
    ("drag", "lag"),
    ("drag", "ripple"),
    ("spring", "torque_bias"),
    ("spring", "saturation"),
    ("tilt", "periodic"),
    ("ripple", "periodic"),
    ("delay", "saturation"),
    ("lag", "dead_zone"),
    ("asymmetric_coulomb", "ripple"),
    ("load_friction", "velocity_bias"),
    ("stribeck", "spring"),
)
LOOPED = (
    (),
    ("coulomb",),
    ("viscous",),
    ("coulomb", "viscous"),
    ("delay",),
    ("coulomb", "delay"),
    ("tilt",),
    ("saturation",),
)
RATE = 100.0  # [Hz], to which a faster log is thinned where its motion allows
ENGINES: Mapping[str, Engine] = {
    "truth": truth.simulate,
    "mujoco": mujoco_truth.simulate,
    "mujoco by default": mujoco_truth.simulate_by_default,
    "euler": coarse_truth.simulate,
}


@dataclass(frozen=True)
class Case:
    """One log of the benchmark.

    hidden: the effects planted, () for none, (stranger,) outside the catalogue; size: one of SIZES, "arm" for the
    numbers of ARM, or "weak" (chosen so that the least lambda is about 22); log: a key of LOGS; engine: of ENGINES.
    """

    column: str
    hidden: tuple[str, ...]
    size: str
    experiment: str
    log: str
    seed: int
    engine: str = "truth"

    @property
    def key(self) -> str:
        """A name for files."""
        words = ("+".join(self.hidden) or "nothing", self.size, self.experiment, self.log, self.engine, str(self.seed))
        return "/".join((self.column, *words))

    @property
    def stranger(self) -> bool:
        """Whether what is hidden stands in no catalogue."""
        return bool(self.hidden) and self.hidden[0] in STRANGERS

    def rng(self, purpose: str) -> np.random.Generator:
        """Plans and noise of a case are its own, and do not depend on which other cases run."""
        return np.random.default_rng([zlib.crc32(self.key.encode()), zlib.crc32(purpose.encode())])


def world(case: Case, numbers: Mapping[str, float] | None = None) -> World:
    """The world of a case; `numbers` replaces those of the table (a weak effect's)."""
    log = LOGS[case.log]
    own = plan(case.experiment, log, case.rng("plan"))
    if case.stranger:
        stranger = STRANGERS[case.hidden[0]]
        return _closed(case, World(own, dict(stranger.numbers), stranger.gust, log))
    if numbers is None:
        numbers = ARM if case.size == "arm" else _numbers(case, World(own, {}, 0.0, log))
    return _closed(case, World(own, numbers, 0.0, log))


def _numbers(case: Case, bare: World) -> dict[str, float]:
    """The hidden numbers at the case's size; limits go by the commands that the machine without effects gets."""
    u = (_closed(case, bare) if "saturation" in case.hidden else bare).plan.u
    peak = float(np.max(np.abs(u[: learned(len(u))])))
    size = "small" if case.size == "weak" else case.size
    row = max(bare.log.dt, 1.0 / RATE)
    return {k: v for name in case.hidden for k, v in numbers_of(name, size, row, peak).items()}


def _closed(case: Case, made: World) -> World:
    """The world with the commands of its servo, if it has one."""
    return played(made, case.rng("noise"), ENGINES[case.engine])


def records(case: Case, made: World) -> list[Record]:
    """The log that a rig writes of that world."""
    own = made.plan
    if case.engine == "truth":
        (motion,) = move([made])
    else:
        motion = ENGINES[case.engine](made.numbers, own.u, own.theta, 0.0, made.log.dt)
    return write(motion, made.plan, made.log, case.rng("noise"))


def _sizes(column: str, log: str, seed: int) -> Iterator[Case]:
    """Every visible effect at three sizes, the experiments in turn."""
    for i, name in enumerate(VISIBLE):
        if LOGS[log].theta_dot is None and name in ("velocity_bias", "velocity_gain"):
            continue
        for j, size in enumerate(SIZES):
            yield Case(column, (name,), size, EXPERIMENTS[(i + j + seed) % 3], log, seed)


def _clean(seed: int) -> Iterator[Case]:
    for name in VISIBLE:
        for size in SIZES:
            for experiment in EXPERIMENTS:
                yield Case("clean", (name,), size, experiment, "clean", seed)


def _weak(seed: int) -> Iterator[Case]:
    for name in (n for n in VISIBLE if "delay" not in n):  # whose least size, one row, is a convention and no physics
        for experiment in EXPERIMENTS:
            yield Case("weak", (name,), "weak", experiment, "clean", seed)


def _pairs(seed: int) -> Iterator[Case]:
    for i, pair in enumerate(PAIRS):
        for j in range(2):
            yield Case("pairs", pair, ("medium", "small")[j], EXPERIMENTS[(i + j + seed) % 3], "clean", seed)


def _strangers(seed: int) -> Iterator[Case]:
    for name in (n for n in STRANGERS if n not in FLEXIBLE):
        for experiment in EXPERIMENTS:
            yield Case("strangers", (name,), "own", experiment, "clean", seed)


def _nothing(seed: int) -> Iterator[Case]:
    for log, count in {
        "clean": 4,
        "loud": 1,
        "slow": 1,
        "speedless": 1,
        "coarse": 1,
        "short": 1,
        **dict.fromkeys(FAST, 1),
    }.items():
        for experiment in EXPERIMENTS:
            for k in range(count):
                yield Case("nothing", (), "none", experiment, log, 100 * seed + k)


def _told(seed: int) -> Iterator[Case]:
    for i, log in enumerate(("told 1/3", "told x3")):
        for j, name in enumerate(VISIBLE):
            yield Case("told", (name,), "medium", EXPERIMENTS[(i + j + seed) % 3], log, seed)
        for j, experiment in enumerate(EXPERIMENTS * 2):
            yield Case("told", (), "none", experiment, log, 100 * seed + j)


def _stamps(seed: int) -> Iterator[Case]:
    for i, log in enumerate(("late", "early", "averaged")):
        for j, name in enumerate(VISIBLE):
            if (i + j) % 2 == 0 or name in ("delay", "lag", "sensor_delay"):
                yield Case("stamps", (name,), "medium", EXPERIMENTS[(i + j + seed) % 3], log, seed)
        for j, experiment in enumerate(EXPERIMENTS * 2):
            yield Case("stamps", (), "none", experiment, log, 100 * seed + j)


def _mujoco(seed: int) -> Iterator[Case]:
    for i, name in enumerate(mujoco_truth.EFFECTS):
        for j, size in enumerate(SIZES):
            yield Case("mujoco", (name,), size, EXPERIMENTS[(i + j + seed) % 3], "clean", seed, "mujoco")
    for experiment in EXPERIMENTS:
        yield Case("mujoco", (), "none", experiment, "clean", seed, "mujoco")


def _fast(seed: int) -> Iterator[Case]:
    for log in FAST:
        yield from _sizes("fast", log, seed)


def _servo(seed: int) -> Iterator[Case]:
    for log, sizes in (("servo", ("small", "medium")), ("servo 200 Hz", ("medium",))):
        for hidden in LOOPED:
            for j, size in enumerate(sizes):
                for experiment in SERVOS:
                    if hidden:
                        yield Case("servo", hidden, size, experiment, log, seed)
                    else:
                        yield Case("servo", (), "none", experiment, log, 100 * seed + j)


def _simulators(seed: int) -> Iterator[Case]:
    for engine in ("euler", "mujoco by default"):
        for experiment in EXPERIMENTS:
            yield Case("simulators", (), "none", experiment, "clean", seed, engine)
            for name in coarse_truth.EFFECTS:
                for size in SIZES:
                    yield Case("simulators", (name,), size, experiment, "clean", seed, engine)


def _harmonic(seed: int) -> Iterator[Case]:
    for name in FLEXIBLE:
        for log in ("servo", "servo 200 Hz"):
            for experiment in SERVOS:
                yield Case("harmonic drive", (name,), "own", experiment, log, seed)


def _arm(seed: int) -> Iterator[Case]:
    for k in range(20):
        yield Case("arm", ("coulomb", "viscous", "delay"), "arm", "servo steps", "arm", 100 * seed + k, "mujoco")


COLUMNS: Mapping[str, Callable[[int], Iterator[Case]]] = {
    "clean": _clean,
    "loud": lambda seed: _sizes("loud", "loud", seed),
    "slow": lambda seed: _sizes("slow", "slow", seed),
    "speedless": lambda seed: _sizes("speedless", "speedless", seed),
    "coarse": lambda seed: _sizes("coarse", "coarse", seed),
    "short": lambda seed: _sizes("short", "short", seed),
    "weak": _weak,
    "pairs": _pairs,
    "strangers": _strangers,
    "nothing": _nothing,
    "told": _told,
    "stamps": _stamps,
    "mujoco": _mujoco,
    "fast": _fast,
    "servo": _servo,
    "simulators": _simulators,
    "harmonic drive": _harmonic,
    "arm": _arm,
}


def learned(rollouts: int) -> int:
    """How many rollouts a diagnosis learns from."""
    return rollouts - max(1, rollouts // 4)


def training(made: World) -> World:
    """The rollouts that a diagnosis learns from: all but the last quarter, which it keeps to report errors; a fast log
    at RATE."""
    own, log, every = made.plan, made.log, max(1, int(made.log.rate // RATE))
    keep = learned(len(own.theta))
    u = own.u[:keep].reshape(keep, -1, every).mean(axis=2)
    thin = replace(own, u=u, theta=own.theta[:keep], wind=own.wind[:keep, ::every])
    return replace(made, plan=thin, log=replace(log, rate=log.rate / every))


def named(key: str) -> Case:
    """The case of a key, as the runner prints it: records(named(key), world(named(key))) is its log.

    A weak effect's numbers stand in the store; give them to `world`. Raises KeyError for an unknown key.
    """
    column, *_, seed = key.split("/")
    if column not in COLUMNS:
        raise KeyError(f"unknown column {column!r}: expected one of {', '.join(COLUMNS)}")
    own = int(seed)
    for base in {own, own // 100}:
        for case in COLUMNS[column](base):
            if case.key == key:
                return case
    raise KeyError(f"no case {key!r}")
