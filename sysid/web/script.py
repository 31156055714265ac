"""The Python lines that repeat every click."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sysid.physics.effects import ACTUATORS, CATALOGUE, Effect
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.plants import Plant
from sysid.web.session import SessionState

READ = {k: k for k in ("columns", "zero", "flip_torque", "degrees", "begin", "end", "dt", "time_unit", "joint")} | {
    "input": "command"
}
"""The options of a log, and what `sysid.read` calls them."""


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


def script(state: SessionState, begun: Mapping[str, Any], node: int, own: Sequence[str] = ()) -> str:
    """The lines: read, fit, add what was added, say what is missing next, save; `own` are classes of own effects."""
    files = list(state.log["files"])
    more = f", hold_out={state.log['hold_out']!r}" if "hold_out" in state.log else ""
    given = state.log.get("noise", "")
    effects = "".join(f"sysid.{e}, " for e in begun["effects"])
    parts = [
        *(["import dataclasses", ""] if own or given else []),
        "import sysid",
        "from sysid.estimation.channels import relied_on",
        "from sysid.estimation.initial_guess import initial_guess",
        *(f"\n\n{text}" for text in own),
        "",
        f"plant = {begun['plant']}",
        f"whole = sysid.read({files!r}{_options(state)}, plant=plant)",
        "log = whole" if "dt" in state.log else "log = whole.thinned()",
        "sensor = sysid.sensor_noise(whole).sensor",
        *([f"sensor = dataclasses.replace(sensor, {given})"] if given else []),
        f"training, held_out = sysid.split(log{more})",
        f"names = {begun['names']!r}",
        f"model = sysid.Model(plant, ({effects}), sysid.RK4(substeps={begun['substeps']}), dt=log.dt)",
        "model = initial_guess(model, names, training, sensor)",
        "estimate = sysid.fit(model, training, relied_on(model, training, sensor), names)",
        *(f"estimate = sysid.add(estimate, {name!r}, log, sensor{more}).estimate" for name in state.added(node)),
        "print(sysid.compare(estimate, held_out))",
        f"print(sysid.diagnose(estimate, log{more}))  # what is missing now",
        'sysid.save(estimate, "model.json")',
    ]
    return "\n".join(parts) + "\n"


def _options(state: SessionState) -> str:
    """How the log is read, as arguments of `sysid.read`."""
    found = {READ[k]: v for k, v in state.log.items() if k in READ}
    return "".join(f", {k}={v!r}" for k, v in found.items())
