"""Every example runs, and says what is wrong with wrong input."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sysid
from sysid.planning.excitation import multisine

EXAMPLES = Path(__file__).parents[1] / "examples"
PNG = b"\x89PNG"


def run(name, *arguments, timeout=300, cwd=None):
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False, cwd=cwd)


def said_by(name, *arguments, **options):
    """What an example prints that ends well."""
    done = run(name, *arguments, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def imported(name):
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("compare_sysid", ["--fast"], "--fast"),
        ("compare_sysid", ["--workers", "0"], "at least 1"),
        ("compare_sysid", ["--seeds", "0"], "at least 1"),
        ("compare_sysid", ["--json", "."], "cannot write"),
        ("compare_sysid", ["--seeds", "1000000000"], "expected at most 10,000"),
        ("optimal_returns", ["--grid", "121"], "even number"),
        ("optimal_returns", ["--grid", "1000000"], "too large"),
        ("paper_claims", ["--seeds", "1"], "at least 2"),
        ("paper_claims", ["--seeds", "1000000000"], "expected at most 100,000"),
        ("paper_claims", ["--seeds", "2", "--figure", "."], "cannot write"),
        ("compare_sweeps", [f"study/results/{preset}/runs.csv" for preset in ("robustness", "paper")], "share no cell"),
        ("hidden_effect", ["--seed", "-1"], "0 or more"),
        ("hidden_effect", ["--figure", "picture"], ".png"),
        ("hidden_effect", ["--html", "."], "cannot write"),
        ("sim_to_real", ["--seed", "-1"], "0 or more"),
        ("sim_to_real", ["--episodes", "1"], "0 or more"),
        ("sim_to_real", ["--episodes", "1000000000"], "expected at most 100,000"),
        ("sim_to_real", ["--train", "-1"], "0 or more"),
    ],
)
def test_wrong_input_is_refused(name, arguments, message, capsys):
    with pytest.raises(SystemExit, match="2"):
        imported(name).main(arguments)
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("hidden_effect", ["--only-log", "--log"]),
        ("hidden_effect", ["--only-log", "--html"]),
        ("compare_sysid", ["--json"]),
    ],
)
def test_a_link_to_itself_is_refused(name, arguments, tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    done = run(f"{name}.py", *arguments, tmp_path / "loop", cwd=tmp_path)
    assert done.returncode == 2
    assert "error: cannot write " in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_compare_sysid(tmp_path):
    numbers, figure = tmp_path / "out.json", tmp_path / "new" / "figure.png"
    said_by("compare_sysid.py", "--quick", "--seeds", "4", "--json", numbers, "--figure", figure)
    results = json.loads(numbers.read_text())
    assert set(results) == {"paper", "encoder"}
    for setting in results.values():
        assert set(setting) == {"grid", "least_squares", "ukf"}
        for method in setting.values():
            assert method["n"] == [1, 5, 10]
            for name in ("rms_error", "crb", "ratio", "coverage", "seconds"):
                assert len(method[name]) == 3
            # more rollouts tell more, and nobody beats the bound by more than chance
            assert method["crb"] == sorted(method["crb"], reverse=True)
            assert min(method["ratio"]) > 0.3
        # the grid's bias is far above what the same readings allow, and least squares takes it out
        assert setting["grid"]["rms_error"][2] > 10 * setting["least_squares"]["rms_error"][2]
        assert max(setting["least_squares"]["ratio"]) < 2.0
    assert figure.read_bytes().startswith(PNG)


@pytest.mark.long
def test_optimal_returns():
    _, *lines = said_by("optimal_returns.py", "--grid", "120").splitlines()
    best = {(2.0, 1.5): -330.7, (1.5, 1.2): -215.2, (2.5, 2.0): -523.6, (1.0, 1.0): -139.1}  # at 600 x 601 states
    assert len(lines) == len(best)
    for line in lines:
        m, l, optimal, swing_up, lqr, _ = map(float, line.split())  # noqa: E741
        assert optimal == pytest.approx(best[m, l], rel=0.05)
        assert lqr < swing_up


@pytest.mark.long
def test_paper_claims(tmp_path):
    said = said_by("paper_claims.py", "--seeds", "60", "--figure", tmp_path / "claims.png")
    assert '"the identification error falls roughly as 1/√n" (Sec. II-B): does not hold.' in said
    assert "29 distinct ones" in said
    assert "15 keep a t interval without zero and 10 survive Holm" in said
    assert (tmp_path / "claims.png").read_bytes().startswith(PNG)


def test_compare_sweeps():
    """The committed sweeps of small and large networks: cells of both, and all pairs with data."""
    said = said_by("compare_sweeps.py", "study/results/paper-small/runs.csv", "study/results/paper/runs.csv")
    _, *lines, last = said.splitlines()
    assert [int(line.split()[1]) for line in lines] == [n for n in (0, 5, 10, 25, 50) for _ in range(5)]
    assert "-359 ± 10 (-349)" in lines[10] and "-341 ±  5 (-339)" in lines[10] and "+17 [+1, +34]" in lines[10]
    assert last.startswith("all 200 pairs with data")


def test_hidden_effect_writes_only_the_log(tmp_path):
    said_by("hidden_effect.py", "--only-log", "--log", tmp_path / "log", "--figure", tmp_path / "no.png")
    assert len(list((tmp_path / "log").glob("swing*.csv"))) == 8
    assert not (tmp_path / "no.png").exists()


@pytest.mark.long
def test_tour_runs():
    """The notebook from beginning to end; what it finds, it asserts itself. Stored without outputs."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install -e '.[dev]'")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed: pip install -e '.[dev]'")
    import nbformat

    notebook = nbformat.read(EXAMPLES / "tour.ipynb", as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=str(EXAMPLES))
    assert "times the noise of the sensors" in cells[-1].outputs[0].text


