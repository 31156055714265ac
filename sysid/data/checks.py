"""Checks of a log's columns, units, zero and signs, before any model sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from sysid.data.record import Record, as_read
from sysid.data.sensor import Sensor, check_sensor
from sysid.errors import InvalidInput
from sysid.limits import MAGNITUDE, check_size
from sysid.physics.ops import Array
from sysid.physics.plants import Plant

COMPARED_SPAN = 0.1
"""Time [s] over which an angle's change is compared with its speed: long enough for the noise to matter little."""
ELSEWHERE = 0.3
"""Least angle [rad] between where free swings have their middle and where the joint should hang, to be remarked on."""
DEGREES = 180.0 / math.pi
"""The ratio of an angle in degrees to the integral of its speed in rad/s."""
FACTORS = {
    1.0 / DEGREES: "theta_dot looks like deg/s where theta is in rad",
    DEGREES: "theta looks like degrees where theta_dot is in rad/s",
    -1.0: "theta_dot has the opposite sign of theta's rate",
    2.0 * math.pi: "theta_dot looks like turns/s where theta is in rad",
    math.pi / 30.0: "theta_dot looks like turns/min where theta is in rad",
}


def check_magnitude(name: str, table: Mapping[str, Array], titles: Mapping[str, str]) -> None:
    """Raise InvalidInput where a column holds numbers that no machine shows: later computations would overflow."""
    for ours, column in table.items():
        largest = float(np.max(np.abs(column), initial=0.0, where=np.isfinite(column)))
        check_size(f"{name}: column {titles[ours]!r} for {ours} reaches", largest, MAGNITUDE)


def check_time(name: str, table: Mapping[str, Array], titles: Mapping[str, str]) -> None:
    """Raise InvalidInput where column t goes backwards in a fifth of the rows; `titles` are the file's column names."""
    t = table["t"]
    if len(t) < 3 or np.mean(np.diff(t) < 0.0) < 0.2:
        return
    rising = [c for c, v in table.items() if c not in ("t", "rollout") and len(v) > 2 and np.all(np.diff(v) > 0.0)]
    if rising:
        raise InvalidInput(
            f"{name}: {titles[rising[0]]!r} increases with every row and {titles['t']!r} does not: "
            f"are t and {rising[0]} swapped?"
        )
    raise InvalidInput(
        f"{name}: {titles['t']!r} goes backwards in {np.mean(np.diff(t) < 0.0):.0%} of the rows: is it t?"
    )


def check_columns(name: str, table: Mapping[str, Array], degrees: bool) -> tuple[tuple[str, ...], bool]:
    """Check that theta_dot is the rate of theta: notes on their units, and whether the speed has to be left out, since
    it is the rate of theta times some factor.

    The change of one column over 0.1 s is compared with the integral of the other, where that is largest. The numbers
    are the file's own: no zero has been converted yet, and no unit, even if the user says that they are `degrees`.
    Raises InvalidInput where two columns are swapped.
    """
    moving = {c: table[c] for c in ("theta", "theta_dot", "torque") if c in table and np.ptp(table[c]) > 0.0}
    if not {"theta", "theta_dot"} <= set(moving):
        return (), False
    if rate_mismatch(table["t"], moving["theta"], moving["theta_dot"]) < 0.5:
        return (), False
    for angle, speed in (("theta_dot", "theta"), ("theta", "torque"), ("torque", "theta_dot")):
        if {angle, speed} <= set(moving) and rate_mismatch(table["t"], moving[angle], moving[speed]) < 0.15:
            swapped = sorted({angle, speed} ^ {"theta", "theta_dot"}) or ["theta", "theta_dot"]
            raise InvalidInput(
                f"{name}: theta_dot is not the rate of theta, but {speed} is the rate of {angle}: "
                f"are {' and '.join(swapped)} swapped?"
            )
    change, integral = _changes(table["t"], moving["theta"], moving["theta_dot"])
    slope = float(change @ integral) / max(float(integral @ integral), 1e-300)
    factor = min(FACTORS, key=lambda ratio: abs(slope / ratio - 1.0))
    known = abs(slope / factor - 1.0) < 0.1
    found = FACTORS[factor] if known else "theta_dot is not the rate of theta"
    proportional = bool(np.corrcoef(change, integral)[0, 1] ** 2 > 0.8)
    if not proportional or (known and factor == DEGREES and not degrees):
        return (f"{name}: {found} (their ratio is {slope:.3g}): check columns and units",), False
    return (f"{name}: {found} (their ratio is {slope:.3g}): theta_dot is left out",), True


