"""Contacts: stretches in which something outside the machine acted, such as a hand, or readings were lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record
from sysid.data.splitting import leave_out
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import shown_extent
from sysid.estimation.torque_regression import slow_speed
from sysid.physics.ops import Array

EXTREME = 6.0
"""An extreme torque differs from the expected one by so many times the median difference: four sd of a Gaussian."""
SHORTEST_CONTACT = 0.2
"""A torque that acts for less than this time [s] is a vibration and no hand."""
LEAST_ENERGY = 0.6
"""All contacts of a log hold at least this share of the missing torque's energy."""
MOST_TIME = 0.15
"""They take at most this share of the time."""
LEAST_ENERGY_AGAIN = 0.4
"""LEAST_ENERGY in a log of which contacts are left out already: lighter pushes show then."""
SLIGHT = 0.05
"""Least peak of a contact, as a share of the largest torque that the log shows."""
LEAST_WORK = 0.2
"""Least work of a push on a free swing, as a share of the largest kinetic energy within WORK_TIME."""
WORK_TIME = 1.0
"""Seconds before and after a stretch."""
MOST_JUMPS = 2
"""So many stretches of a free swing may do less work: readings jump once or twice, and more is what the model lacks."""
OUTSIDE = "a hand's push, or lost readings"
"""What may have acted in a contact, in words."""
HELD_SPEED = 0.02
"""Share of the RMS speed below which friction holds a joint; one that a hand holds still moves a little."""
LARGEST_COMMAND = 5.0
"""Mean square of the commands in contacts, over that of the log, from which the drive is the cause, and no hand."""
LEAST_STEP = 0.1
"""A command steps, or ramps, if it changes by this share of its range within STEP_TIME."""
STEP_TIME = 0.1
"""Time [s] in which a step is over."""
SOON = 0.25
"""Time [s] within which the effect of a command's step begins to show, in a torque that is smoothed over 0.4 s."""
LEAST_CHANCE = 0.05
"""Probability that by chance so many contacts begin with steps of the command, below which the drive is the cause."""
SHORTEST_OBSERVED = 8.0
"""Length [s] of a log from which it shows what is rare."""
_NEIGHBOURS = 25
"""Nearest samples at other times whose median torque is the expected one."""
_APART = 0.5
"""Samples within this time [s] of each other belong to one motion; a state comes back only if it is met outside it."""


@dataclass(frozen=True)
class Contact:
    """A stretch of the record `name`, t_begin to t_end [s], in which an unexplained torque peaks at `peak` [unit]."""

    name: str
    t_begin: float
    t_end: float
    peak: float
    unit: str = "N m"

    def __str__(self) -> str:
        return f"{self.name}, {self.t_begin:.1f}-{self.t_end:.1f} s ({self.peak:+.2g} {self.unit})"


def contacts_sentence(contacts: Sequence[Contact]) -> str:
    """A sentence that something outside the joint acted in these stretches."""
    return f"No state of the joint explains {'; '.join(map(str, contacts))}: {OUTSIDE}, perhaps."


def without_contacts(records: Sequence[Record], contacts: Sequence[Contact]) -> tuple[Record, ...]:
    """The records without the contacts (`leave_out`)."""
    return leave_out(records, [(c.name, c.t_begin, c.t_end) for c in contacts])


def find_contacts(fit: Fit, torque: Array, least: float = 0.0, again: bool = False) -> tuple[Contact, ...]:
    """Find the stretches in which a missing torque (M,) [N m], made `slow`, is extreme for the state of the joint.

    A model that misses something everywhere leaves extremes, too, though nobody touched the machine. The extremes
    therefore have to hold most of the missing torque's energy, in a small part of the time; less of it is enough if
    contacts were left out already (`again`). They must not come with the largest commands or with steps of the command.
    Nothing counts that is below `least` [N m], slight beside the torques of the log, or friction of a standing joint;
    nor, of more than two stretches of a free swing, what hardly changes its energy.
    """
    samples = fit.samples
    if len(samples) * samples.dt < SHORTEST_OBSERVED:
        return ()
    known = np.where(samples.follows, torque, np.nan)
    contacts = [c for c in _extremes(fit, known, least) if not _is_friction(fit, known, _within(samples, c))]
    felt = SLIGHT * shown_extent(samples, fit.model).u_max
    if not samples.driven and sum(abs(c.peak) > felt for c in contacts) > MOST_JUMPS:
        contacts = [c for c in contacts if _works(fit, known, c)]
    inside = np.any([np.zeros(len(samples), dtype=bool), *(_within(samples, c) for c in contacts)], axis=0)
    energy = float(np.nansum(known**2))
    held = float(np.nansum(known[inside] ** 2))
    share = LEAST_ENERGY_AGAIN if again else LEAST_ENERGY
    rare = held > share * energy > 0.0 and np.mean(inside) < MOST_TIME
    if not rare or _commanded(fit, known, contacts, inside):
        return ()
    return tuple(contact for contact in contacts if abs(contact.peak) > felt)