@pytest.mark.long
def test_own_strategy(tmp_path):
    """A user's strategy beside one of ours, from its dialogue to the page."""
    said = said_by("own_strategy.py", timeout=1800, cwd=tmp_path)
    assert "Which strategy beats the point estimate?" in said
    cases = (tmp_path / "results" / "own_strategy" / "cases.csv").read_text()
    assert "own_strategy.py:TestedBand,5," in cases
    assert "tested band" in (tmp_path / "results" / "own_strategy" / "report.html").read_text()


@pytest.mark.long
def test_own_effect():
    without, with_magnet = said_by("own_effect.py").split("with:")
    assert "unknown: " in without
    assert "\nmissing: magnet (k = 0.30" in with_magnet


@pytest.mark.long
def test_real_log(tmp_path):
    """On a log that names its columns as the public ones do, from the hanging position."""
    truth = sysid.Model(sysid.GeneralJoint(J=0.15, G=3.0), (sysid.Coulomb(0.15),), dt=0.01)
    rng = np.random.default_rng(3)
    u = multisine(rng, 1200, truth.dt, 3.0, 2.0)
    (record,) = sysid.Sensor(0.002, 0.05).measure(sysid.simulate(truth, u, 3.0, 0.0), rng)
    table = np.column_stack([record.t, record.theta - np.pi, record.theta_dot, np.append(record.u, 0.0)])
    header = "time_s,angle_rad,velocity_rad_s,torque_meas_Nm"
    np.savetxt(tmp_path / "rig.csv", table, "%.8g", ",", header=header, comments="")
    (tmp_path / "rig.json").write_text('{"sign_convention": "angle 0 = hanging down"}')
    said = said_by("real_log.py", tmp_path / "rig.csv", "--out", tmp_path / "results")
    assert said.count("$ python -m sysid") == 4
    assert "--zero hanging" in said
    assert "\nmissing: coulomb" in said
    for figure in ("before.png", "after.png"):
        assert (tmp_path / "results" / figure).read_bytes().startswith(PNG)


