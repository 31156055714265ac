"""The experiment's answer: parts of a gap add up, contrasts are paired and Holm's, and a run from nothing is told."""

import csv
import dataclasses
import io
import json

import numpy as np
import pytest
from rich.console import Console

from policies.environments.randomization import Fixed
from study.mismatch.mismatch_findings import Verdict, mismatch_findings
from study.mismatch.mismatch_page import mismatch_sentences
from study.mismatch.mismatch_plan import CONTRASTS, MISMATCH_PLANS
from study.pipeline.stages import run
from study.statistics import paired_t
from study.strategies.designs import OPTIMUM, PLAIN_ROD, Designed
from study.strategies.populations import TRAININGS, Trained
from study.strategies.session import CaseRound, key_of
from study.strategies.trial_experiment import TrialExperiment, trial_results
from study.strategies.trial_findings import TrialResults
from study.trials.ground_truth import PRIOR, oracle
from study.trials.training_setup import TrainingSetup
from tests.study.inline import Inline

PLAN = dataclasses.replace(
    MISMATCH_PLANS["mismatch-quick"],
    seeds=(1, 2, 3, 4),
    described=4,
    strategies=("prior", "fitted", "band", "mended", "oracle"),
)
RETURNS = {"prior": -900.0, "fitted": -500.0, "band": -520.0, "mended": -400.0, "oracle": -380.0}


def invented():
    """Rounds, agents and designs of PLAN: mended has the delay but not the magnet; every case has its model."""
    rounds, trained, designs = [], [], []
    for case in PLAN.cases:
        plant, seed = PLAN.plant(case.plant), case.seed
        theta = {"m": 1.0 + 0.1 * seed, "l": 1.2 + 0.01 * len(case.strategy)}
        named = case.strategy == "mended" and plant.effect == "delay"
        model = oracle(plant) if named or case.strategy == "oracle" else PRIOR
        setup = TrainingSetup(model if case.strategy in ("oracle", "prior") else model.with_parameters(theta), Fixed())
        if case.strategy == "mended":
            said = ("missing", ("delay",)) if named else ("unknown", ())
            setup = dataclasses.replace(setup, verdict=said[0], steps=said[1], believed=named)
        key = f"{key_of(setup, seed)}-{case.strategy}-{case.plant}"
        answer = {"deployed": key, "best": None, "observed": None, "rollouts": case.n, "simulated": 7}
        rounds.append(CaseRound(case, 0, {"setups": {key: setup.to_json()}, "learn": None, "answer": answer}, 1.0))
        reached = RETURNS[case.strategy] + np.random.default_rng(seed).normal(0.0, 5.0)
        trained.append(Trained(key, {hidden.name: (reached,) * 2 for hidden in PLAN.plants}, {}, 10.0))
        if case.strategy in PLAN.centers:
            designs.append(Designed(plant.name, setup.model_key, seed, (-450.0 - seed,) * 2, 1.0))
    for plant in PLAN.plants:
        for seed in PLAN.seeds:
            designs.append(Designed(plant.name, OPTIMUM, seed, (-350.0 - seed,) * 2, 1.0))
            designs.append(Designed(plant.name, PLAIN_ROD, seed, (-430.0 - seed,) * 2, 1.0))
    return rounds, trained, designs


@pytest.fixture(scope="module")
def findings():
    return mismatch_findings(PLAN, TrialResults(*invented()))


def test_the_parts_of_a_gap_add_up_seed_by_seed(findings):
    for condition, outcome in findings.outcomes.items():
        split = findings.splits[condition]
        assert split is not None and split.tables == len(PLAN.seeds)
        assert split.structure + split.identification + split.training == pytest.approx(outcome.gap)
        if condition.strategy == "oracle":
            assert (split.structure, split.identification) == (0.0, 0.0)
        else:
            knows = condition.strategy == "mended" and condition.plant == "delay_large"
            assert split.structure == pytest.approx(0.0 if knows else 80.0)
            assert split.identification == pytest.approx(100.0 if knows else 20.0)


def returns(findings, plant, strategy, n):
    return findings.outcomes[findings.condition(plant, strategy, n)].returns