def _within(samples: Samples, contact: Contact) -> NDArray[np.bool_]:
    """Which of the samples (M,) a stretch holds. Records of the same name are pieces of one, apart in time."""
    named = np.array([r.name == contact.name for r in samples.records])[samples.number]
    return named & (samples.t >= contact.t_begin) & (samples.t <= contact.t_end)


def _is_friction(fit: Fit, torque: Array, inside: NDArray[np.bool_]) -> bool:
    """Whether the joint stands for most of a stretch while the missing torque opposes the drive. That is dry friction,
    and the joint's state does not tell how large it is."""
    theta_dot, drive = fit.motion.x[:, 1], np.mean(fit.linearised.drive_torques, axis=1)
    held = (np.abs(theta_dot) < slow_speed([theta_dot], HELD_SPEED)) & (torque * drive < 0.0)
    return float(np.mean(held[inside])) > 0.5


def _works(fit: Fit, torque: Array, contact: Contact) -> bool:
    """Whether a torque does work in a stretch, by LEAST_WORK of the kinetic energy near it."""
    samples, theta_dot = fit.samples, fit.motion.x[:, 1]
    near = replace(contact, t_begin=contact.t_begin - WORK_TIME, t_end=contact.t_end + WORK_TIME)
    inside, energy = _within(samples, contact), 0.5 * fit.inertia * np.max(theta_dot[_within(samples, near)] ** 2)
    return bool(abs(np.nansum((torque * theta_dot)[inside])) * samples.dt > LEAST_WORK * energy)


def _commanded(fit: Fit, torque: Array, contacts: Sequence[Contact], inside: NDArray[np.bool_]) -> bool:
    """Whether the drive is the cause: the stretches come with steps of the command more often than by chance, or the
    command is much larger inside than on average (a commanded angle has no such size)."""
    samples = fit.samples
    command = np.full(len(inside), np.nan)
    command[samples.follows] = np.concatenate([r.u for r in samples.records])
    if _with_steps(samples, command, torque, contacts):
        return True
    if fit.model.at_angle:
        return False
    square = np.nan_to_num(command) ** 2
    return bool(np.mean(square[inside]) > LARGEST_COMMAND * np.mean(square))


def _with_steps(samples: Samples, command: Array, torque: Array, contacts: Sequence[Contact]) -> bool:
    """Whether stretches begin near a step of the command (M,), or peak soon after one, more often than by chance.

        sum_(i >= k) C(n, i) p^i (1 - p)^(n - i) < 0.05,   k of n stretches do, as does a share p of the log's time

    A later step does not count, since it may be a controller's answer to a push.
    """
    width, soon = (max(1, round(seconds / samples.dt)) for seconds in (STEP_TIME, SOON))
    changes = np.abs(command[width:] - command[:-width]) > LEAST_STEP * np.ptp(command[samples.follows])
    steps = np.zeros(len(command), dtype=bool)
    steps[width:] = changes & (samples.number[width:] == samples.number[:-width])
    near = np.convolve(steps, np.ones(2 * soon + 1), "same") > 0.5
    after = np.convolve(steps, np.ones(soon + 1))[: len(steps)] > 0.5
    spans = [np.flatnonzero(_within(samples, c)) for c in contacts]
    begins = np.array([span[0] for span in spans])
    peaks = np.array([span[np.nanargmax(np.abs(torque[span]))] for span in spans])
    by_chance = near | np.roll(after, -round(float(np.mean(peaks - begins))))
    n, k, p = len(contacts), int(np.sum(near[begins] | after[peaks])), float(np.mean(by_chance[samples.follows]))
    return sum(math.comb(n, i) * p**i * (1.0 - p) ** (n - i) for i in range(k, n + 1)) < LEAST_CHANCE


