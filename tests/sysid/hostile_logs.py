"""Files that claim to be logs and mean harm."""

from __future__ import annotations

import sqlite3
import struct
import zipfile
from pathlib import Path

import numpy as np

from tests.sysid.robot_files import write_bag_file


def bomb(path: Path) -> None:
    """An .npz whose arrays claim ten gigabytes each."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1342177280,), }"
    content = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + header.ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("t", "theta"):
            file.writestr(f"{name}.npy", content + bytes(1 << 24))


def pickled(path: Path) -> None:
    """An .npz that would run code when it is read as objects."""
    np.savez(path, t=np.array([{}], dtype=object), theta=np.array([{}], dtype=object))


def lying_bag(path: Path) -> None:
    """A ROS 2 bag whose messages claim to be longer than they are."""
    t = 0.02 * np.arange(60)
    write_bag_file(path, {"t": t, "theta": np.sin(t), "theta_dot": np.cos(t), "torque": np.zeros(60)}, "SQLITE3")
    with sqlite3.connect(path) as file:
        (content,) = file.execute("SELECT data FROM messages").fetchone()
        lying = b"".join([content[:16], struct.pack("<I", 2**32 - 1), content[20:]])
        file.execute("UPDATE messages SET data = ?", (lying,))
    file.close()
