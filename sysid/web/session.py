"""Sessions: a folder each, with how a log is read and every model that was made of it, as plain files.

<folder>/<identifier>/session.json     title, options of the log, models and where one is among them
<folder>/<identifier>/log/1/swing.csv  dropped files, in a folder each
<folder>/<identifier>/models/0/...     what was found out about a model, a file for each answer
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.files import write_whole
from sysid.data.json_file import read_json
from sysid.errors import InvalidInput
from sysid.web.own_effect import OwnEffect

BAGS = (".mcap", ".db3", ".bag")
ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".log", ".npz", ".mat", ".h5", ".hdf5", ".parquet", *BAGS)
"""What the names of dropped files end in; what they hold is told by their content alone."""
LONGEST_NAME = 40
CHANGING = threading.RLock()
"""Held while a session is changed: the server answers several requests at once."""


class Answer(StrEnum):
    """The files in a model's folder, each written when what it holds is known."""

    BEGUN = "begun.json"
    MODEL = "model.json"
    EXPORTED = "exported.json"
    MJCF = "model.xml"
    URDF = "model.urdf"
    OWN_EFFECTS = "own_effects.py"
    SERIES = "series.npz"
    FAILS = "fails.json"
    EFFECTS = "effects.json"
    REPORT = "report.html"
    NEXT = "next_experiment.csv"
    PLANNED = "planned.json"
    TRAINING = "training.txt"
    PROGRESS = "progress.json"
    ERROR = "error.json"


FORMAT = 4
"""What the answers below look like; those that another version wrote are worked out anew."""
OF_THIS_FORMAT = (Answer.EXPORTED, Answer.FAILS, Answer.EFFECTS, Answer.PLANNED)


@dataclass(frozen=True)
class Node:
    """A model of the history.

    parent       the number of the model that it was made of; None: of the log alone
    added        the effect that was added to that one
    log, start   of a model that was made of the log alone: how that was read, and the model to begin with
    before       of such a model: the one that was looked at when everything was begun anew
    """

    parent: int | None = None
    added: str = ""
    log: LogOptions | None = None
    start: ModelOptions | None = None
    before: int | None = None

    @property
    def undone(self) -> int | None:
        """The model that is looked at once this one is undone."""
        return self.before if self.parent is None else self.parent


@dataclass(frozen=True)
class SessionState:
    """What session.json holds; `own` are the user's own effects."""

    title: str = ""
    log: LogOptions = field(default_factory=LogOptions)
    start: ModelOptions = field(default_factory=ModelOptions)
    nodes: tuple[Node, ...] = ()
    at: int | None = None
    own: tuple[OwnEffect, ...] = ()

    def path(self, node: int | None) -> tuple[int, ...]:
        """The models from the first to this one."""
        numbers: list[int] = []
        while node is not None:
            numbers.append(node)
            node = self.nodes[node].parent
        return tuple(reversed(numbers))

    def added(self, node: int | None) -> tuple[str, ...]:
        """The effects that were added on the way to a model."""
        return tuple(self.nodes[k].added for k in self.path(node) if self.nodes[k].added)

    def own_effects(self, node: int) -> list[OwnEffect]:
        """Those of them that the user wrote."""
        return [effect for effect in self.own if effect.name in self.added(node)]

    def settings_of(self, node: int) -> SessionState:
        """The state with the settings that a model was made with, which the form may no longer show."""
        first = self.nodes[self.path(node)[0]]
        return replace(self, log=first.log or self.log, start=first.start or self.start)


