"""The Python lines that repeat every click."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.physics.effects import Effect
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.plants import Plant
from sysid.web.session import SessionState


def begun_with(model: Model, names: Sequence[str], effects: Path | None) -> dict[str, Any]:
    """What the first fit began with, in Python; `effects` is the file with the user's own."""
    plant = model.plant
    bounds = f", bounds={dict(plant.bounds)!r}" if plant.bounds else ""
    return {
        "plant": f"sysid.{type(plant).__name__}({_numbers(plant)}{bounds})",
        "effects": [f"effect({effect.name!r}, {_numbers(effect)})" for effect in model.effects],
        "substeps": model.integrator.substeps if isinstance(model.integrator, RK4) else 1,
        "names": list(names),
        "effects_file": str(effects.resolve()) if effects else "",
    }


def _numbers(part: Plant | Effect) -> str:
    return ", ".join(f"{name}={float(p.value)!r}" for name, p in part.parameters.items())


def script(state: SessionState, begun: Mapping[str, Any], node: int, own_effects: Sequence[str] = ()) -> str:
    """The lines: read, fit, add what was added, say what is missing next, save; `own_effects` are classes."""
    log = state.settings_of(node).log
    files, given = [str(file) for file in log.files], log.noise
    more = "" if log.hold_out is None else f", hold_out={log.hold_out!r}"
    options = "".join(f", {name}={value!r}" for name, value in log.reading().items())
    effects = "".join(f"sysid.{e}, " for e in begun["effects"])
    loaded = [f"sysid.load_effects({begun['effects_file']!r})"] if begun.get("effects_file") else []
    parts = [
        *(["import dataclasses", ""] if own_effects or given else []),
        "import sysid",
        "from sysid.estimation.channels import relied_on",
        *(f"\n\n{text}" for text in own_effects),
        "",
        *loaded,
        f"plant = {begun['plant']}  # guessed from the log",
        f"log = sysid.read({files!r}{options}, plant=plant)",
        "sensor = sysid.sensor_noise(log).sensor",
        *([f"sensor = dataclasses.replace(sensor, {given})"] if given else []),
        f"training, held_out = sysid.split(log{more})",
        f"names = {begun['names']!r}",
        f"model = sysid.Model(plant, ({effects}), sysid.RK4(substeps={begun['substeps']}), dt=log.dt)",
        "estimate = sysid.fit(model, training, relied_on(model, training, sensor), names)",
        *(f"estimate = sysid.add(estimate, {name!r}, log, sensor{more}).estimate" for name in state.added(node)),
        "print(sysid.compare(estimate, held_out))",
        f"print(sysid.diagnose(estimate, log{more}))  # what is missing now",
        'sysid.save(estimate, "model.json")',
    ]
    return "\n".join(parts) + "\n"
