"""The cases of the benchmark, column by column; each is a world that a seed makes up."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

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
    planned = plan(case.experiment, log, case.rng("plan"))
    if case.stranger:
        stranger = STRANGERS[case.hidden[0]]
        return _closed(case, World(planned, dict(stranger.numbers), stranger.gust, log))
    if numbers is None:
        numbers = ARM if case.size == "arm" else _numbers(case, World(planned, {}, 0.0, log))
    return _closed(case, World(planned, numbers, 0.0, log))


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
    planned = made.plan
    if case.engine == "truth":
        (motion,) = move([made])
    else:
        motion = ENGINES[case.engine](made.numbers, planned.u, planned.theta, 0.0, made.log.dt)
    return write(motion, made.plan, made.log, case.rng("noise"))


def _alone(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Each hidden by itself."""
    return [(name,) for name in names]


def _each(
    column: str, hidden: Iterable[tuple[str, ...]], sizes: Sequence[str], log: str, seed: int, engine: str = "truth"
) -> Iterator[Case]:
    """All that is hidden, at every size in every experiment; a servo's logs have experiments of their own."""
    for effects in hidden:
        for size in sizes:
            for experiment in SERVOS if log.startswith("servo") else EXPERIMENTS:
                yield Case(column, effects, size, experiment, log, seed, engine)


def _in_turn(
    column: str, hidden: Iterable[tuple[str, ...]], sizes: Sequence[str], log: str, seed: int, engine: str = "truth"
) -> Iterator[Case]:
    """All that is hidden and the log can show, at every size; the experiments take turns."""
    for i, effects in enumerate(hidden):
        for j, size in enumerate(sizes):
            if LOGS[log].theta_dot is not None or effects[0] not in ("velocity_bias", "velocity_gain"):
                yield Case(column, effects, size, EXPERIMENTS[(i + j + seed) % 3], log, seed, engine)


def _bare(column: str, log: str, seed: int, count: int = 1) -> Iterator[Case]:
    """Nothing hidden, so many times in every experiment."""
    for k in range(count):
        yield from _each(column, [()], ["none"], log, 100 * seed + k)


def _nothing(seed: int) -> Iterator[Case]:
    for log in ("clean", "loud", "slow", "speedless", "coarse", "short", *FAST):
        yield from _bare("nothing", log, seed, 4 if log == "clean" else 1)


def _logged(column: str, logs: Sequence[str], every: int, seed: int) -> Iterator[Case]:
    """Logs that are not what they seem: of each one in so many visible effects, and six times nothing."""
    for i, log in enumerate(logs):
        for j, name in enumerate(VISIBLE):
            if (i + j) % every == 0 or name in ("delay", "lag", "sensor_delay"):
                yield Case(column, (name,), "medium", EXPERIMENTS[(i + j + seed) % 3], log, seed)
        for j, experiment in enumerate(EXPERIMENTS * 2):
            yield Case(column, (), "none", experiment, log, 100 * seed + j)


def _mujoco(seed: int) -> Iterator[Case]:
    yield from _in_turn("mujoco", _alone(mujoco_truth.EFFECTS), SIZES, "clean", seed, "mujoco")
    yield from _each("mujoco", [()], ["none"], "clean", seed, "mujoco")


def _servo(seed: int) -> Iterator[Case]:
    for log, sizes in (("servo", ("small", "medium")), ("servo 200 Hz", ("medium",))):
        yield from _bare("servo", log, seed, len(sizes))
        yield from _each("servo", LOOPED, sizes, log, seed)


def _simulators(seed: int) -> Iterator[Case]:
    for engine in ("euler", "mujoco by default"):
        yield from _each("simulators", [()], ["none"], "clean", seed, engine)
        yield from _each("simulators", _alone(coarse_truth.EFFECTS), SIZES, "clean", seed, engine)


def _on_logs(
    cases: Callable[..., Iterator[Case]], column: str, hidden: Iterable[str], sizes: Sequence[str], logs: Sequence[str]
) -> Callable[[int], Iterator[Case]]:
    """By seed, the cases of effects alone on each of some logs."""
    return lambda seed: chain.from_iterable(cases(column, _alone(hidden), sizes, log, seed) for log in logs)


def _arm(seed: int) -> Iterator[Case]:
    for k in range(20):
        yield Case("arm", ("coulomb", "viscous", "delay"), "arm", "servo steps", "arm", 100 * seed + k, "mujoco")


NOT_LATE = tuple(n for n in VISIBLE if "delay" not in n)
"""A delay's least size, one row, is a convention and no physics."""
COLUMNS: Mapping[str, Callable[[int], Iterator[Case]]] = {
    "clean": _on_logs(_each, "clean", VISIBLE, SIZES, ["clean"]),
    **{log: _on_logs(_in_turn, log, VISIBLE, SIZES, [log]) for log in ("loud", "slow", "speedless", "coarse", "short")},
    "weak": _on_logs(_each, "weak", NOT_LATE, ["weak"], ["clean"]),
    "pairs": lambda seed: _in_turn("pairs", PAIRS, ["medium", "small"], "clean", seed),
    "strangers": _on_logs(_each, "strangers", [n for n in STRANGERS if n not in FLEXIBLE], ["own"], ["clean"]),
    "nothing": _nothing,
    "told": partial(_logged, "told", ("told 1/3", "told x3"), 1),
    "stamps": partial(_logged, "stamps", ("late", "early", "averaged"), 2),
    "mujoco": _mujoco,
    "fast": _on_logs(_in_turn, "fast", VISIBLE, SIZES, FAST),
    "servo": _servo,
    "simulators": _simulators,
    "harmonic drive": _on_logs(_each, "harmonic drive", FLEXIBLE, ["own"], ["servo", "servo 200 Hz"]),
    "arm": _arm,
}


def learned(rollouts: int) -> int:
    """How many rollouts a diagnosis learns from."""
    return rollouts - max(1, rollouts // 4)


def training(made: World) -> World:
    """The rollouts that a diagnosis learns from: all but the last quarter, which it keeps to report errors; a fast log
    at RATE."""
    planned, log, every = made.plan, made.log, max(1, int(made.log.rate // RATE))
    keep = learned(len(planned.theta))
    u = planned.u[:keep].reshape(keep, -1, every).mean(axis=2)
    thin = replace(planned, u=u, theta=planned.theta[:keep], wind=planned.wind[:keep, ::every])
    return replace(made, plan=thin, log=replace(log, rate=log.rate / every))


def named(key: str) -> Case:
    """The case of a key, as the runner prints it: records(named(key), world(named(key))) is its log.

    A weak effect's numbers stand in the store; give them to `world`. Raises KeyError for an unknown key.
    """
    column, *_, seed = key.split("/")
    if column not in COLUMNS:
        raise KeyError(f"unknown column {column!r}: expected one of {', '.join(COLUMNS)}")
    number = int(seed)
    for base in {number, number // 100}:
        for case in COLUMNS[column](base):
            if case.key == key:
                return case
    raise KeyError(f"no case {key!r}")
