"""What an agent trains on, as plain data too."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from policies.environments.randomization import Randomization, from_json
from study.pipeline.settings import digest
from study.trials.learned_torque import CommandFilter, ResidualNetwork, stacked
from study.trials.outside_effects import OUTSIDE
from sysid import Model
from sysid.estimation.saved_model import from_dict, to_dict


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """What an agent trains on.

    Parameters
    ----------
    model : Model
        The machine at the centre of what is drawn.
    drawn : Randomization
        How the parameters of every episode are drawn.
    verdict : str
        The verdict of a diagnosis; "" if nothing was diagnosed.
    steps : tuple of str
        The effects that the diagnosis added.
    believed : bool
        Whether these were believed.
    """

    model: Model
    drawn: Randomization
    verdict: str = ""
    steps: tuple[str, ...] = ()
    believed: bool = True

    def to_json(self) -> dict[str, Any]:
        """Plain data, from which `training_setup_of` makes the same setup."""
        model, learned = apart(self.model)
        outside = [e for e in model.effects if e.name in OUTSIDE]
        model = dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in outside))
        return {
            "model": to_dict(model),
            "outside": {e.name: {name: float(p.value) for name, p in e.parameters.items()} for e in outside},
            "learned": _numbers(*learned) if learned else None,
            "drawn": self.drawn.to_json(),
            "verdict": self.verdict,
            "steps": list(self.steps),
            "believed": self.believed,
        }

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that change with whatever an agent's training depends on."""
        data = self.to_json()
        return digest({name: data[name] for name in ("model", "outside", "learned", "drawn")})

    @property
    def model_key(self) -> str:
        """The same of the model at the centre."""
        data = self.to_json()
        return digest([data["model"], data["outside"]])


def training_setup_of(data: dict[str, Any]) -> TrainingSetup:
    """The setup in plain data."""
    model = from_dict(data["model"]).model
    for name, numbers in data["outside"].items():
        model = model.with_effect(OUTSIDE[name](**numbers))
    if data["learned"] is not None:
        model = _with_learned(model, data["learned"])
    return TrainingSetup(model, from_json(data["drawn"]), data["verdict"], tuple(data["steps"]), data["believed"])


def _numbers(taps: CommandFilter, network: ResidualNetwork) -> dict[str, Any]:
    return {"taps": taps.taps.tolist(), "layers": [[W.tolist(), b.tolist()] for W, b in network.layers]}


def _with_learned(model: Model, numbers: dict[str, Any]) -> Model:
    layers = tuple((np.array(W), np.array(b)) for W, b in numbers["layers"])
    learned = CommandFilter(np.array(numbers["taps"])), ResidualNetwork(layers, drive_max=model.u_max)
    return model.with_effect(learned[0]).with_effect(learned[1])


def apart(model: Model) -> tuple[Model, tuple[Any, ...]]:
    """The model without the two learned effects, and these; () where it has none."""
    learned = tuple(e for kind in (CommandFilter, ResidualNetwork) for e in model.effects if isinstance(e, kind))
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in learned)), learned


def together(setups: Sequence[TrainingSetup], device: str = "cpu") -> Model:
    """One model that carries the agents of setups of one structure: the first's, with what each has learned."""
    (model, learned), *_ = parts = [apart(setup.model) for setup in setups]
    if not learned:
        return model
    return dataclasses.replace(model, effects=(*model.effects, *stacked([effects for _, effects in parts], device)))
