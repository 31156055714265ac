"""Sensors: the noise of readings, and simulated readings that have it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid.data.jitter import speed_about
from sysid.data.record import Record
from sysid.errors import InvalidInput, check_kind, is_real
from sysid.limits import check_range
from sysid.physics.ops import Array
from sysid.physics.simulate import Trajectory

UNITS = {"theta": "rad", "theta_dot": "rad/s"}
"""The units of the channels for a plant that turns; `Plant.unit` translates them for another."""


@dataclass(frozen=True)
class Sensor:
    """The noise of the sensors: the standard deviation of each channel's readings; None where it is not measured.

    Attributes
    ----------
    theta : float or None
        Of the angle [rad], or of the start angle where a record has only that.
    theta_dot : float or None
        Of the speed [rad/s].
    jitter : float
        Of the stamps [s]: an angle was read that much earlier or later, which is an error of theta_dot times that.

    Raises
    ------
    InvalidInput
        Where a sd is not positive, or is out of all proportion, or no channel is left.
    """

    theta: float | None = None
    theta_dot: float | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for name in UNITS:
            sd = getattr(self, name)
            if sd is not None and not (is_real(sd) and sd > 0.0 and math.isfinite(sd)):
                raise InvalidInput(f"sensor sd of {name} is {sd!r}: expected a positive number, or None (not measured)")
            if sd is not None:
                check_range(f"sensor sd of {name} is", sd)
        if not (is_real(self.jitter) and self.jitter >= 0.0 and math.isfinite(self.jitter)):
            raise InvalidInput(f"the sensor's jitter is {self.jitter!r} s: expected zero or more")
        if self.theta is None and self.theta_dot is None:
            raise InvalidInput("the sensor measures nothing: give the sd of theta, of theta_dot or of both")

    def measure(self, trajectory: Trajectory, rng: np.random.Generator) -> list[Record]:
        """Simulate readings of a trajectory, with independent Gaussian errors; one record for each rollout."""
        t, sds = trajectory.t, (self.theta, self.theta_dot)
        rows = (a.reshape(-1, a.shape[-1]) for a in (trajectory.u, trajectory.theta_read, trajectory.theta_dot_read))
        records = []
        for i, (u, *truth) in enumerate(zip(*rows, strict=True)):
            angle, speed = (
                None if sd is None else y + sd * rng.standard_normal(len(t)) for sd, y in zip(sds, truth, strict=True)
            )
            if self.jitter and angle is not None:
                angle += self.jitter * truth[1] * rng.standard_normal(len(t))
            records.append(Record(t, u, angle, speed, name=f"rollout {i}"))
        return records

    def readings(self, record: Record) -> tuple[Array, Array]:
        """The readings (N+1, 2) of theta and theta_dot, and the sd of each; inf where nothing was read.

        Raises InvalidInput where the record lacks a channel that has a sd.
        """
        values, sds = np.zeros((len(record) + 1, 2)), np.full((len(record) + 1, 2), math.inf)
        for column, channel in enumerate(UNITS):
            sd, value = getattr(self, channel), getattr(record, channel)
            if sd is None:
                continue
            if value is None:
                raise InvalidInput(f"{record.name} has no {channel} readings, but the sensor gives them a sd of {sd:g}")
            values[: len(value), column], sds[: len(value), column] = value, sd
            if self.jitter and channel == "theta" and record.has_angles:
                sds[:, column] = np.hypot(sd, self.jitter * speed_about(value, record.dt))
        return values, sds


def check_sensor(sensor: Sensor) -> None:
    """Raise InvalidInput for what is no Sensor, such as a number or all of the noise that `sensor_noise` finds."""
    check_kind("sensor", sensor, Sensor, "a Sensor, such as Sensor(theta=0.003) or sensor_noise(records).sensor")
