"""What further rollouts are worth: laws of a problem whose answer is known, the paper's plant, and the command line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from study.paper.protocol import averaged_sensor, paper_model, paper_rollouts, transitions
from study.worth.__main__ import main
from study.worth.decision import SwingUpDecision
from study.worth.posterior import BoundedNormal, NormalCoordinates
from study.worth.value_of_information import AS_BEFORE, DESIGNED, Worth, cost_of_errors, worth_of_rollouts
from sysid import Coulomb, Estimate, GeneralJoint, GridSearch, InvalidInput, Model, PointMassPendulum, Sensor, fit
from sysid.physics.plants import Plant
from sysid.planning.excitation import Limits
from sysid.planning.next_experiment import next_experiment
from sysid.planning.planned_experiment import Experiment
from tests.sysid.written import rollouts as measured
from tests.sysid.written import table, write

COST = np.array([[3000.0, 500.0], [500.0, 200.0]])
COVARIANCE = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])


@dataclass(frozen=True)
class Quadratic:
    """A problem in which an error e of the parameters costs e'We, whatever they are."""

    cost: np.ndarray
    offset: float = -100.0

    def returns(self, believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        e = np.mean(believed, axis=1) - true
        return self.offset - np.einsum("ki,ij,kj->k", e, self.cost, e)


def estimate(covariance: np.ndarray = COVARIANCE) -> Estimate:
    return Estimate(paper_model(1.5, 1.5), ("m", "l"), covariance, {}, True, "converged", 0.0, 400, "test")


def files(folder: Path, sensor: Sensor) -> list[str]:
    """Two short logs of a rod."""
    records = measured(2, 1.0, sensor=sensor)
    return [str(write(folder / f"swing{i}.csv", table(record))) for i, record in enumerate(records)]


def played(information: np.ndarray) -> Callable[[np.ndarray], Experiment]:
    return lambda cost: Experiment("steps", "play steps.", ("m", "l"), "cost", information=information)


def test_a_quadratic_cost_is_worth_what_its_trace_says() -> None:
    """V* - V0 = tr(W C), and Vh - V0 = tr(W (C - C')), C' = (C^-1 + F)^-1."""
    designed = np.array([[4e4, 0.0], [0.0, 100.0]])
    worth = worth_of_rollouts(
        estimate(), 5, Quadratic(COST), played(designed), further=(1, 4, 1000), draws=300, rng=np.random.default_rng(1)
    )
    assert worth.perfect.value == pytest.approx(np.trace(COST @ COVARIANCE), abs=4.0 * worth.perfect.sem)
    precision = np.linalg.inv(COVARIANCE)
    assert {(further.kind, further.rollouts) for further in worth.further} == {
        (kind, h) for kind in (AS_BEFORE, DESIGNED) for h in (1, 4, 1000)
    }
    for further in worth.further:
        information = further.rollouts * (precision / 5.0 if further.kind == AS_BEFORE else designed)
        right = np.trace(COST @ (COVARIANCE - np.linalg.inv(precision + information)))
        assert further.gain.value == pytest.approx(right, abs=4.0 * further.gain.sem)
    last = next(further for further in worth.further if further.kind == AS_BEFORE and further.rollouts == 1000)
    assert last.gain.value == pytest.approx(worth.perfect.value, rel=0.05)


@pytest.mark.long
def test_a_rollout_is_worth_measuring_below_its_break_even_price_and_not_above() -> None:
    def at(price: float | None) -> Worth:
        return worth_of_rollouts(estimate(), 1, Quadratic(COST), price=price, draws=500)

    price = at(None).break_even
    assert price > 0.3
    cheap, dear, unthinkable = at(0.9 * price), at(1.1 * price), at(100.0)
    assert cheap.best is not None
    assert cheap.advice.startswith("Measure first: ") and "do not settle it (--draws)" in cheap.advice
    assert at(0.1 * price).advice.endswith(" to the return.")
    assert dear.best is None
    assert dear.advice.startswith("Train now")
    assert unthinkable.settled
    assert not unthinkable.further
    assert "one rollout costs 100" in unthinkable.advice


def test_what_is_known_well_enough_asks_for_no_experiment() -> None:
    def never(cost: np.ndarray) -> Experiment:
        raise AssertionError("nothing was to be planned")

    worth = worth_of_rollouts(estimate(1e-4 * COVARIANCE), 5, Quadratic(COST), never)
    assert worth.settled
    assert worth.advice.startswith("Train now, with --randomize none: ")


def test_the_cost_of_errors_is_found_from_losses() -> None:
    posterior = BoundedNormal.of(estimate(np.diag([1e-4, 4e-4])))
    true = posterior.draws(np.random.default_rng(0), 400)
    axes = np.linalg.inv(posterior.root) @ posterior.coordinates.slope
    cost = axes.T @ np.diag([7.0, 3.0]) @ axes
    loss = np.einsum("ki,ij,kj->k", true - 1.5, cost, true - 1.5)
    assert cost_of_errors(posterior, true, loss) == pytest.approx(cost, rel=0.1)
    assert np.trace(cost_of_errors(posterior, true, 0.0 * loss)) > 0.0


@pytest.mark.parametrize("covariance", [100.0 * COVARIANCE, 9.0 * np.eye(2)])
def test_what_is_drawn_lies_within_bounds_and_about_the_centre(covariance: np.ndarray) -> None:
    posterior = BoundedNormal.of(estimate(covariance))
    drawn = posterior.draws(np.random.default_rng(3), 3000)
    assert np.all((drawn >= 0.3) & (drawn <= 3.0))
    x = posterior.coordinates.numbers(drawn)
    sem = np.std(x, axis=0) / math.sqrt(len(x))
    assert np.all(np.abs(np.mean(x, axis=0) - posterior.coordinates.numbers(posterior.centre)) < 6.0 * sem)


def motion(plant: Plant) -> tuple[float, float]:
    """J and G."""
    return float(plant.inertia()), float(plant.gravity_torque(0.5 * math.pi))


@pytest.mark.parametrize("plant", [paper_model(1.5, 0.8).plant, PointMassPendulum(m=1.3, l=0.6), GeneralJoint(J=0.4)])
def test_coordinates_are_those_of_the_motion_and_lead_back(plant: Plant) -> None:
    model = Model(plant, (Coulomb(0.2),))
    names = (*(n for n, p in plant.parameters.items() if not p.known), "coulomb.tau_c")
    coordinates = NormalCoordinates.of(model, names)
    p = coordinates.fitted * np.random.default_rng(0).uniform(0.6, 1.6, (50, 3))
    x = coordinates.numbers(p)
    assert coordinates.parameters(x) == pytest.approx(p, rel=1e-5)
    for row, numbers in zip(p, x, strict=True):
        other = model.with_parameters(dict(zip(names, row, strict=True))).plant
        (J, G), (other_J, other_G) = (motion(own_plant) for own_plant in (plant, other))
        assert numbers == pytest.approx([J / other_J, (other_G / other_J) / (G / J), row[2]], rel=1e-5)
    step = 1e-6 * coordinates.fitted
    slope = (
        coordinates.numbers(coordinates.fitted + np.diag(step))
        - coordinates.numbers(coordinates.fitted - np.diag(step))
    ) / (2.0 * step[:, None])
    assert pytest.approx(coordinates.slope, rel=1e-4, abs=1e-6) == slope.T


@pytest.mark.long
def test_what_a_grid_search_knows_is_normal_in_these_coordinates() -> None:
    """Squared distances of 40 truths are chi-square of two numbers there, and far beyond it in m and l."""
    distances = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 77])
        truth = rng.uniform(0.3, 3.0, 2)
        fitted = GridSearch().fit(paper_model(), transitions(paper_rollouts(paper_model(*truth), 1, rng)))
        known = BoundedNormal.of(fitted)
        off = np.array([known.coordinates.numbers(truth) - known.mean, truth - list(fitted.values.values())])
        distances.append(
            [e @ np.linalg.solve(C, e) for e, C in zip(off, (known.covariance, fitted.covariance), strict=True)]
        )
    here, there = np.mean(distances, axis=0)
    assert here == pytest.approx(2.0, abs=4.0 * 2.0 / math.sqrt(40))
    assert there > 5.0


