"""Sessions: a folder each, with how a log is read and every model that was made of it, as plain files.

<folder>/<identifier>/session.json     title, options of the log, models and where one is among them
<folder>/<identifier>/log/log1.csv     uploaded files; what they were called stands in session.json alone
<folder>/<identifier>/models/0/...     what was found out about a model, a file for each answer
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.files import write_whole
from sysid.data.json_file import read_json
from sysid.errors import InvalidInput

ENDINGS = (".csv", ".tsv", ".txt", ".npz", ".mat", ".h5", ".parquet", ".mcap", ".db3", ".bag")
BEGUN, MODEL, FAILS, SERIES, EFFECTS, REPORT, NEXT, PLANNED, MJCF, URDF, EXPORTED, ERROR = (
    "begun.json",
    "model.json",
    "fails.json",
    "series.npz",
    "effects.json",
    "report.html",
    "next_experiment.csv",
    "planned.json",
    "model.xml",
    "model.urdf",
    "exported.json",
    "error.json",
)


@dataclass(frozen=True)
class Node:
    """A model of the history: the number of the one that it was made of (None: the log alone), and what was added."""

    parent: int | None = None
    added: str = ""


@dataclass(frozen=True)
class SessionState:
    """What session.json holds; `titles` are the names under which files came, `beside` is the model that the
    one at which one is is compared with, `own` are the user's own effects."""

    title: str = ""
    log: dict[str, Any] = field(default_factory=dict)
    start: dict[str, Any] = field(default_factory=dict)
    titles: tuple[str, ...] = ()
    nodes: tuple[Node, ...] = ()
    at: int | None = None
    beside: int | None = None
    own: tuple[dict[str, Any], ...] = ()

    @property
    def log_options(self) -> LogOptions:
        """How the log is read."""
        own = {**self.log, "files": tuple(map(Path, self.log.get("files", ())))}
        return LogOptions(**own)

    @property
    def model_options(self) -> ModelOptions:
        """The model to begin with."""
        own = {**self.start, "set": tuple(self.start.get("set", ()))}
        return ModelOptions(**own)

    def path(self, node: int | None) -> tuple[int, ...]:
        """The models from the first to this one."""
        found: list[int] = []
        while node is not None:
            found.append(node)
            node = self.nodes[node].parent
        return tuple(reversed(found))

    def added(self, node: int | None) -> tuple[str, ...]:
        """The effects that were added on the way to a model."""
        return tuple(self.nodes[k].added for k in self.path(node) if self.nodes[k].added)


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
        """What is kept of it; raises InvalidInput for a file that this version did not write."""
        data = read_json(self.folder / "session.json", "a session of the workbench")
        known = {f.name for f in fields(SessionState)}
        if not isinstance(data, dict) or not set(data) <= known:
            raise InvalidInput(f"{self.folder.name}/session.json is no session of this version")
        nodes = tuple(Node(**n) for n in data.get("nodes", ()))
        return SessionState(
            **data | {"nodes": nodes, "titles": tuple(data["titles"]), "own": tuple(data.get("own", ()))}
        )

    def save(self, state: SessionState) -> None:
        """Keep it."""
        write_whole(self.folder / "session.json", json.dumps(asdict(state), indent=1))

    def change(self, **changes: Any) -> SessionState:
        """Keep it with these fields changed."""
        state = replace(self.state, **changes)
        self.save(state)
        return state

    def of(self, node: int) -> Path:
        """The folder of a model."""
        return self.folder / "models" / str(int(node))

    def read(self, node: int | None, name: str) -> Any:
        """An answer about a model; None where it is not there yet."""
        path = None if node is None else self.of(node) / name
        return None if path is None or not path.is_file() else json.loads(path.read_text())

    def keep_file(self, number: int, title: str, content: bytes) -> Path:
        """Write an uploaded file under a number: of its name only a known ending is used."""
        ending = Path(title).suffix.lower()
        path = self.folder / "log" / f"log{number}{ending if ending in ENDINGS else '.csv'}"
        path.parent.mkdir(exist_ok=True)
        write_whole(path, content)
        return path

    def add_node(self, parent: int | None, added: str = "") -> int:
        """A new model, which becomes the one that is looked at; its number."""
        state = self.state
        number = len(state.nodes)
        shutil.rmtree(self.of(number), ignore_errors=True)
        self.of(number).mkdir(parents=True)
        self.change(nodes=(*state.nodes, Node(parent, added)), at=number)
        return number

    def drop_last_node(self) -> None:
        """Take the newest model back, as where its fit failed or was cancelled."""
        state = self.state
        number = len(state.nodes) - 1
        shutil.rmtree(self.of(number), ignore_errors=True)
        self.change(
            nodes=state.nodes[:-1], at=state.nodes[number].parent if state.at == number else state.at, beside=None
        )

    def begin_anew(self) -> None:
        """Forget all models."""
        shutil.rmtree(self.folder / "models", ignore_errors=True)
        self.change(nodes=(), at=None, beside=None)


class Sessions:
    """All sessions of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.lock = folder, threading.RLock()
        folder.mkdir(parents=True, exist_ok=True)

    def new(self, title: str, log: LogOptions | None = None, start: ModelOptions | None = None) -> Session:
        """A new session, perhaps of files that lie elsewhere."""
        session = Session(self.folder / secrets.token_hex(4))
        session.folder.mkdir()
        files = () if log is None else tuple(str(p.resolve()) for p in log.files)
        session.save(
            SessionState(
                title=title,
                log={} if log is None else _given(replace(log, settings=None), LogOptions()) | {"files": files},
                start={} if start is None else _given(replace(start, effects=None), ModelOptions()),
                titles=tuple(Path(f).name for f in files),
            )
        )
        return session

    def find(self, identifier: str | None) -> Session | None:
        """The session of that name; None where there is none. No other name is a folder."""
        if not identifier or not re.fullmatch(r"[0-9a-f]{8}", identifier):
            return None
        session = Session(self.folder / identifier)
        return session if (session.folder / "session.json").is_file() else None

    def all(self) -> tuple[Session, ...]:
        """All of them, the newest first."""
        found = [Session(p.parent) for p in self.folder.glob("*/session.json")]
        known = [s for s in found if self.find(s.identifier)]
        return tuple(sorted(known, key=lambda s: -(s.folder / "session.json").stat().st_mtime))

    def of_files(self, files: Sequence[Path]) -> Session | None:
        """The newest session of exactly these files."""
        wanted = [str(f.resolve()) for f in files]
        return next((s for s in self.all() if list(s.state.log.get("files", ())) == wanted), None)


def _given(options: Any, usual: Any) -> dict[str, Any]:
    """The options that are not the usual ones, as JSON holds them."""
    own = {k: v for k, v in vars(options).items() if v != getattr(usual, k)}
    return {k: str(v) if isinstance(v, Path) else v for k, v in own.items()}
