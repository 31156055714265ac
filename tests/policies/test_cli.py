"""The command line: a policy from a model.json, what it is worth elsewhere, and what is said to wrong input."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sysid
from policies.__main__ import main
from policies.cli.commands import CHECKPOINT, LONGEST_HISTORY, history_for, plausible_range
from policies.control import references
from policies.control.dynamic_programming import Grid
from policies.environments.machine import past_commands_needed
from policies.environments.randomization import Fixed
from policies.evaluation import evaluate, fresh_start_states
from policies.storage.policy_file import DESCRIPTION, WEIGHTS, load_policy
from policies.training.sac import SACPopulation
from study.paper.protocol import paper_model
from sysid import Coulomb, Delay, Lag, Model, RodPendulum, Sensor, Spring, Stamp

ROOT = Path(__file__).parents[2]
TINY = ("--algorithm", "sac", "--agents", "1", "--steps", "60", "--hidden", "8", "8", "--no-references")


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A folder of model.json files."""
    folder = tmp_path_factory.mktemp("models")
    rod = RodPendulum(2.0, 1.5, bounds={"m": (1e-3, 1e3), "l": (0.01, 100.0)})
    truth = Model(rod, (Delay(T=0.1), Coulomb(0.2)), dt=0.05)
    rng = np.random.default_rng(0)
    start = np.pi + rng.normal(0.0, 0.3, 2)
    u = 15.0 * np.sin(np.arange(80) * 0.05 * np.array([[3.0], [5.0]]))
    records = Sensor(0.003, 0.05).measure(sysid.simulate(truth, u, start, np.zeros(2)), rng)
    sysid.save(sysid.fit(truth, records, Sensor(0.003, 0.05)), folder / "fitted.json")
    sysid.save(paper_model(2.0, 1.5), folder / "paper.json")
    sysid.save(paper_model(1.0, 1.0), folder / "light.json")
    sysid.save(Model(rod, dt=0.02), folder / "fine.json")
    sysid.save(Model(rod, (Stamp(0.5),), dt=0.05, u_max=1.0), folder / "weak.json")
    sysid.save(Model(rod, (Spring(-100.0),), dt=0.05, u_max=2.0), folder / "unstable.json")
    sysid.save(Model(sysid.LinearAxis(), dt=0.05, u_max=2.0), folder / "axis.json")
    return folder


@pytest.fixture(scope="module")
def policy(models):
    """Trained on paper.json."""
    folder = models / "policy"
    assert main(["train", str(models / "paper.json"), "-o", str(folder), *TINY]) == 0
    return folder


@pytest.fixture
def run(capsys):
    """The command line as a function: exit code, what it printed, what it complained of."""

    def runs(*words):
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return runs


@pytest.mark.long
def test_the_whole_way(models, tmp_path, run, monkeypatch):
    monkeypatch.setattr(references, "COARSE", Grid(60, 61, 5, memory=3))
    folder, answer = tmp_path / "policy", tmp_path / "answer.json"
    options = ("--u-max", 2, "--randomize", "posterior", "--agents", 2, "--steps", 40_000, "--hidden", 8, 8)
    code, said, _ = run("train", models / "fitted.json", "-o", folder, *options)
    assert code == 0
    assert "and its last 3 commands" in said and "agent" in said and "is the best on this model" in said
    curve = [line for line in said.splitlines() if " s" in line and "#" in line]
    assert len(curve) == 3  # the tenths in which the first pendulum's episodes ended
    assert "swing-up, then LQR" in said and "designed without delay, coulomb" in said

    saved = load_policy(folder)
    assert (saved.policy.history, saved.model.dt, saved.model.u_max) == (3, 0.05, 2.0)
    assert saved.about["randomization"]["kind"] == "Posterior"
    assert saved.about["randomization"]["names"] == ["m", "l", "delay.T", "coulomb.tau_c"]
    worth = evaluate(saved.policy, saved.model, *fresh_start_states(0, 200))
    assert saved.about["return"]["mean"] == worth.mean
    assert f"{worth.mean:.1f}" in said

    code, said, _ = run("evaluate", folder, "--model", models / "paper.json", "--json", answer)
    assert code == 0
    result = json.loads(answer.read_text())
    other = evaluate(saved.policy, paper_model(2.0, 1.5), *fresh_start_states(0, 200))
    assert result["own"]["mean"] == worth.mean and result["other"]["mean"] == other.mean
    assert result["gap"]["mean"] == pytest.approx(worth.mean - other.mean)
    low, high = result["gap"]["interval"]
    paired = (worth.returns - other.returns).std(ddof=1) / 200**0.5
    assert high - low == pytest.approx(2.0 * 1.972 * paired, rel=1e-3)
    assert f"{result['gap']['mean']:.1f}" in said


