"""Probes: the values that a parameter is tried at before anything is fitted, by what the log can show."""

from __future__ import annotations

from collections.abc import Callable

from sysid.physics.parameters import Extent

LogProbe = Callable[[Extent], tuple[float, ...]]


def of_largest(*shares: float) -> LogProbe:
    """Shares of the log's largest torque; the shares themselves where the log has none."""
    return lambda extent: tuple(share * (extent.u_max or 1.0) for share in shares)


def of_curve(*shares: float) -> LogProbe:
    """Shares of the slope that takes the log's largest torque at its largest speed."""
    return lambda extent: tuple(share * (extent.u_max or 1.0) / extent.speed for share in shares)


def of_duration(*shares: float) -> LogProbe:
    """Shares of the log's longest rollout [s], 0.1 s at least."""
    return lambda extent: tuple(max(share * extent.duration, 0.1) for share in shares)


def doubling(longest: float) -> LogProbe:
    """Times [s]: 0.5, 1, 2, 4, ... intervals, as far as `longest` [s] and the log reach."""

    def times(extent: Extent) -> tuple[float, ...]:
        last, found = min(longest, extent.duration), [0.5 * extent.dt]
        while 2.0 * found[-1] <= last:
            found.append(2.0 * found[-1])
        return tuple(found) if found[0] <= last else (last,)

    return times