def test_what_will_be_believed_covers_the_truth() -> None:
    """(mean' - p)' C'^-1 (mean' - p) is chi-square of two numbers where p is drawn from what is believed now."""
    known = BoundedNormal.of(estimate())
    rng, F = np.random.default_rng(4), np.array([[3000.0, 1000.0], [1000.0, 4000.0]])
    distances = []
    for p, z in zip(known.draws(rng, 2000), rng.standard_normal((2000, 2)), strict=True):
        after = known.after(F, p, z)
        off = after.mean - after.coordinates.numbers(p)
        distances.append(off @ np.linalg.solve(after.covariance, off))
    assert np.mean(distances) == pytest.approx(2.0, abs=4.0 * 2.0 / math.sqrt(2000))


@pytest.mark.long
def test_the_papers_grid_has_to_go_on_and_least_squares_is_done_after_one() -> None:
    truth = paper_model(2.0, 1.5)
    rollouts = paper_rollouts(truth, 5, np.random.default_rng(0))
    grid = GridSearch().fit(paper_model(), transitions(rollouts))
    exact = fit(paper_model(), [rollouts[0].averaged], averaged_sensor(1.0), ("m", "l"))

    def advised(fitted: Estimate, n: int) -> Worth:
        def design(cost: np.ndarray) -> Experiment:
            return next_experiment(fitted, limits=Limits(2.0, 10.0), sensor=Sensor(theta_dot=0.7), cost=cost)

        decision = SwingUpDecision.of(fitted.model, fitted.names, episodes=20)
        return worth_of_rollouts(fitted, n, decision, design, price=3.0, further=(1,), draws=12)

    measure, train = advised(grid, 5), advised(exact, 1)
    assert measure.best is not None
    assert measure.best.kind == DESIGNED
    assert train.settled
    assert train.perfect.value < 3.0


