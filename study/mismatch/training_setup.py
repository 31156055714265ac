"""What a strategy made of its rollouts, as plain data: the model to train on and what is drawn in training."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from policies.environments.randomization import Randomization, from_json
from study.mismatch.out_of_catalogue import OUT_OF_CATALOGUE
from study.mismatch.residual_network import CommandFilter, ResidualNetwork, stacked
from study.pipeline.settings import digest
from sysid import InvalidInput, Model
from sysid.estimation.saved_model import from_dict, to_dict


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """What an agent trains on.

    model    the machine at the centre of what is drawn; drawn: the parameters of every episode
    verdict  a diagnosis' verdict, and steps: the effects that it added; "" and () where nothing was diagnosed
    about    other numbers that were found on the way
    """

    model: Model
    drawn: Randomization
    verdict: str = ""
    steps: tuple[str, ...] = ()
    about: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain data, from which `training_setup_of` makes the same setup."""
        model, learned = apart(self.model)
        model, outside = _without_outside(model)
        return {
            "model": to_dict(model),
            "outside": outside,
            "learned": _numbers(learned),
            "drawn": self.drawn.to_json(),
            "verdict": self.verdict,
            "steps": list(self.steps),
            "about": self.about,
        }

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that change with whatever an agent's training depends on."""
        data = self.to_json()
        return digest({name: data[name] for name in ("model", "outside", "learned", "drawn")})


def training_setup_of(data: dict[str, Any]) -> TrainingSetup:
    """The setup in plain data; raises InvalidInput for other data."""
    try:
        model = from_dict(data["model"]).model
        for name, numbers in data["outside"].items():
            model = model.with_effect(OUT_OF_CATALOGUE[name](**numbers))
        if data["learned"] is not None:
            model = _with_learned(model, data["learned"])
        return TrainingSetup(model, from_json(data["drawn"]), data["verdict"], tuple(data["steps"]), data["about"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(f"no training setup ({error!r}): expected what TrainingSetup.to_json gives") from None


def _without_outside(model: Model) -> tuple[Model, dict[str, dict[str, float]]]:
    """The model without the effects that the catalogue lacks, and those as numbers."""
    outside = [e for e in model.effects if e.name in OUT_OF_CATALOGUE]
    numbers = {e.name: {name: float(p.value) for name, p in e.parameters.items()} for e in outside}
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in outside)), numbers


def _numbers(learned: tuple[Any, ...]) -> dict[str, Any] | None:
    """What was learned as numbers."""
    if not learned:
        return None
    taps, layers = learned[0].taps, learned[1].layers
    return {"taps": taps.tolist(), "layers": [[W.tolist(), b.tolist()] for W, b in layers]}


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
    parts = [apart(setup.model) for setup in setups]
    model = parts[0][0]
    if parts[0][1]:
        model = dataclasses.replace(model, effects=(*model.effects, *stacked([own for _, own in parts], device)))
    return model
