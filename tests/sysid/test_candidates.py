"""Candidates: every effect can be tried on any log, from neutral, on the side on which it can be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from sysid import CATALOGUE, Delay, Effect, Joint, JointEffect, Model, Record, RodPendulum, Stamp, Viscous, simulate
from sysid.data.record import extent_of
from sysid.physics.candidates import Candidate, candidates, candidates_for
from sysid.physics.parameters import NEVER, Extent, parameter
from sysid.planning.excitation import multisine

DT = 0.02
EXTENT = Extent(DT, 6.0, 2.0, speed=3.0)


def rod(*effects: Effect) -> Model:
    return Model(RodPendulum(), effects, dt=DT)


def motion(model: Model) -> np.ndarray:
    u = multisine(np.random.default_rng(0), 100, DT, 2.0, 3.0)
    run = simulate(model, u, math.pi + 0.5, 0.2)
    return np.stack([run.theta_read, run.theta_dot_read])


@pytest.fixture(params=CATALOGUE)
def tried(request: pytest.FixtureRequest) -> tuple[Candidate, ...]:
    return candidates_for(CATALOGUE[request.param], EXTENT)


def some(tried: tuple[Candidate, ...]) -> list[Candidate]:
    return [tried[i] for i in sorted({0, len(tried) // 2, len(tried) - 1})]


def test_neutral_changes_nothing_and_probes_do(tried: tuple[Candidate, ...]) -> None:
    plain = motion(rod())
    for a in some(tried):
        assert np.max(np.abs(motion(rod(a.neutral)) - plain)) < 1e-12
        for probe in a.probes:
            assert np.max(np.abs(motion(rod(probe)) - plain)) > 1e-9


def test_one_probe_a_magnitude_at_its_stated_size(tried: tuple[Candidate, ...]) -> None:
    for a in tried:
        assert len(a.magnitudes) == len(a.probes) == len(a.sizes) >= 1
        shapes = {k: v for k, v in a.neutral.parameters.items() if k not in a.magnitudes}
        for k, probe, size in zip(a.magnitudes, a.probes, a.sizes, strict=True):
            neutral = a.neutral.parameters[k].neutral
            for other, p in probe.parameters.items():
                expected = neutral + size if other == k else a.neutral.parameters[other].value
                assert p.value == pytest.approx(expected)
            assert all(probe.parameters[s].value == shapes[s].value for s in shapes)


def test_a_magnitude_is_tried_on_the_side_on_which_it_can_be(tried: tuple[Candidate, ...]) -> None:
    for a in tried:
        low, high = a.neutral.parameters[a.magnitudes[0]].bounds
        neutral = a.neutral.parameters[a.magnitudes[0]].neutral
        if len(a.magnitudes) == 1 and neutral in (low, high):
            assert a.side * a.sizes[0] > 0.0
            assert a.side == (1 if neutral == low else -1)
        else:
            assert a.side == 0


@pytest.mark.parametrize("factor", [-1e9, 0.0, 1.0, 1e9])
def test_a_fit_begins_inside_the_bounds(tried: tuple[Candidate, ...], factor: float) -> None:
    for a in some(tried):
        for k, p in a.at([factor * size for size in a.sizes]).parameters.items():
            low, high = p.bounds
            assert low <= p.value <= high
            assert k not in a.magnitudes or low < p.value < high, "at a bound nothing may have a slope"


def test_a_size_within_the_bounds_is_taken_as_it_is() -> None:
    (coulomb,) = candidates_for(CATALOGUE["coulomb"], EXTENT)
    assert coulomb.at((0.37,)).tau_c == pytest.approx(0.37)
    (gain,) = candidates_for(CATALOGUE["torque_gain"], EXTENT)
    assert gain.at((-0.2,)).c == pytest.approx(0.8)


def test_a_limit_at_never_begins_at_its_probe() -> None:
    for a in candidates_for(CATALOGUE["saturation"], EXTENT):
        assert a.neutral.limit >= NEVER
        assert a.at((-3.0,)).limit == a.probes[0].limit < EXTENT.u_max


def test_shapes_are_tried_in_every_combination() -> None:
    assert len(candidates_for(CATALOGUE["viscous"], EXTENT)) == 1
    stribeck = candidates_for(CATALOGUE["stribeck"], EXTENT)
    assert [a.neutral.v_s for a in stribeck] == [0.05, 0.15, 0.5]
    assert all(a.magnitudes == ("tau_c", "excess") and a.side == 0 for a in stribeck)
    assert len(candidates_for(CATALOGUE["ripple"], EXTENT)) == 23
    assert len(candidates_for(CATALOGUE["saturation"], EXTENT)) == 5


@pytest.mark.parametrize("u_max", [1e-7, 1e4, 1e9])
def test_probes_stay_within_the_bounds_whatever_the_unit_of_the_torque(u_max: float) -> None:
    """A log in counts is no reason to end: an effect whose bounds do not reach so far is not tried."""
    by_effect = candidates(rod(), lambda kind: Extent(DT, 6.0, u_max))
    assert {"coulomb", "viscous", "delay"} <= set(by_effect)
    sizes = [size for tried in by_effect.values() for a in tried for size in a.sizes]
    assert np.all(np.isfinite(sizes)) and np.all(sizes)
    assert ("saturation" in by_effect) == (u_max < 1e9)


def test_candidates_are_what_the_model_neither_has_nor_excludes() -> None:
    everything = set(CATALOGUE)
    assert set(candidates(rod(), lambda kind: EXTENT)) == everything
    assert set(candidates(rod(Viscous()), lambda kind: EXTENT)) == everything - {"viscous"}
    assert set(candidates(rod(Delay()), lambda kind: EXTENT)) == everything - {"delay", "stamp"}
    assert set(candidates(rod(Stamp()), lambda kind: EXTENT)) == everything - {"delay", "stamp"}
    assert set(candidates(rod(Viscous()), lambda kind: EXTENT, ("viscous", "drag"))) == {"drag"}


def test_an_effect_of_a_users_own_is_tried_like_ours(catalogue: dict[str, type[Effect]]) -> None:
    @dataclass(frozen=True, eq=False)
    class Pull(JointEffect):
        k: float = parameter(0.0, unit="N m", bounds=(-1.0, 0.0), neutral=0.0, probe=(-0.02,))
        at: float = parameter(1.0, unit="rad", bounds=(0.0, 3.0), probe=(0.5, 1.0))
        formula: ClassVar[str] = "tau = k sin(theta - at)"

        def torque(self, joint: Joint) -> float:
            from sysid.physics import ops

            return self.k * ops.sin(joint.theta - self.at)

    catalogue["pull"] = Pull
    tried = candidates(rod(), lambda kind: EXTENT)["pull"]
    assert [a.neutral.at for a in tried] == [0.5, 1.0]
    assert all(a.magnitudes == ("k",) and a.sizes == (-0.02,) and a.side == -1 for a in tried)


def test_extent_is_that_of_the_longest_and_strongest() -> None:
    def record(n: int, peak: float) -> Record:
        return Record(DT * np.arange(n + 1), np.full(n, peak), np.zeros(n + 1))

    assert extent_of([record(10, -3.0), record(50, 1.0)]) == pytest.approx(Extent(DT, 1.0, 3.0))
    silent = extent_of([record(10, 0.0)])
    assert all(len(candidates_for(kind, silent)) >= 1 for kind in CATALOGUE.values()), "a free swing has no torque"