def test_the_same_seed_gives_the_same_policy(models, policy, tmp_path, run):
    assert run("train", models / "paper.json", "-o", tmp_path / "again", *TINY)[0] == 0
    assert (tmp_path / "again" / WEIGHTS).read_bytes() == (policy / WEIGHTS).read_bytes()
    assert run("train", models / "paper.json", "-o", tmp_path / "other", *TINY, "--seed", 1)[0] == 0
    assert (tmp_path / "other" / WEIGHTS).read_bytes() != (policy / WEIGHTS).read_bytes()


def test_on_its_own_model_there_is_no_gap_and_references_stand_beside(models, policy, tmp_path, run, monkeypatch):
    monkeypatch.setattr(references, "FINE", Grid(60, 61, 5))
    answer = tmp_path / "answer.json"
    words = ("evaluate", policy, "--model", models / "paper.json", "--references", "--json", answer, "--episodes", 30)
    assert run(*words)[0] == 0
    result = json.loads(answer.read_text())
    assert result["gap"] == {"mean": 0.0, "interval": [0.0, 0.0], "episodes": 30}
    optimum, swing_up, lqr = result["references"]
    assert optimum["mean"] > swing_up["mean"] > lqr["mean"] and optimum["mean"] > result["own"]["mean"]


def test_the_policy_may_command_less_than_asked_of_a_weaker_machine(models, policy, run):
    code, said, _ = run("evaluate", policy, "--model", models / "weak.json", "--episodes", 5)
    assert code == 0
    assert "weak.json gives at most 1 N m, the policy commands up to 2 N m" in said


def test_another_interval_holds_the_commands_and_history_can_be_asked_for(models, tmp_path, run):
    folder = tmp_path / "policy"
    code, said, _ = run("train", models / "fine.json", "-o", folder, *TINY, "--u-max", 2, "--history", 1)
    assert code == 0 and "a command every 0.04 s" in said and "and its last command" in said
    saved = load_policy(folder)
    assert (saved.model.dt, saved.model.integrator.substeps, saved.policy.history) == (0.04, 4, 1)
    code, _, complaint = run("evaluate", folder, "--model", models / "paper.json")
    assert code == 2
    assert "error: paper.json: the model is integrated in steps of 0.05 s" in complaint


def test_a_long_delay_is_observed_whole():
    """A delay of 0.3 s at 100 Hz is 30 commands; what is longer than the longest history is said."""
    delayed = Model(RodPendulum(), (Delay(T=0.3),), dt=0.01, u_max=2.0)
    assert history_for(delayed, Fixed()) == past_commands_needed(delayed) == 30


def test_a_history_that_is_cut_is_said(caplog):
    slow = Model(RodPendulum(), (Lag(T=5.0),), dt=0.01, u_max=2.0)
    with caplog.at_level("INFO", "policies"):
        assert history_for(slow, Fixed()) == LONGEST_HISTORY
    assert f"observes the last {LONGEST_HISTORY}" in caplog.text


