"""To know an effect cannot hurt, an effect of size 0 is none, and sizes are found where the loss is."""

import csv
import dataclasses

import numpy as np
import pytest

from policies.control.dynamic_programming import Grid
from policies.evaluation import PolicyBatch, batch_returns, evaluate
from study.mismatch import effect_cost
from study.mismatch.effect_cost import (
    EFFECT_COST_FOLDER,
    LOSS_FIGURE,
    LOSS_TABLE,
    SHARP,
    TARGETS,
    Bench,
    LossRow,
    explore,
    main,
    read_losses,
    write_losses,
)
from study.mismatch.magnitudes import MAGNITUDES, Magnitude
from study.trials.ground_truth import BLUNT, hidden_machine, near_optimal
from study.trials.hidden_plant import ALL_PLANTS
from sysid import CATALOGUE, DynamicEffect, State

COARSE = Grid(theta=60, theta_dot=61, u=7)
LINE = Magnitude("viscous", "b", "N m s/rad", 0.8, lambda s: {"b": s})


@pytest.fixture(scope="module")
def bench():
    return Bench(COARSE, COARSE, episodes=50, substeps=5)


def row(magnitude, size, percent):
    zero = {f.name: 0.0 for f in dataclasses.fields(LossRow)}
    values = {"effect": magnitude.effect, "size": size, "unit": magnitude.unit, "aware": -400.0, "percent": percent}
    return LossRow(**zero | values)


def test_every_effect_of_the_catalogue_is_asked_for_but_these():
    """Three that move as others do or belong to the log, six that refine others or need their own log, and those with
    states, which no table of the optimum has."""
    ours = {name for name, kind in CATALOGUE.items() if kind.__module__.startswith("sysid.")}
    alike, special = {"back_emf", "coasting_drive", "stamp"}, {"directional_load_friction", "eccentricity"}
    special |= {"filtered_speed", "torque_speed_limit", "warming_friction", "cubic_spring"}
    dynamic = {name for name in ours if issubclass(CATALOGUE[name], DynamicEffect)}
    assert ours - set(MAGNITUDES) == {*alike, *special, *dynamic}


@pytest.mark.parametrize("name", MAGNITUDES)
def test_at_size_zero_it_is_the_plain_machine_and_at_its_largest_another(name):
    rng = np.random.default_rng(0)
    start, u = rng.uniform(-3.0, 3.0, (2, 20)), rng.uniform(-2.0, 2.0, (30, 20))

    def motion(effect):
        model = hidden_machine(effect, substeps=5)
        state, sensing, seen = model.initial_state(*start), model.sensing(*start), []
        for k, command in enumerate(u):
            state = model.advance(state, command, k * model.dt)
            reading, sensing = model.read(state.theta, state.theta_dot, sensing, (k + 1) * model.dt)
            seen.append([*state[:2], *reading])
        return np.array(seen)

    magnitude = MAGNITUDES[name]
    np.testing.assert_allclose(motion(magnitude.at(0.0)), motion(None), atol=1e-9)
    assert np.max(np.abs(motion(magnitude.at(magnitude.largest)) - motion(None))) > 0.05


@pytest.mark.long
@pytest.mark.parametrize("name", MAGNITUDES)
def test_knowing_does_not_hurt(bench, name):
    cost = bench.measure(MAGNITUDES[name], 0.75 * MAGNITUDES[name].largest)
    error = 0.02 * abs(cost.aware)  # the coarse table's own
    assert cost.loss > -error - 2.0 * cost.sem
    assert cost.loss == pytest.approx(cost.aware - cost.ignorant)


@pytest.mark.parametrize("name", ["coulomb", "delay", "ripple", "backlash"])
def test_an_effect_of_size_zero_costs_nothing(bench, name):
    cost = bench.measure(MAGNITUDES[name], 0.0)
    assert (cost.loss, cost.sem) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert cost.ignorant == pytest.approx(cost.plain)


def test_a_delay_of_four_samples_is_dear_and_knowing_it_brings_most_back(bench):
    cost = bench.measure(MAGNITUDES["delay"], 0.2)
    assert cost.percent > 10.0
    assert cost.aware > cost.plain - 0.1 * abs(cost.plain)


def test_a_batch_of_policies_does_as_each_does_alone(bench):
    model, (theta, theta_dot) = hidden_machine(MAGNITUDES["delay"].at(0.1)), (x[:6] for x in bench.starts)
    policies = (bench.ignorant[0], near_optimal(model, COARSE))
    assert PolicyBatch(policies).history == 2
    together = batch_returns(policies, model, theta, theta_dot)
    for policy, returns in zip(policies, together, strict=True):
        np.testing.assert_allclose(returns, evaluate(policy, model, theta, theta_dot).returns, rtol=1e-12)


