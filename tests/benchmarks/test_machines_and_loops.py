"""Laws of the machines in a loop, of coarse and flexible ones, and of how their logs are written and kept."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from tests.benchmarks import coarse_truth, mujoco_truth, truth
from tests.benchmarks.cases import COLUMNS, ENGINES, RATE, Case, named, records, training, world
from tests.benchmarks.experiments import ENCODER, KD, KP, SERVOS, Log, Servo, World, move, plan, played, write
from tests.benchmarks.methods import Answer, thinned
from tests.benchmarks.readme_example import HIDDEN, example, right, subsets
from tests.benchmarks.runner import Store, run

pytestmark = pytest.mark.long

SHORT = Log(seconds=2.0, rollouts=3, theta=0.001, angle_step=ENCODER)
HIDDEN_NUMBERS = {"coulomb.tau_c": 0.2, "delay.T": 0.03}


def experiment(name, log=SHORT, seed=0):
    return plan(name, log, np.random.default_rng(seed))


def run_of(engine, planned, dt, numbers=None, **settings):
    return engine(numbers or {}, planned.u, planned.theta, 0.0, dt, **settings)


@pytest.mark.parametrize("engine", [truth.simulate, coarse_truth.simulate])
def test_a_servo_without_gains_is_no_servo(engine):
    planned = experiment("steps")
    servo = Servo(np.zeros_like(planned.u), SHORT, np.random.default_rng(1), kp=0.0, kd=0.0)
    looped, opened = (run_of(engine, planned, SHORT.dt, feedback=f) for f in (servo, None))
    assert np.array_equal(looped.theta, opened.theta)
    assert np.array_equal(looped.u, planned.u)


@pytest.mark.parametrize("name", SERVOS)
@pytest.mark.parametrize("log", [SHORT, replace(SHORT, theta_dot=None, differenced=True), replace(SHORT, rate=200.0)])
def test_the_log_holds_the_readings_that_its_servo_read(name, log):
    """u = KP (aim - theta) - KD theta_dot in every row, although the loop ran in one simulation and the log is written
    by another, which plays the commands back; a first row has no difference behind it."""
    made = World(experiment(name, log), HIDDEN_NUMBERS, 0.0, log)
    closed = played(made, np.random.default_rng(1))
    (motion,) = move([closed])
    for record, aim in zip(write(motion, closed.plan, log, np.random.default_rng(1)), made.plan.aim, strict=True):
        assert record.u == pytest.approx(KP * (aim - record.theta[:-1]) - KD * record.theta_dot[:-1], abs=1e-9)


def test_an_encoder_is_half_a_step_off_at_most_and_differences_add_up_to_its_angle():
    log = replace(SHORT, theta=0.0, theta_dot=None, differenced=True)
    planned = experiment("steps", log)
    (motion,) = move([World(planned, {}, 0.0, log)])
    for i, record in enumerate(write(motion, planned, log, np.random.default_rng(0))):
        assert np.max(np.abs(record.theta - motion.theta[i])) <= 0.5 * ENCODER + 1e-12
        assert record.theta[0] + log.dt * np.cumsum(record.theta_dot) == pytest.approx(record.theta)


def test_a_link_on_a_stiff_spring_moves_as_a_rigid_one():
    """The static deflection falls with the square of the resonance, and so does what is left of the difference."""
    planned = experiment("multisine")
    rigid, *flexible = (
        run_of(truth.simulate, planned, SHORT.dt, {"flexible.f": f}).theta for f in (np.inf, 40.0, 80.0, 160.0)
    )
    off = [np.sqrt(np.mean((theta - rigid) ** 2)) for theta in flexible]
    assert off[1] < 0.35 * off[0]
    assert off[2] < 0.35 * off[1]
    assert off[2] < 1e-3


def test_a_flexible_joint_rings_at_its_resonance():
    """Both inertias free of gravity: the motor swings about their common motion at f, losing exp(-2 pi zeta) a turn."""
    f, dt = 12.0, 1e-3
    numbers = {"flexible.f": f, "flexible.zeta": 0.02, "g": 1e-9}
    u = np.zeros((1, 1000))
    u[0, :10] = 5.0
    motion = truth.simulate(numbers, u, [np.pi], 0.0, dt)
    speed = motion.theta_dot[0, 11:] - np.mean(motion.theta_dot[0, -500:])
    rises = np.flatnonzero((speed[:-1] < 0.0) & (speed[1:] >= 0.0))
    assert 1.0 / (np.mean(np.diff(rises)) * dt) == pytest.approx(f, rel=0.01)
    turns = (len(speed) - 200) * dt * f
    fell = np.ptp(speed[-100:]) / np.ptp(speed[:100])
    assert np.log(fell) == pytest.approx(-2.0 * np.pi * 0.02 * (turns + 100 * dt * f), rel=0.1)


@pytest.mark.parametrize("numbers", [{}, {"viscous.b": 0.1}, {"coulomb.tau_c": 0.12}])
def test_the_coarse_simulator_nears_the_fine_one_with_its_step(numbers):
    planned = experiment("steps")
    fine = run_of(truth.simulate, planned, SHORT.dt, numbers).theta
    off = [
        np.sqrt(np.mean((run_of(coarse_truth.simulate, planned, SHORT.dt, numbers, step=h).theta - fine) ** 2))
        for h in (4e-3, 2e-3, 1e-3)
    ]
    assert off[1] == pytest.approx(0.5 * off[0], rel=0.2)
    assert off[2] == pytest.approx(0.5 * off[1], rel=0.2)


def test_what_a_coarse_simulator_lacks_is_said():
    planned = experiment("steps")
    with pytest.raises(KeyError, match="tilt"):
        run_of(coarse_truth.simulate, planned, SHORT.dt, {"tilt.alpha": 0.1})


def test_mujoco_delays_as_the_truth_does():
    pytest.importorskip("mujoco", reason="the second engine needs the extra [sim]")
    planned = experiment("steps")
    both = [
        run_of(engine, planned, SHORT.dt, {"delay.T": 0.03}).theta for engine in (truth.simulate, mujoco_truth.simulate)
    ]
    assert np.max(np.abs(both[0] - both[1])) < 1e-3


@pytest.mark.parametrize("engine", ["euler", "mujoco by default"])
def test_semi_implicit_euler_shows_the_angle_half_a_step_early(engine):
    """theta = theta(t + h/2) and theta_dot = theta_dot(t) to first order: each is off by the other's part of it."""
    if engine != "euler":
        pytest.importorskip("mujoco", reason="the second engine needs the extra [sim]")
    step = {"euler": 1e-3, "mujoco by default": mujoco_truth.DEFAULT_STEP}[engine]
    planned = experiment("multisine")
    fine, coarse = (run_of(simulate, planned, SHORT.dt) for simulate in (truth.simulate, ENGINES[engine]))
    early = fine.theta + 0.5 * step * fine.theta_dot
    assert np.std(coarse.theta - early) < 0.1 * np.std(coarse.theta - fine.theta)
    assert np.std(coarse.theta_dot - fine.theta_dot) < 1e-4


