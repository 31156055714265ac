"""A log as the programs of robots write it: the same columns in files of every format."""

import csv
import json

import numpy as np


def write_text(path, columns, delimiter=","):
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        writer.writerows([repr(float(v)) for v in row] for row in zip(*columns.values(), strict=True))
    return path


def write_windows(path, columns):
    """As a spreadsheet of western Europe saves it: decimal commas, semicolons, and one column more, by its unit."""
    write_text(path, columns | {"Temperatur (\N{DEGREE SIGN}C)": np.zeros(len(columns["t"]))}, ";")
    path.write_text(path.read_text().replace(".", ","), encoding="cp1252")
    return path


def write_utf_16(path, columns):
    path.write_text(write_text(path, columns, "\t").read_text(), encoding="utf-16")
    return path


def write_excel(path, columns, above=(), below=()):
    """A workbook whose second sheet holds the log, with rows above and below that of the names."""
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.create_sheet("log")
    for row in (*above, list(columns), *below, *zip(*columns.values(), strict=True)):
        sheet.append([cell.item() if isinstance(cell, np.generic) else cell for cell in row])
    with path.open("wb") as file:
        book.save(file)
    return path


def write_json(path, content):
    path.write_text(json.dumps(content))
    return path


def write_lines(path, rows):
    path.write_text("\n".join(map(json.dumps, rows)))
    return path


def records(columns):
    return [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]


def write_npz(path, columns):
    with path.open("wb") as file:
        np.savez(file, **columns)
    return path


def write_mat(path, columns):
    from scipy.io import savemat

    with path.open("wb") as file:
        savemat(file, columns, do_compression=True)
    return path


def write_mat_4(path, columns):
    from scipy.io import savemat

    with path.open("wb") as file:
        savemat(file, columns, format="4")
    return path


def write_mat_73(path, columns, group=""):
    """As MATLAB lays out its version 7.3: HDF5 behind a header of its own, each matrix transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            data = file.create_dataset(f"{group}/{name}", data=np.atleast_2d(np.asarray(values).T), compression="gzip")
            data.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("#refs#")["a"] = np.zeros(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    return path


def write_parquet(path, columns):
    import pyarrow
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(dict(columns)), path)
    return path


def write_bag(path, columns, storage="SQLITE3", joints=("shoulder",), effort=True, extra=()):
    """A bag's folder: messages JointState in which the first of the joints is the log's, and others stand still.

    extra   (topic, type, values (K,)): messages of one number, each sent just before the state of its row
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state = "sensor_msgs/msg/JointState"
    State, Header, Time = (store.types[n] for n in (state, "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    others = [0.0] * (len(joints) - 1)
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        states = writer.add_connection("/joint_states", state, typestore=store)
        numbers = [(writer.add_connection(name, kind, typestore=store), kind, values) for name, kind, values in extra]
        for k, t in enumerate(columns["t"]):
            stamp = round(1e9 * t)
            for connection, kind, values in numbers:
                writer.write(connection, stamp, store.serialize_cdr(_number(store, kind, values[k]), kind))
            readings = [np.array([columns[c][k], *others]) for c in ("theta", "theta_dot", "torque")]
            header = Header(Time(*divmod(stamp, 10**9)), "")
            message = State(header, list(joints), readings[0], readings[1], readings[2] if effort else np.zeros(0))
            writer.write(states, stamp, store.serialize_cdr(message, state))
    return path


def _number(store, kind, value):
    if kind.endswith("Float64"):
        return store.types[kind](float(value))
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    return store.types[kind](layout, np.array([0.0, value]))


def write_bag_file(path, columns, storage):
    """A bag's file alone, whatever it is called."""
    folder = write_bag(path.with_name(f"{path.name} folder"), columns, storage)
    (inside,) = (p for p in folder.iterdir() if p.suffix in (".db3", ".mcap"))
    inside.rename(path)
    return path


FORMS = {
    "csv": write_text,
    "tsv": lambda path, columns: write_text(path, columns, "\t"),
    "semicolons": lambda path, columns: write_text(path, columns, ";"),
    "blanks": lambda path, columns: write_text(path, columns, " "),
    "windows": write_windows,
    "utf-16": write_utf_16,
    "excel": write_excel,
    "json": lambda path, columns: write_json(
        path, {"mass": 1.0, **{n: list(map(float, c)) for n, c in columns.items()}}
    ),
    "json records": lambda path, columns: write_json(path, {"mass": 1.0, "entries": records(columns)}),
    "json lines": lambda path, columns: write_lines(path, records(columns)),
    "npz": write_npz,
    "mat 4": write_mat_4,
    "mat 5": write_mat,
    "mat 5 struct": lambda path, columns: write_mat(path, {"log": columns}),
    "mat 7.3": write_mat_73,
    "mat 7.3 struct": lambda path, columns: write_mat_73(path, columns, "log"),
    "parquet": write_parquet,
    "bag": write_bag,
    "bag of mcap": lambda path, columns: write_bag(path, columns, "MCAP"),
    "db3": lambda path, columns: write_bag_file(path, columns, "SQLITE3"),
    "mcap": lambda path, columns: write_bag_file(path, columns, "MCAP"),
}
