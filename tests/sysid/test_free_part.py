"""Laws of the free part: of a free swing is read what no hand holds, and what is free throughout is read whole."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest

from sysid import Coulomb, Drag, Effect, GeneralJoint, Model, Record, Viscous, diagnose, read, simulate
from sysid.data.free_part import free_part
from sysid.data.record import write_csv

DT = 0.01
PERIOD = 2.0 * math.pi * math.sqrt(0.1 / 2.0)
"""Of small swings."""


@lru_cache
def swing(theta: float, theta_dot: float = 0.0, push: float = 0.0, seconds: float = 20.0) -> np.ndarray:
    """Angles (N+1,) of a pendulum that hangs at pi, by default let go from theta, and hit there for a fifth of a second
    where it is pushed."""
    joint = Model(GeneralJoint(J=0.1, G=2.0), effects=(Coulomb(tau_c=0.02), Viscous(b=0.01)), dt=DT)
    u = np.zeros((1, round(seconds / DT)))
    u[0, :20] = push
    return np.asarray(simulate(joint, u, np.array([theta]), np.array([theta_dot])).theta[0])


def logged(theta: np.ndarray, seed: int = 0, noise: float = 1e-3) -> Record:
    """The angles as a log without a torque."""
    read_ = theta + noise * np.random.default_rng(seed).standard_normal(len(theta))
    return Record(DT * np.arange(len(theta)), np.zeros(len(theta) - 1), read_, name="swing")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", (1e-4, 1e-3, 1e-2))
def test_what_swings_from_the_first_sample_on_is_read_whole(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    theta = swing(math.pi + rng.uniform(0.3, 2.5) * rng.choice([-1.0, 1.0]), rng.uniform(-3.0, 3.0))
    record = logged(theta, seed, noise)
    assert free_part(record) == (record, "")


@pytest.mark.parametrize("noise", (1e-4, 3e-3))
def test_a_rest_much_longer_than_the_swing_is_shortened_and_a_shorter_one_is_not(noise: float) -> None:
    theta = swing(math.pi + 1.0)
    stands = np.flatnonzero(np.abs(theta - theta[-1]) > 0.02)[-1] * DT
    for rest, shortened in ((1.5 * stands, False), (10.0 * stands, True)):
        whole = logged(np.concatenate([theta, np.full(round(rest / DT), theta[-1])]), noise=noise)
        record, said = free_part(whole)
        assert (len(record) < len(whole)) == shortened
        assert ("it is a long rest" in said) == shortened and "hand" not in said
        assert record.t[0] == 0.0 and stands < 0.8 * record.t[-1]


def held(seconds: float, away: float = 1.0) -> np.ndarray:
    """A swing before which a hand holds the pendulum."""
    free = swing(math.pi + away)
    return np.concatenate([np.full(round(seconds / DT), free[0]), free])


@pytest.mark.parametrize("seconds", (0.1, 1.0, 4.0))
@pytest.mark.parametrize("away", (-1.0, 0.4, 2.0))
def test_what_is_held_at_first_is_read_from_where_it_is_let_go(seconds: float, away: float) -> None:
    record, said = free_part(logged(held(seconds, away)))
    assert seconds < record.t[0] < seconds + 0.5 * PERIOD
    assert said.startswith(f"swing: the first {record.t[0]:.3g} s are left out")
    assert len(record.previous_commands) > 0, "no torque acted before, which is known"


def test_what_a_hand_lifts_and_what_trembles_in_it_is_left_out() -> None:
    free, rng = swing(math.pi + 1.0), np.random.default_rng(0)
    lifted = math.pi + np.concatenate([np.zeros(150), np.linspace(0.0, 1.0, 130), np.ones(80)])
    lifted[150:] += 0.02 * np.convolve(rng.standard_normal(len(lifted) - 120), np.ones(31) / math.sqrt(31.0), "valid")
    record, _ = free_part(logged(np.concatenate([lifted, free])))
    assert 3.6 < record.t[0] < 3.6 + 0.5 * PERIOD


def test_what_is_hit_while_it_hangs_is_read_from_the_first_swing_on() -> None:
    record, _ = free_part(logged(np.concatenate([np.full(400, math.pi), swing(math.pi, push=1.5)])))
    assert 4.2 < record.t[0] < 4.2 + 0.5 * PERIOD


def test_swings_before_a_stronger_push_are_kept() -> None:
    record = logged(np.concatenate([swing(math.pi + 0.5, seconds=6.0), swing(math.pi, push=2.5)]))
    assert free_part(record) == (record, "")


@pytest.mark.parametrize("lost", (0.15, -0.12))
@pytest.mark.parametrize("theta", (0.8, 2.2))
def test_a_first_swing_in_which_time_is_lost_is_left_out(theta: float, lost: float) -> None:
    """A logger that stops for a moment, or a hand that leads the pendulum, bends the first period by a sixth."""
    angle = swing(math.pi + theta)
    at, change = round(0.9 * PERIOD / DT), round(lost * PERIOD / DT)
    bent = np.concatenate([angle[:at], np.full(max(change, 0), angle[at]), angle[at + max(-change, 0) :]])
    record, said = free_part(logged(bent, noise=3e-4))
    assert 0.9 * PERIOD < record.t[0] < 2.0 * PERIOD
    assert "in another time than later" in said


def caught(seconds: float, stands: float) -> np.ndarray:
    """A swing that a hand stops within a tenth of a second, and holds."""
    free = swing(math.pi + 1.0, seconds=seconds)
    slower = 1.0 - np.exp(-np.arange(DT, stands, DT) / 0.05)
    return np.concatenate([free, free[-1] + (free[-1] - free[-2]) / DT * 0.05 * slower])


@pytest.mark.parametrize("seconds", (4.0, 5.8, 6.0, 6.3, 8.05))
@pytest.mark.parametrize("stands", (2.0, 10.0))
def test_what_a_hand_catches_is_read_until_then(seconds: float, stands: float) -> None:
    record, said = free_part(logged(caught(seconds, stands)))
    assert seconds - 0.75 * PERIOD < record.t[-1] <= seconds
    assert f"what comes after {record.t[-1]:.4g} s is left out" in said


def test_both_ends_are_told_in_one_sentence() -> None:
    _, said = free_part(logged(np.concatenate([np.full(400, math.pi + 1.0), caught(12.0, 3.0)])))
    cut = "the first 4.28 s and what comes after 15.56 s are left out"
    assert said == f"swing: {cut}: without a torque a hand holds or moves it there"


@pytest.mark.parametrize("friction", (Coulomb(tau_c=0.2), Coulomb(tau_c=0.03), Viscous(b=0.2), Drag(c=0.05)))
def test_what_comes_to_rest_by_itself_is_read_until_it_stands(friction: Effect) -> None:
    joint = Model(GeneralJoint(J=0.1, G=2.0), friction, dt=DT)
    starts = math.pi + np.linspace(0.3, 2.0, 9)
    for theta in np.asarray(simulate(joint, np.zeros((9, 2500)), starts, np.zeros(9)).theta):
        record, said = free_part(logged(theta))
        assert record.t[0] == 0.0 and "hand" not in said
        assert np.ptp(theta[len(record) :]) < 0.02 * np.ptp(theta)


def test_what_stands_until_its_drive_moves_it_is_read_whole() -> None:
    theta = np.concatenate([np.full(200, math.pi + 1.0), swing(math.pi + 1.0)])
    still = logged(theta)
    driven = Record(still.t, np.where(still.t[:-1] < 1.9, 0.0, 0.1), still.theta, name="driven")
    assert free_part(driven) == (driven, "")


def test_logs_without_angles_and_without_motion_are_read_whole() -> None:
    t = DT * np.arange(101)
    for record in (Record(t, np.zeros(100), None, t), Record(t, np.zeros(100), np.ones(101))):
        assert free_part(record) == (record, "")


@pytest.mark.long
@pytest.mark.parametrize(("made", "seconds"), [(held, (0.1,)), (held, (4.0,)), (caught, (12.0, 3.0))])
def test_a_diagnosis_is_not_bent_by_a_hand(made, seconds, tmp_path) -> None:
    """Both frictions are named, with their numbers, of a log that a hand had part in."""
    write_csv(logged(made(*seconds)), tmp_path / "swing.csv")
    log = read(tmp_path / "swing.csv", thin=False)
    assert any("a hand holds or moves it there" in note for note in log.notes)
    diagnosis = diagnose(Model(GeneralJoint(), dt=log.dt), log, parameters=("G",))
    assert {step.effect for step in diagnosis.steps} == {"coulomb", "viscous"}
    assert diagnosis.estimate.values["coulomb.tau_c"] == pytest.approx(0.02, rel=0.02)
    assert diagnosis.estimate.values["viscous.b"] == pytest.approx(0.01, rel=0.02)
