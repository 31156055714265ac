"""A piece of a rollout knows what came before it: the time that went by, and the commands that drives remember."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from sysid import (
    RK4,
    Delay,
    Drift,
    Effect,
    GridSearch,
    InvalidInput,
    Lag,
    LeastSquares,
    Model,
    Record,
    RodPendulum,
    SensorDelay,
    UnscentedKalman,
    diagnose,
    fit,
)
from sysid.data.logs import read
from sysid.data.splitting import split
from sysid.estimation.held_out import held_out_error
from sysid.planning.excitation import steps
from tests.sysid.planted import DT, SENSOR, logs, truth


def rod(*effects: Effect) -> Model:
    return dataclasses.replace(truth(*effects), integrator=RK4(4))


def log(*effects: Effect, n: int = 1, seconds: float = 12.0, seed: int = 1) -> list[Record]:
    return logs(rod(*effects), seed, n, seconds, draw=partial(steps, u_max=2.0, hold=0.4))


def test_a_part_of_a_part_is_a_part() -> None:
    (record,) = log()
    piece = record.part(100, 400).part(50, 120)
    np.testing.assert_array_equal(piece.previous_commands, record.u[:150])
    np.testing.assert_allclose(piece.time_since_start, DT * np.arange(150, 221))
    assert not piece.starts_midway and dataclasses.replace(piece, before=None).starts_midway
    with pytest.raises(InvalidInput, match="before its rollout does"):
        dataclasses.replace(record, origin=1.0)


@pytest.mark.long
@pytest.mark.parametrize("effect", [Delay(T=0.25), Lag(T=0.1), SensorDelay(T=0.15)])
def test_the_true_model_is_as_good_behind_a_cut_as_before_it(effect: Effect) -> None:
    """Windows begin in the middle of a motion, under commands given before the cut."""
    ratios = []
    for seed in range(4):
        held_out = split(log(effect, seed=seed))[1]
        ratios.append(held_out_error(rod(effect), held_out, SENSOR).windows[0].ratio)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize("identifier", ["fit", "least squares", "filter"])
@pytest.mark.parametrize(("effect", "name"), [(Delay(T=0.11), "delay.T"), (Drift(r=0.05), "drift.r")])
def test_what_is_found_in_a_piece_is_what_is_found_in_the_whole(identifier: str, effect: Effect, name: str) -> None:
    """Of any identifier: time counts from where the rollout began, and drives remember."""
    piece = log(effect)[0].part(200, 600)
    start = rod(dataclasses.replace(effect, **{name.split(".")[1]: 0.03}))
    if identifier == "fit":
        estimate = fit(start, [piece], SENSOR, [name])
    else:
        kind = LeastSquares if identifier == "least squares" else UnscentedKalman
        estimate = kind([name], SENSOR).fit(start, [piece])
    assert abs(estimate.values[name] - float(effect.parameters[name.split(".")[1]].value)) < 4.0 * estimate.sd[name]
    assert estimate.noise["theta"] == pytest.approx(SENSOR.theta, rel=0.15)


@pytest.mark.long
def test_the_papers_grid_knows_the_past_too() -> None:
    """One-step errors behind a cut are those of the same instants before it."""
    model, (record,) = rod(Delay(T=0.11)), log(Delay(T=0.11))
    model = dataclasses.replace(model, plant=RodPendulum(m=1.0, l=0.9, bounds={"l": (0.8, 1.0)}))
    whole = GridSearch(["l"], points=5).fit(model, [record])
    halves = GridSearch(["l"], points=5).fit(model, [record.part(0, 300), record.part(300, 600)])
    assert halves.values == whole.values
    assert halves.noise == pytest.approx(whole.noise, rel=1e-9)


@pytest.mark.long
def test_gaps_hide_nothing_of_a_delay(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """The logger paused five times: what the drive did meanwhile no row tells, and nothing is made of it."""
    files = []
    for i, record in enumerate(log(Delay(T=0.1), n=4, seconds=6.0)):
        rows = np.column_stack([record.t, np.append(record.u, 0.0), record.theta, record.theta_dot])
        lost = [k for begin in (50, 110, 170, 230) for k in range(begin + 9 * i, begin + 9 * i + 20)]
        files.append(tmp_path / f"{i}.csv")
        np.savetxt(
            files[-1], np.delete(rows, lost, axis=0), "%.17g", ",", header="t,torque,theta,theta_dot", comments=""
        )
    records = read(files)
    assert sum(r.starts_midway for r in records) == 16
    diagnosis = diagnose(rod(), records, SENSOR)
    assert (diagnosis.verdict, [s.effect for s in diagnosis.steps]) == ("missing", ["delay"])


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 3])
def test_a_long_swing_under_a_delay_is_found_through_short_windows(seed: int) -> None:
    """From the plain model a whole motion is too far off for a fit to arrive from."""
    diagnosis = diagnose(Model(RodPendulum(g=9.81), dt=DT), log(Delay(T=0.1), seconds=20.0, seed=seed), SENSOR)
    assert (diagnosis.verdict, [s.effect for s in diagnosis.steps]) == ("missing", ["delay"])
    assert diagnosis.estimate.values["delay.T"] == pytest.approx(0.1, abs=1e-3)
