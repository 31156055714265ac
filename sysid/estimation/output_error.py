"""Output error: a model's trajectories over windows of a log, whitened residuals and their exact derivatives.

CasADi rolls the step of one control interval over a window. Beside the state it carries the sensitivity
S = dx / dx_0 to the window's initial state:

    x' = f(x),    S' = (df / dx) S,    S_0 = I

Cost and memory therefore grow linearly with the samples, and a new model compiles in hundredths of a second.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeAlias

import casadi
import numpy as np
from numpy.typing import NDArray

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel, Samples, level, smoothed_motion
from sysid.estimation.windows import Window
from sysid.physics.effects import InputEffect, OutputEffect
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.parameters import Parametric

Index = NDArray[np.intp]
CHANNELS = ("theta", "theta_dot")

Among: TypeAlias = Index | slice
"""A choice of windows: their indices, or ALL."""
ALL = slice(None)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals and derivatives of a model from window starts (K, 2), with R = 2 (L + 1) readings a window.

    e (K, R)            readings less model, whitened; 0 where nothing was read
    S_x (K, R, 2)       derivative of the model's whitened readings with respect to the window's start
    states (K, L+1, 2)  the model's trajectory
    """

    e: Array
    S_x: Array
    states: Array


class Response:
    """A model on K windows of a log, with the initial states (K, 2) as the only unknowns; or K models that differ in
    their numbers alone, one for each window.

    States of dynamic effects begin each window where a Kalman smoother over the whole log finds them.
    """

    def __init__(self, model: Model | Sequence[Model], samples: Samples, windows: Sequence[Window]) -> None:
        self.samples, self.windows = samples, tuple(windows)
        of_windows = (model,) * len(self.windows) if isinstance(model, Model) else model
        self.models = tuple({id(m): m for m in of_windows}.values())
        self.model, number = self.models[0], {id(m): i for i, m in enumerate(self.models)}
        self._model_of = np.array([number[id(m)] for m in of_windows], dtype=np.intp)
        self.length = max(w.count for w in self.windows)
        self._gather()

    def _gather(self) -> None:
        """Set readings and weights 1/sd, padded to (K, 2, L+1), and the index in the whole log of each interval."""
        K, L = len(self.windows), self.length
        records = self.samples.records
        first = np.concatenate([[0], np.cumsum([len(r) for r in records])])
        self.interval = np.full((K, L), first[-1], dtype=np.intp)  # padding: one interval beyond the end
        self.time, self.time_since_start = np.zeros((K, L + 1)), np.zeros((K, L + 1))
        self.y, self.weight = np.zeros((K, 2, L + 1)), np.zeros((K, 2, L + 1))
        read = [self.samples.sensor.readings(r) for r in records]
        for i, w in enumerate(self.windows):
            record, begin, count, lead = w.record, w.begin, w.count, w.lead
            self.interval[i, :count] = first[record] + begin + np.arange(count)
            since = self.model.dt * (begin + np.arange(L + 1))
            self.time[i], self.time_since_start[i] = (
                records[record].t[0] + since,
                records[record].time_since_start[0] + since,
            )
            values, sds = read[record]
            self.y[i, :, : count + 1] = values[begin : begin + count + 1].T
            self.weight[i, :, lead : count + 1] = 1.0 / sds[begin + lead : begin + count + 1].T
            if begin + count < len(records[record]):
                self.weight[i, :, count] = 0.0  # that instant is the next window's first, and counts there

    @cached_property
    def _first(self) -> Index:
        """The instants (K,) of the whole log at which the windows begin."""
        return np.array([int(self.samples.first[w.record]) + w.begin for w in self.windows], dtype=np.intp)

    @cached_property
    def starts(self) -> Array:
        """States (K, 2) at which a refit begins: the smoothed readings at the windows' first instants."""
        return self.samples.smoothed[self._first]

    @cached_property
    def _inner(self) -> Array:
        """States (K, n - 2) of the dynamic effects at the windows' first instants."""
        if not self.model.dynamic_effects:
            return np.empty((len(self.windows), 0))
        size, states = level(self.samples), []
        for model in self.models:
            linearised = LinearisedModel(self.samples, model, smoothed_motion(self.samples, size))
            states.append(linearised.motion.inner + linearised.system.filter(Disturbances(0.3 * size)).smooth()[:, 4:])
        return np.array(states)[self._model_of, self._first]

    @cached_property
    def commands(self) -> Array:
        """The commands of the whole log (N,)."""
        return np.concatenate([r.u for r in self.samples.records])

    @cached_property
    def drives(self) -> Array:
        """Drive torques (V, N + 1, S) of the whole log; the last row is padding. V is 1 for models without input
        effects, else the number of models."""
        models = self.models if self.model.input_effects else self.models[:1]
        torques = np.array([self.samples.drives(model)[self.samples.follows] for model in models])
        return np.pad(torques, [(0, 0), (0, 1), (0, 0)])

    # motion --------------------------------------------------------------------------------------------------

    @cached_property
    def _step(self) -> _Step:
        moving = (self.model.plant, *(e for e in self.model.effects if not isinstance(e, InputEffect | OutputEffect)))
        settings = (self.model.integrator, self.model.dt)
        return _compiled(_Structure((*settings, *(_without_numbers(part) for part in moving)), self.model))

    def _inputs(self, among: Among) -> tuple[Array, Array, Array]:
        """The inputs of a mapped step beside states, a row for each interval: drive torques, time, model's numbers."""
        interval, time = self.interval[among], self.time_since_start[among, : self.length]
        of = self._model_of[among]
        numbers = np.array([model.numbers(self._step.names) for model in self.models])[of]
        drives = self.drives[of[:, None] if len(self.drives) > 1 else 0, interval]
        return drives.reshape(interval.size, -1), time.reshape(-1, 1), np.repeat(numbers, self.length, axis=0)

    def _rolled(self, step: casadi.Function, first: Array, among: Among) -> Array:
        """The values (K, L+1, V) that a step, rolled over windows, makes of their first values (K, V)."""
        roll = _rolling(step, self.length).map(len(first))
        rest = evaluate_mapped(roll, first, *self._inputs(among)).reshape(len(first), self.length, -1)
        return np.concatenate([first[:, None], rest], axis=1)

    def states(self, starts: Array) -> Array:
        """States (K, L+1, 2) of all windows from their starts (K, 2)."""
        return self._rolled(self._step.end, np.hstack([starts, self._inner]), ALL)[..., :2]

    # readings ------------------------------------------------------------------------------------------------

    def readings(self, states: Array, among: Among = ALL) -> Array:
        """Readings (..., K, 2, L+1) of perfect sensors along states (..., K, L+1, 2) of windows."""
        if not self.model.output_effects:
            return np.swapaxes(states, -1, -2)
        t, read = np.broadcast_to(self.time_since_start[among], states.shape[:-1]), np.swapaxes(states, -1, -2).copy()
        for number, model in enumerate(self.models):
            at = self._model_of[among] == number
            theta, theta_dot = np.moveaxis(states[..., at, :, :], -1, 0)
            read[..., at, :, :] = np.stack(model.read_record(theta, theta_dot, t[..., at, :]), axis=-2)
        return read

    def _reading_slopes(self, states: Array, Z: Array, among: Among) -> Array:
        """Derivatives (K, 2, L+1, Q) of the readings along Q directions Z (K, L+1, 2, Q) of the states.

        They are central differences along each direction, which a sensor with a long memory makes no costlier.
        """
        if not self.model.output_effects:
            return np.swapaxes(Z, 1, 2)
        h, size = 1e-6 * self.samples.reach, np.maximum(np.max(np.abs(Z), axis=(0, 1, 2)), 1.0)
        direction = np.moveaxis(Z / size, -1, 0)
        up, down = (self.readings(states + s * direction, among) for s in (h, -h))
        return np.moveaxis((up - down) / (2.0 * h), 0, -1) * size

    # all together --------------------------------------------------------------------------------------------

    def linearise(self, starts: Array, among: Among = ALL) -> Linearisation:
        """Residuals and derivatives at the starts (K, 2) of windows."""
        K, first = len(starts), np.hstack([starts, self._inner[among]])
        n = first.shape[1]
        moved = self._rolled(self._step.both, np.hstack([first, np.tile(np.eye(2, n).ravel(), (K, 1))]), among)
        states, S = moved[..., :2], moved[..., n:].reshape(K, -1, 2, n)[..., :2].swapaxes(2, 3)
        e = (self.y[among] - self.readings(states, among)) * self.weight[among]
        S_x = self._reading_slopes(states, S, among) * self.weight[among][..., None]
        return Linearisation(e.reshape(K, -1), S_x.reshape(K, -1, 2), states)