def test_the_aware_policy_does_not_peek_at_the_machines_memory(bench):
    policy = near_optimal(hidden_machine(MAGNITUDES["lag"].at(0.1)), COARSE)
    theta, theta_dot = (x[:3] for x in bench.starts)
    past = np.ones((3, policy.history))
    u = [policy(State(theta, theta_dot, memory), 1.0, past) for memory in ((), ((7.0 + 0.0 * theta,),))]
    np.testing.assert_array_equal(*u)


@pytest.mark.parametrize(
    "curve",
    [lambda s: 60.0 * s / 0.8, lambda s: 100.0 * (s / 0.8) ** 3, lambda s: 90.0 / (1.0 + np.exp(-60.0 * (s - 0.33)))],
)
def test_sizes_are_found_where_the_loss_passes_the_targets(curve):
    rows = explore(LINE, lambda magnitude, size: row(magnitude, size, float(curve(size))))
    assert [r.size for r in rows] == sorted({r.size for r in rows})
    for target in TARGETS:
        assert min(abs(r.percent - target) for r in rows) < max(0.45, 0.15 * target)


def test_where_nothing_is_lost_nothing_is_looked_for():
    asked = []
    explore(LINE, lambda magnitude, size: asked.append(size) or row(magnitude, size, 0.1))
    assert asked == [pytest.approx(i / 10.0) for i in range(9)]


def test_a_table_is_read_as_it_was_written(tmp_path):
    lag, coulomb = MAGNITUDES["lag"], MAGNITUDES["coulomb"]
    rows = [row(lag, 0.123, 4.5), row(coulomb, 0.5, -0.25), row(coulomb, 0.25, 0.0)]
    write_losses(tmp_path / LOSS_TABLE, rows)
    assert read_losses(tmp_path / LOSS_TABLE) == [rows[2], rows[1], rows[0]]
    assert read_losses(tmp_path / "none.csv") == []


def test_a_run_goes_on_from_its_table(tmp_path, monkeypatch):
    measured = []

    class Counting:
        def measure(self, magnitude, size):
            measured.append(size)
            if len(measured) == 3:
                raise KeyboardInterrupt
            return row(magnitude, size, 0.0)

    monkeypatch.setattr(effect_cost, "Bench", Counting)
    assert main(["--out", str(tmp_path), "--effects", "drag"]) == 130
    assert len(read_losses(tmp_path / LOSS_TABLE)) == 2
    assert main(["--out", str(tmp_path), "--effects", "drag"]) == 0
    assert len(measured) == 3 + 7
    assert (tmp_path / LOSS_FIGURE).read_bytes().startswith(b"\x89PNG")
    assert main(["--out", str(tmp_path), "--effects", "drag"]) == 0
    assert len(measured) == 3 + 7


def test_what_is_no_table_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / LOSS_TABLE).write_text("a,b\n1,2\n")
    assert main(["--out", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and message.count("\n") == 1
    assert (tmp_path / LOSS_TABLE).read_text() == "a,b\n1,2\n"


def test_the_sizes_that_the_experiment_hides_cost_what_its_plan_says():
    rows = {(r.effect, r.size): r.percent for r in read_losses(EFFECT_COST_FOLDER / LOSS_TABLE)}
    hidden = [plant for plant in ALL_PLANTS if plant.effect in MAGNITUDES]
    assert len(hidden) == 3
    for plant in hidden:
        assert plant.percent == pytest.approx(rows[plant.effect, plant.numbers[0][1]], abs=0.05)


def test_the_table_that_losses_are_measured_with_stands_for_agents_better_than_finer_ones():
    with (EFFECT_COST_FOLDER / "table_resolution.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [r["effect"] for r in rows] == list(MAGNITUDES)
    agents = np.array([float(r["agents"]) for r in rows])
    ratios = {n: np.array([float(r[f"table_{n}"]) for r in rows]) for n in (BLUNT.theta, 240, SHARP.theta)}
    distance = {n: np.hypot.reduce(np.log(ratio / agents)) for n, ratio in ratios.items()}
    assert distance[BLUNT.theta] < min(0.5 * distance[SHARP.theta], 0.7 * distance[240])


def test_the_shipped_table_is_whole():
    rows = read_losses(EFFECT_COST_FOLDER / LOSS_TABLE)
    for name, magnitude in MAGNITUDES.items():
        sizes = [r.size for r in rows if r.effect == name]
        assert sizes[0] == 0.0 and sizes[-1] == pytest.approx(magnitude.largest) and len(sizes) >= 9
