"""What a model answers to a log: trajectories, whitened residuals and their exact derivatives, window by window.

A window is a stretch of a record with an initial state of its own; a whole rollout is the longest one. One CasADi
Function per control interval is mapped over all samples at once; the chain rule over time is a linear recursion in
NumPy. So cost and memory grow linearly with the samples, and a new model compiles in hundredths of a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record, check_records
from sysid.data.sensor import Sensor
from sysid.estimation.windows import Window
from sysid.physics.model import Model
from sysid.physics.ops import Array

Index = NDArray[np.intp]
CHANNELS = ("theta", "theta_dot")


class Motion(NamedTuple):
    """What a model does on a log: drive torques (N + 1, S) of the whole log, states (K, L+1, 2) of all windows, and
    the whitened residuals e (K, R)."""

    drives: Array
    states: Array
    e: Array


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A model on a log at parameters p (P,) and window starts (K, 2), with R = 2 (L + 1) readings a window.

    e (K, R)          readings less model, whitened; 0 where nothing was read
    S_x (K, R, 2)     derivative of the model's whitened readings with respect to the window's start
    S_p (K, R, P)     and to the parameters
    states (K, L+1, 2)
    """

    e: Array
    S_x: Array
    S_p: Array
    states: Array


class Response:
    """A model whose parameters `names` are free, on the windows of a log; the other parameters keep their numbers."""

    def __init__(
        self, model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor, windows: Sequence[Window]
    ) -> None:
        self.model, self.names, self.sensor = model, tuple(names), sensor
        self.records = check_records(model, records)
        self.windows = tuple(windows)
        self.length = max(w.count for w in self.windows)
        inputs = {n for e in model.input_effects for n in model.names_of(e.name)}
        self.shaping = tuple(i for i, n in enumerate(self.names) if n in inputs)
        self._gather()

    def _gather(self) -> None:
        """Padded readings (K, 2, L+1) with weights 1/sd, and where each window's intervals lie in the whole log."""
        K, L = len(self.windows), self.length
        first = np.concatenate([[0], np.cumsum([len(r) for r in self.records])])
        self.interval = np.full((K, L), first[-1], dtype=np.intp)  # padding: one interval beyond the end
        self.time, self.time_since_start = np.zeros((K, L + 1)), np.zeros((K, L + 1))
        self.y, self.weight = np.zeros((K, 2, L + 1)), np.zeros((K, 2, L + 1))
        targets = [_targets(r, self.sensor) for r in self.records]
        for i, w in enumerate(self.windows):
            record, begin, count, lead = w.record, w.begin, w.count, w.lead
            self.interval[i, :count] = first[record] + begin + np.arange(count)
            since = self.model.dt * (begin + np.arange(L + 1))
            self.time[i], self.time_since_start[i] = (
                self.records[record].t[0] + since,
                self.records[record].time_since_start[0] + since,
            )
            value, weight = targets[record]
            self.y[i, :, : count + 1] = value[:, begin : begin + count + 1]
            self.weight[i, :, lead : count + 1] = weight[:, begin + lead : begin + count + 1]
            if begin + count < len(self.records[record]):
                self.weight[i, :, count] = 0.0  # that instant is the next window's first
        self.n_readings = np.count_nonzero(self.weight, axis=(0, 2))

    @cached_property
    def starts(self) -> Array:
        """States (K, 2) to begin a fit with: smoothed readings at the windows' first instants."""
        from sysid.estimation.smoothed_start import smooth_states

        smooth = [smooth_states(r, self.sensor) for r in self.records]
        return np.array([smooth[w.record][w.begin] for w in self.windows])

    # input path ----------------------------------------------------------------------------------------------

    @cached_property
    def commands(self) -> Array:
        """The commands of the whole log (N,)."""
        return np.concatenate([r.u for r in self.records])

    def drives(self, p: Array) -> Array:
        """Drive torques (N + 1, S) of the whole log; the last row pads."""
        return np.concatenate([self._driven(p), np.zeros((1, self.model.integrator.substeps))])

    def drive_slopes(self, p: Array, drives: Array) -> Array:
        """Derivatives (N + 1, S, P) of the drive torques, which are `drives` at p.

        Differences to the side that the bounds leave open: a delay moves the torque piecewise linearly, a lag
        smoothly, and neither needs more.
        """
        slopes = np.zeros((*drives.shape, len(self.names)))
        known = self.model.parameters
        for i in self.shaping:
            low, high = known[self.names[i]].bounds
            h = 1e-6 * max(min(high - low, 1.0), 1e-3)
            h = -h if p[i] + h > high else h
            moved = p.copy()
            moved[i] += h
            slopes[:-1, :, i] = (self._driven(moved) - drives[:-1]) / h
        return slopes

    def _driven(self, p: Array) -> Array:
        if not self.model.input_effects:
            return np.repeat(self.commands[:, None], self.model.integrator.substeps, axis=1)
        model = self.model.with_parameters(dict(zip(self.names, p.tolist(), strict=True)))
        drives = np.empty((len(self.commands), self.model.integrator.substeps))
        for at, past in self._equally_long:
            commands = np.concatenate([past, self.commands[at]], axis=1)
            drives[at] = model.drive_record(commands)[:, past.shape[1] :]
        return drives

    @cached_property
    def _equally_long(self) -> list[tuple[Index, Array]]:
        """Places (K, N) in the whole log of the K records of each length N, and the commands (K, M) before them."""
        first = np.concatenate([[0], np.cumsum([len(r) for r in self.records])])
        alike: dict[tuple[int, int], list[tuple[int, Array]]] = {}
        for begin, record in zip(first.tolist(), self.records, strict=False):
            alike.setdefault((len(record), len(record.previous_commands)), []).append((begin, record.previous_commands))
        return [
            (np.add.outer([begin for begin, _ in own], np.arange(N)), np.array([past for _, past in own]))
            for (N, _), own in alike.items()
        ]

    def _symbolic(self, p: casadi.SX) -> Model:
        return self.model.with_parameters(dict(zip(self.names, casadi.vertsplit(p), strict=True)))

    # motion --------------------------------------------------------------------------------------------------

    @cached_property
    def _step(self) -> tuple[casadi.Function, casadi.Function]:
        """(x, p, drives, t) -> x', and -> the columns of d x' / d (x, p, drives)."""
        P, S = len(self.names), self.model.integrator.substeps
        x, p, drives = casadi.SX.sym("x", 2), casadi.SX.sym("p", P), casadi.SX.sym("drives", S)
        t = casadi.SX.sym("t")
        after = casadi.densify(casadi.vertcat(*self._symbolic(p).move(x[0], x[1], tuple(casadi.vertsplit(drives)), t)))
        slope = casadi.densify(casadi.jacobian(after, casadi.vertcat(x, p, drives)))
        inputs = [x, p, drives, t]
        return (
            casadi.Function("step", inputs, [after], {"cse": True}),
            casadi.Function("slope", inputs, [casadi.vec(slope)], {"cse": True}),
        )

    @cached_property
    def _roll(self) -> casadi.Function:
        return self._step[0].mapaccum(self.length).map(len(self.windows))

    @cached_property
    def _tangent(self) -> casadi.Function:
        return self._step[1].map(len(self.windows) * self.length)

    def states(self, p: Array, starts: Array, drives: Array) -> Array:
        """States (K, L+1, 2) of all windows from their starts (K, 2)."""
        K, L = len(self.windows), self.length
        states = np.empty((K, L + 1, 2))
        states[:, 0] = starts
        states[:, 1:] = evaluate(self._roll, *self._inputs(p, starts, drives)).reshape(K, L, 2)
        return states

    def slopes(self, p: Array, states: Array, drives: Array) -> tuple[Array, Array]:
        """One-step derivatives A (K, L, 2, 2) with respect to the state and G (K, L, 2, P) to the parameters."""
        K, L, P = len(self.windows), self.length, len(self.names)
        out = evaluate(self._tangent, *self._inputs(p, states[:, :L].reshape(K * L, 2), drives))
        columns = out.reshape(K, L, -1, 2).transpose(0, 1, 3, 2)
        A, G, B = columns[..., :2], columns[..., 2 : 2 + P].copy(), columns[..., 2 + P :]
        if self.shaping:
            slopes = self.drive_slopes(p, drives)
            for i in self.shaping:
                G[..., i] += np.einsum("klxs,kls->klx", B, slopes[self.interval, :, i])
        return A, G

    def _inputs(self, p: Array, x: Array, drives: Array) -> tuple[Array, Array, Array, Array]:
        """What a mapped step takes, a row an interval, but states x as they are."""
        K, L = len(self.windows), self.length
        held, clock = drives[self.interval].reshape(K * L, -1), self.time_since_start[:, :L].reshape(-1, 1)
        return x, np.repeat(p[None], K * L, axis=0), held, clock

    # readings ------------------------------------------------------------------------------------------------

    def readings(self, p: Array, states: Array) -> Array:
        """What perfect sensors show (..., K, 2, L+1) along states (..., K, L+1, 2) at parameters p (P,)."""
        if not self.model.output_effects:
            return np.swapaxes(states, -1, -2)
        model = self.model.with_parameters(dict(zip(self.names, p.tolist(), strict=True)))
        reading = model.read_record(
            states[..., 0], states[..., 1], np.broadcast_to(self.time_since_start, states.shape[:-1])
        )
        return np.stack(reading, axis=-2)

    def reading_slopes(self, p: Array, states: Array, Z: Array, own: Array) -> Array:
        """Derivatives (K, 2, L+1, Q) of the readings along Q directions: Z (K, L+1, 2, Q) of states, own (Q, P) of p.

        Central differences along each direction: a sensor's memory may be long, its derivative is not.
        """
        if not self.model.output_effects:
            return np.swapaxes(Z, 1, 2)
        h, size = 1e-6, np.maximum(np.max(np.abs(Z), axis=(0, 1, 2)), 1.0)
        direction = np.moveaxis(Z / size, -1, 0)
        seen = np.empty((len(own), *np.swapaxes(states, 1, 2).shape))
        # readings depend on the parameters of the sensors alone, and the states do not depend on those
        sensing = {n for e in self.model.output_effects for n in self.model.names_of(e.name)}
        still = ~np.any(own * np.array([n in sensing for n in self.names], dtype=float), axis=1)
        if np.any(still):
            up, down = (self.readings(p, states + s * direction[still]) for s in (h, -h))
            seen[still] = (up - down) / (2.0 * h)
        for i in np.flatnonzero(~still):
            step = h * own[i] / size[i]
            up, down = (self.readings(self._inside(p + s * step), states) for s in (1.0, -1.0))
            moved = np.linalg.norm(self._inside(p + step) - self._inside(p - step)) / np.linalg.norm(step)
            seen[i] = (up - down) / (moved * h)
        slopes: Array = np.moveaxis(seen, 0, -1) * size
        return slopes

    def _inside(self, p: Array) -> Array:
        """p within the bounds of its parameters."""
        known = self.model.parameters
        low, high = np.array([known[n].bounds for n in self.names]).T
        return np.clip(p, low, high)

    # all together --------------------------------------------------------------------------------------------

    def motion(self, p: Array, starts: Array) -> Motion:
        """What the model does at parameters p (P,) from window starts (K, 2), and how far the log is from it."""
        drives = self.drives(p)
        states = self.states(p, starts, drives)
        e = (self.y - self.readings(p, states)) * self.weight
        return Motion(drives, states, e.reshape(len(self.windows), -1))

    def residual(self, p: Array, starts: Array) -> Array:
        """Whitened residuals (K, R) alone."""
        return self.motion(p, starts).e

    def linearise(self, p: Array, starts: Array, motion: Motion | None = None) -> Linearisation:
        """Residuals and derivatives at parameters p (P,), window starts (K, 2) and, where it is known, their motion."""
        drives, states, e = self.motion(p, starts) if motion is None else motion
        A, G = self.slopes(p, states, drives)
        Z = propagate(A, G)
        own = np.concatenate([np.zeros((2, len(p))), np.eye(len(p))])
        S = self.reading_slopes(p, states, Z, own) * self.weight[..., None]
        S = S.reshape(len(self.windows), -1, S.shape[-1])
        return Linearisation(e, S[..., :2], S[..., 2:], states)