class _Step(NamedTuple):
    """The compiled step of models that differ in the numbers `names` alone: `end` maps (x, drives, t, numbers) to x',
    where x includes states of dynamic effects; `both` does so for x with the two columns of S below it."""

    names: tuple[str, ...]
    end: casadi.Function
    both: casadi.Function


@dataclass(frozen=True)
class _Structure:
    """A model without its numbers, as a key under which its compiled step is kept, and one such model."""

    parts: tuple[Hashable, ...]
    model: Model = field(compare=False)


def _without_numbers(part: Parametric) -> Hashable:
    """The type and the settings of a plant or an effect, without its numbers."""
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    kept = {name: value for name, value in values.items() if name != "bounds" and name not in part.parameters}
    return type(part), *((name, _hashable(value)) for name, value in kept.items())


def _hashable(value: object) -> Hashable:
    """The value, or its id if it cannot be hashed (a tuple of arrays only claims to be hashable). The model that is
    kept beside the key keeps the object alive, so that its id stays its own."""
    try:
        hash(value)
    except TypeError:
        return id(value)
    return value


@lru_cache(maxsize=64)
def _compiled(structure: _Structure) -> _Step:
    """The compiled step for all models of a structure. It is kept, since compiling takes as long as using it."""
    model = structure.model
    sizes = [len(e.start_sd) for e in model.dynamic_effects]
    passive = {e.name for e in (*model.input_effects, *model.output_effects)}
    names = tuple(name for name, p in model.parameters.items() if p.owner not in passive)
    x, t = casadi.SX.sym("x", 2 + sum(sizes)), casadi.SX.sym("t")
    drives, numbers = casadi.SX.sym("drives", model.integrator.substeps), casadi.SX.sym("numbers", len(names))
    theta, theta_dot, *values = casadi.vertsplit(x)
    rest = iter(values)
    inner = tuple(tuple(next(rest) for _ in range(size)) for size in sizes)
    model = model.with_numbers(names, casadi.vertsplit(numbers))
    *moved, inner_then = model.move_with_inner(theta, theta_dot, inner, tuple(casadi.vertsplit(drives)), t)
    after = casadi.densify(casadi.vertcat(*moved, *(value for states in inner_then for value in states)))
    S, others = casadi.SX.sym("S", after.size1(), 2), [drives, t, numbers]
    end = casadi.Function("step", [x, *others], [after], {"cse": True})
    inputs, outputs = casadi.vertcat(x, casadi.vec(S)), casadi.vertcat(after, casadi.vec(casadi.jtimes(after, x, S)))
    return _Step(names, end, casadi.Function("both", [inputs, *others], [casadi.densify(outputs)], {"cse": True}))


@lru_cache(maxsize=64)
def _rolling(step: casadi.Function, length: int) -> casadi.Function:
    """A step rolled over so many intervals. It is kept, since making it takes as long as using it."""
    return step.mapaccum(length)


def evaluate_mapped(function: casadi.Function, *inputs: Array) -> Array:
    """Evaluate a mapped CasADi function of one output; each row of an array is a column for CasADi.

    CasADi stores matrices by column and NumPy by row, so that its buffer reads and writes the arrays in place. An
    ordinary call would convert them, which costs half as much again as the computation.
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