def test_a_policy_for_onnx(models, policy, tmp_path, run):
    onnx = pytest.importorskip("onnx", reason="the extra [onnx] is not installed")
    code, said, _ = run("export", policy, "-o", tmp_path / "p.onnx")
    assert code == 0 and "p.onnx: differs from the policy by at most" in said
    x = np.random.default_rng(0).normal(size=(9, 3)).astype(np.float32)
    (u,) = onnx.reference.ReferenceEvaluator(onnx.load(tmp_path / "p.onnx")).run(None, {"observation": x})
    np.testing.assert_allclose(u[:, 0], load_policy(policy).policy.command(x), atol=2e-5)


def test_without_the_package_onnx_nothing_is_written(policy, tmp_path, run, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    code, _, complaint = run("export", policy, "-o", tmp_path / "p.onnx")
    assert code == 2 and "pip install 'gapfinder[onnx]'" in complaint
    assert list(tmp_path.iterdir()) == []


def test_the_ways_to_randomize(models, tmp_path, run):
    def drawn(*words):
        folder = tmp_path / words[0].replace(":", "_") / "p"
        folder.parent.mkdir()
        code, said, _ = run("train", models / "fitted.json", "-o", folder, *TINY, "--u-max", 2, "--randomize", *words)
        assert code == 0
        return load_policy(folder).about["randomization"], said

    assert drawn("none")[0] == {"kind": "Fixed"}
    band, said = drawn("band:0.3")
    assert band["w"] == 0.3 and band["center"].keys() == {"m", "l", "delay.T", "coulomb.tau_c"}
    low, high = map(float, re.search(r"m (\S+) \.\. ([\d.]+)", said).groups())
    assert 1.4 <= low < 1.42 and 2.58 < high <= 2.61
    prior, _ = drawn("prior", "--range", "m=1.5:2.5")
    assert prior["ranges"]["m"] == [1.5, 2.5]
    assert prior["ranges"]["delay.T"] == pytest.approx([0.0, 0.2], rel=0.05)
    assert prior["ranges"]["l"] == pytest.approx([0.75, 3.0], rel=0.05)


def test_what_is_plausible_where_nobody_measured():
    rod = RodPendulum(2.0, 1.5, bounds={"m": (0.3, 3.0)})
    parameters = Model(rod, (Delay(T=0.2), sysid.TorqueGain(0.8), sysid.Saturation(1.5))).parameters
    assert plausible_range(parameters["m"]) == (0.3, 3.0)  # its bounds
    assert plausible_range(parameters["g"]) == (5.0, 20.0)
    assert plausible_range(parameters["delay.T"]) == (0.0, 0.3)  # as far as its memory reaches
    assert plausible_range(parameters["torque_gain.c"]) == pytest.approx((0.6, 1.0))
    assert plausible_range(parameters["saturation.limit"]) == (0.75, 3.0)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("nowhere.json",), "no such file"),
        (("fitted.json",), "no torque limit: give one with --u-max"),
        (("unstable.json",), "runs away under torques within 2 N m"),
        (("axis.json",), "LinearAxis"),
        (("paper.json", "--u-max", "3"), "beyond the model's own limit"),
        (("paper.json", "--dt", "0.03"), "expected a multiple"),
        (("paper.json", "--history", "-1"), "--history -1"),
        (("paper.json", "--steps", "0"), "--steps 0"),
        (("paper.json", "--agents", "0"), "--agents 0"),
        (("paper.json", "--seed", "-1"), "--seed -1"),
        (("paper.json", "--hidden", "0"), "--hidden 0"),
        (("paper.json", "--algorithm", "ppo"), "algorithm 'ppo': expected one of shac, sac"),
        (("fine.json", "--u-max", "2", "--dt", "0.5", "--history", "30"), "history = 30: expected 0 to 20"),
        (("paper.json", "--randomize", "wide"), "expected none, band:W"),
        (("paper.json", "--randomize", "band"), "'' is no number; expected band:0.3"),
        (("paper.json", "--randomize", "band:2"), "expected a relative width in [0, 1)"),
        (("paper.json", "--randomize", "posterior"), "was never fitted"),
        (("paper.json", "--range", "m=1:2"), "expected --randomize prior with it"),
        (
            ("paper.json", "--randomize", "prior", "--range", "mass=1:2"),
            "unknown parameter 'mass'; this model has m, l, g",
        ),
        (("paper.json", "--randomize", "prior", "--range", "m=1"), "is no number; expected m=0.5:2"),
        (("paper.json", "--randomize", "prior", "--range", "m=1:9"), "out of bounds"),
        (("paper.json", "--randomize", "prior", "--range", "m=2:1"), "expected (low, high)"),
        (("paper.json", "-o", "nowhere/policy"), "there is no folder"),
        (("paper.json", "-o", "paper.json"), "is a file: expected a folder"),
        (("paper.json", "--effects", "nowhere.py"), "no such file"),
    ],
)
def test_what_cannot_be_trained_ends_with_a_sentence(models, run, monkeypatch, words, complaint):
    monkeypatch.chdir(models)
    before = {path: path.read_bytes() for path in models.glob("*.json")}
    code, said, complained = run("train", *words, *(() if "-o" in words else ("-o", "fresh")))
    assert code == 2 and "training" not in said
    assert complained.startswith("error: ") and complained.count("\n") == 1 and complaint in complained
    assert not (models / "fresh").exists() and before == {path: path.read_bytes() for path in models.glob("*.json")}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("evaluate", "nowhere"), "no such file"),
        (("evaluate", "policy", "--model", "nowhere.json"), "no such file"),
        (("evaluate", "policy", "--model", "policy/policy.json"), "no model of ours|schema"),
        (("evaluate", "policy", "--model", "unstable.json"), "unstable.json: the model runs away"),
        (("evaluate", "policy", "--model", "axis.json"), "axis.json: the plant is a LinearAxis"),
        (("evaluate", "policy", "--episodes", "1"), "--episodes 1"),
        (("evaluate", "policy", "--seed", "-1"), "--seed -1"),
        (("evaluate", "policy", "--json", "paper.json"), "is there already"),
        (("evaluate", "policy", "--json", "policy/policy.json", "--force"), "is read by this command"),
        (("evaluate", "policy", "--json", "nowhere/answer.json"), "there is no folder"),
        (("export", "policy", "-o", "policy"), "is a folder: expected a file"),
        (("export", "policy", "-o", "paper.json"), "is there already"),
    ],
)
def test_what_cannot_be_judged_ends_with_a_sentence(models, policy, run, monkeypatch, words, complaint):
    monkeypatch.chdir(models)
    before = {path: path.read_bytes() for path in (*models.glob("*.json"), *policy.iterdir())}
    code, _, complained = run(*words)
    assert code == 2
    assert complained.startswith("error: ") and complained.count("\n") == 1
    assert any(part in complained for part in complaint.split("|"))
    assert before == {path: path.read_bytes() for path in (*models.glob("*.json"), *policy.iterdir())}


