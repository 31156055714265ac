"""The experiment of the strategies from end to end, in the small: rounds, an interruption, tables, figure, page."""

import csv
import dataclasses
import io
import json
import warnings
from collections import Counter

import numpy as np
import pytest
from rich.console import Console

from policies import SACPopulation, SACSettings
from policies.environments.randomization import Band
from study.figure_style import save_figure
from study.pipeline.settings import RunOptions
from study.pipeline.stages import run
from study.presets import open_experiment
from study.strategies.catalogue import PLACES, strategy_called
from study.strategies.designs import OPTIMUM, Designed
from study.strategies.populations import GoesOnLearning, Trained, _read, _write, networks_of
from study.strategies.session import STEPS, CaseRound
from study.strategies.strategies_page import LOOKS, returns_of_strategies, strategies_sentences
from study.strategies.strategies_plan import STRATEGIES_PLANS, StrategiesPlan
from study.strategies.trial_experiment import trial_results
from study.strategies.trial_findings import TrialResults, trial_findings
from study.trials.ground_truth import PRIOR
from study.trials.hidden_plant import PLAIN
from sysid import InvalidInput
from tests.study.inline import Inline

TINY = dataclasses.replace(
    STRATEGIES_PLANS["strategies-smoke"], name="tiny", plants=(PLAIN,), sensings=("encoder",), budgets=(0, 2, 5),
    described=2, strategies=("prior", "point", "cross_entropy", "fine_tuning", "scratch"), steps=2048,
    learner_steps=160, random_steps=40, batch=8, in_rounds=2,
    contrasts=(("cross_entropy", "point"), ("fine_tuning", "point")),
)  # fmt: skip


HEAD = "plant,sensing,strategy,n,seed,mean,optimum,simulated"


class Stops(Inline):
    """Is interrupted before the task of that number."""

    def __init__(self, last):
        super().__init__()
        self.last = last

    def execute(self, tasks, heard):
        for task in tasks:
            if len(self.tasks) == self.last:
                raise KeyboardInterrupt
            super().execute([task], heard)


def attempt(folder, executor, plan=TINY, imported=None):
    said = io.StringIO()
    console = Console(file=said, width=200)
    with open_experiment(plan, RunOptions(folder, imported=imported)) as experiment:
        run(experiment, executor, console)
        experiment.publish(console)
    return said.getvalue()


def cases(folder):
    with (folder / "cases.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder, executor = tmp_path_factory.mktemp("undisturbed"), Inline()
    return folder, attempt(folder, executor), executor.tasks


@pytest.mark.long
def test_an_experiment_ends_with_answers_tables_figure_and_page(undisturbed):
    folder, said, tasks = undisturbed
    assert "How many rollouts does it take?" in said and "What is the best return worth that was seen?" in said
    assert len(cases(folder)) == len(TINY.cases)
    assert (folder / "returns.png").read_bytes().startswith(b"\x89PNG")
    page = (folder / "report.html").read_text()
    assert "Rollouts to within 5 % of the optimum" in page and "Vuong 2019" in page
    assert f"<td>{6 * TINY.steps:,}</td>" in page
    names = [key for task in tasks if hasattr(task, "keys") for key in task.keys]
    assert len(names) == len(set(names))  # no agent is trained twice
    best = {row["strategy"]: row["best_anew"] for row in cases(folder)}
    assert best["cross_entropy"] and not best["point"]


@pytest.mark.long
def test_simulated_steps_are_counted_and_real_ones_are_not(undisturbed):
    by = {(row["strategy"], row["n"]): float(row["simulated"]) for row in cases(undisturbed[0])}
    assert by["point", "2"] == by["prior", "0"] == TINY.steps
    assert by["fine_tuning", "5"] == by["fine_tuning", "0"] == TINY.learner_steps
    assert by["scratch", "5"] == 0.0
    assert by["cross_entropy", "5"] == 6 * TINY.steps


@pytest.mark.long
def test_an_interrupted_experiment_comes_to_the_same_numbers(undisturbed, tmp_path):
    for last in (1, 3):
        with pytest.raises(KeyboardInterrupt):
            attempt(tmp_path, Stops(last))
    rest = Inline()
    attempt(tmp_path, rest)
    assert cases(tmp_path) == cases(undisturbed[0])
    assert len(rest.tasks) == len(undisturbed[2]) - 1 - 3


@pytest.mark.long
def test_finished_cases_of_other_folders_are_taken_up_and_the_rest_is_run(undisturbed, tmp_path):
    folder, _, tasks = undisturbed
    part, alone = TINY.with_strategies(["prior", "point", "cross_entropy"]), Inline()
    attempt(tmp_path / "part", alone, part)
    rest = Inline()
    attempt(tmp_path / "all", rest, imported=tmp_path / "part" / "cases.csv")
    assert cases(tmp_path / "all") == cases(folder)
    summary = json.loads((tmp_path / "all" / "study.json").read_text())
    assert summary["imported"] == len(part.cases) and "imported" not in json.loads((folder / "study.json").read_text())
    trained = [{key for task in group if hasattr(task, "keys") for key in task.keys} for group in (tasks, rest.tasks)]
    assert trained[1] < trained[0] and summary["agents"] == len(trained[1])
    attempt(tmp_path / "all", again := Inline(), imported=tmp_path / "part" / "cases.csv")
    assert not again.tasks


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", r"foreign.csv has no column 'plant': expected plant, sensing, .*"),
        (
            f"{HEAD}\nplain,encoder,point,3,1010,-1,-1,0\n",
            r"has the case plain, encoder, point, 3, 1010: expected .*'tiny'",
        ),
        (f"{HEAD}\nplain,encoder,point,2,1010,much,-1,0\n", r"line 2 does not hold the numbers of a row"),
    ],
)
def test_foreign_cases_are_refused_and_nothing_is_taken_up(tmp_path, text, message):
    (tmp_path / "foreign.csv").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        attempt(tmp_path / "out", Inline(), imported=tmp_path / "foreign.csv")
    with trial_results(tmp_path / "out", TINY) as results:
        assert not results.all(STEPS)


