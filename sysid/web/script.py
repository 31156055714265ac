"""The Python lines that repeat every click."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.physics.effects import ACTUATORS, CATALOGUE, Effect
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.plants import Plant
from sysid.web.session import State

READ = {"zero": None, "flip_torque": None, "degrees": None, "begin": None, "end": None, "dt": None, "time_unit": None}
"""The options of a log that `sysid.read` takes under the same name."""


def begun_with(model: Model, names: Sequence[str]) -> dict[str, Any]:
    """What the first fit began with, in Python: plant, effects, steps, and the names that it might move."""
    substeps = model.integrator.substeps if isinstance(model.integrator, RK4) else 1
    effects = [_effect(e) for e in model.effects]
    return {"plant": _plant(model.plant), "effects": effects, "substeps": substeps, "names": list(names)}


def _plant(plant: Plant) -> str:
    numbers = [f"{name}={float(p.value)!r}" for name, p in plant.parameters.items()]
    bounds = [f"bounds={dict(plant.bounds)!r}"] if plant.bounds else []
    return f"sysid.{type(plant).__name__}({', '.join([*numbers, *bounds])})"


def _effect(own: Effect) -> str:
    numbers = "".join(f", {name}={float(p.value)!r}" for name, p in own.parameters.items())
    known = {**CATALOGUE, **ACTUATORS}
    return f"effect({own.name!r}{numbers})" if own.name in known else f"# {own.name} is not known here"


def script(state: State, begun: Mapping[str, Any], node: int, own_effects: str = "") -> str:
    """The lines: read, fit, add what was added, say what is missing next, save."""
    options = {k: state.log[k] for k in READ if k in state.log}
    options |= {"columns": state.log["columns"]} if "columns" in state.log else {}
    options |= {"command": state.log["input"]} if "input" in state.log else {}
    files = [Path(f).name if t == Path(f).name else f for f, t in zip(state.log["files"], state.titles, strict=True)]
    told = "".join(f", {k}={v!r}" for k, v in options.items())
    hold_out = state.log.get("hold_out")
    more = "" if hold_out is None else f", {hold_out!r}"
    noise = _noise(state.log.get("noise", ""))
    thinned = "whole" if state.log.get("dt") is not None else "whole.thinned()"
    added = "\n".join(
        f"estimate = sysid.add(estimate, {name!r}, log, sensor{more}).estimate" for name in state.added(node)
    )
    effects = ", ".join(begun["effects"])
    return f"""\
{"import dataclasses" + chr(10) if "dataclasses" in noise else ""}
import sysid
from sysid.estimation.initial_guess import initial_guess
{"from sysid import effect" + chr(10) if effects else ""}{own_effects}
plant = {begun["plant"]}
whole = sysid.read({files!r}{told}, plant=plant)
log = {thinned}
sensor = {noise}
training, held_out = sysid.split(log{more})
names = {begun["names"]!r}
model = sysid.Model(plant, ({effects}{"," if effects else ""}), sysid.RK4(substeps={begun["substeps"]}), dt=log.dt)
estimate = sysid.fit(initial_guess(model, names, training, sensor), training, sensor, names)
{added}{chr(10) if added else ""}print(sysid.compare(estimate, held_out, sensor))
print(sysid.diagnose(estimate, log, sensor{more}))  # what is missing now
sysid.save(estimate, "model.json")
"""


def _noise(told: str) -> str:
    """The sensor: what the user gave, else what the log shows."""
    given = ", ".join(pair.strip() for pair in told.split(",") if pair.strip())
    found = "sysid.sensor_noise(whole).sensor"
    return f"dataclasses.replace({found}, {given})" if given else found
