"""A training step can be launched as one graph: it works in place, and nothing in it waits for the device."""

from itertools import product

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from policies.environments.randomization import Band, RandomForce, Ranges
from policies.training.cuda_graph import CudaGraph
from policies.training.sac import SACPopulation, SACSettings
from policies.training.shac import SHACPopulation, SHACSettings
from study.paper.protocol import paper_model
from sysid import CATALOGUE, Delay, Lag, Model, RodPendulum, SensorDelay
from sysid.physics.effects import effect

SETTINGS = {
    SACPopulation: SACSettings(hidden=(16, 16), batch=32, random_steps=20, steps=450, capacity=40),
    SHACPopulation: SHACSettings(hidden=(16, 16), environments=8, horizon=5, steps=4000),
}
BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Ranges.of(paper_model(), ("m", "l"))]
RANDOM_FORCES = [RandomForce(BANDS[0], 0.5, 0.1), BANDS[1]]
MODELS = {
    "paper": paper_model(),
    "forced": paper_model(),
    "history": Model(RodPendulum(), (Delay(T=0.12), Lag(T=0.1), SensorDelay(T=0.07)), dt=0.05, u_max=2.0),
}

SINGLE = {name: Model(RodPendulum(), (effect(name),), dt=0.05, u_max=2.0).machine for name in sorted(CATALOGUE)}
CARRIED = {name: model for name, model in SINGLE.items() if not any(e.ahead for e in model.input_effects)}


def make(name="paper", algorithm=SACPopulation, device="cpu"):
    randomizations, history = RANDOM_FORCES if name == "forced" else BANDS, 3 if name == "history" else 0
    population = algorithm((MODELS | CARRIED)[name], randomizations, (0, 1), SETTINGS[algorithm], device, history)
    population.train(30)
    return population


def numbers(population):
    """Everything that a step changes, but for counters."""
    replayed = [population.replay.storage.rows] if isinstance(population, SACPopulation) else [population._ended]
    return [*replayed, *population.loss.parameters(), population.observation, population.returns, *population.env._kept]


class Waiting(TorchDispatchMode):
    """Records the operations that bring a number from the device to the host."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.name()
        if name in ("aten::_local_scalar_dense", "aten::item", "aten::is_nonzero", "aten::nonzero", "aten::equal"):
            self.calls.append(name)
        return function(*args, **(kwargs or {}))


class FromHost(TorchFunctionMode):
    """Records the calls that bring a number from the host to the device."""

    MAKERS = (torch.tensor, torch.as_tensor, torch.from_numpy)

    def __init__(self):
        super().__init__()
        self.calls = []

    def __torch_function__(self, function, types, args=(), kwargs=None):
        scalar = function is torch.where and any(isinstance(v, float | int) for v in args)
        if function in self.MAKERS or scalar:
            self.calls.append(function.__name__)
        return function(*args, **(kwargs or {}))


EVERY = [*product(MODELS, SETTINGS), *((name, SHACPopulation) for name in CARRIED)]


@pytest.mark.parametrize(("name", "algorithm"), EVERY)
def test_a_learning_step_never_waits_for_the_device_and_brings_it_nothing(name, algorithm):
    population = make(name, algorithm)
    with Waiting() as waiting, FromHost() as bringing:
        population._learn()
    assert waiting.calls == [] and bringing.calls == []


def test_what_waits_for_the_device_or_brings_it_something_is_seen():
    with Waiting() as waiting, FromHost() as bringing:
        float(torch.ones(2).sum())
        torch.as_tensor(1.0), torch.where(torch.tensor([True]), torch.zeros(1), 1.0)
    assert waiting.calls != [] and bringing.calls == ["as_tensor", "tensor", "where"]


@pytest.mark.long
@pytest.mark.parametrize("algorithm", SETTINGS)
@pytest.mark.parametrize("name", MODELS)
def test_a_recorded_step_repeats_what_the_step_does(name, algorithm):
    """What a CUDA graph does with it: the same operations on the same tensors, without the Python around them."""
    stepped, replayed = make(name, algorithm), make(name, algorithm)
    graph = make_fx(lambda: replayed._learn())()  # noqa: PLW0108  (a bound method counts self as an argument)
    for _ in range(16):  # enough for the replay's ring to be full
        stepped._learn()
    with torch.no_grad():
        for _ in range(15):
            graph()
    assert all(map(torch.equal, numbers(stepped), numbers(replayed)))


def test_work_on_a_cpu_is_called_as_it_is():
    calls = []
    replayed = CudaGraph(lambda: calls.append(1), torch.device("cpu"))
    for _ in range(6):
        replayed()
    assert len(calls) == 6


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("algorithm", SETTINGS)
@pytest.mark.parametrize("name", MODELS)
def test_a_graph_on_a_gpu_does_what_the_steps_do(name, algorithm):
    here, there = (make(name, algorithm, device) for device in ("cpu", "cuda"))
    steps = 30 if algorithm is SACPopulation else 8 * SETTINGS[algorithm].window
    here.train(steps), there.train(steps)
    (work,) = (work for work in vars(there).values() if isinstance(work, CudaGraph))
    assert work._graph is not None
    for ours, theirs in zip(numbers(here), numbers(there), strict=True):
        torch.testing.assert_close(ours, theirs.cpu(), rtol=1e-3, atol=1e-3)