def test_a_policy_is_replaced_only_when_asked(models, policy, tmp_path, run):
    folder = tmp_path / "policy"
    words = ("train", models / "paper.json", "-o", folder, *TINY)
    assert run(*words)[0] == 0
    before = (folder / DESCRIPTION).read_bytes()
    code, _, complaint = run(*words, "--seed", 1)
    assert code == 2 and "is there already" in complaint
    assert (folder / DESCRIPTION).read_bytes() == before
    assert run(*words, "--seed", 1, "--force")[0] == 0
    assert load_policy(folder).about["seeds"] == [1]


def test_a_training_that_is_stopped_writes_nothing(models, tmp_path, run, monkeypatch):
    def stopped(self, steps):
        raise KeyboardInterrupt

    monkeypatch.setattr(SACPopulation, "train", stopped)
    code, _, complaint = run("train", models / "paper.json", "-o", tmp_path / "policy", *TINY)
    assert (code, complaint) == (130, "stopped\n")
    assert list(tmp_path.iterdir()) == []


def test_what_was_stopped_goes_on_and_not_as_another_training(models, tmp_path, run, monkeypatch):
    def stopped(self, steps):
        go_on(self, steps)
        raise KeyboardInterrupt

    go_on, folder = SACPopulation.train, tmp_path / "policy"
    monkeypatch.setattr(SACPopulation, "train", stopped)
    assert run("train", models / "paper.json", "-o", folder, *TINY)[0] == 130
    monkeypatch.setattr(SACPopulation, "train", go_on)
    before = (folder / CHECKPOINT).read_bytes()
    for words, complaint in ((("--history", 1), "a checkpoint with history = 0"), (("--seed", 1), "with seeds = [0]")):
        code, _, complained = run("train", models / "paper.json", "-o", folder, *TINY, *words)
        assert code == 2 and complaint in complained and complained.count("\n") == 1
        assert [path.name for path in folder.iterdir()] == [CHECKPOINT]
        assert (folder / CHECKPOINT).read_bytes() == before
    code, said, _ = run("train", models / "paper.json", "-o", folder, *TINY)
    assert code == 0 and f"going on from {folder / CHECKPOINT}" in said and not (folder / CHECKPOINT).exists()