def _changes(t: Array, angle: Array, speed: Array) -> tuple[Array, Array]:
    """The change of `angle` over 0.1 s, and the integral of `speed` over the same rows."""
    steps = np.diff(t)
    span = min(max(round(COMPARED_SPAN / max(float(np.median(steps)), 1e-9)), 1), len(t) - 1)
    area = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * steps)))
    return angle[span:] - angle[:-span], area[span:] - area[:-span]


def rate_mismatch(t: Array, angle: Array, speed: Array) -> float:
    """The median of |change - integral| (`_changes`) over that of |integral|, in the fastest quarter of the rows."""
    change, integral = _changes(t, angle, speed)
    fast = np.abs(integral) >= np.percentile(np.abs(integral), 75.0)
    return float(np.median(np.abs(change - integral)[fast])) / max(float(np.median(np.abs(integral)[fast])), 1e-300)


def doubts(
    records: Sequence[Record], plant: Plant | None, command: str, shift: float = 0.0, degrees: bool = False
) -> tuple[str, ...]:
    """Notes on what looks unlikely: an angle in degrees, a torque that never changes, a zero or a sign turned round.

    The angles of the file were larger by `shift` [rad], and in `degrees`: a note on the zero is in the file's units.

    A `plant` that does not turn gets no notes on angles, and forces in place of torques; without gravity none on zero.
    """
    notes = []
    turns, newton = (True, "N m") if plant is None else (plant.turns, plant.unit("N m"))
    largest = max(float(np.max(np.abs(r.theta))) if r.theta is not None else 0.0 for r in records)
    if turns and largest > 40.0:
        notes.append(f"theta reaches {largest:.3g} rad ({largest / (2 * math.pi):.1f} turns): or is it in degrees?")
    if command == "position":  # what follows is of torques: a servo pulls at rest, too, and against the angle
        return tuple(notes)
    if command == "torque" and not turns:
        command = "force"
    first = float(records[0].u[0])
    if all(np.all(r.u == first) for r in records):
        free = f"a free {'swing' if turns else 'motion'}: the {command} is 0"
        acts = f"the {command} never changes ({first:g}{f' {newton}' if command in ('torque', 'force') else ''})"
        notes.append(free if first == 0.0 else acts)
    hangs = plant is None or float(plant.largest_gravity_torque) > 0.0
    if not turns:
        return tuple(notes)
    A, b = _accelerations(records)
    middle = _middle_of_swings(A, b) if hangs else None
    if middle is not None and abs(math.remainder(middle - math.pi, 2.0 * math.pi)) > ELSEWHERE:
        angle = math.remainder(middle + shift, 2.0 * math.pi)
        at = f"{math.degrees(angle) if degrees else angle:.4g}"
        return (*notes, f"the swings are about {at} in this log, where the joint seems to hang: say so (--zero {at})")
    return (*notes, *_turned(A, b, command, hangs))


def _middle_of_swings(A: Array, b: Array) -> float | None:
    """The angle [rad] towards which free swings are pulled, by their `_accelerations`; None for other records.

    theta_ddot = -k (theta - middle) - b theta_dot,   k > 0
    """
    if not len(b) or np.ptp(A[:, 1]) > 0.0 or np.ptp(A[:, 0]) == 0.0:
        return None
    free = A[:, [0, 2, 3]]
    k, _, pull = np.linalg.lstsq(free, b, rcond=None)[0]
    unexplained = _shares(free, b)[1]
    return float(-pull / k) if k < 0.0 and unexplained < 0.3 else None


