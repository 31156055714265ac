"""Linearisation: all samples of a log, record after record, and a model linearised along a motion through them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import casadi
import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record, check_records, extent_of
from sysid.data.rests import readings_at_rest_merged
from sysid.data.sensor import Sensor, check_sensor
from sysid.estimation.kalman import LinearSystem
from sysid.estimation.smoothed_start import smooth_states
from sysid.estimation.torque_regression import slow_speed
from sysid.estimation.windows import UNKNOWN
from sysid.physics.effects import DynamicEffect, Effect, InputEffect, JointEffect
from sysid.physics.effects.effect import Joint, Stretch
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.parameters import Extent

WIDER = (1e2, 1e4, 1e5)
"""Factors of the finite difference of a number that a smaller one leaves without any slope: a delay moves the drive at
the end of a substep first, and if the joint sticks there, nothing happens until it has moved by more."""
SMOOTHED_SHARE = 0.2
"""Uncertainty of a dynamic effect's states along the smoothed readings, as a share of their sd at a record's start."""


class Samples:
    """The M instants of all records, one record after the other.

    t, time_since_start (M,)   time of the log, and since the rollout began [s]
    commands (M,)              of the interval after each instant; no interval follows a record's last instant, so that
                               whatever arrays say about it has no meaning
    y, weight (M, 2)           readings of theta and theta_dot and their 1 / sd, 0 where nothing was read; those at rest
                               are merged (`sysid.data.rests`)
    number, follows (M,)       index of the record; whether the next instant belongs to the same record
    error_channel              channel whose neighbouring readings may share an error (`Disturbances`): 0, the angle; or
                               if `speeds_share` and most instants have no angle 1, the speed
    """

    def __init__(self, model: Model, records: Sequence[Record], sensor: Sensor, speeds_share: bool = False) -> None:
        self.records, self.sensor, self.dt = check_records(model, records), sensor, model.dt
        check_sensor(sensor)
        self._extent = extent_of(self.records, model.plant.turns)
        counts = np.array([len(r) + 1 for r in self.records])
        self.first = np.concatenate([[0], np.cumsum(counts)])
        self.number = np.repeat(np.arange(len(counts)), counts)
        self.follows = np.append(self.number[1:] == self.number[:-1], False)
        inside = np.arange(len(self.number)) - self.first[self.number]
        self.t, self.time_since_start = (
            np.array([float(begin[0]) for begin in begins])[self.number] + self.dt * inside
            for begins in ([r.t for r in self.records], [r.time_since_start for r in self.records])
        )
        self.commands = np.concatenate([np.append(r.u, 0.0) for r in self.records])
        read = readings_at_rest_merged(self.records, sensor)
        self.y = np.concatenate([values for values, _ in read])
        self.weight = 1.0 / np.concatenate([sds for _, sds in read])
        for record, begin in zip(self.records, self.first.tolist(), strict=False):
            if record.starts_midway:  # for a while a model with a memory cannot predict what unknown commands left
                blind = min(math.ceil(UNKNOWN / self.dt), len(record) // 2)
                self.weight[begin : begin + blind] = 0.0
        self.error_channel = int(speeds_share and not self.reads(0))
        self._followed: dict[tuple[str, bytes], Array] = {}
        self._followers: dict[tuple[str, int], casadi.Function] = {}

    def __len__(self) -> int:
        return len(self.number)

    @property
    def reach(self) -> float:
        """A large way for this log [rad] (`Extent`)."""
        return self._extent.reach

    @property
    def driven(self) -> bool:
        """Whether any of the records is driven; otherwise the log is one of free swings."""
        return any(r.driven for r in self.records)

    @property
    def readings(self) -> int:
        """The number of readings."""
        return int(np.count_nonzero(self.weight))

    def reads(self, channel: int) -> bool:
        """Whether most instants that have a reading have one of this channel; a known start alone is not enough."""
        read = self.weight > 0.0
        return bool(np.mean(read[np.any(read, axis=1), channel]) > 0.5)

    @cached_property
    def smoothed(self) -> Array:
        """States (M, 2) of the smoothest motion that follows the readings, without any model of the machine."""
        return np.concatenate([smooth_states(r, self.sensor, self.reach) for r in self.records])

    def extent(self, model: Model, kind: type[Effect] | None = None) -> Extent:
        """The extent of the log, which probes of an effect depend on. Its u_max is the drive's largest torque, or, for
        input effects, the largest command."""
        extent = self._extent._replace(inertia=float(model.inertia()))
        if model.actuator is None or (kind is not None and issubclass(kind, InputEffect)):
            return extent
        theta, theta_dot = self.smoothed.T
        torque = model.torque(theta, theta_dot, self.drives(model)[:, 0])
        return extent._replace(u_max=float(np.max(np.abs(torque[self.follows]))))

    def drives(self, model: Model) -> Array:
        """The model's drive torques (M, S) [N m] in the S substeps of the interval after each instant."""
        if not model.input_effects:
            return np.repeat(self.commands[:, None], model.integrator.substeps, axis=1)
        drives = np.zeros((len(self), model.integrator.substeps))
        for (past, length), alike in self._alike.items():
            torques = model.drive_record(np.array([self.records[i].commands for i in alike]))
            drives[self.first[alike][:, None] + np.arange(length)] = torques[:, past:]
        return drives

    @cached_property
    def _alike(self) -> dict[tuple[int, int], list[int]]:
        """The numbers of the records with as many commands before them and as many of their own: of a log that gaps cut
        into hundreds of pieces, most are alike."""
        alike = defaultdict[tuple[int, int], list[int]](list)
        for i, record in enumerate(self.records):
            alike[len(record.previous_commands), len(record)].append(i)
        return alike

    def follow_smoothed(self, effects: Sequence[DynamicEffect]) -> Array:
        """The states (V, M, n) of V effects of one kind along the smoothed readings, computed once and kept."""
        rows = np.array([[float(p.value) for p in e.parameters.values()] for e in effects])
        key = (effects[0].name, rows.tobytes())
        if key not in self._followed:
            self._followed[key] = self._follow(effects[0], rows)
        return self._followed[key]

    def _follow(self, effect: DynamicEffect, rows: Array) -> Array:
        """The states (V, M, n) for the numbers `rows` (V, P), beginning each record at rest."""
        theta, theta_dot = self.smoothed.T
        stretches = np.column_stack([theta_dot[:-1], theta_dot[1:], np.diff(theta)])
        followed = np.zeros((len(rows), len(self), len(effect.start_sd)))
        for first, last in pairwise(self.first.tolist()):
            inputs, count = stretches[first : last - 1].T, last - first - 1
            key = effect.name, count
            if key not in self._followers:
                self._followers[key] = _follower(effect, self.dt).mapaccum(count)
            along = self._followers[key]
            for states, numbers in zip(followed, rows, strict=True):
                states[first + 1 : last] = along(0, inputs, casadi.repmat(casadi.DM(numbers), 1, count)).full().T
        return followed

    def read(self, model: Model, x: Array) -> Array:
        """Readings (..., M, 2) of perfect sensors along states x (..., M, 2)."""
        if not model.output_effects:
            return x
        seen = np.empty_like(x)
        lengths = np.diff(self.first)
        for length in np.unique(lengths).tolist():  # a sensor with memory goes step by step, so all records go together
            rows = self.first[:-1][lengths == length][:, None] + np.arange(length)
            t = np.broadcast_to(self.time_since_start[rows], x[..., rows, 0].shape)
            seen[..., rows, :] = np.stack(model.read_record(x[..., rows, 0], x[..., rows, 1], t), axis=-1)
        return seen


