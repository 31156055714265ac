"""model.json: a model as plain data, with the estimate of its parameters if it was fitted.

    {"schema": "gapfinder/model/1",
     "plant": {"name": "RodPendulum", "parameters": {"m": {"value": 1.2, "unit": "kg"}, ...}},
     "effects": [{"name": "delay", "parameters": {"T": {"value": 0.02, "unit": "s"}}, "settings": {"longest": 0.3}}],
     "integrator": {"name": "RK4", "settings": {"substeps": 2}},
     "dt": 0.02, "u_max": null,
     "free": ["m", "l", "delay.T"],
     "estimate": null, or {"covariance": [[...]], "noise": {...}, "sensor": {...}, "random_torque": 0.0, ...}}

A parameter has "bounds": [low, high] if they are not the declared ones. "free" lists the names that a fit may move, in
the order of the covariance's rows. null stands for infinity: no torque limit, no bound on that side, a variance that is
not known. Numbers come back exactly.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any, TypeVar

import numpy as np

from sysid.data.files import path_of, save_file
from sysid.data.json_file import count, entry, mapping, number_in, plain, read_json, sequence, text
from sysid.data.sensor import UNITS, Sensor
from sysid.errors import InvalidInput, excerpt
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free
from sysid.physics.effects import Effect, kind_of
from sysid.physics.integrators import RK4, Integrator, SemiImplicitEuler
from sysid.physics.model import Model
from sysid.physics.parameters import Parametric
from sysid.physics.plants import GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum

MODEL_SCHEMA = "gapfinder/model/1"
PLANT_CLASSES: dict[str, type[Plant]] = {
    kind.__name__: kind for kind in (RodPendulum, PointMassPendulum, GeneralJoint, LinearAxis)
}
INTEGRATOR_CLASSES: dict[str, type[Integrator]] = {kind.__name__: kind for kind in (RK4, SemiImplicitEuler)}

Part = TypeVar("Part")


@dataclass(frozen=True, eq=False)
class SavedModel:
    """The content of a model.json.

    Attributes
    ----------
    model : Model
        The model with its numbers.
    free : tuple of str
        The names that a fit may move.
    estimate : Estimate or None
        The fit that the numbers come from; None if the model was never fitted.
    """

    model: Model
    free: tuple[str, ...]
    estimate: Estimate | None


def save(answer: Model | Estimate, path: str | PathLike[str]) -> None:
    """Write a model, or an estimate with its model, as model.json.

    Parameters
    ----------
    answer : Model or Estimate
        The model or estimate to write.
    path : path
        The file.

    Raises
    ------
    InvalidInput
        Where the file cannot be written, and for a plant or an integrator that is not one of sysid's.
    """
    save_file(path, json.dumps(to_dict(answer), indent=1, allow_nan=False) + "\n")


def load(path: str | PathLike[str]) -> SavedModel:
    """Read a model.json; effects of your own have to be loaded (`load_effects`) before.

    Parameters
    ----------
    path : path
        A file that `save` wrote.

    Returns
    -------
    SavedModel
        The model, its free parameters, and the estimate if it was fitted. Numbers come back exactly.

    Raises
    ------
    InvalidInput
        In one sentence, for anything that is not a model of this version.
    """
    path = path_of(path)
    data = read_json(path, "a model.json as `save` writes it")
    try:
        return from_dict(data)
    except InvalidInput as error:
        raise InvalidInput(f"{path.name}: {error}") from None


def load_model(path: str | PathLike[str]) -> Model:
    """The model of a model.json.

    Parameters
    ----------
    path : path
        A file that `save` wrote.

    Returns
    -------
    Model
        The model that `load` would return.

    Raises
    ------
    InvalidInput
        As `load` does.
    """
    return load(path).model


# ---- to plain data ---------------------------------------------------------------------------------------------------


def to_dict(answer: Model | Estimate) -> dict[str, Any]:
    """Plain data of schema "gapfinder/model/1"."""
    if not isinstance(answer, Model | Estimate):
        came = f"a {type(answer).__name__}" + (", whose `estimate` is one" if hasattr(answer, "estimate") else "")
        raise InvalidInput(f"what is to be saved is {came}: expected a Model or an Estimate")
    estimate = answer if isinstance(answer, Estimate) else None
    model = answer if isinstance(answer, Model) else answer.model
    for part, ours in ((model.plant, PLANT_CLASSES), (model.integrator, INTEGRATOR_CLASSES)):
        if ours.get(type(part).__name__) is not type(part):
            raise InvalidInput(f"{type(part).__name__} cannot be saved: expected one of {', '.join(ours)}")
    return {
        "schema": MODEL_SCHEMA,
        "plant": {"name": type(model.plant).__name__, "parameters": _parameters(model.plant, model.plant)},
        "effects": [
            {"name": e.name, "parameters": _parameters(e, model.plant), "settings": _settings(e)} for e in model.effects
        ],
        "integrator": {"name": type(model.integrator).__name__, "settings": _settings(model.integrator)},
        "dt": model.dt,
        "u_max": plain(model.u_max),
        "free": list(free(model) if estimate is None else estimate.names),
        "estimate": None if estimate is None else _fields(estimate, but=("model", "names")),
    }


def _parameters(part: Parametric, plant: Plant) -> dict[str, dict[str, Any]]:
    for name, p in part.parameters.items():
        if np.ndim(p.value) > 0:
            raise InvalidInput(f"{type(part).__name__}.{name} is an array: expected a model of one machine")
    return {
        name: {"value": float(p.value), "unit": plant.unit(p.unit)}
        | ({"bounds": plain(p.bounds)} if name in part.bounds else {})
        for name, p in part.parameters.items()
    }


def _settings(part: Any) -> dict[str, Any]:
    """The fields that are neither parameters nor their bounds."""
    known = {"bounds", *part.parameters} if isinstance(part, Parametric) else set()
    return _fields(part, but=known)


def _fields(part: Any, but: Collection[str] = ()) -> dict[str, Any]:
    return {f.name: plain(getattr(part, f.name)) for f in dataclasses.fields(part) if f.name not in but}


# ---- from plain data -------------------------------------------------------------------------------------------------


def from_dict(data: Any) -> SavedModel:
    """The inverse of `to_dict`. Raises InvalidInput for another schema and for missing or unknown entries."""
    if not isinstance(data, dict) or not str(data.get("schema", "")).startswith("gapfinder/"):
        raise InvalidInput(f'it is no model of ours: expected "schema": "{MODEL_SCHEMA}"')
    if data["schema"] != MODEL_SCHEMA:
        raise InvalidInput(f'its schema is "{data["schema"]}": this version reads "{MODEL_SCHEMA}"')
    plant, integrator = mapping(data, "plant"), mapping(data, "integrator")
    model = Model(
        plant=_part(_choice(PLANT_CLASSES, plant, "plant"), plant),
        effects=tuple(_part(_effect_kind(text(e, "name")), e) for e in sequence(data, "effects")),
        integrator=_build(_choice(INTEGRATOR_CLASSES, integrator, "integrator"), mapping(integrator, "settings")),
        dt=number_in(data, "dt"),
        u_max=number_in(data, "u_max", math.inf),
    )
    names = tuple(map(str, sequence(data, "free")))
    model.check_names(names)
    about = mapping(data, "estimate") if data.get("estimate") is not None else None
    return SavedModel(model, names, None if about is None else _about(model, names, about))


def _effect_kind(name: str) -> type[Effect]:
    try:
        return kind_of(name)
    except InvalidInput as unknown:
        raise InvalidInput(f"{unknown}, or one of your own, whose file is given with --effects") from None


def _part(kind: type[Part], saved: Mapping[str, Any]) -> Part:
    parameters = mapping(saved, "parameters")
    fields: dict[str, Any] = {name: number_in(mapping(parameters, name), "value") for name in parameters}
    settings = mapping(saved, "settings") if "settings" in saved else {}
    bounds = {name: _bounds(p["bounds"], name) for name, p in parameters.items() if "bounds" in p}
    return _build(kind, {**settings, **fields, "bounds": bounds})


def _build(kind: type[Part], fields: Mapping[str, Any]) -> Part:
    """A part from its fields, where None means infinity; raises InvalidInput for a field that the part lacks."""
    known = [f.name for f in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for name in fields:
        if name not in known:
            raise InvalidInput(f"{kind.__name__} has no {name!r}: it has {', '.join(known)}")
    try:
        return kind(**{name: math.inf if value is None else value for name, value in fields.items()})
    except InvalidInput:
        raise
    except (TypeError, ValueError, OverflowError):
        came = ", ".join(f"{name} = {excerpt(value)}" for name, value in fields.items() if name != "bounds")
        raise InvalidInput(f"{kind.__name__} cannot be made of {came}") from None


def _about(model: Model, names: tuple[str, ...], saved: Mapping[str, Any]) -> Estimate:
    rows = sequence(saved, "covariance")
    try:
        covariance = np.array([[math.inf if c is None else float(c) for c in row] for row in rows], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInput("covariance is ragged or not numeric: expected a square matrix") from None
    if np.any(np.isnan(covariance)):
        raise InvalidInput("covariance holds NaN: expected numbers, null where one is not known")
    if covariance.shape != (len(names), len(names)):
        raise InvalidInput(f"covariance has shape {covariance.shape}: expected {len(names)} rows and columns")
    noise, sensor = mapping(saved, "noise"), mapping(saved, "sensor") if entry(saved, "sensor") is not None else None
    return Estimate(
        model=model,
        names=names,
        covariance=covariance,
        noise={channel: number_in(noise, channel) for channel in noise},
        success=bool(entry(saved, "success")),
        status=text(saved, "status"),
        cost=number_in(saved, "cost", math.nan),
        n_readings=count(saved, "n_readings"),
        method=text(saved, "method"),
        sensor=None
        if sensor is None
        else Sensor(**{c: number_in(sensor, c) for c in (*UNITS, "jitter") if sensor.get(c) is not None}),
        **{name: number_in(saved, name) for name in ("random_torque", "correlation_time") if name in saved},
    )


def _choice(known: Mapping[str, type[Part]], saved: Mapping[str, Any], what: str) -> type[Part]:
    name = text(saved, "name")
    if name not in known:
        raise InvalidInput(f"unknown {what} {name!r}: expected one of {', '.join(known)}")
    return known[name]


def _bounds(saved: Any, name: str) -> tuple[float, float]:
    if not isinstance(saved, list) or len(saved) != 2:
        raise InvalidInput(f"the bounds of {name} are {excerpt(saved)}: expected [low, high]")
    low, high = saved
    return number_in({name: low}, name, -math.inf), number_in({name: high}, name, math.inf)