def test_real_log_refuses_what_is_no_log(tmp_path):
    assert "no such file" in run("real_log.py", tmp_path / "absent.csv").stderr
    (tmp_path / "notes.csv").write_text("name,colour\nbob,red\n")
    done = run("real_log.py", tmp_path / "notes.csv", "--out", tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: notes.csv has no t: found name, colour")


@pytest.mark.long
def test_hidden_effect(tmp_path):
    log, figure, report, numbers = (tmp_path / name for name in ("log", "figure.png", "report.html", "out.json"))
    said_by("hidden_effect.py", "--log", log, "--figure", figure, "--html", report, "--json", numbers)
    diagnosis = json.loads(numbers.read_text())
    assert diagnosis["verdict"] == "missing"
    assert {step["effect"] for step in diagnosis["steps"]} == {"coulomb", "delay"}
    assert diagnosis["base_error"] > 4.0
    assert diagnosis["error"] < 1.1
    for name, truth in (("coulomb.tau_c", 0.15), ("delay.T", 0.05)):
        assert abs(diagnosis["parameters"][name]["value"] - truth) < 4.0 * diagnosis["parameters"][name]["sd"]
    assert len(list(log.glob("swing*.csv"))) == 8
    assert figure.read_bytes().startswith(PNG)
    assert report.read_text(encoding="utf-8").startswith("<!doctype html>")


@pytest.mark.long
def test_sim_to_real(monkeypatch, capsys):
    """A short log and a coarse table: what a machine in another simulator lacks is named, and what the policy of the
    mended model promises is measured there; that of the fitted model promises as much, and falls short."""
    pytest.importorskip("mujoco", reason="the machine needs the extra [sim]")
    example = imported("sim_to_real")
    monkeypatch.setattr(example, "ROLLOUTS", 2)
    monkeypatch.setattr(example, "GRID", example.Grid(120, 121, u=11, memory=3, theta_dot_max=12.0))
    assert example.main(["--episodes", "8"]) == 0
    said = capsys.readouterr().out
    sizes = {
        name: [float(x) for x in re.search(rf"{name} = (\S+) \+- (\S+) ", said).groups()] for name in ("T", "tau_c")
    }
    assert abs(sizes["T"][0] - 0.12) < 0.002
    assert abs(sizes["tau_c"][0] - 0.2) < 0.01
    rows = {line[:16].strip(): re.findall(r"(\S+) \+- (\S+)", line) for line in said.splitlines()[-2:]}
    (promised, _), (measured, error), _ = ((float(a), float(b)) for a, b in rows["the mended model"])
    assert abs(measured - promised) < error
    (promised, _), (measured, _), (difference, error) = ((float(a), float(b)) for a, b in rows["the fitted model"])
    assert difference < -4.0 * error


@pytest.mark.long
def test_another_algorithm(tmp_path, monkeypatch):
    """TorchRL's TD3 learns from a model's file; the policy observes the commands that a delay holds back."""
    example = imported("another_algorithm")
    light = sysid.Model(sysid.RodPendulum(0.3, 0.6), (sysid.Viscous(0.3), sysid.Delay(T=0.1)), dt=0.05, u_max=2.0)
    sysid.save(light, tmp_path / "model.json")
    example.torch.manual_seed(0)
    machine = example.machine_of(sysid.load(tmp_path / "model.json").model)
    starts = example.fresh_start_states(0, 20)
    before, after = (example.evaluate(example.train(machine, steps), machine, *starts) for steps in (0, 600))
    assert example.train(machine, 0).history == 2
    assert after.mean > 0.7 * before.mean, (before, after)
    assert len((EXAMPLES / "another_algorithm.py").read_text().splitlines()) <= 60


@pytest.mark.long
def test_workbench(tmp_path):
    pytest.importorskip("dash", reason="the workbench needs the extra web")
    pytest.importorskip("playwright", reason="a browser is driven by playwright, of the extra dev")
    if not (shutil.which("chromium") or shutil.which("chromium-browser")):
        pytest.skip("no Chromium is installed: apt-get install chromium")
    said_by("workbench.py", "--folder", tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["workbench_mended.png", "workbench_missing.png"]