def _follower(effect: DynamicEffect, dt: float) -> casadi.Function:
    """The function (states, [speed before, speed after, travel], the effect's numbers) -> the states after dt."""
    names = tuple(effect.parameters)
    states, stretch = casadi.SX.sym("states", len(effect.start_sd)), casadi.SX.sym("stretch", 3)
    numbers = casadi.SX.sym("numbers", len(names))
    symbolic = effect.with_parameters(dict(zip(names, casadi.vertsplit(numbers), strict=True)))
    *_, after = symbolic.follow(tuple(casadi.vertsplit(states)), Stretch(dt, *casadi.vertsplit(stretch)))
    return casadi.Function("follow", [states, stretch, numbers], [casadi.vertcat(*after)])


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion that a model is linearised about.

    x (M, 2)            states of the joint
    d (M,)              random acceleration [rad/s^2]
    spread (M, 3 + q)   uncertainty of each, in rad, rad/s, rad/s^2 and the units of `inner`: half widths of the slopes
    inner (M, q)        states of dynamic effects; the q `owners` are the effects' names
    """

    x: Array
    d: Array
    spread: Array
    inner: Array = field(default_factory=lambda: np.zeros((0, 0)))
    owners: tuple[str, ...] = ()

    def of_model(self, samples: Samples, model: Model) -> Motion:
        """The motion with the states of this model's dynamic effects; a new effect's follow the smoothed readings."""
        owners = tuple(e.name for e in model.dynamic_effects for _ in e.start_sd)
        if owners == self.owners and len(self.inner) == len(samples):
            return self
        columns, spread = [np.zeros((len(samples), 0))], [self.spread[:, :3]]
        for e in model.dynamic_effects:
            at = [i for i, name in enumerate(self.owners) if name == e.name]
            if at:
                columns.append(self.inner[:, at])
                spread.append(self.spread[:, [3 + i for i in at]])
            else:
                columns.append(samples.follow_smoothed([e])[0])
                spread.append(np.tile(SMOOTHED_SHARE * np.array(e.start_sd), (len(samples), 1)))
        return Motion(self.x, self.d, np.hstack(spread), np.hstack(columns), owners)

    def moved(self, z: Array, spread: Array) -> Motion:
        """The motion after the smoothed deviation z (M, N) is added to it."""
        return Motion(self.x + z[:, :2], z[:, 2], spread, self.inner + z[:, 4 : 4 + self.inner.shape[1]], self.owners)


class LinearisedModel:
    """A model linearised along a motion through the samples of a log.

    Slopes are central differences as wide as the state is uncertain. At a point, a joint that sticks has a slope of
    zero, and a filter that believed in it would never let the joint go. One call of the model makes all differences.
    """

    def __init__(self, samples: Samples, model: Model, motion: Motion) -> None:
        motion = motion.of_model(samples, model)
        self.samples, self.model, self.motion = samples, model, motion
        self.drives, self.seen = samples.drives(model), samples.read(model, motion.x)
        size = motion.spread.shape[1]
        h = np.maximum(motion.spread, samples.reach * np.array([1e-7, *[1e-6] * (size - 1)]))
        rows = np.zeros((1 + 2 * size, len(samples), size))
        for i in range(size):
            rows[1 + 2 * i, :, i], rows[2 + 2 * i, :, i] = h[:, i], -h[:, i]
        ends = self._ends(model, self.drives, motion.inner, rows)
        self.ends = ends[0]
        A = np.stack([(ends[1 + 2 * i] - ends[2 + 2 * i]) / (2.0 * h[:, i, None]) for i in range(size)], axis=2)
        next_states = np.roll(np.hstack([motion.x, motion.inner]), -1, axis=0)
        gap = self.ends - A[:, :, 2] * motion.d[:, None] - next_states
        A[~samples.follows], gap[~samples.follows] = 0.0, 0.0
        self.ahead = (0, 0)
        H, r = self._readings()
        channel = samples.error_channel
        self.system = LinearSystem(
            A, gap, H, r, samples.weight[:, channel], samples.follows, samples.dt, model.inner_sd, samples.reach,
            channel,
        )  # fmt: skip
        # the first readings of a sensor with memory show what was before the record: the model cannot use them
        self.unused = samples.readings - int(np.count_nonzero(np.any(H != 0.0, axis=2)))

    def _ends(self, model: Model, drives: Array, inner: Array, shift: Array | None = None) -> Array:
        """The states (..., M, n) one step after the motion, or after the motion moved by `shift` (..., M, n + 1).

        For V variants, the model holds arrays (V, 1), and the drives (V, M, S) and the states of dynamic effects,
        `inner` (V, M, q), have a row for each.
        """
        theta, theta_dot, d = self.motion.x[:, 0], self.motion.x[:, 1], self.motion.d
        if shift is not None:
            theta, theta_dot, d = theta + shift[..., 0], theta_dot + shift[..., 1], d + shift[..., 2]
            inner = inner + shift[..., 3:]
        values = iter(np.moveaxis(inner, -1, 0))
        states = tuple(tuple(next(values) for _ in e.start_sd) for e in model.dynamic_effects)
        torques = tuple(drives[..., j] for j in range(drives.shape[-1]))
        t, push = self.samples.time_since_start, model.inertia() * d
        *ends, after = model.move_with_inner(theta, theta_dot, states, torques, t, push)
        return np.stack(np.broadcast_arrays(*ends, *(value for values in after for value in values)), axis=-1)

    def changes(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Derivatives by P parameters: G (M, n, P) of the steps' ends, R (M, 2, P) of the readings in the sensor's sd.

        The random acceleration d is held, not the random torque, so that its distribution is the same for any inertia.
        A number whose small change does nothing is changed by more (WIDER).
        """
        parameters, P = self.model.parameters, len(names)
        if not P:
            M = len(self.samples)
            return np.zeros((M, len(self.system.moving), 0)), np.zeros((M, 2, 0))
        value = np.array([float(parameters[n].value) for n in names])
        low, high = np.array([parameters[n].bounds for n in names]).T
        h = 1e-6 * np.where(low > 0.0, value, np.maximum(np.abs(value), 1e-2 * np.minimum(high - low, 1.0)))
        ends, seen, told = np.empty((P, *self.ends.shape)), np.empty((P, *self.seen.shape)), np.zeros(P, dtype=bool)
        for wider in (1.0, *WIDER):
            step = np.where(value + wider * h <= high, wider * h, -wider * h)
            row, size = np.flatnonzero(~told), step[~told, None, None]
            changed = self._variants(self.model, (value + np.diag(step))[row], names, self.motion.inner)
            ends[row], seen[row] = (changed[0] - self.ends) / size, (changed[1] - self.seen) / size
            told[row] = np.any(ends[row] * self.samples.follows[:, None], (1, 2)) | np.any(seen[row], (1, 2))
            if np.all(told):
                break
        return self._as_changes(ends, seen)

    def effect_changes(self, effects: Sequence[Effect], sizes: Sequence[float]) -> tuple[Array, Array]:
        """G and R as in `changes`, with a column for each of several effects of one kind, per size from neutral."""
        torques = [e for e in effects if isinstance(e, JointEffect) and float(e.inertia()) == 0.0]
        if len(torques) == len(effects):
            return self._torque_changes(torques, sizes)
        model = self.model.with_effect(effects[0])
        keys = model.names_of(effects[0].name)
        rows = np.array([[float(p.value) for p in e.parameters.values()] for e in effects])
        dynamic = [e for e in effects if isinstance(e, DynamicEffect)]
        inner = self.motion.inner
        if dynamic:
            new = self.samples.follow_smoothed(dynamic)
            inner = np.concatenate([np.broadcast_to(inner, (*new.shape[:-1], inner.shape[-1])), new], axis=-1)
        ends, seen = self._variants(model, rows, keys, inner)
        size = np.asarray(sizes)[:, None, None]
        return self._as_changes((ends[..., : self.ends.shape[-1]] - self.ends) / size, (seen - self.seen) / size)

    def _torque_changes(self, effects: Sequence[JointEffect], sizes: Sequence[float]) -> tuple[Array, Array]:
        """G and R of effects that are torques s along the motion; u is the share of an interval that has passed.

            dtheta' = B_theta mean 2 (1 - u) s,   dtheta_dot' = B_theta_dot mean s

        B is the slope of a step's end with respect to a torque held over the interval.
        """
        parameters, V, M = effects[0].parameters, len(effects), len(self.samples)
        rows = np.array([[float(p.value) for p in e.parameters.values()] for e in effects])
        # a shape is repeated in as many rows as the effect has magnitudes: what it alone determines is evaluated once
        shared = math.gcd(V, sum(p.neutral is not None for p in parameters.values()))
        columns = np.moveaxis(rows.reshape(V // shared, shared, 1, -1), -1, 0)
        once = [column[:, :1] if np.all(column == column[:, :1]) else column for column in columns]
        effect = effects[0].with_parameters(dict(zip(parameters, once, strict=True)))
        early, held = np.zeros((V // shared, shared, M)), np.zeros((V // shared, shared, M))
        for joint, left in self._within:
            torque = effect.torque(joint) / len(self._within)
            early += 2.0 * left * torque
            held += torque
        B = self.system.A[:, :, 2] / self.model.inertia() / np.asarray(sizes)[:, None, None]
        early, held = early.reshape(V, M, 1), held.reshape(V, M, 1)
        ends = np.concatenate([B[..., :1] * early, B[..., 1:] * held], axis=2)
        return self._as_changes(ends, np.broadcast_to(0.0, (V, M, 2)))

    @cached_property
    def middle(self) -> Array:
        """States (M, 2) in the middle of the interval after each instant."""
        x = self.motion.x
        return np.where(self.samples.follows[:, None], 0.5 * (x + np.roll(x, -1, axis=0)), x)

    @cached_property
    def drive_torques(self) -> Array:
        """Torques of the drive (M, S) [N m]; where commands are no torques, an actuator turns them into torques."""
        theta, theta_dot = self.middle.T[:, :, None]
        return np.broadcast_to(self.model.torque(theta, theta_dot, self.drives), self.drives.shape)

    def moving_joint(self, model: Model) -> Joint:
        """The joint of a model in the middle of those K intervals (K, S) in which it moves and a torque is commanded;
        K = 0 for a servo, which is commanded a position."""
        theta, theta_dot = self.middle.T
        at = self.samples.follows & (np.abs(theta_dot) > slow_speed([theta_dot])) & (self.samples.commands != 0.0)
        if model.at_angle:
            at[:] = False
        t = self.samples.time_since_start[at, None]
        return model.joint(theta[at, None], theta_dot[at, None], t, self.drives[at])

    @cached_property
    def _within(self) -> list[tuple[Joint, float]]:
        """The joint at the nodes of a Gauss quadrature over the interval, with the share of the interval that is left
        there: one node in every substep, or two if there is only one substep."""
        model, samples, substeps = self.model, self.samples, self.drives.shape[-1]
        (theta, theta_dot), d = self.motion.x.T, self.motion.d
        gained, push, nodes = self.ends[:, 1] - theta_dot, model.inertia() * d, []
        places = (0.5,) if substeps > 1 else (0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0))
        for k, drive in enumerate(self.drives.T):
            for place in places:
                u = (k + place) / substeps
                t = u * samples.dt
                travelled = t * (theta_dot + 0.5 * u * gained)
                node = (theta + travelled, theta_dot + u * gained, samples.time_since_start + t, drive, push)
                nodes.append((model.joint(*node), 1.0 - u))
        return nodes

    def _variants(self, model: Model, rows: Array, names: Sequence[str], inner: Array) -> tuple[Array, Array]:
        """Steps' ends (V, M, n) and readings (V, M, 2) of V variants of a model with the numbers `rows` (V, P)."""

        def variant(row: Array) -> Model:
            return model.with_numbers(names, row.tolist())

        driven, shown = (
            self._differ(model, rows, names, effects) for effects in (model.input_effects, model.output_effects)
        )
        drives = self.drives
        if np.any(driven):
            drives = np.stack(
                [self.samples.drives(variant(row)) if d else drives for row, d in zip(rows, driven, strict=True)]
            )
        ends = self._ends(model.with_numbers(names, rows.T[..., None]), drives, inner)
        seen = [
            self.samples.read(variant(row), self.motion.x) if s else self.seen
            for row, s in zip(rows, shown, strict=True)
        ]
        return np.broadcast_to(ends, (len(rows), *ends.shape[-2:])), np.stack(seen)

    def _differ(self, model: Model, rows: Array, names: Sequence[str], effects: Sequence[Effect]) -> NDArray[np.bool_]:
        """Which of the variants (V,) have other numbers of some `effects` than the model that is linearised."""
        known, differ = self.model.parameters, np.zeros(len(rows), dtype=bool)
        of_effects = {n for e in effects for n in model.names_of(e.name)}
        for name, column in zip(names, rows.T, strict=True):
            if name in of_effects:
                differ |= column != float(known[name].value) if name in known else True
        return differ

    def _as_changes(self, ends: Array, seen: Array) -> tuple[Array, Array]:
        G = np.moveaxis(ends * self.samples.follows[:, None], 0, -1)
        if not np.any(seen):
            return G, np.moveaxis(seen, 0, -1)
        return G, self._moved_ahead(np.moveaxis(seen, 0, -1) * self.samples.weight[:, :, None])

    def _readings(self) -> tuple[Array, Array]:
        """Slopes H (M, 2, 2) of the readings and residuals r (M, 2), in units of the sensor's sd.

        A sensor with memory is late: each reading is moved to the instant that it shows, and a change of the speed is
        taken to have changed all angles before it, too.
        """
        samples, model, x = self.samples, self.model, self.motion.x
        residual = (samples.y - self.seen) * samples.weight
        if not model.output_effects:
            return np.eye(2) * samples.weight[:, :, None], residual
        h, t = 1e-6 * samples.reach, samples.t - samples.t[0]
        one, zero = np.ones_like(t), np.zeros_like(t)
        shifts = np.stack([np.column_stack(v) for v in ((one, zero), (t, one), (0.5 * t * t, t))])
        shown = samples.read(model, np.concatenate([x + h * shifts, x - h * shifts]))
        moved = (shown[:3] - shown[3:]) / (2.0 * h)
        H = np.stack([moved[0], moved[1] - moved[0] * t[:, None]], axis=2)
        steady = moved[2][:, 1] / np.where(H[:, 1, 1] == 0.0, 1.0, H[:, 1, 1])  # a gain of the speed is not late
        late = np.median(np.column_stack([-H[:, 0, 1], t - steady]), axis=0)
        self.ahead = (max(0, round(float(late[0]) / samples.dt)), max(0, round(float(late[1]) / samples.dt)))
        H, residual = self._moved_ahead(H * samples.weight[:, :, None]), self._moved_ahead(residual)
        H[:, 0, 1] += self.ahead[0] * samples.dt * H[:, 0, 0]
        return H, residual

    def _moved_ahead(self, values: Array) -> Array:
        """Values (M, 2, ...) of readings, moved to the instants that they show; 0 where a record has none."""
        moved, M = values.copy(), len(values)
        for channel, by in enumerate(self.ahead):
            if by:
                source = np.minimum(np.arange(M) + by, M - 1)
                same = (self.samples.number[source] == self.samples.number) & (np.arange(M) + by < M)
                moved[:, channel] = np.where(same.reshape(-1, *[1] * (values.ndim - 2)), values[source, channel], 0.0)
        return moved


def smoothed_motion(samples: Samples, size: float) -> Motion:
    """The smoothed readings as a motion with d = 0; `size` [rad/s^2] is the uncertainty of d."""
    M = len(samples)
    return Motion(samples.smoothed, np.zeros(M), np.tile([1e-3 * samples.reach, 0.05 * samples.reach, size], (M, 1)))


def level(samples: Samples) -> float:
    """The RMS acceleration of the smoothed readings [rad/s^2], to which s is compared."""
    change = np.diff(samples.smoothed[:, 1])[samples.follows[:-1]] / samples.dt
    return max(float(np.sqrt(np.mean(change**2))), 1e-9) if len(change) else math.nan
