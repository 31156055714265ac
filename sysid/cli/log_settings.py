"""log.toml: how a log is read, written down once beside it instead of on every command line.

columns = {t = "time_s", theta = "angle_rad", torque = "tau"}
zero = "hanging"
plant = "joint"
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args, get_type_hints

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.files import full_path, read_file
from sysid.errors import InvalidInput, excerpt

FILE = "log.toml"
NO_FILE = "none"
"""`--log none` reads none."""
FIELDS = {"from": "begin", "to": "end"}
"""The fields of the options that are called otherwise on the command line."""


def _kinds() -> dict[str, Any]:
    """The keys of the file, the options of the command line without their dashes, and what each of them may be."""
    named = {field: key for key, field in FIELDS.items()}
    kinds = {named.get(n, n): kind for n, kind in get_type_hints(LogOptions).items() if n not in ("files", "settings")}
    return kinds | {"plant": get_type_hints(ModelOptions)["plant"]}


def _read(value: Any, kind: Any) -> tuple[Any, str]:
    """The value as an option of that kind holds it, None where it cannot; and what was expected."""
    if kind is bool:
        return value if isinstance(value, bool) else None, "true or false"
    if kind is str:
        pairs = ",".join(f"{ours}={theirs}" for ours, theirs in value.items()) if isinstance(value, Mapping) else value
        return pairs if isinstance(pairs, str) else None, 'a table, as {theta = ...}, or a text, as "theta=..."'
    choices = [choice for member in get_args(kind) for choice in get_args(member)]
    if value in choices:
        return value, ""
    numeric = float in get_args(kind)
    kinds = [*choices, "a number"] if numeric else choices
    expected = " or ".join(filter(None, (", ".join(kinds[:-1]), kinds[-1])))
    known = numeric and isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    return float(value) if known else None, expected


def settings_in(path: Path) -> dict[str, Any]:
    """What a settings file says, by key, as the options of the command line hold it.

    Raises InvalidInput for a file that cannot be read, an unknown key or a value of the wrong kind, with the choices.
    """
    try:
        content = tomllib.loads(read_file(path, "a log.toml").decode())
    except InvalidInput:
        raise
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{path} is not TOML: {error}") from None
    settings, kinds = {}, _kinds()
    for name, value in content.items():
        key = name.replace("-", "_")
        if key not in kinds:
            near = get_close_matches(key, kinds, n=1)
            perhaps = f"did you mean {near[0]}? E" if near else "e"
            raise InvalidInput(f"{path}: unknown key {excerpt(name)}: {perhaps}xpected some of {', '.join(kinds)}")
        settings[key], expected = _read(value, kinds[key])
        if settings[key] is None:
            raise InvalidInput(f"{path}: {name} = {excerpt(value)}: expected {expected}")
    return settings


def settings_file(files: tuple[Path, ...]) -> Path | None:
    """The log.toml in the folder of the logs; raises InvalidInput where they lie in several folders with different."""
    folders = list(dict.fromkeys(full_path(file, "read").parent for file in files))
    paths = [folder / FILE for folder in folders if (folder / FILE).is_file()]
    if not paths:
        return None
    if len(paths) < len(folders) or any(settings_in(path) != settings_in(paths[0]) for path in paths):
        raise InvalidInput(
            f"the logs lie in {len(folders)} folders whose {FILE} differ or are not there: expected one that holds for "
            f"all, given with --log FILE.toml, or --log {NO_FILE}"
        )
    return files[0].parent / FILE


def with_settings(log: LogOptions, start: ModelOptions) -> tuple[LogOptions, ModelOptions, str]:
    """The options, completed by the settings file where they say nothing, and one line on what was taken from where.

    log.settings names the file, else it is looked for beside the log; the line is empty where there is none.
    """
    if log.settings is not None and str(log.settings) == NO_FILE:
        return replace(log, settings=None), start, ""
    path = log.settings or settings_file(log.files)
    if path is None:
        return log, start, ""
    given, taken = vars(log) | {"plant": start.plant or start.model}, dict[str, Any]()
    settings = settings_in(path)
    for key, value in settings.items():
        option = given[FIELDS.get(key, key)]
        if option is None or option is False or option == "":
            taken[key] = value
    said = [f"{key} {str(value).lower() if isinstance(value, bool) else value}" for key, value in taken.items()]
    overridden = ", ".join(key for key in settings if key not in taken)
    changes = {FIELDS.get(key, key): value for key, value in taken.items()}
    start = replace(start, plant=changes.pop("plant", start.plant))
    note = f"{path}: {'; '.join(said) or 'nothing taken'}"
    note += f" (the command line overrides {overridden})" if overridden else ""
    return replace(log, settings=path, **changes), start, note