def _accelerations(records: Sequence[Record]) -> tuple[Array, Array]:
    """Rows (n, 4) of theta, mean command, speed and 1, and the accelerations (n,), over 0.1 s."""
    rows, targets = [np.zeros((0, 4))], [np.zeros(0)]
    for r in records:
        span = max(round(COMPARED_SPAN / r.dt), 1)
        if r.theta is None or not r.has_angles or len(r) < 4 * span:
            continue
        mean = np.convolve(r.u, np.full(2 * span, 0.5 / span), "valid")
        mid = r.theta[span:-span]
        speed = (r.theta[2 * span :] - r.theta[: -2 * span]) / (2 * span * r.dt)
        targets.append((r.theta[2 * span :] - 2.0 * mid + r.theta[: -2 * span]) / (span * r.dt) ** 2)
        rows.append(np.column_stack([mid, mean, speed, np.ones(len(mid))])[: len(targets[-1])])
    return np.concatenate(rows), np.concatenate(targets)


def _turned(A: Array, b: Array, command: str, hangs: bool) -> tuple[str, ...]:
    """Whether gravity or torque act against our convention, by least squares of `_accelerations`:

    theta_ddot = a sin(theta) + c u - b theta_dot + d,   a > 0 and c > 0 are expected

    If a controller moves a geared joint slowly, acceleration hardly shows. Its torque is then regressed instead:

    u = -G sin(theta) + J theta_ddot + b theta_dot + tau_c sign(theta_dot) + d,   G > 0 is expected
    """
    A = np.column_stack([np.sin(A[:, 0]), A[:, 1:]])
    if float(b @ b) == 0.0:
        return ()
    hanging = "the pendulum is pulled towards theta = 0: does 0 mean hanging in this log?"
    turned = f"a positive {command} lowers theta: is its sign turned round?"
    notes = []
    share, unexplained = _shares(A, b)
    if hangs and unexplained < 0.3 and share[0] < -0.3:
        notes.append(hanging)
    if unexplained < 0.3 and share[1] < -min(0.3, max(0.1, 3.0 * math.sqrt(unexplained))):
        notes.append(turned)
    if not notes and np.ptp(A[:, 1]) > 0.0:
        held = np.column_stack([A[:, 0], b, A[:, 2], np.sign(A[:, 2]), A[:, 3]])
        share, unexplained = _shares(held, A[:, 1])
        rubs = share[2] + share[3]
        if unexplained < 0.3 and abs(share[0]) > 0.5 and rubs < -0.1:
            notes.append(turned)
        elif hangs and unexplained < 0.3 and share[0] > 0.5 and rubs > 0.0:
            notes.append(hanging)
    return tuple(notes)


def _shares(A: Array, b: Array) -> tuple[Array, float]:
    """The share of the spread of b (n,), with its sign, that each column of A (n, m) accounts for in a least-squares
    fit, and the share of b's variance that the fit leaves unexplained."""
    fit = np.linalg.lstsq(A, b, rcond=None)[0]
    unexplained = float(np.sum((b - A @ fit) ** 2) / np.sum((b - b.mean()) ** 2 + 1e-300))
    return fit * A.std(axis=0) / max(float(b.std()), 1e-300), unexplained


def check_excitation(records: Sequence[Record], sensor: Sensor) -> None:
    """Raise InvalidInput where every channel of every record is constant up to the sensor's noise.

    A channel moves if the variance of its means over ten samples is above three times that of noise, sigma^2 / 10.
    """
    check_sensor(sensor)
    ranges, records = [], as_read(records)
    for channel, sd in (("theta", sensor.theta), ("theta_dot", sensor.theta_dot)):
        for record in records:
            y = getattr(record, channel)
            if sd is None or y is None:
                continue
            width = min(10, len(y))
            means = y[: len(y) // width * width].reshape(-1, width).mean(axis=1)
            if len(means) < 2 or np.var(means, ddof=1) > 3.0 * sd**2 / width:
                return
            ranges.append(f"{channel} stays within {np.ptp(y):.2g} of {np.mean(y):.4g} (noise {sd:.2g})")
    if ranges:
        raise InvalidInput(f"the machine is at rest: {ranges[0]} in {records[0].name}: nothing shows its inertia")