def test_contrasts_are_those_of_the_plan_paired_and_raised_by_holm(findings):
    planned = [(a, b) for a, b in CONTRASTS if a in PLAN.strategies and b in PLAN.strategies]
    assert [(c.a, c.b) for c in findings.compared] == planned * len(PLAN.plants)
    raw = []
    for c in findings.compared:
        one, other = (returns(findings, c.plant, strategy, c.n) for strategy in (c.a, c.b))
        raw.append(paired_t(one, other))
        assert (c.contrast.mean, c.contrast.low, c.contrast.high) == (raw[-1].mean, raw[-1].low, raw[-1].high)
    least = int(np.argmin([contrast.p for contrast in raw]))
    assert findings.compared[least].p == pytest.approx(min(1.0, len(raw) * raw[least].p))
    assert all(c.p >= contrast.p for c, contrast in zip(findings.compared, raw, strict=True))


def test_contrasts_together_are_their_mean_and_no_wider_than_the_widest(findings):
    rows = [c for c in findings.compared if (c.a, c.b) == ("band", "fitted")]
    every = np.array([[returns(findings, c.plant, strategy, c.n) for c in rows] for strategy in ("band", "fitted")])
    together = findings.together(rows)
    assert (len(rows), together.seeds) == (2, len(PLAN.seeds))
    assert together.mean == pytest.approx(np.mean([c.contrast.mean for c in rows]))
    assert together == paired_t(*every.mean(axis=1))
    assert together.high - together.low <= max(c.contrast.high - c.contrast.low for c in rows)


def test_verdicts_are_counted_and_said(findings):
    assert findings.verdicts["delay_large", 5] == {Verdict("missing", ("delay",)): 4}
    assert findings.verdicts["magnet", 5] == {Verdict("unknown", (), False): 4}
    said = dict(mismatch_sentences(findings))
    assert "1 of 1 are better and 0 worse" in said["What is it worth to name the effect?"]
    assert "unknown" in str(said) and len(said) == 4
    assert (
        "No: with a band of ±30 % around the fitted m and l 0 of 2 are better and 2 worse"
        in said["Does breadth pay when the simulator lacks an effect?"]
    )


@pytest.mark.long
def test_a_run_from_nothing_to_the_page(tmp_path):
    """The smoke plan's settings, three strategies: what stands in the tables is what its agents returned, and a second
    run finds nothing to do."""
    smoke = MISMATCH_PLANS["mismatch-smoke"]
    plan = dataclasses.replace(
        smoke, plants=smoke.plants[:1], strategies=("prior", "fitted", "mended"), seeds=(1000, 1001), described=2
    )
    out = io.StringIO()
    with trial_results(tmp_path, plan) as results:
        experiment = TrialExperiment(plan, results, 1e9)
        run(experiment, Inline(), Console(file=out))
        experiment.publish(Console(file=out))
        again = Inline()
        run(experiment, again, Console(file=out))
        trained = {agent.key: agent.returns for agent in results.all(TRAININGS)}
        answers = TrialResults.of(results).answers
    assert again.tasks == []
    trials, outcomes, contrasts = (
        list(csv.DictReader((tmp_path / f"{name}.csv").read_text().splitlines()))
        for name in ("cases", "outcomes", "contrasts")
    )
    written = {(row["plant"], row["strategy"], int(row["n"]), int(row["seed"])): float(row["mean"]) for row in trials}
    reached = {
        (case.plant, case.strategy, case.n, case.seed): float(np.mean(trained[answers[case]["deployed"]][case.plant]))
        for case in plan.cases
    }
    assert written == pytest.approx(reached, rel=1e-5)
    for row in outcomes:
        parts = sum(float(row[part]) for part in ("structure", "identification", "training"))
        assert float(row["gap"]) == pytest.approx(parts, rel=1e-4)
    assert {(row["a"], row["b"]) for row in contrasts} == {("mended", "fitted")}
    record = json.loads((tmp_path / "study.json").read_text())
    assert record["contrasts"] == [f"{a} - {b}" for a, b in CONTRASTS]
    assert (tmp_path / "returns.png").read_bytes().startswith(b"\x89PNG")
    html = (tmp_path / "report.html").read_text()
    assert html.count("data:image/png") == 1 and "http" not in html.replace("http://www.w3.org", "")