def test_a_folder_of_other_strategies_is_refused(tmp_path):
    trial_results(tmp_path, TINY).close()
    with pytest.raises(InvalidInput, match="holds results of other settings of preset 'tiny'"):
        attempt(tmp_path, Inline(), TINY.with_strategies(["prior", "point"]))


def test_an_agent_that_goes_on_learning_begins_with_what_it_had(tmp_path):
    settings, drawn = SACSettings(hidden=(8, 8), steps=60, batch=8, random_steps=20), [Band({"m": 1.0, "l": 1.0})] * 2
    trained = SACPopulation(PRIOR, drawn, [1, 2], settings, history=4)
    trained.train(60)
    later = GoesOnLearning(PRIOR, drawn, [7, 8], settings, history=4)
    for a in range(2):
        _write(tmp_path / f"{a}.npz", networks_of(trained, a))
        _read(tmp_path / f"{a}.npz", networks_of(later, a))
    for one, other in zip(trained.policies(), later.policies(), strict=True):
        for (W, b), (V, c) in zip(one.layers, other.layers, strict=True):
            assert np.array_equal(W, V) and np.array_equal(b, c)
    for name, leaf in networks_of(trained, 1).items():
        assert np.array_equal(leaf, networks_of(later, 1)[name]), name
    before = networks_of(later, 0)["critic0"].clone()
    later.train(20)  # its own actions, no update yet
    assert np.array_equal(before, networks_of(later, 0)["critic0"])
    later.train(20)
    assert not np.array_equal(before, networks_of(later, 0)["critic0"])


def invented(returns, optimum=-100.0, budgets=(5, 10, 25)):
    """Findings of returns (strategy, n) -> one a seed."""
    seeds = (1, 2, 3, 4)
    plan = StrategiesPlan(
        "invented", (PLAIN,), ("point", "cross_entropy"), budgets, (("cross_entropy", "point"),), budgets, seeds,
        described=4, in_rounds=4,
    )  # fmt: skip
    steps, trained = [], []
    for case in plan.cases:
        key, best = f"{case.strategy}-{case.n}-{case.seed}", f"best-{case.n}-{case.seed}"
        compares = case.strategy == "cross_entropy"
        answer = {"deployed": key, "best": best if compares else None, "observed": -90.0 if compares else None,
                  "rollouts": case.n, "simulated": 7}  # fmt: skip
        steps.append(CaseRound(case, 0, {"setups": {}, "learn": None, "answer": answer}, 3600.0))
        worth = returns[case.strategy, case.n] + 0.1 * case.seed
        trained.append(Trained(key, {"plain": (worth, worth)}, {}, 0.0))
        if compares:
            trained.append(Trained(best, {"plain": (-140.0,)}, {}, 0.0))
    designs = [Designed("plain", OPTIMUM, seed, (optimum,), 0.0) for seed in seeds]
    return plan, TrialResults(steps, trained, designs)


