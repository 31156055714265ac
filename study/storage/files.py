"""Whole files, as sysid.files writes them."""

from sysid.files import partial, write_whole

__all__ = ["partial", "write_whole"]
