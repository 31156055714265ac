"""Residuals of a model on records and their exact derivatives, cut into shooting segments (CasADi).

Each record is cut into segments of `length` control intervals that start at a node x = (theta, theta_dot). One
SX function maps (node, parameters, commands, readings) to the segment's squared residuals, its end state and their
derivatives; it is mapped over all segments of all records.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from sysid.data.record import Record, check_direct, check_records
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.physics.model import Model
from sysid.physics.ops import Array

_LARGEST_GROWTH = 1e5

LONGEST_SEGMENT = 50
"""Control intervals; a longer one only takes longer to compile."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """A linearisation at parameters p (P,) and nodes x (M, 2) of M segments, z = (x, p).

    cost     half the sum of squared, whitened residuals
    end      (M, 2)             state after each segment
    gradient (M, 2 + P)         d cost_i / dz
    end_z    (M, 2, 2 + P)      d end_i / dz
    slope    (M, 2 (L + 1), 2 + P)  d residuals_i / dz, whitened
    squares  (2,)               whitened squares of theta's and of theta_dot's residuals
    """

    cost: float
    end: Array
    gradient: Array
    end_z: Array
    slope: Array
    squares: Array


class Segments:
    """Records cut into segments for a model whose parameters `names` are free; the others keep their numbers.

    Input effects run over the whole record, from rest, before it is cut.
    """

    def __init__(
        self,
        model: Model,
        names: Sequence[str],
        records: Sequence[Record],
        sensor: Sensor,
        length: int,
        functions: tuple[casadi.Function, ...] | None = None,
    ) -> None:
        self.model, self.names, self.sensor = model, tuple(names), sensor
        check_direct(model, "LeastSquares")
        self.records = check_records(model, records)
        self.length = max(1, length)
        self.counts = [math.ceil(len(r) / self.length) for r in self.records]
        self.first = np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(int)
        self.size = int(sum(self.counts))
        inputs = {n for e in model.input_effects for n in model.names_of(e.name)}
        self.shaping = tuple(i for i, n in enumerate(self.names) if n in inputs)
        self.n_readings = np.zeros(2, dtype=int)
        self.value, self.weight = self._targets()
        begins = [float(r.time_since_start[0]) for r in self.records]
        since = [begin + self.length * model.dt * np.arange(c) for begin, c in zip(begins, self.counts, strict=True)]
        self.time = np.concatenate(since)[None, :]
        self.path = self._input_path()
        self.functions = functions or self._segment()
        self.segment, self.slope, self.curvature = (f.map(self.size) for f in self.functions)

    def head(self, n: int) -> Segments:
        """The first n control intervals of every record, cut by the same length."""
        records = [r.head(n) for r in self.records]
        return Segments(self.model, self.names, records, self.sensor, self.length, self.functions)

    @property
    def continued(self) -> Array:
        """(M,) bool: whether a segment is followed by another one of the same record."""
        inner = np.ones(self.size, dtype=bool)
        inner[self.first - 1] = False
        return inner

    def _targets(self) -> tuple[Array, Array]:
        """Reading and weight 1/sd^2 of both channels, each (2 (L + 1), M), theta's rows first."""
        L = self.length
        value, weight = np.zeros((2, L + 1, self.size)), np.zeros((2, L + 1, self.size))
        for record, begin, count in zip(self.records, self.first, self.counts, strict=True):
            n = len(record)
            read, precision = np.zeros((2, n + 1)), np.zeros((2, n + 1))
            for reading in self.sensor.readings(record):
                row = 0 if reading.channel == "theta" else 1
                read[row, reading.index] = reading.value
                precision[row, reading.index] = reading.sd**-2
                self.n_readings[row] += len(reading.index)
            for i in range(count):
                k = np.arange(i * L, min((i + 1) * L, n) + (i == count - 1))
                value[:, : len(k), begin + i] = read[:, k]
                weight[:, : len(k), begin + i] = precision[:, k]
        return value.reshape(-1, self.size), weight.reshape(-1, self.size)

    def _input_path(self) -> casadi.Function:
        """p -> drive torques (S L, M) and their derivatives (S L, M) for each parameter of an input effect."""
        S, L, model = self.model.integrator.substeps, self.length, self.model
        p = casadi.MX.sym("p", len(self.names))
        columns = []
        for record, count in zip(self.records, self.counts, strict=True):
            drive = casadi.repmat(casadi.DM(record.u).T, S, 1)
            if model.input_effects:
                u = casadi.DM(record.commands).T
                drive = self._drive_step().mapaccum(u.numel())(self._rest(), u, p)[1][
                    :, len(record.previous_commands) :
                ]
            padded = casadi.horzcat(drive, casadi.DM.zeros(S, count * L - len(record)))
            columns.append(casadi.reshape(padded, S * L, count))
        drives = casadi.horzcat(*columns)
        slopes = [
            casadi.reshape(casadi.jtimes(casadi.vec(drives), p, _unit(i, len(self.names))), S * L, self.size)
            for i in self.shaping
        ]
        return casadi.Function("path", [p], [casadi.MX(drives), *slopes])

    def _rest(self) -> casadi.DM:
        return casadi.DM([value for memory in self.model.rest(0.0) for value in memory])

    def _drive_step(self) -> casadi.Function:
        """(memory, u, p) -> (memory', drive torques (S,))."""
        sizes = [len(memory) for memory in self.model.rest(0.0)]
        flat, u, p = casadi.SX.sym("memory", sum(sizes)), casadi.SX.sym("u"), casadi.SX.sym("p", len(self.names))
        model = self.model.with_parameters(dict(zip(self.names, casadi.vertsplit(p), strict=True)))
        values = iter(casadi.vertsplit(flat)) if sum(sizes) else iter(())
        memory = tuple(tuple(next(values) for _ in range(size)) for size in sizes)
        drive, after = model.drive(u, memory)
        return casadi.Function(
            "drive", [flat, u, p], [casadi.vertcat(*(v for m in after for v in m)), casadi.vertcat(*drive)]
        )

    def _segment(self) -> tuple[casadi.Function, ...]:
        """One segment: node, p, drives, their slopes, start time, readings, weights -> the parts of Blocks.

        The second function gives Blocks.slope; the third takes two multipliers more and gives the Hessian of
        lam_f cost + lam_g' end.
        """
        S, L, P, dt = self.model.integrator.substeps, self.length, len(self.names), self.model.dt
        x, p, t0 = casadi.SX.sym("x", 2), casadi.SX.sym("p", P), casadi.SX.sym("t0")
        drives = casadi.SX.sym("drives", S * L)
        slopes = [casadi.SX.sym(f"slope{i}", S * L) for i in self.shaping]
        value, weight = casadi.SX.sym("value", 2 * (L + 1)), casadi.SX.sym("weight", 2 * (L + 1))
        # p enters as p + shift with shift = 0, so that d/dshift includes the drive's dependence on p
        shift = casadi.SX.sym("shift", P)
        bent = drives + sum((s * shift[i] for s, i in zip(slopes, self.shaping, strict=True)), casadi.SX(0))
        model = self.model.with_parameters(dict(zip(self.names, casadi.vertsplit(p + shift), strict=True)))
        theta, theta_dot = x[0], x[1]
        angles, speeds = [theta], [theta_dot]
        for k in range(L):
            drive = tuple(bent[k * S + j] for j in range(S))
            theta, theta_dot = model.move(theta, theta_dot, drive, t0 + k * dt)
            angles.append(theta)
            speeds.append(theta_dot)
        residual = casadi.sqrt(weight) * (casadi.vertcat(*angles, *speeds) - value)
        end, z = casadi.vertcat(theta, theta_dot), casadi.vertcat(x, shift)
        cost, slope = 0.5 * casadi.sumsqr(residual), casadi.jacobian(residual, z)
        lam_f, lam_g = casadi.SX.sym("lam_f"), casadi.SX.sym("lam_g", 2)
        hessian, _ = casadi.hessian(lam_f * cost + casadi.dot(lam_g, end), z)
        outputs = [
            cost,
            end,
            casadi.mtimes(slope.T, residual),
            casadi.vec(casadi.densify(casadi.jacobian(end, z))),
            casadi.vertcat(casadi.sumsqr(residual[: L + 1]), casadi.sumsqr(residual[L + 1 :])),
            casadi.vec(casadi.densify(slope)),
            casadi.vec(casadi.densify(hessian)),
        ]
        *outputs, slope, hessian = casadi.substitute(outputs, [shift], [casadi.SX.zeros(P)])
        inputs = [x, p, drives, *slopes, t0, value, weight]
        return (
            casadi.Function("segment", inputs, outputs, {"cse": True}),
            casadi.Function("slope", inputs, [slope], {"cse": True}),
            casadi.Function("curvature", [*inputs, lam_f, lam_g], [hessian], {"cse": True}),
        )

    def _inputs(self, p: casadi.MX, nodes: casadi.MX) -> list[casadi.MX]:
        return [nodes, casadi.repmat(p, 1, self.size), *self.path.call([p]), self.time, self.value, self.weight]

    def symbolic(self, p: casadi.MX, nodes: casadi.MX) -> list[casadi.MX]:
        """The parts of Blocks, one column a segment; matrices are vectorised column by column."""
        return list(self.segment.call(self._inputs(p, nodes)))

    def hessian(self, p: casadi.MX, nodes: casadi.MX, lam_f: casadi.MX, lam_g: casadi.MX) -> casadi.MX:
        """Hessian (vectorised, M) of lam_f cost_i + lam_g_i' end_i, lam_g (2, M); the drive counts as linear in p."""
        return self.curvature.call([*self._inputs(p, nodes), casadi.repmat(lam_f, 1, self.size), lam_g])[0]

    def blocks(self, p: Array, nodes: Array) -> Blocks:
        """The linearisation at parameters p (P,) and nodes (M, 2)."""
        P, M = len(self.names), self.size
        inputs = self._inputs(casadi.DM(p), casadi.DM(nodes.T))
        cost, end, gradient, end_z, squares = (np.asarray(v) for v in self.segment.call(inputs))
        slope = np.asarray(self.slope.call(inputs)[0])
        return Blocks(
            cost=float(np.sum(cost)),
            end=end.T,
            gradient=gradient.T,
            end_z=end_z.T.reshape(M, 2 + P, 2).transpose(0, 2, 1),
            slope=slope.T.reshape(M, 2 + P, 2 * (self.length + 1)).transpose(0, 2, 1),
            squares=np.sum(squares, axis=1),
        )

    def roll(self, p: Array, starts: Array) -> Array:
        """Nodes (M, 2) of whole rollouts from starts (R, 2): each segment begins where the one before ended."""
        nodes = np.zeros((self.size, 2))
        nodes[self.first] = starts
        counts = np.array(self.counts)
        for i in range(1, int(counts.max())):
            end = np.asarray(self.symbolic(casadi.DM(p), casadi.DM(nodes.T))[1]).T
            at = self.first[counts > i] + i
            nodes[at] = end[at - 1]
        return nodes

    def information(self, blocks: Blocks, whole: bool = True) -> Array:
        """Fisher information (P, P) of the parameters, the initial state of every whole record eliminated.

            F = sum_records M_pp - M_px M_xx^-1 M_xp,   M = S' Sigma^-1 S,   S = d(readings) / d(x_0, p)

        S follows the whole rollout; where `whole` is false every segment has a free state of its own instead.
        Where an initial error has grown by more than 10^5, beyond what float64 can cancel, a free state begins
        anew too: that can only understate the information. (Schur complement; e.g. Kay, Estimation Theory, Sec. 3.7.)
        """
        P = len(self.names)
        total = np.zeros((P, P))
        spans = zip(self.first, self.counts, strict=True) if whole else ((i, 1) for i in range(self.size))
        for begin, count in spans:
            samples, rows = np.eye(2 + P), list[Array]()
            for i in range(begin, begin + count):
                if np.linalg.norm(samples[:2, :2], 2) > _LARGEST_GROWTH:
                    total += _without_state(np.concatenate(rows))
                    samples, rows = np.eye(2 + P), []
                rows.append(blocks.slope[i] @ samples)
                samples = np.vstack([blocks.end_z[i] @ samples, samples[2:]])
            total += _without_state(np.concatenate(rows))
        return total