def test_what_is_found_is_what_was_put_in():
    returns = {("point", 5): -104.5, ("point", 10): -120.0, ("point", 25): -103.0,
               ("cross_entropy", 5): -160.0, ("cross_entropy", 10): -130.0, ("cross_entropy", 25): -104.0}  # fmt: skip
    plan, results = invented(returns)
    findings = trial_findings(plan, results)
    # the budget from which on it stays: five rollouts were luck
    assert findings.arrived("plain", "encoder", "point") == 25
    assert findings.arrived("plain", "encoder", "cross_entropy") == 25
    assert [c.contrast.mean for c in findings.compared] == pytest.approx([-55.5, -10.0, -1.0])
    outcome = findings.line("plain", "encoder", "cross_entropy")[10]
    assert outcome.anew == pytest.approx(-140.0) and outcome.simulated[0] == 7
    sentences = dict(strategies_sentences(findings))
    assert "SimOpt" not in str(sentences)
    assert "3 contrasts" in sentences["Which strategy beats the point estimate?"]


@pytest.mark.parametrize("worth", [-110.0, -900.0])
@pytest.mark.parametrize("budgets", [(5, 10, 25), (5,)])
def test_the_figure_has_room_for_all_that_is_in_it(tmp_path, worth, budgets):
    """Also where every mean is outside the panel; matplotlib warns where it gives up."""
    returns = {(s, n): worth for s in ("point", "cross_entropy") for n in budgets}
    findings = trial_findings(*invented(returns, budgets=budgets))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert save_figure(lambda: returns_of_strategies(findings), tmp_path / "figure.png").stat().st_size > 10_000


def test_with_several_budgets_every_strategy_has_a_line_of_what_it_falls_short_by():
    returns = {("point", 5): -104.5, ("point", 10): -102.0, ("cross_entropy", 5): -160.0, ("cross_entropy", 10): -130.0}
    figure = returns_of_strategies(trial_findings(*invented(returns, budgets=(0, 5, 10))))
    panels = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_ylabel().split("\n")[0] for axes in panels] == ["identified", "compared returns"]
    drawn = [{tuple(np.round(line.get_ydata(), 2)) for line in axes.lines} for axes in panels]
    point, near = (0.04, 0.02), (0.05, 0.05)
    assert all({point, near} <= points for points in drawn)
    assert {(0.6, 0.3), (0.4, 0.4)} <= drawn[1] - drawn[0]
    assert all(low > high for low, high in (axes.get_ylim() for axes in panels))  # the optimum is above


def test_no_two_lines_of_a_group_look_alike():
    assert max(Counter(strategy_called(name).group for name in PLACES).values()) <= len(LOOKS)


def test_with_one_budget_every_strategy_has_a_row_with_its_mean():
    returns = {("point", 5): -104.5, ("cross_entropy", 5): -160.0}
    figure = returns_of_strategies(trial_findings(*invented(returns, budgets=(5,))))
    axes = figure.axes[0]
    rows = {label.get_text(): at for at, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)}
    drawn = {(line.get_xdata()[0], line.get_ydata()[0]) for line in axes.lines if len(line.get_xdata()) == 1}
    marks = {row: {round(x, 2) for x, y in drawn if y == at} for row, at in rows.items()}
    assert marks == {"point estimate": {-104.25}, "cross-entropy": {-159.75, -140.0}}


@pytest.mark.parametrize(("name", "places"), [("kalman", 4), ("prior", 5), ("point", 5)])
def test_a_strategy_alone_is_told_of_where_it_can_be_run(name, places):
    """The Kalman filter needs an angle; the prior spends no rollout."""
    plan = STRATEGIES_PLANS["strategies"].with_strategies([name])
    assert len(plan.places) == places == len({(case.plant, case.sensing) for case in plan.cases})
    cases = {case: {"deployed": str(case), "best": None, "observed": None, "rollouts": case.n, "simulated": 1}
             for case in plan.cases}  # fmt: skip
    steps = [CaseRound(case, 0, {"setups": {}, "learn": None, "answer": answer}, 0.0) for case, answer in cases.items()]
    trained = [Trained(str(case), {case.plant: (-100.0,)}, {}, 0.0) for case in cases]
    designs = [Designed(plant.name, OPTIMUM, seed, (-100.0,), 0.0) for plant, _ in plan.places for seed in plan.seeds]
    findings = trial_findings(plan, TrialResults(steps, trained, designs))
    assert dict(strategies_sentences(findings))["How many rollouts does it take?"].count("come") == places
    assert len(returns_of_strategies(findings).axes) >= places
