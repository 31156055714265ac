"""Tables of a function over a regular grid, multilinear between the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.physics.ops import Array


@dataclass(frozen=True)
class Axis:
    """`count` nodes over `span`, centred at zero: from -span/2 around a circle, or to span/2 along a line.

    What lies beyond a line's ends counts as its ends. The nodes of a line are odd in number, those of a circle even, so
    that zero is one of them.
    """

    span: float
    count: int
    circle: bool = False

    @property
    def spacing(self) -> float:
        """Between two nodes."""
        return self.span / (self.count if self.circle else self.count - 1)

    @property
    def nodes(self) -> Array:
        """Where they are (count,)."""
        return self.spacing * (np.arange(self.count) - self.count // 2)

    def around(self, x: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
        """The nodes below and above x, and the share of the upper one, each of the shape of x."""
        place = np.asarray(x) / self.spacing + self.count // 2
        if self.circle:
            below = np.floor(place).astype(np.int32)
            return below % self.count, (below + 1) % self.count, place - below
        place = np.clip(place, 0.0, self.count - 1.0)
        below = np.minimum(place.astype(np.int32), self.count - 2)
        return below, below + 1, place - below


def corners(axes: Sequence[Axis], point: Sequence[ArrayLike]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The nodes (..., 2^D) around each point, numbered as in a flat table over D axes, and their weights (..., 2^D)."""
    nodes, weights = np.zeros(1, dtype=np.int32), np.ones(1, dtype=np.float32)
    for axis, x in zip(axes, np.broadcast_arrays(*point), strict=True):
        below, above, share = axis.around(x)
        pair = np.stack([below, above], axis=-1)[..., None, :]
        shares = np.stack([1.0 - share, share], axis=-1).astype(np.float32)[..., None, :]
        nodes = (nodes[..., None] * np.int32(axis.count) + pair).reshape(*x.shape, -1)
        weights = (weights[..., None] * shares).reshape(*x.shape, -1)
    return nodes, weights