def _without_state(S: Array) -> Array:
    """M_pp - M_px M_xx^-1 M_xp for M = S'S, S (rows, 2 + P): what of the columns of p lies beside those of x.

    From S itself: in M, whose entries are squares, an information that is small beside M_pp would drown.
    """
    S_x = S[:, :2] / np.maximum(np.linalg.norm(S[:, :2], axis=0), 1e-300)
    directions, size, _ = np.linalg.svd(S_x, full_matrices=False)
    directions = directions[:, size > 1e-10]
    beside = S[:, 2:]
    for _ in range(2):  # once more takes out what rounding left
        beside = beside - directions @ (directions.T @ beside)
    information: Array = beside.T @ beside
    return information


def _unit(i: int, n: int) -> casadi.DM:
    unit = casadi.DM.zeros(n)
    unit[i] = 1.0
    return unit


def fisher_information(
    model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor, starts: Array
) -> Array:
    """The information that readings carry about parameters, at the model's own numbers.

    Its inverse is the Cramer-Rao bound of every unbiased estimate; the initial states count as unknown.

    Parameters
    ----------
    model : Model
        The model with its numbers.
    names : sequence of str
        The P parameters.
    records : sequence of Record
        The R rollouts: their commands and which channels are read when.
    sensor : Sensor
        Noise of the readings.
    starts : array (R, 2)
        The initial states, theta [rad] and theta_dot [rad/s].

    Returns
    -------
    array (P, P)
        In inverse squares of the parameters' units.

    Raises
    ------
    InvalidInput
        For an unknown parameter, and for starts of another shape.
    """
    model.check_names(names)
    segments = Segments(model, names, records, sensor, length=max(1, min(LONGEST_SEGMENT, round(1.0 / model.dt))))
    if np.shape(starts) != (len(segments.records), 2):
        raise InvalidInput(
            f"starts has shape {np.shape(starts)}: expected ({len(segments.records)}, 2), theta and theta_dot a record"
        )
    p = np.array([float(model.parameters[n].value) for n in names])
    return segments.information(segments.blocks(p, segments.roll(p, np.asarray(starts, dtype=float))))
