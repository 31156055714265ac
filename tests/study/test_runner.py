"""A study of several operating points, from nothing to its report; runs from elsewhere stand in for its own."""

import csv
import dataclasses
import io
import json

import numpy as np
import pytest
from rich.console import Console

from policies.evaluation import evaluate, fresh_start_states, start_states
from study.paper.finished_runs import RUNS
from study.paper.presets import Point, Preset
from study.paper.protocol import paper_model
from study.paper.reference_controllers import REFERENCES
from study.paper.sweep import Sweep, SweepPopulation, identify, sweep_results
from study.paper.sweep_page import outputs
from study.pipeline.population_task import read_policy
from study.pipeline.publication import PUBLISHED
from study.pipeline.stages import run
from study.pipeline.tables import write_rows
from sysid import InvalidInput
from sysid.version import installed_version
from tests.study.inline import Inline

MANY = Preset(
    name="many",
    points=(
        Point("main", (0, 2), (0.0, 0.5), (0,)),
        Point("small_gap", (2,), (0.0,), (0, 1), truth=(1.5, 1.2), identifier="least_squares"),
        Point("prior_range", (0,), (0.5,), (0, 1), (1.5, 1.2), sigma=2.0, randomization="prior_range"),
    ),
    hidden=(8, 8),
    steps=600,
    population=3,
    batch=16,
    random_steps=200,
    episodes=4,
    reference_seeds=(0, 1, 2),
    grid=40,
)


def finish(folder, preset=MANY, imported=None, publish=True):
    """Run what is missing and publish; returns the executor, the runs and what was said."""
    executor, said = Inline(), io.StringIO()
    with sweep_results(folder, preset) as store:
        sweep = Sweep(preset, store, 1e9, imported)
        run(sweep, executor, Console(file=said))
        if publish:
            sweep.publish(Console(file=said))
        return executor, store.all(RUNS), said.getvalue()


def trained(executor):
    return [task for task in executor.tasks if isinstance(task, SweepPopulation)]


def references(executor):
    return [task for task in executor.tasks if task.table is REFERENCES]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    return folder, *finish(folder)


def table(folder, name="runs.csv"):
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


def test_every_run_is_of_its_points_plant_and_estimate(finished):
    folder, _, runs, _ = finished
    assert {run.cell for run in runs} == set(MANY.cells)
    assert len(list(folder.glob("policies/*.npz"))) == len(MANY.cells)
    for r in runs:
        point = MANY.point(r.cell.point)
        assert r.theta_hat == identify(point, r.cell.n, r.cell.seed)
        assert r.id_error == pytest.approx(np.linalg.norm(np.subtract(r.theta_hat, point.truth)))
        for returns, starts in ((r.returns, start_states), (r.fresh_returns, fresh_start_states)):
            policy = read_policy(folder, r.cell)
            answer = evaluate(policy, paper_model(*point.truth), *starts(r.cell.seed, MANY.episodes))
            assert returns == tuple(answer.returns.tolist())


def test_the_prior_range_is_trained_whatever_the_label_says(finished):
    _, _, runs, _ = finished
    kinds = {r.cell.point: r.settings["randomization"]["kind"] for r in runs}
    assert kinds == {"main": "Band", "small_gap": "Band", "prior_range": "Ranges"}


def test_a_controller_is_designed_once_and_run_on_every_plant_that_asks(finished):
    folder, executor, runs, _ = finished
    designs = [task.arguments[1:3] for task in references(executor)]
    assert len(designs) == len(set(designs)) == 2 * 3 + len({r.theta_hat for r in runs})
    with sweep_results(folder, MANY) as store:
        stored = store.all(REFERENCES)
    assert {(r.theta, r.truth) for r in stored if r.controller == "optimal"} >= {
        (r.theta_hat, MANY.point(r.cell.point).truth) for r in runs
    }
    assert {r.seed for r in stored} == {0, 1, 2}


def test_the_folder_holds_tables_figures_and_a_section_a_point(finished):
    folder, _, _, said = finished
    made = {path.name for path in folder.iterdir()}
    drawn = {"heatmap_main.png", "pareto_main.png", *(f"curves_{point.name}.png" for point in MANY.points)}
    assert drawn | {"runs.csv", "references.csv", "report.html", "policies", "results.sqlite"} <= made
    assert made <= {*outputs(MANY), *PUBLISHED, "results.sqlite"}
    assert not made & {
        f"{name}_{point}.png" for name in ("heatmap", "pareto") for point in ("small_gap", "prior_range")
    }
    rows = table(folder)
    assert [row["point"] for row in rows] == ["main"] * 4 + ["small_gap"] * 2 + ["prior_range"] * 2
    page = (folder / "report.html").read_text(encoding="utf-8")
    places = [page.index(f'<h2 class="point">{name}</h2>') for name in ("Main", "Small gap", "Prior range")]
    assert places == sorted(places)
    assert page.count("How far from optimal, and why?") == said.count("How far from optimal, and why?") == 3
    assert "speed read to 2 rad/s" in said
    rows = table(folder, "references.csv")
    assert [row["m"] for row in rows] == ["2.0"] * 3 + ["1.5"] * 3
    for plant in (rows[:3], rows[3:]):
        returns = {row["controller"]: float(row["return_mean"]) for row in plant}
        assert returns["optimal"] > returns["swing_up_lqr"] > returns["lqr"]