def test_a_fast_log_is_decided_at_the_rate_at_which_it_is_read():
    case = next(c for c in COLUMNS["fast"](0) if c.log == "200 Hz" and c.hidden == ("coulomb",))
    made = world(case)
    log, thin = thinned(records(case, made)), training(made)
    assert 1.0 / log.dt == pytest.approx(RATE)
    assert thin.log.rate == pytest.approx(RATE)
    assert thin.plan.u == pytest.approx(np.array([r.u for r in log[: len(thin.plan.u)]]))


@pytest.mark.parametrize("column", list(COLUMNS))
def test_a_case_is_found_again_by_its_key(column):
    cases = list(COLUMNS[column](3))
    assert len({c.key for c in cases}) == len(cases)
    assert named(cases[-1].key) == cases[-1]


def invented(case, methods, known):
    """An answer without any work."""
    return {}, {m: asdict(Answer("missing", named=(("coulomb",), ("delay", "sensor_delay")))) for m in methods}


def test_a_resumed_run_asks_only_what_is_open(tmp_path):
    store, cases = Store(tmp_path), [example(seed) for seed in range(3)]
    first, second = (
        [c.seed for c, *_ in run(asked, ["ours"], store, 1, solve=invented)] for asked in (cases[:2], cases)
    )
    assert sorted(first) == [0, 1]
    assert second == [2]
    assert all(right(c, store.answers("ours")[c.key]) for c in cases)


def test_every_two_and_more_of_eight_logs():
    assert len({c.key for c in subsets(0)}) == 247
    assert example(0) in list(subsets(0))


@pytest.mark.parametrize(
    "answer",
    [
        Answer("missing", named=(("coulomb",),)),
        Answer("missing", named=(("coulomb",), ("delay",), ("viscous",))),
        Answer("partly", named=(("coulomb",), ("delay",))),
    ],
)
def test_less_more_and_a_remainder_are_not_exactly_the_two(answer):
    assert not right(Case("readme", HIDDEN, "own", "swings", "12345678", 0), answer)