@dataclass(frozen=True)
class Session:
    """One session's folder."""

    folder: Path

    @property
    def identifier(self) -> str:
        """Its name in addresses."""
        return self.folder.name

    @property
    def state(self) -> SessionState:
        """What is kept of it, by defaults what an older version did not keep; raises InvalidInput for anything else."""
        data = read_json(self.folder / "session.json", "a session of the workbench")
        try:
            data.pop("titles", None)  # of an older version: what dropped files were called
            data = {name: value for name, value in data.items() if value is not None}
            nodes = tuple(Node(**n | _options(n)) for n in data.get("nodes", ()))
            own_effects = tuple(OwnEffect(**o) for o in data.get("own", ()))
            state = SessionState(**data | _options(data) | {"nodes": nodes, "own": own_effects})
            _ = [state.path(node) for node in (state.at, *range(len(nodes)))]
        except (AttributeError, LookupError, TypeError, ValueError):
            raise InvalidInput(f"{self.identifier}/session.json is no session of this version") from None
        return state

    def save(self, state: SessionState) -> None:
        write_whole(self.folder / "session.json", json.dumps(asdict(state, dict_factory=_given), indent=1, default=str))

    def change(self, **changes: Any) -> None:
        """Keep it with these fields changed, and others as another thread may just have changed them."""
        with CHANGING:
            self.save(replace(self.state, **changes))

    def of(self, node: int) -> Path:
        """The folder of a model."""
        return self.folder / "models" / str(int(node))

    def read(self, node: int | None, name: Answer) -> Any:
        """An answer about a model; None where it is not there yet, or is one that another version wrote."""
        path = None if node is None else self.of(node) / name
        data = json.loads(path.read_text()) if path is not None and path.is_file() else None
        other = name in OF_THIS_FORMAT and isinstance(data, dict) and data.get("format") != FORMAT
        return None if other else data

    def write(self, node: int, name: Answer, data: dict[str, Any]) -> None:
        """Keep an answer about a model."""
        write_whole(self.of(node) / name, json.dumps({"format": FORMAT, **data}, allow_nan=False))

    def has(self, node: int, name: Answer) -> bool:
        """Whether an answer about a model is there."""
        return (self.of(node) / name).is_file() and (name not in OF_THIS_FORMAT or self.read(node, name) is not None)

    def shown(self, name: Answer) -> int | None:
        """The model whose answer the page shows: the one that is looked at, or until that has it, the one before."""
        state = self.state
        node = state.at
        while node is not None and not self.has(node, name):
            node = state.nodes[node].undone
        return node

    def keep_file(self, number: int, title: str, content: bytes) -> Path:
        """Write a dropped file into a folder of that number, under what is harmless in its name."""
        name = re.sub(r"[^\w. -]+", "_", Path(title).stem)[:LONGEST_NAME] + Path(title).suffix.lower()
        path = self.folder / "log" / str(number) / name
        path.parent.mkdir(parents=True)
        write_whole(path, content)
        return path

    def add_node(self, node: Node) -> int:
        """A new model, which becomes the one that is looked at; its number."""
        with CHANGING:
            nodes = self.state.nodes
            number = len(nodes)
            shutil.rmtree(self.of(number), ignore_errors=True)
            self.of(number).mkdir(parents=True)
            self.change(nodes=(*nodes, node), at=number)
        return number

    def drop_last_node(self) -> None:
        """Take the newest model back, as where its fit failed or was cancelled."""
        with CHANGING:
            state = self.state
            *nodes, last = state.nodes
            shutil.rmtree(self.of(len(nodes)), ignore_errors=True)
            self.change(nodes=tuple(nodes), at=last.undone if state.at == len(nodes) else state.at)


class Sessions:
    """All sessions of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.lock = folder, threading.RLock()
        folder.mkdir(parents=True, exist_ok=True)

    def new(self, title: str, log: LogOptions | None = None, start: ModelOptions | None = None) -> Session:
        """A new session, perhaps of files that lie elsewhere."""
        session = Session(self.folder / secrets.token_hex(4))
        session.folder.mkdir()
        log, start = log or LogOptions(), start or ModelOptions()
        log = replace(log, files=tuple(p.resolve() for p in log.files), settings=None)
        session.save(SessionState(title, log, replace(start, effects=None)))
        return session

    def find(self, identifier: str | None) -> Session | None:
        """The session of that name; None where there is none that this version reads. No other name is a folder."""
        return None if not identifier or self.refusal(identifier) else Session(self.folder / identifier)

    def refusal(self, identifier: str) -> str:
        """Why a name is that of no session, in a sentence; empty where it is one."""
        known = re.fullmatch(r"[0-9a-f]{8}", identifier) and (self.folder / identifier / "session.json").is_file()
        if not known:
            return "There is no such session here: it was deleted, or the workbench has another --folder."
        try:
            _ = Session(self.folder / identifier).state
        except InvalidInput as error:
            return f"{error}: expected one that this workbench wrote; its folder can be deleted by hand."
        return ""

    def all(self) -> tuple[Session, ...]:
        """All of them, the newest first."""
        sessions = [Session(p.parent) for p in self.folder.glob("*/session.json")]
        known = [s for s in sessions if self.find(s.identifier)]
        return tuple(sorted(known, key=lambda s: -(s.folder / "session.json").stat().st_mtime))

    def of_files(self, files: Sequence[Path]) -> Session | None:
        """The newest session of exactly these files."""
        wanted = tuple(f.resolve() for f in files)
        return next((s for s in self.all() if s.state.log.files == wanted), None)


def _given(fields: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """The fields of a dataclass that are not None, which stands for what is left out."""
    return {name: value for name, value in fields if value is not None}


def _options(data: Mapping[str, Any]) -> dict[str, Any]:
    """How a log is read, and the model to begin with, of a session or of a model of it, where JSON says them."""
    options: dict[str, Any] = {}
    if (log := data.get("log")) is not None:
        options["log"] = LogOptions(**log | {"files": tuple(map(Path, log.get("files", ())))})
    if (start := data.get("start")) is not None:
        model = {"model": Path(start["model"])} if "model" in start else {}
        options["start"] = ModelOptions(**start | model | {"set": tuple(start.get("set", ()))})
    return options