def evaluate(function: casadi.Function, *inputs: Array) -> Array:
    """The one output of a mapped function, a row a column of CasADi's; so are the inputs.

    CasADi keeps columns together as NumPy does rows: its buffer reads and writes the arrays in place, without the
    matrices and lists of a call, which cost half as much again as the computation.
    """
    buffer, run = function.buffer()
    rows = [np.ascontiguousarray(value, dtype=float) for value in inputs]
    for i, value in enumerate(rows):
        if value.size:
            buffer.set_arg(i, value.data)
    out = np.empty((function.size2_out(0), function.size1_out(0)))
    buffer.set_res(0, out.data)
    run()
    return out


def propagate(A: Array, G: Array, initial: bool = True) -> Array:
    """Z (K, L+1, 2, 2 + Q): derivatives of the states with respect to a window's start and to Q parameters.

        Z_(k+1) = A_k Z_k + [0, G_k],   Z_0 = [I, 0]

    A (K, L, 2, 2), G (K, L, 2, Q). Long windows are cut into blocks that run side by side and are then chained.
    Without `initial` the columns of the start are left out: Z (K, L+1, 2, Q).
    """
    K, L, _, Q = G.shape
    B = L if K * 8 > L else max(16, math.isqrt(L))
    blocks = -(-L // B)
    pad = blocks * B - L
    A = np.concatenate([A, np.broadcast_to(np.eye(2), (K, pad, 2, 2))], axis=1).reshape(K, blocks, B, 2, 2)
    G = np.concatenate([G, np.zeros((K, pad, 2, Q))], axis=1).reshape(K, blocks, B, 2, Q)
    first = 2 if initial or blocks > 1 else 0
    Z = np.zeros((K, blocks, B + 1, 2, first + Q))
    if first:
        Z[:, :, 0, 0, 0] = Z[:, :, 0, 1, 1] = 1.0
    for b in range(B):
        z, a = Z[:, :, b], A[:, :, b]
        Z[:, :, b + 1] = a[..., :1] * z[:, :, :1] + a[..., 1:] * z[:, :, 1:]
        Z[:, :, b + 1, :, first:] += G[:, :, b]
    if blocks > 1:
        start = Z[:, 0, -1]
        for i in range(1, blocks):
            own = Z[:, i].copy()
            phi = own[..., :2]
            Z[:, i] = phi[..., :1] * start[:, None, :1] + phi[..., 1:] * start[:, None, 1:]
            Z[:, i, :, :, 2:] += own[..., 2:]
            start = Z[:, i, -1]
    out = np.concatenate([Z[:, :, :-1].reshape(K, blocks * B, 2, -1), Z[:, -1:, -1]], axis=1)[:, : L + 1]
    return out if initial else out[..., first:]


def _targets(record: Record, sensor: Sensor) -> tuple[Array, Array]:
    """Readings (2, n + 1) and their weights 1 / sd, 0 where nothing was read."""
    value, weight = np.zeros((2, len(record) + 1)), np.zeros((2, len(record) + 1))
    for reading in sensor.readings(record):
        row = CHANNELS.index(reading.channel)
        value[row, reading.index], weight[row, reading.index] = reading.value, 1.0 / reading.sd
    return value, weight
