"""Findings in words: phrases that the sentences of several answers share, on a terminal as on a page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.estimation.estimate import Estimate


def chance(p_value: float) -> str:
    """A p-value in words: how probable a finding is by chance."""
    return f"p = {p_value:.2g}" if p_value >= 1e-4 else "p < 0.0001"


def quantity(name: str, units: Mapping[str, str]) -> str:
    """The word for "theta", "theta_dot", "torque" or "time", for a plant with these units."""
    turning = {"theta": "angle", "theta_dot": "speed", "torque": "torque", "time": "time"}
    sliding = {"theta": "position", "torque": "force"}
    return sliding.get(name, turning[name]) if units["theta"] == "m" else turning[name]


def spaced_unit(name: str) -> str:
    """A unit to be written behind a number, with a space before it; empty for a plain number."""
    return "" if name == "1" else f" {name}"


def fitted_numbers(estimate: Estimate, effect: str | None = None) -> dict[str, dict[str, Any]]:
    """The fitted numbers {name: {value, sd, unit}}: all, or those of an effect and such ratios of them as are known."""
    parameters, sd = estimate.model.parameters, estimate.sd
    numbers = {
        name: {"value": value, "sd": sd[name], "unit": parameters[name].unit}
        for name, value in estimate.values.items()
        if effect is None or parameters[name].owner == effect
    }
    for present in (e for e in estimate.model.effects if e.name == effect):
        for ratio, (above, below, unit) in present.ratios.items():
            parts = [f"{effect}.{part}" for part in (above, below)]
            if numbers.keys() >= set(parts) and (known := _ratio(estimate, *parts)) is not None:
                numbers[f"{effect}.{ratio}"] = known | {"unit": estimate.model.plant.unit(unit)}
    return numbers


def _ratio(estimate: Estimate, above: str, below: str) -> dict[str, float] | None:
    """The ratio r = a / b of two fitted numbers and its sd, to first order; None if the sd is half of r or more.

    sd = r |(1/a, -1/b)|_C,   C their covariance
    """
    at = [estimate.names.index(n) for n in (above, below)]
    a, b = (float(estimate.values[n]) for n in (above, below))
    if not (a > 0.0 and b > 0.0):
        return None
    slope = np.array([1.0 / a, -1.0 / b])
    share = math.sqrt(max(float(slope @ estimate.covariance[np.ix_(at, at)] @ slope), 0.0))
    return {"value": a / b, "sd": share * a / b} if share < 0.5 else None


def with_numbers(effect: str, numbers: Mapping[str, Mapping[str, Any]]) -> str:
    """An effect and its fitted numbers: "coulomb (tau_c = 0.1499 +- 6.1e-05 N m)"."""
    return f"{effect} ({numbers_in_words(numbers)})"


def numbers_in_words(numbers: Mapping[str, Mapping[str, Any]]) -> str:
    """Fitted numbers of one owner: "m = 1.04 +- 0.0003 kg, l = 0.97 +- 0.0002 m"."""
    return ", ".join(
        f"{name.rpartition('.')[2]} = {n['value']:.4g} +- {n['sd']:.2g}{spaced_unit(n['unit'])}"
        for name, n in numbers.items()
    )


def dependence_on(quantities: Sequence[str], *where: str) -> str:
    """A phrase on what an unexplained torque depends on, and where it acts. What nothing predicts depends on "time"."""
    on = [name for name in quantities if name != "time"]
    if len(on) < len(quantities):
        on.append("in part on nothing that was read" if on else "nothing that was read")
    return ", ".join(["it depends on " + " and ".join(on), *filter(None, where)])
