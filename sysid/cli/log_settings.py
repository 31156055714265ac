"""log.toml: how a log is read, written down once beside it instead of on every command line.

columns = {t = "time_s", theta = "angle_rad", torque = "tau"}
zero = "hanging"
plant = "joint"
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from sysid.cli.options import LogOptions, ModelOptions
from sysid.data.files import place, read_file
from sysid.errors import InvalidInput, excerpt

FILE = "log.toml"
NONE = "none"
"""`--log none` reads none."""


def _choice(*names: str) -> Callable[[Any], str | None]:
    return lambda value: value if isinstance(value, str) and value in names else None


def _pairs(value: Any) -> str | None:
    """ "t=time_s,theta=angle", also from a table."""
    if isinstance(value, Mapping):
        return ",".join(f"{ours}={theirs}" for ours, theirs in value.items())
    return value if isinstance(value, str) else None


def _number(value: Any) -> float | None:
    return (
        float(value) if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 else None
    )


def _switch(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


class _Key(NamedTuple):
    """The field of the options that a key stands for, what turns its value into the field's, and what it may be."""

    field: str
    read: Callable[[Any], Any]
    expected: str


KEYS = {
    "columns": _Key("columns", _pairs, 't = "time_s", theta = "angle", ... in a table, or "t=time_s,theta=angle"'),
    "zero": _Key("zero", _choice("upright", "hanging"), "upright or hanging"),
    "flip_torque": _Key("flip_torque", _switch, "true or false"),
    "input": _Key("input", _choice("torque", "current", "voltage", "position"), "torque, current, voltage or position"),
    "degrees": _Key("degrees", _switch, "true or false"),
    "from": _Key("begin", _number, "a number of seconds"),
    "to": _Key("end", _number, "a number of seconds"),
    "dt": _Key("dt", _number, "a number of seconds"),
    "time_unit": _Key("time_unit", _choice("s", "ms", "us"), "s, ms or us"),
    "noise": _Key("noise", _pairs, 'theta = 0.003, theta_dot = 0.05 in a table, or "theta=0.003"'),
    "hold_out": _Key("hold_out", _number, "a share or a number of rollouts"),
    "plant": _Key("plant", _choice("rod", "point", "joint", "axis"), "rod, point, joint or axis"),
}
"""The keys of the file: the options of the command line, without their dashes."""


def settings(path: Path) -> dict[str, Any]:
    """What a settings file says.

    Parameters
    ----------
    path : Path
        A TOML file with some of KEYS.

    Returns
    -------
    dict
        The values by key, as the options of the command line hold them.

    Raises
    ------
    InvalidInput
        For a file that cannot be read, an unknown key or a value of the wrong kind, with the choices.
    """
    try:
        content = tomllib.loads(read_file(path, "a log.toml").decode())
    except InvalidInput:
        raise
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{path} is not TOML: {error}") from None
    found = {}
    for name, value in content.items():
        key = name.replace("-", "_")
        if key not in KEYS:
            near = get_close_matches(key, KEYS, n=1)
            perhaps = f"did you mean {near[0]}? E" if near else "e"
            raise InvalidInput(f"{path}: unknown key {excerpt(name)}: {perhaps}xpected some of {', '.join(KEYS)}")
        found[key] = KEYS[key].read(value)
        if found[key] is None:
            raise InvalidInput(f"{path}: {name} = {excerpt(value)}: expected {KEYS[key].expected}")
    return found


def beside(files: tuple[Path, ...]) -> Path | None:
    """The log.toml in the folder of the logs; raises InvalidInput where they lie in several folders with different."""
    folders = list(dict.fromkeys(place(file, "read").parent for file in files))
    found = [folder / FILE for folder in folders if (folder / FILE).is_file()]
    if not found:
        return None
    if len(found) < len(folders) or any(settings(path) != settings(found[0]) for path in found):
        raise InvalidInput(
            f"the logs lie in {len(folders)} folders whose {FILE} differ or are not there: expected one that holds for "
            f"all, given with --log FILE.toml, or --log {NONE}"
        )
    return files[0].parent / FILE


def settled(log: LogOptions, start: ModelOptions) -> tuple[LogOptions, ModelOptions, str]:
    """The options, completed by the settings file; what the command line says counts.

    Parameters
    ----------
    log, start : LogOptions, ModelOptions
        The options as they were given; log.settings names the file, else it is looked for beside the log.

    Returns
    -------
    log, start : LogOptions, ModelOptions
        The options with what the file says where they said nothing.
    said : str
        One line on what was taken from where; empty where there is no file.
    """
    if log.settings is not None and str(log.settings) == NONE:
        return replace(log, settings=None), start, ""
    path = log.settings or beside(log.files)
    if path is None:
        return log, start, ""
    log, taken, overridden = replace(log, settings=path), list[str](), list[str]()
    for key, value in settings(path).items():
        given = getattr(start if key == "plant" else log, KEYS[key].field)
        silent = given is None or given is False or given == ""
        if not silent or (key == "plant" and start.model is not None):
            overridden.append(key)
            continue
        taken.append(f"{key} {str(value).lower() if isinstance(value, bool) else value}")
        change = {KEYS[key].field: value}
        if key == "plant":
            start = replace(start, **change)
        else:
            log = replace(log, **change)
    said = f"{path}: {'; '.join(taken) or 'nothing taken'}"
    return log, start, said + (f" (the command line overrides {', '.join(overridden)})" if overridden else "")