def test_machines_side_by_side_return_what_each_returns_alone() -> None:
    decision = SwingUpDecision.of(paper_model(2.0, 1.5), ("m", "l"), episodes=4)
    believed, true = np.array([[[2.0, 1.5]], [[1.0, 1.0]]]), np.array([[1.8, 1.4], [1.0, 1.2]])
    together = decision.returns(believed, true)
    alone = [decision.returns(believed[i : i + 1], true[i : i + 1])[0] for i in range(2)]
    assert together == pytest.approx(alone, abs=1e-9)
    same = decision.returns(np.tile(believed[:1], (2, 1, 1)), true)
    assert same == pytest.approx([alone[0], decision.returns(believed[:1], true[1:])[0]], abs=1e-9)


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [
        ({"rollouts": 0.0}, "rollouts = 0.0: expected a positive number"),
        ({"price": -1.0}, "price = -1.0: expected"),
        ({"price": math.nan}, "price = nan: expected"),
        ({"further": ()}, "further rollouts (): expected"),
        ({"further": (0,)}, "further rollouts (0,): expected whole numbers from 1"),
        ({"draws": 2}, "draws = 2: expected at least 4"),
        ({"draws": 10**9}, "draws ="),
        ({"covariance": np.diag([np.inf, 1.0])}, "the log does not determine m"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(numbers: dict, sentence: str) -> None:
    given = {"rollouts": 5.0, "covariance": COVARIANCE} | numbers
    fitted = estimate(given.pop("covariance"))
    with pytest.raises(InvalidInput) as refusal:
        worth_of_rollouts(fitted, given.pop("rollouts"), Quadratic(COST), **given)
    assert str(refusal.value).startswith(sentence)


@pytest.mark.long
def test_the_command_tells_what_to_do_and_writes_it(tmp_path, capsys) -> None:
    log = files(tmp_path, Sensor(theta=0.05, theta_dot=2.0))
    outputs = {name: tmp_path / name for name in ("w.json", "next.csv", "w.png")}
    written = [f"--{kind}={outputs[name]}" for kind, name in zip(("json", "out", "figure"), outputs, strict=True)]
    code = main([*log, "--u-max", "2", "--draws", "4", "--further", "1", *written])
    said = capsys.readouterr().out
    assert code == 0
    answer = json.loads(outputs["w.json"].read_text())
    assert answer["schema"] == "gapfinder/worth/1"
    assert answer["advice"] in said
    assert outputs["next.csv"].exists() == outputs["w.png"].exists() == bool(answer["further"])


def test_a_model_without_a_torque_limit_is_one_sentence(tmp_path, capsys) -> None:
    log = files(tmp_path, Sensor(theta=0.01, theta_dot=0.1))
    assert main([*log, "--json", str(tmp_path / "w.json")]) == 2
    said = capsys.readouterr()
    assert "the model has no torque limit: give one with --u-max" in said.err
    assert not (tmp_path / "w.json").exists()
