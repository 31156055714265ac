"""Laws of the benchmark's own machinery, and a sample of its cases. The whole: python -m tests.benchmarks."""

import numpy as np
import pytest

from tests.benchmarks import decidability, mujoco_truth, truth
from tests.benchmarks.baseline import find
from tests.benchmarks.cases import INVISIBLE, Case, records, training, world
from tests.benchmarks.experiments import LOGS, World, move, plan, write
from tests.benchmarks.hidden import numbers_of
from tests.benchmarks.methods import ours
from tests.benchmarks.score import exact, first_right, right

pytestmark = pytest.mark.long

CLEAN = LOGS["clean"]
DT = CLEAN.dt


def hidden(effect, size="medium", experiment="steps", seed=0):
    planned = plan(experiment, CLEAN, np.random.default_rng(seed))
    return World(planned, numbers_of(effect, size, DT, float(np.max(np.abs(planned.u)))), 0.0, CLEAN)


def test_truth_converges_with_the_square_of_the_step():
    case = hidden("stribeck")
    reference, *runs = (
        truth.simulate(case.numbers, case.plan.u, case.plan.theta, 0.0, DT, step=h).theta for h in (2e-4, 2e-3, 1e-3)
    )
    coarse, fine = (np.sqrt(np.mean((run - reference) ** 2)) for run in runs)
    assert fine < 0.4 * coarse
    assert fine < 0.02 * CLEAN.theta


def test_a_free_swing_loses_what_friction_takes():
    """Energy: E(0) - E(t) = tau_c times the path, to the accuracy of a path summed over samples."""
    p, tau_c = truth.NEUTRAL, 0.6
    run = truth.simulate({"coulomb.tau_c": tau_c}, np.zeros((1, 3000)), [np.pi + 1.5], 0.0, 2e-3, step=1e-3)
    J, G = p["m"] * p["l"] ** 2 / 3.0, 0.5 * p["m"] * p["g"] * p["l"]
    energy = 0.5 * J * run.theta_dot[0] ** 2 + G * np.cos(run.theta[0])
    path = np.sum(np.abs(np.diff(run.theta[0])))
    assert energy[0] - energy[-1] == pytest.approx(tau_c * path, rel=1e-4)
    assert np.all(run.theta[0, -100:] == run.theta[0, -1]), "it comes to rest, and sticks"


def test_friction_holds_until_the_drive_exceeds_it():
    u = np.repeat([[0.29, 0.31]], 50, axis=1)
    run = truth.simulate({"stribeck.tau_c": 0.1, "stribeck.tau_s": 0.3}, u, [np.pi], 0.0, DT)
    assert np.all(run.theta_dot[0, :51] == 0.0)
    assert np.all(run.theta_dot[0, 51:60] > 0.0)


@pytest.mark.parametrize("effect", ["", "coulomb", "tilt"])
def test_both_engines_agree(effect):
    pytest.importorskip("mujoco", reason="the second engine needs the extra [sim]")
    case = hidden(effect or "coulomb")
    numbers, planned = (dict(case.numbers) if effect else {}), case.plan
    both = [engine.simulate(numbers, planned.u[:3], planned.theta[:3], 0.0, DT) for engine in (truth, mujoco_truth)]
    assert np.max(np.abs(both[0].theta - both[1].theta)) < 0.3 * CLEAN.theta
    assert np.max(np.abs(both[0].theta_dot - both[1].theta_dot)) < 0.1 * CLEAN.theta_dot


def test_evidence_is_what_a_refit_without_the_effect_leaves():
    """The linear response against finite differences of the machine itself, for a small effect."""
    case = World(hidden("drag").plan, {"drag.c": 2e-5}, 0.0, CLEAN)
    planned, bare = case.plan, {"m": truth.NEUTRAL["m"], "l": truth.NEUTRAL["l"]}

    def read(numbers, theta=0.0, theta_dot=0.0):
        run = truth.simulate(numbers, planned.u, planned.theta + theta, theta_dot, DT, step=1e-3)
        return np.stack([run.theta / CLEAN.theta, run.theta_dot / CLEAN.theta_dot], axis=-1)

    nominal, step = read(bare), 1e-5
    starts = [(read(bare, **{k: step}) - nominal) / step for k in ("theta", "theta_dot")]
    base = [((read(bare | {k: bare[k] + step}) - nominal) / step).ravel() for k in ("m", "l")]
    lanes = np.eye(len(planned.theta))[:, :, None, None]
    absorbed = np.stack([*base, *((lane * s).ravel() for s in starts for lane in lanes)], axis=1)
    z = (read(case.numbers) - nominal).ravel()
    rest = z - absorbed @ np.linalg.lstsq(absorbed, z, rcond=None)[0]
    assert decidability.decide(case, "drag").evidence == pytest.approx(rest @ rest, rel=0.05)


@pytest.mark.parametrize("effect", INVISIBLE)
def test_what_mass_and_length_absorb_leaves_no_evidence(effect):
    assert decidability.decide(hidden(effect), effect).evidence < 1.0


def test_the_baseline_names_what_a_careful_engineer_names():
    effects = ("viscous", "coulomb", "torque_bias", "ripple", "lag", "saturation")
    worlds = [hidden(effect) for effect in effects]
    rng = np.random.default_rng(1)
    logs = [write(motion, w.plan, CLEAN, rng) for motion, w in zip(move(worlds), worlds, strict=True)]
    named = [find(log).chosen[:1] == (effect,) for log, effect in zip(logs, effects, strict=True)]
    assert sum(named) >= 5


def test_a_hidden_effect_is_named():
    case = Case("clean", ("lag",), "small", "mixed", "clean", 7)
    made = world(case)
    assert decidability.decide(training(made), "lag").decidable
    answer = ours(records(case, made), None)
    assert first_right(case, answer)
    assert exact(case, answer)
    assert answer.error_after < 1.1


@pytest.mark.parametrize("what", [(), ("magnet",)])
def test_nothing_and_a_stranger_are_told_from_the_catalogue(what):
    case = Case("strangers" if what else "nothing", what, "own", "multisine", "clean", 7)
    assert right(case, ours(records(case, world(case)), None))
