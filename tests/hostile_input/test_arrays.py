"""Whatever an .npz or a .mat file holds, it is read, or refused in one sentence."""

import io
import zipfile

import numpy as np
import pytest
import scipy.io
from hypothesis import example, given
from hypothesis import strategies as st

import sysid
from tests.hostile_input.answering import ARRAYS, answered, many


def packed(save, **options):
    content = io.BytesIO()
    save(content, **options)
    return content.getvalue()


NPZ = packed(np.savez, **ARRAYS)
MAT = packed(scipy.io.savemat, mdict=ARRAYS, do_compression=True)


def header(shape, kind="<f8"):
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue() + bytes(800)


def zipped(theta):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("t.npy", header((100,)))
        file.writestr("theta.npy", theta)
    return content.getvalue()


@many
@given(changes=st.lists(st.tuples(st.integers(0, len(NPZ) - 1), st.integers(0, 255)), max_size=8), cut=st.integers(0))
@example(changes=[(6, 1)], cut=0)
def test_a_damaged_npz_is_refused_or_read(tmp_path_factory, changes, cut):
    content = bytearray(NPZ)
    for place, byte in changes:
        content[place] = byte
    path = tmp_path_factory.getbasetemp() / "log.npz"
    path.write_bytes(content[: cut % (len(NPZ) + 1)] if cut else content)
    answered(sysid.read, path)


CLAIMS = [
    *((shape, "<f8") for shape in [(10**12,), (10**18,), (10**30,), (-1,), (2**62, 4), (0, 10**12), ("x",)]),
    *(((100,), kind) for kind in ("|O", "<U10", "|V1000000000", "zzz")),
]


@pytest.mark.parametrize(("shape", "kind"), CLAIMS, ids=str)
def test_an_array_claims_what_it_likes(shape, kind, tmp_path):
    (tmp_path / "log.npz").write_bytes(zipped(header(shape, kind)))
    assert not answered(sysid.read, tmp_path / "log.npz")


@pytest.mark.parametrize(("place", "value"), [(6, 1), (8, 1), (8, 97), (8, 65535)], ids=str)
def test_an_npz_that_is_encrypted_or_compressed_in_another_way(place, value, tmp_path):
    content = bytearray(NPZ)
    for mark, offset in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        at = content.find(mark)
        while at >= 0:
            content[at + place + offset : at + place + offset + 2] = value.to_bytes(2, "little")
            at = content.find(mark, at + 4)
    (tmp_path / "log.npz").write_bytes(content)
    assert not answered(sysid.read, tmp_path / "log.npz")


@many
@given(cut=st.integers(0, len(MAT) - 1))
def test_a_mat_that_was_cut_short_is_refused(tmp_path_factory, cut):
    path = tmp_path_factory.getbasetemp() / "log.mat"
    path.write_bytes(MAT[:cut])
    answered(sysid.read, path)