def _extremes(fit: Fit, torque: Array, least: float) -> tuple[Contact, ...]:
    """Stretches in which a torque is extreme compared to what acts in the same state at other times.

    A magnet acts whenever the joint passes its angle, and friction at every speed; a hand acts only once. The expected
    torque is therefore the median at other times, at the nearest states, angles or speeds. A torque is extreme if it
    differs from all three by more than EXTREME times the median difference, by more than the median torque and by more
    than `least` [N m], and if it is rare: beyond twice the 90 % quantile.
    """
    samples = fit.samples
    at = np.flatnonzero(np.isfinite(torque))[:: max(1, round(0.25 * SHORTEST_CONTACT / samples.dt))]
    if len(at) < _NEIGHBOURS:
        return ()
    record, t, states, d = samples.number[at], samples.t[at], fit.motion.x[at], torque[at]
    instants = t + record * (np.max(t) - np.min(t) + 2.0 * _APART)
    angle = np.column_stack([np.cos(states[:, 0]), np.sin(states[:, 0])])
    speed = states[:, 1:] / (np.std(states[:, 1]) or 1.0)
    expected = np.stack([_elsewhere(points, instants, d) for points in (np.hstack([angle, speed]), angle, speed)])
    size = np.min(np.abs(d - expected), axis=0)
    limit = max(EXTREME * float(np.median(size)), float(np.nanmedian(np.abs(torque))), least)
    rare = np.abs(d) > 2.0 * np.quantile(np.abs(d), 0.9)
    alone = np.flatnonzero((size > limit) & rare)
    contacts, unit = [], fit.model.plant.unit("N m")
    for low, high in _stretches(alone, size > 0.25 * limit, record):
        stretch = d[low : high + 1]
        peak = float(stretch[np.argmax(np.abs(stretch))])
        name = samples.records[record[low]].name
        contacts.append(Contact(name, float(t[low]), float(t[high]) + 0.25 * SHORTEST_CONTACT, peak, unit))
    return tuple(contacts)


def slow(d: Array, record: NDArray[np.intp], dt: float) -> Array:
    """A torque d (M,) averaged under a Hann window of 0.4 s, to remove what is faster than a hand; nan where the window
    would reach beyond the record."""
    half = max(1, round(SHORTEST_CONTACT / dt))
    window = np.hanning(2 * half + 1)
    smooth = np.full_like(d, np.nan)
    for i in range(int(record[-1]) + 1):
        rows = np.flatnonzero(record == i)
        if len(rows) > 2 * half:
            smooth[rows[half:-half]] = np.convolve(d[rows], window / window.sum(), "valid")
    return smooth


def _elsewhere(points: Array, instants: Array, d: Array) -> Array:
    """For each point (M, n), the median d of the nearest points at other times; 0 if there is none."""
    from scipy.spatial import cKDTree

    width = int(2.0 * _APART / (0.25 * SHORTEST_CONTACT)) + 2
    reach = min(len(d), _NEIGHBOURS + width)
    _, near = cKDTree(points).query(points, k=reach)
    other = np.abs(instants[near] - instants[:, None]) > _APART
    other &= np.cumsum(other, axis=1) <= _NEIGHBOURS
    values = np.where(other, d[near], np.nan)
    values[~other.any(axis=1), 0] = 0.0
    return np.nanmedian(values, axis=1)


def _stretches(alone: NDArray[np.intp], wide: NDArray[np.bool_], record: NDArray[np.intp]) -> list[tuple[int, int]]:
    """The first and the last sample of each contact: from the extremes `alone`, widened as long as `wide` holds."""
    spans: list[tuple[int, int]] = []
    for k in alone.tolist():
        if spans and k <= spans[-1][1]:
            continue
        low = high = k
        while low > 0 and wide[low - 1] and record[low - 1] == record[k]:
            low -= 1
        while high < len(wide) - 1 and wide[high + 1] and record[high + 1] == record[k]:
            high += 1
        spans.append((low, high))
    return spans
