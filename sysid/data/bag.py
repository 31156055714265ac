"""Reading ROS 2 bags and MCAP: joints in sensor_msgs/JointState messages, and other topics that carry numbers.

Messages are decoded by ROS 2's own definitions, whatever definitions the file contains.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sysid.errors import InvalidInput, printable
from sysid.limits import RAW_ROWS, check_size
from sysid.physics.ops import Array

MCAP = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file."""
STATES = "sensor_msgs/msg/JointState"
NUMBER_TYPES = ("std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray")
READINGS = ("theta", "theta_dot", "torque")
"""Our names for the position, the velocity and the effort of a joint."""


class Row(NamedTuple):
    """A joint's state in one message: when it was written to the file, when it was stamped [ns], and its readings."""

    written: int
    stamped: int
    theta: float
    theta_dot: float
    torque: float


class Content(NamedTuple):
    """The rows of each joint by (topic, name), and the (time of writing, value) pairs of other topics' numbers."""

    joints: dict[tuple[str, str], list[Row]]
    numbers: dict[str, list[tuple[int, float]]]


def read_bag(path: Path, columns: Mapping[str, str] | None, joint: str) -> dict[str, Any]:
    """The wanted columns of a bag, or the names of all: a joint's t [s] since its first message, theta, theta_dot and
    torque, and the numbers of other topics, each held until the next is sent.

    Raises InvalidInput, in a sentence that lists them, where there are several joints and none is named.
    """
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    content = _content(path, tuple((file, file.stat().st_mtime_ns, file.stat().st_size) for file in files))
    rows = _joint(path, content, joint)
    readings: dict[str, Any] = {name: np.array([getattr(row, name) for row in rows]) for name in READINGS}
    readings = {n: v for n, v in readings.items() if n == "torque" or np.isfinite(v).any()}
    if columns is None:
        return dict.fromkeys(("t", *readings, *content.numbers))
    if columns.get("torque") == "torque" and not np.isfinite(readings["torque"]).any():
        topics = ", ".join(content.numbers) or "none"
        raise InvalidInput(
            f"{path.name}: the joint's efforts are empty: name the topic that commands it, as in "
            f"torque=/commands[0], or leave the torque out (torque=) for a free swing; topics of numbers: {topics}"
        )
    written = np.array([row.written for row in rows])
    stamps = np.array([row.stamped for row in rows])
    stamps = stamps if stamps.any() else written  # this robot does not stamp its messages
    readings["t"] = (stamps - stamps[0]) / 1e9
    return {
        ours: readings[name] if name in readings else _held(content.numbers[name], written)
        for ours, name in columns.items()
    }


@lru_cache(maxsize=1)
def _content(path: Path, files: tuple[Any, ...]) -> Content:
    """All that a bag holds, cached: names are asked for first, columns next. `files` changes with the bag's content."""
    from rosbags.typesys import Stores, get_typestore

    types, joints, numbers = get_typestore(Stores.ROS2_HUMBLE), defaultdict(list), defaultdict(list)
    size = 0
    with _opened(path) as reader:
        wanted = [c for c in reader.connections if c.msgtype in (STATES, *NUMBER_TYPES)]
        for connection, written, raw in reader.messages(wanted) if wanted else ():
            message: Any = types.deserialize_cdr(raw, connection.msgtype)
            if connection.msgtype == STATES:
                for name, row in _rows(message, written):
                    joints[connection.topic, name].append(row)
                    size += 1
            else:
                for name, value in _numbers(connection.topic, message.data):
                    numbers[name].append((written, value))
                    size += 1
            check_size(f"{path.name}: numbers in its messages:", size, RAW_ROWS)
    return Content(joints, numbers)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a bag's folder, or a single file of one by its content, whatever it is called."""
    from rosbags.rosbag2 import Reader

    plugin = "dir"
    if path.is_file():
        with path.open("rb") as file:
            plugin = ".mcap" if file.read(len(MCAP)) == MCAP else ".db3"
    storage = Reader.STORAGE_PLUGINS[plugin](path)
    storage.open()
    try:
        yield storage
    finally:
        storage.close()


def _rows(message: Any, written: int) -> Iterator[tuple[str, Row]]:
    stamped, names = 10**9 * message.header.stamp.sec + message.header.stamp.nanosec, message.name
    series = (message.position, message.velocity, message.effort)
    filled = (values.tolist() + [math.nan] * (len(names) - len(values)) for values in series)
    for name, *values in zip(names, *filled, strict=False):
        yield name, Row(written, stamped, *values)


def _numbers(topic: str, data: Any) -> Iterator[tuple[str, float]]:
    """The numbers of a message with the names of their columns."""
    if np.ndim(data) == 0:
        yield printable(topic), float(data)
    else:
        yield from ((f"{printable(topic)}[{i}]", float(value)) for i, value in enumerate(data))


def _joint(path: Path, content: Content, joint: str) -> Sequence[Row]:
    """The rows of the joint that is asked for, in the order in which they were written."""
    read = {k: rows for k, rows in content.joints.items() if not np.isnan([r[2:4] for r in rows]).all()}
    often = Counter(name for _, name in read)
    called = {(topic, name): name if often[name] == 1 else f"{topic}:{name}" for topic, name in read}
    named = {printable(called[key]): rows for key, rows in read.items()}
    if not named:
        raise InvalidInput(f"{path.name} has no joint with positions or velocities: expected messages {STATES}")
    if joint in named or (not joint and len(named) == 1):
        return named[joint or next(iter(named))]
    came = f"no joint {joint!r}" if joint else f"{len(named)} joints"
    raise InvalidInput(f"{path.name} has {came}: expected one of {', '.join(named)} (--joint, joint=)")


def _held(sent: Sequence[tuple[int, float]], written: Array) -> Array:
    """The last number that was sent before each instant (zero-order hold); nan before the first."""
    times, values = (np.array(v) for v in zip(*sent, strict=True))
    order = np.argsort(times, kind="stable")
    last = np.searchsorted(times[order], written, side="right") - 1
    return np.where(last >= 0, values[order][last], math.nan)
