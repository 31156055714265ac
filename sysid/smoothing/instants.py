"""Instants: a log as one line of instants, and a model's steps and readings along it, linearised."""

from __future__ import annotations

import numpy as np

from sysid.comparison.held_out import error_of, lead_of, refit_windows
from sysid.model import Model
from sysid.records import Array
from sysid.response import Response
from sysid.smoothing.smoother import Chain
from sysid.windows import cut

_NO_PARAMETERS = np.zeros(0)
_SPREAD = (3.0, 30.0)
"""How far a record's first state may lie from where it is thought to be [rad], [rad/s]: anywhere."""


class Instants:
    """The M instants of all records, one record after the other, and what the model says at them.

    drives (M, S) [N m], t (M,) [s], y and weight (M, 2): readings and 1 / sd, 0 where nothing was read; number (M,) of
    the record; follows (M,): whether the next instant belongs to the same record. The last instant of a record has no
    interval after it: whatever is said about that is idle.
    """

    def __init__(self, model: Model, response: Response) -> None:
        self.model, self.response, self.records = model, response, response.records
        counts = np.array([len(r) for r in self.records])
        self.inside = np.arange(response.length + 1) <= counts[:, None]
        beyond = np.full((len(counts), 1), counts.sum())
        rows = np.concatenate([response.interval, beyond], axis=1)[self.inside]
        self.drives = response.drives(_NO_PARAMETERS)[rows]
        self.t, self.clock = response.time[self.inside], response.clock[self.inside]
        self.y, self.weight = (np.swapaxes(v, 1, 2)[self.inside] for v in (response.y, response.weight))
        self.number = np.repeat(np.arange(len(counts)), counts + 1)
        self.follows = np.append(self.number[1:] == self.number[:-1], False)

    @property
    def shortest(self) -> float:
        """The shortest memory of a torque [s] that can be told: a sensor that remembers blurs what is faster."""
        remembers = any(e.rest(0.0, 0.0, self.model.dt) for e in self.model.output_effects)
        return max(2.0 * self.model.dt, 0.2 if remembers else 0.0)

    def windows(self, seconds: float = 1.0) -> tuple[Array, float]:
        """The states x (M, 2) of the model on windows, each begun where it fits best, and the error of these."""
        windows = cut(self.records, seconds, lead_of(self.model))
        fit = refit_windows(self.model, self.records, self.response.sensor, windows)
        x = np.zeros((len(self.t), 2))
        first = np.searchsorted(self.number, np.arange(len(self.records)))
        for window, states in zip(windows, fit.lin.states, strict=True):
            begin, shared = first[window.record] + window.begin, window.shared
            x[begin + shared : begin + window.count + 1] = states[shared : window.count + 1]
        return x, error_of(fit, seconds).ratio

    def residuals(self, x: Array) -> Array:
        """Readings less model along x, in units of the sensor's sd (M, 2)."""
        residuals: Array = (self.y - self._read(x)) * self.weight
        return residuals

    def chain(self, x: Array, d: Array, steps: Array) -> Chain:
        """The model about a motion x (M, 2) under d (M,), sloped over `steps` (M, 3) of theta, theta_dot, d.

        Central differences as wide as the state is uncertain: a joint that sticks has no slope at a point, and a
        filter that believed in none would never let it go.
        """
        z = np.column_stack([x, d])
        A = np.zeros((len(x), 2, 3))
        for i in range(3):
            shift = np.zeros_like(z)
            shift[:, i] = steps[:, i]
            A[:, :, i] = (self._move(z + shift) - self._move(z - shift)) / (2.0 * steps[:, i, None])
        gap = self._move(z) - A[:, :, 2] * d[:, None] - np.roll(x, -1, axis=0)
        A[~self.follows], gap[~self.follows] = 0.0, 0.0
        H, r = self._readings(x)
        return Chain(A, gap, H, r, self.follows, _SPREAD, self.model.dt)

    def motion_torque(self, x: Array, chain: Chain) -> float:
        """RMS of the torque that moves the joint [N m]: the yardstick for d."""
        change = np.diff(x[:, 1])[self.follows[:-1]]
        response = float(np.max(np.abs(chain.A[:, 1, 2])))
        return max(float(np.sqrt(np.mean(change**2))) / max(response, 1e-12), 1e-9)

    def coordinates(self, x: Array) -> dict[str, Array]:
        """Mean theta (its place), theta_dot, drive torque and time of each interval, (M,) each."""
        middle = 0.5 * (x + np.roll(x, -1, axis=0))
        own = {"theta": self.model.plant.place(middle[:, 0]), "theta_dot": middle[:, 1]}
        return own | {"torque": self.drives.mean(axis=1), "time": self.t + 0.5 * self.model.dt}

    def split(self, values: Array) -> list[Array]:
        """By record."""
        return np.split(values, np.flatnonzero(~self.follows)[:-1] + 1)

    def _move(self, z: Array) -> Array:
        drives = tuple((self.drives + z[:, 2:]).T)
        return np.stack(np.broadcast_arrays(*self.model.move(z[:, 0], z[:, 1], drives, self.clock)), axis=1)

    def _readings(self, x: Array) -> tuple[Array, Array]:
        """Slopes H (M, 2, 2) of the readings and residuals r (M, 2), in units of the sensor's sd.

        A sensor remembers: what it shows is moved to the instant that it shows, and a change of speed is taken as one
        of all angles before, too.
        """
        r = self.residuals(x)
        if not self.model.output_effects:
            return np.eye(2) * self.weight[:, :, None], r
        h, t = 1e-6, self.t - self.t[0]
        one, zero = np.ones_like(t), np.zeros_like(t)
        shifts = (np.column_stack(v) for v in ((one, zero), (t, one), (0.5 * t * t, t)))
        moved = [(self._read(x + h * v) - self._read(x - h * v)) / (2.0 * h) for v in shifts]
        H = np.stack([moved[0], moved[1] - moved[0] * t[:, None]], axis=2)
        late = np.median(np.column_stack([-H[:, 0, 1], t - moved[2][:, 1]]), axis=0)
        H, dt = H * self.weight[:, :, None], self.model.dt
        for channel in range(2):
            m = max(0, round(float(late[channel]) / dt))
            source = np.minimum(np.arange(len(t)) + m, len(t) - 1)
            same = (self.number[source] == self.number) & (np.arange(len(t)) + m < len(t))
            H[:, channel], r[:, channel] = H[source, channel] * same[:, None], r[source, channel] * same
            if channel == 0:
                H[:, 0, 1] += m * dt * H[:, 0, 0]
        return H, r

    def _read(self, x: Array) -> Array:
        if not self.model.output_effects:
            return x
        padded = np.zeros((*self.inside.shape, 2))
        padded[self.inside] = x
        return np.asarray(np.swapaxes(self.response.readings(_NO_PARAMETERS, padded), 1, 2)[self.inside])