def test_a_study_keeps_what_its_numbers_depend_on(finished):
    folder, _, runs, _ = finished
    record = json.loads((folder / "study.json").read_text())
    assert record["runs"] == len(MANY.cells) and record["fingerprint"] == MANY.fingerprint
    assert record["versions"]["gapfinder"] == installed_version("gapfinder") and record["worker_hours"] > 0.0
    for r in runs:
        assert (len(r.returns), len(r.curve)) == (MANY.episodes, MANY.steps // 200)
        settings = json.dumps(r.settings)
        assert all(f'"{name}"' in settings for name in ("polyak", "gamma", "randomization", "sigma", "truth"))
        assert {"torch", "torchrl", "numpy", "python"} <= set(r.versions)


def test_a_finished_study_has_nothing_left_to_do(finished):
    folder, _, runs, _ = finished
    executor, again, _ = finish(folder, publish=False)
    assert executor.tasks == []
    assert again == runs


def test_on_another_device_all_agents_train_together(finished, tmp_path, monkeypatch):
    monkeypatch.setattr("study.paper.sweep.SweepPopulation.run", lambda self, link: [])
    with sweep_results(tmp_path, MANY, "cuda") as store:
        executor = Inline()
        run(Sweep(MANY, store, 1e9), executor, Console(file=io.StringIO()))
    (population,) = trained(executor)
    assert population.cells == MANY.cells
    assert population.gpus == 1


def test_a_table_of_runs_is_taken_up_without_its_episodes(finished, tmp_path):
    folder, _, _, _ = finished
    executor, taken, said = finish(tmp_path, imported=folder / "runs.csv")
    assert trained(executor) == []
    assert (tmp_path / "runs.csv").read_text() == (folder / "runs.csv").read_text()
    assert {(r.imported, r.returns, r.curve) for r in taken} == {("runs.csv", (), ())}
    assert "8 runs taken up" in said
    assert (tmp_path / "references.csv").read_text() == (folder / "references.csv").read_text()
    assert "8 runs were taken up from runs.csv" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_is_missing_is_trained_and_imported_runs_stay(finished, tmp_path):
    folder, _, runs, _ = finished
    lines = (folder / "runs.csv").read_text().splitlines()
    (tmp_path / "some.csv").write_text("\n".join([lines[0], *lines[5:]]) + "\n")
    executor, taken, _ = finish(tmp_path / "out", imported=tmp_path / "some.csv", publish=False)
    assert [task.index for task in trained(executor)] == [0, 1]
    cells = {r.cell for r in taken if not r.imported}
    assert cells == {cell for cell in MANY.cells if cell.point == "main"}
    means = {r.cell: r.mean for r in runs}
    assert {r.cell: r.mean for r in taken} == pytest.approx(means)


def test_a_published_table_of_one_point_needs_no_column_for_it(tmp_path):
    one = dataclasses.replace(MANY, points=(Point("main", (0,), (0.0,), (3,)),))
    (tmp_path / "summary.csv").write_text(
        "n,w,seed,id_error,eval_return_mean,eval_return_std,theta_hat_mass,theta_hat_length,wall_time_s\n"
        "0,0.0,3,1.118033988749895,-770.5,200.0,1.0,1.0,900.0\n"
    )
    executor, (taken,), _ = finish(tmp_path / "out", one, imported=tmp_path / "summary.csv")
    assert trained(executor) == []
    assert (taken.mean, taken.std, taken.seconds) == (-770.5, 200.0, 900.0)
    assert table(tmp_path / "out")[0]["eval_return_fresh"] == ""


def changed(folder, path, **columns):
    """The table with another first run."""
    first, *rest = table(folder)
    write_rows(path, [*first], ([*row.values()] for row in (first | columns, *rest)))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"point": "nowhere"}, r"runs.csv: nowhere, n = 0, w = 0, seed 0 does not .* expected one of the points main,"),
        ({"n": "7"}, r"runs.csv: main, n = 7, .* expected n in \(0, 2\)"),
        ({"w": "0.1"}, r"main, n = 0, w = 0.1, .* w in \(0.0, 0.5\)"),
        ({"theta_hat_mass": "1.00001"}, r"seed 0 does not .* its theta_hat is \(1.00001, 1.0\), expected \(1.0, 1.0\)"),
        ({"w": "0.5"}, r"main, n = 0, w = 0.5, seed 0 comes twice"),
    ],
)
def test_a_row_of_something_else_is_refused_and_nothing_taken_up(finished, tmp_path, columns, message):
    changed(finished[0], tmp_path / "runs.csv", **columns)
    with sweep_results(tmp_path / "out", MANY) as store:
        with pytest.raises(InvalidInput, match=message):
            run(Sweep(MANY, store, 1e9, tmp_path / "runs.csv"), Inline(), Console(file=io.StringIO()))
        assert store.keys(RUNS) == set()
