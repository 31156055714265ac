"""What the command line of policies understands: one dataclass a command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from sysid.cli.command_options import File, Switch, option

Folder = Annotated[Positional[Path], arg(metavar="POLICY")]
Texts = UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True)
class TrainCommand:
    """A controller for a fitted model: swing up and hold, trained on the model with all its effects.

    What is stopped, the same command goes on with.
    """

    model: Annotated[Positional[Path], arg(metavar="MODEL")]
    """A model.json, as sysid writes it."""

    out: Annotated[Path, arg(aliases=["-o"]), option("FOLDER", "policy")] = Path("policy")
    """Where the policy is written: policy.json and policy.safetensors."""

    u_max: Annotated[float | None, option("TORQUE", "the model's")] = None
    """Largest torque [N m] that the policy commands."""

    dt: Annotated[float | None, option("S", "near 0.05, a multiple of the model's")] = None
    """Time between two commands [s]."""

    history: Annotated[int | None, option("K", "what its delays and lags need")] = None
    """How many of its past commands the policy observes: those not yet in effect decide what comes next."""

    randomize: Annotated[str, arg(metavar="none|band:W|posterior|prior")] = "none"
    """What is drawn anew in every training episode. none: nothing. band:0.3: each fitted parameter within 30 % of its
    value. posterior: all of them from the fit's covariance. prior: each within its bounds where these span less
    than a factor of 20; otherwise a plant's number from half to twice its value, an effect's from nothing to twice."""

    range: Annotated[Texts, arg(metavar="NAME=LOW:HIGH", help_behavior_hint="(repeatable)")] = ()
    """With --randomize prior: the range of a parameter, as in m=0.5:2."""

    algorithm: Annotated[str, arg(metavar="shac|sac")] = "shac"
    """How agents learn. shac: from the gradient of the return through the model. sac: soft actor-critic, from
    transitions alone, as in the paper."""

    steps: Annotated[int | None, option("N", "2,048,000 of shac, 75,000 of sac")] = None
    """Commands that each agent gives in training. How long they take here is measured and said when it begins."""

    hidden: Annotated[tuple[int, ...], arg(metavar="N")] = (64, 64)
    """Sizes of the network's hidden layers."""

    agents: Annotated[int, arg(metavar="A")] = 4
    """Agents trained side by side, of seeds SEED, SEED + 1, ...; the best on the model is kept. A few take hardly
    longer than one, and not every one gets near what is possible."""

    seed: Annotated[int, arg(metavar="S")] = 0
    """Where all random numbers of the training come from."""

    effects: File = None
    """The Python file with effects of your own that the model has; it is run."""

    no_references: Switch = False
    """Leave out the optimum and the textbook's controllers on the same model."""

    force: Switch = False
    """Write over files that are there."""


@dataclass(frozen=True)
class EvaluateCommand:
    """What a policy is worth: on the model it was trained on, and on another: the transfer gap."""

    policy: Folder
    """The folder that `train` wrote."""

    model: File = None
    """Another model.json."""

    episodes: Annotated[int, arg(metavar="N")] = 200
    """Start states."""

    seed: Annotated[int, arg(metavar="S")] = 0
    """Where the start states come from; train uses 0."""

    references: Switch = False
    """The optimum and the textbook's controllers on the same model too."""

    json: File = None
    """Write the numbers here."""

    effects: File = None
    """The Python file with effects of your own that a model has; it is run."""

    force: Switch = False
    """Write over files that are there."""


@dataclass(frozen=True)
class ExportPolicyCommand:
    """A policy as ONNX, for a controller that knows nothing of Python."""

    policy: Folder
    """The folder that `train` wrote."""

    out: Annotated[Path, arg(aliases=["-o"]), option("FILE", "policy.onnx")] = Path("policy.onnx")
    """Where it is written."""

    effects: File = None
    """The Python file with effects of your own that its model has; it is run."""

    force: Switch = False
    """Write over a file that is there."""


COMMANDS: dict[str, Callable[..., Any]] = {
    "train": TrainCommand,
    "evaluate": EvaluateCommand,
    "export": ExportPolicyCommand,
}
