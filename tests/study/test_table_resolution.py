"""A table stands for agents that lose what it loses, and for no others."""

import csv

import numpy as np
import pytest

from policies.control.dynamic_programming import Grid, solve
from study.mismatch import table_resolution
from study.mismatch.chosen_sizes import SIZES
from study.mismatch.loss import EFFECT_COST_FOLDER, SHARP
from study.mismatch.magnitudes import MAGNITUDES
from study.mismatch.rod import BLUNT, machine
from study.mismatch.table_resolution import ANGLES, RESOLUTION_TABLE, compare_tables, train_agents, write_resolution


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(table_resolution, "MAGNITUDES", {name: MAGNITUDES[name] for name in ("delay", "torque_gain")})


def test_a_table_is_no_distance_from_itself_and_some_from_another(few, tmp_path):
    tables = [solve(machine(substeps=2), Grid(theta=n, theta_dot=n + 1, u=7)) for n in (40, 60)]
    found = compare_tables(tables, [tables[1], tables[1]], (40, 60), episodes=20)
    assert found.effects == ("delay", "torque_gain")
    assert found.sizes == (SIZES["delay"].large.size, SIZES["torque_gain"].medium.size)
    assert np.all(found.tables > 1.0)  # what hurts makes a return more negative
    assert found.distances[1] == pytest.approx(0.0, abs=1e-12)
    assert found.distances[0] > 0.01
    assert "60 0.000" in str(found)
    write_resolution(tmp_path / RESOLUTION_TABLE, found)
    header, *rows = csv.reader((tmp_path / RESOLUTION_TABLE).read_text().splitlines())
    assert header == ["effect", "size", "table_40", "table_60", "agents", "agents_sd"]
    assert [float(row[3]) for row in rows] == [float(row[4]) for row in rows]


def test_agents_are_compared_too(few):
    agents = train_agents(steps=300, seeds=(100, 101), hidden=(8, 8))
    found = compare_tables([agents[0]], agents, (0,), episodes=5)
    assert found.agents.shape == (2, 2)
    np.testing.assert_allclose(found.tables[:, 0], found.agents[:, 0])


def test_the_table_that_sizes_were_chosen_with_stands_for_agents_better_than_finer_ones():
    with (EFFECT_COST_FOLDER / RESOLUTION_TABLE).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["effect"] for row in rows] == list(MAGNITUDES)
    agents = np.array([float(row["agents"]) for row in rows])
    distance = {n: np.hypot.reduce(np.log([float(r[f"table_{n}"]) for r in rows] / agents)) for n in ANGLES}
    assert distance[BLUNT.theta] < 0.5 * distance[SHARP.theta]
    assert distance[BLUNT.theta] < 0.7 * distance[240]