@pytest.mark.long
@pytest.mark.parametrize(("algorithm", "steps"), [("sac", 450), ("shac", 30_000)])
def test_the_time_is_measured_and_a_control_rate_is_advised(algorithm, steps, models, tmp_path, run):
    words = ("-o", tmp_path / "p", "--algorithm", algorithm, "--hidden", 8, "--no-references", "--steps")
    code, said, _ = run("train", models / "paper.json", *words, steps)
    assert code == 0 and re.search(r"this takes about \d+ s here", said) and re.search(r"\d+ s, \d+ s left", said)
    assert "suits this machine" not in said
    code, said, _ = run("train", models / "fine.json", *words, steps // 10, "--force", "--u-max", 2, "--dt", 0.3)
    assert "a command every 0.3 s is more than it can wait: --dt from 0.016 to 0.16 suits this machine" in said


def test_an_effect_of_the_users_own_is_trained_on_and_needed_again(tmp_path, run):
    effects_file = tmp_path / "own.py"
    effects_file.write_text(
        "from dataclasses import dataclass\n"
        "from sysid import JointEffect, ops, parameter, register\n\n"
        "@register\n@dataclass(frozen=True, eq=False)\n"
        "class Magnet(JointEffect):\n"
        "    a: ops.Value = parameter(0.0, unit='N m', bounds=(0.0, 9.0), neutral=0.0)\n\n"
        "    def torque(self, joint):\n"
        "        return -self.a * ops.sin(2.0 * joint.theta)\n"
    )
    before = dict(sysid.CATALOGUE)
    try:
        sysid.load_effects(effects_file)
        magnetic = dataclasses.replace(paper_model(), effects=(sysid.effect("magnet", a=0.3),))
        sysid.save(magnetic, tmp_path / "model.json")
        words = ("train", tmp_path / "model.json", "-o", tmp_path / "policy", *TINY)
        assert run(*words, "--effects", effects_file)[0] == 0
        assert run("evaluate", tmp_path / "policy", "--effects", effects_file, "--episodes", 5)[0] == 0
    finally:
        sysid.CATALOGUE.clear()
        sysid.CATALOGUE.update(before)
    code, _, complaint = run("evaluate", tmp_path / "policy")
    assert code == 2 and "magnet" in complaint


@pytest.mark.parametrize("words", [(), ("train",), ("evaluate",), ("export",)])
def test_help_answers_without_torch(words):
    code = (
        "import sys; from policies.__main__ import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: print(sorted({'torch', 'scipy', 'control'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words, "--help"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip().endswith("[]") and "usage" in done.stdout


@pytest.mark.long
def test_as_a_module(models, policy):
    words = [sys.executable, "-m", "policies", "evaluate", str(policy), "--episodes", "5"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "on its own model" in done.stdout
    words[4] = str(models / "nowhere")
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_plausible_ranges_stay_within_the_bounds():
    for kind in sysid.CATALOGUE.values():
        for p in Model(RodPendulum(2.9, 0.31), (kind(),)).parameters.values():
            low, high = plausible_range(p)
            assert p.bounds[0] <= low <= high <= p.bounds[1]
