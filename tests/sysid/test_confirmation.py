"""Confirmation keeps no addition that raises the error on held-out data, unless it is a friction that the losses of
held-out swings confirm."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.data.sensor import Sensor
from sysid.diagnosis import confirmation
from sysid.diagnosis.answer import MissingTorque, Remaining
from sysid.diagnosis.confirmation import Confirmation
from sysid.diagnosis.criteria import NEGLIGIBLE_RISE
from sysid.diagnosis.explanation import Evidence, Explanation
from sysid.diagnosis.friction_sets import FrictionSets
from sysid.diagnosis.search import Addition
from sysid.diagnosis.search_settings import DEFAULT, SearchSettings
from sysid.estimation.torque_regression import FrictionAlong
from sysid.physics.effects import CATALOGUE

NAMES = ("coulomb", "tilt", "viscous")
TILT_IS_RARE = SearchSettings(rare_from=CATALOGUE["tilt"].rarity)
SUBSETS = tuple(own for size in range(len(NAMES) + 1) for own in combinations(NAMES, size))


def _torque(after: float, drive: float = 10.0) -> MissingTorque:
    return MissingTorque(drive, 1.0, after)


class Named(tuple[str, ...]):
    """A fit of a script: the names of its additions, an inertia, dry friction, and speeds that share no error."""

    samples, inertia = SimpleNamespace(error_channel=0, driven=True), 1.0
    model = SimpleNamespace(effects=(SimpleNamespace(is_dry=True, contains=()),), input_effects=())


HIDDEN = Addition("coulomb", (), (), 0.0)


class Told(Explanation):
    """An explanation of a script: its error is given, and something remains."""

    evidence: ScriptedEvidence

    @property
    def error(self) -> Any:
        return SimpleNamespace(ratio=self.evidence.ratios[self.names])

    torque: Any = _torque(1.0)
    remains: Any = True
    fails_elsewhere: Any = False
    friction_along: Any = None


class ScriptedEvidence(Evidence):
    """The evidence of a script: the error of every set of additions."""

    ratios: dict[tuple[str, ...], float]
    held_out_balance: Any = None

    @property
    def bare(self) -> Any:
        return Told(self, (), cast(Any, Named()))


class Scripted(Confirmation):
    """A confirmation of three stages, whose errors, and which of its additions hide something, are given."""

    def __init__(
        self,
        ratios: dict[tuple[str, ...], float],
        hiding: frozenset[str],
        settings: SearchSettings = DEFAULT,
        stages: Sequence[tuple[str, ...]] = tuple(NAMES[: k + 1] for k in range(len(NAMES))),
        replaced: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.ratios, self.hiding = ratios, hiding
        made = {name: Addition(name, (), (), 0.0) for name in NAMES}
        made |= {name: replace(made[name], replaced=(made[simpler],)) for name, simpler in replaced.items()}
        sensor = Sensor(theta=1.0)
        slight = ("coulomb", "warming_friction", "spring")
        found = [([made[name] for name in own], own) for own in stages]
        parts: Any = {"stages": found, "settings": settings, "negligible": slight, "sensor": sensor, "effects": None}
        parts["simpler_forms"] = lambda _, own: [(self.simpler[1:], None)] if own.name in self.simpler[:1] else ()
        parts["in_place_of"] = lambda refined, new, own: [
            made[n] for a in own for n in (new if a is refined else [a.name])
        ]
        search: Any = SimpleNamespace(**parts)
        evidence = ScriptedEvidence(search, cast(Any, Named()), (), (), sensor)
        evidence.ratios = ratios
        super().__init__(evidence)

    def explanation(self, additions: Sequence[Addition]) -> Explanation:
        return self._weigh(additions, cast(Any, None))

    def _weigh(self, additions: Sequence[Addition], fit: Any) -> Explanation:
        found = Told(self.evidence, tuple(additions), fit)
        found.fit = cast(Any, Named(found.names))
        return found

    simpler: tuple[str, ...] = ()
    """A refinement, and what comes in its place."""

    def _other_frictions(self, sets: FrictionSets) -> list[Explanation]:
        return []

    def _swells(self, *_: Any) -> bool:
        return False

    def _take_numbers_that_predict_best(self) -> None:
        """A script has no numbers."""

    def _another_pays(self, end: Any) -> bool:
        return True

    def _is_part_of_unknown(self, addition: Any, *_: Any) -> bool:
        return addition.name in self.hiding


@contextmanager
def scripted() -> Iterator[pytest.MonkeyPatch]:
    """Each addition is something, is determined and is plausible, where the test says nothing else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(confirmation, "hidden_friction", lambda _: None)
        patch.setattr(confirmation, "is_nothing", lambda *_: False)
        patch.setattr(confirmation, "is_undetermined", lambda *_: False)
        patch.setattr(confirmation, "is_plausible", lambda *_: True)
        patch.setattr(confirmation, "shows_in_balance", lambda *_: False)
        yield patch


@given(st.integers(0, 2**32 - 1), st.frozensets(st.sampled_from(NAMES)))
def test_what_is_kept_errs_no_more_than_the_model_as_it_came(seed: int, hiding: frozenset[str]) -> None:
    ratios = np.random.default_rng(seed).uniform(1.0, 4.0, len(SUBSETS)).tolist()
    with scripted():
        found = Scripted(dict(zip(SUBSETS, ratios, strict=True)), hiding)
    kept = found.now.names
    assert found.ratios[kept] <= found.ratios[()] * (1.0 + 2.0 * NEGLIGIBLE_RISE)
    assert set(kept) | set(found.unconfirmed) == set(NAMES) and not set(kept) & set(found.unconfirmed)
    assert not hiding & set(kept)


@pytest.mark.parametrize("unknown", NAMES)
def test_what_the_readings_do_not_determine_is_no_finding(unknown: str) -> None:
    fewer = {own: 4.0 - len(own) + 0.1 * (unknown not in own) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(confirmation, "is_undetermined", lambda _, name: name == unknown)
        found = Scripted(fewer, frozenset())
    assert found.now.names == tuple(sorted(set(NAMES) - {unknown}))
    assert found.unconfirmed == [unknown]


@pytest.mark.parametrize(("error", "remains"), [(5.0, False), (7.0, True)])
def test_errors_of_a_few_times_the_noise_are_none(error: float, remains: bool) -> None:
    """A noise that was given too small by less needs no random torque, and is no finding."""
    among: Any = SimpleNamespace(settings=DEFAULT, widened=False)
    own = Explanation(among, (), cast(Any, SimpleNamespace(undisturbed=True)))
    vars(own)["fitted_error"] = error
    assert own.remains is remains


@pytest.mark.parametrize(("factor", "stays"), [(0.3, True), (0.9, False)])
def test_what_halves_the_held_out_error_stays_though_more_torque_is_missing(factor: float, stays: bool) -> None:
    fewer = {own: 10.0 * (factor if "coulomb" in own else 1.0) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(Told, "torque", property(lambda own: _torque(2.0 if "coulomb" in own.names else 1.0)))
        found = Scripted(fewer, frozenset())
    assert found.now.names == (("coulomb",) if stays else ())


@pytest.mark.parametrize(("factor", "missing", "stays"), [(0.6, 1.0, True), (0.6, 2.0, False), (0.3, 2.0, True)])
def test_hidden_friction_is_named_unless_it_imitates_something_unknown(
    factor: float, missing: float, stays: bool
) -> None:
    """More torque is missing with what imitates, and the error does not halve."""
    errors = {own: 10.0 for own in SUBSETS} | {("coulomb",): 10.0 * factor}
    with scripted() as patch:
        patch.setattr(Told, "torque", property(lambda own: _torque(missing if own.names else 1.0)))
        patch.setattr(confirmation, "hidden_friction", lambda bare: Told(bare.evidence, (HIDDEN,), cast(Any, Named())))
        found = Scripted(errors, frozenset(), stages=())
    assert found.now.names == (("coulomb",) if stays else ())
    assert (("coulomb",) in found.weighed) is stays


def test_beside_an_error_that_speeds_share_the_missing_torque_is_no_judge() -> None:
    fewer = {own: 10.0 * (0.9 if "coulomb" in own else 1.0) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(Named, "samples", SimpleNamespace(error_channel=1, driven=True))
        patch.setattr(Told, "torque", property(lambda own: _torque(2.0 if "coulomb" in own.names else 1.0)))
        found = Scripted(fewer, frozenset())
    assert found.now.names == ("coulomb",)


@pytest.mark.parametrize(("small", "stays"), [("coulomb", True), ("viscous", True), ("tilt", False)])
def test_a_rarer_effect_has_to_do_more_to_stay(small: str, stays: bool) -> None:
    """Of the error beyond the noise, the others halve what is left; three per cent are enough for a friction alone."""
    factors = {name: 0.97 if name == small else 0.5 for name in NAMES}
    beyond = {own: 4.0 * math.prod(factors[name] for name in own) for own in SUBSETS}
    with scripted():
        found = Scripted({own: math.sqrt(1.0 + x * x) for own, x in beyond.items()}, frozenset())
    assert found.now.names == tuple(name for name in NAMES if stays or name != small)


@pytest.mark.parametrize(("share", "stays"), [(0.99, False), (0.97, True)])
def test_a_rare_effect_alone_has_to_lower_the_error_too(share: float, stays: bool) -> None:
    """The two frictions beside it change nothing, and go first."""
    beyond = {own: 4.0 * (share if "tilt" in own else 1.0) for own in SUBSETS}
    with scripted():
        found = Scripted({own: math.sqrt(1.0 + x * x) for own, x in beyond.items()}, frozenset())
    assert found.now.names == (("tilt",) if stays else ())


@pytest.mark.parametrize(("share", "stays"), [(0.75, False), (0.65, True)])
@pytest.mark.parametrize("friction", [0.5, 1.0])
def test_a_rare_effect_has_to_halve_the_square_of_what_is_left(friction: float, share: float, stays: bool) -> None:
    """Alone, and beside a friction that explains as much or more."""
    factors = {"tilt": share, "coulomb": friction, "viscous": 1.0}
    beyond = {own: 4.0 * math.prod(factors[name] for name in own) for own in SUBSETS}
    with scripted():
        found = Scripted({own: math.sqrt(1.0 + x * x) for own, x in beyond.items()}, frozenset(), TILT_IS_RARE)
    assert ("tilt" in found.now.names) is stays


@pytest.mark.parametrize(("share", "stays"), [(0.75, False), (0.65, True)])
def test_a_refinement_has_to_beat_what_it_replaced_or_makes_place_for_it(share: float, stays: bool) -> None:
    """A friction that gives, in place of a stiff one, is judged against that one."""
    beyond = {own: 8.0 * (0.1 if own else 1.0) * (share if "tilt" in own else 1.0) for own in SUBSETS}
    stages = (("coulomb",), ("tilt",))
    with scripted() as patch:
        patch.setattr(confirmation, "CATALOGUE", {**CATALOGUE, "tilt": CATALOGUE["dahl"]})
        ratios = {own: math.sqrt(1.0 + x * x) for own, x in beyond.items()}
        found = Scripted(ratios, frozenset(), stages=stages, replaced={"tilt": "coulomb"})
    assert found.now.names == (("tilt",) if stays else ("coulomb",))
    assert found.unconfirmed == ([] if stays else ["tilt"])


@pytest.mark.parametrize(("share", "stays"), [(1.01, False), (0.99, True)])
def test_beside_what_no_other_effect_explains_a_rare_effect_need_only_not_raise_the_error(
    share: float, stays: bool
) -> None:
    beyond = {own: 4.0 * (share if "tilt" in own else 1.0) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(Scripted, "_another_pays", lambda _, end: "tilt" not in end)
        found = Scripted({own: math.sqrt(1.0 + x * x) for own, x in beyond.items()}, frozenset(), TILT_IS_RARE)
    assert ("tilt" in found.now.names) is stays


def test_with_which_nothing_remains_a_rare_effect_need_not_lower_the_held_out_error() -> None:
    with scripted() as patch:
        patch.setattr(Told, "remains", property(lambda own: "tilt" not in own.names))
        found = Scripted({own: 2.0 for own in SUBSETS}, frozenset())
        assert found.now.names == ("tilt",)
        raised = Scripted({own: 2.01 if "tilt" in own else 2.0 for own in SUBSETS}, frozenset())
    assert "tilt" not in raised.now.names


def test_of_two_that_are_needless_the_rarer_one_goes_first() -> None:
    """The errors of a filmed pendulum with two frictions and a drift, for which the tilt stands here: without the dry
    friction less is lost than without the drift, and then the drift is too rare for what it explains."""
    errors = {(): 23.02, ("coulomb",): 9.33, ("tilt",): 22.94, ("viscous",): 3.66}
    errors |= {("coulomb", "tilt"): 9.17, ("coulomb", "viscous"): 3.47, ("tilt", "viscous"): 3.22, NAMES: 3.21}
    with scripted():
        found = Scripted(errors, frozenset(), TILT_IS_RARE)
    assert found.now.names == ("coulomb", "viscous")


@pytest.mark.parametrize(("share", "returns"), [(0.9, True), (0.99, False)])
def test_what_a_dropped_addition_had_taken_the_place_of_comes_back(share: float, returns: bool) -> None:
    """The tilt took the place of the dry friction, and is too rare for what it explains; with the dry friction the
    error is this share of what it is with the viscous one alone."""
    errors = {own: 9.0 for own in SUBSETS} | {("viscous",): 4.0, ("coulomb", "viscous"): 4.0 * share}
    errors |= {("tilt", "viscous"): 3.5}
    stages = (("viscous",), ("coulomb", "viscous"), ("tilt", "viscous"))
    with scripted():
        found = Scripted(errors, frozenset(), TILT_IS_RARE, stages)
    assert found.now.names == (("coulomb", "viscous") if returns else ("viscous",))


@pytest.mark.parametrize(("share", "stays"), [(1.01, False), (0.999, True)])
def test_what_the_energy_balance_shows_need_only_not_raise_the_error(share: float, stays: bool) -> None:
    errors = {own: 4.0 * (share if "coulomb" in own else 1.0) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(confirmation, "shows_in_balance", lambda before, after, _: "coulomb" not in before)
        patch.setattr(Named, "model", property(lambda self: self))
        patch.setattr(Named, "effects", (), raising=False)
        found = Scripted(errors, frozenset())
    assert found.now.names == (("coulomb",) if stays else ())


@pytest.mark.parametrize(("share", "stays"), [(0.99, False), (0.9, True)])
def test_a_refinement_has_to_beat_its_simpler_form_on_held_out_data(share: float, stays: bool) -> None:
    """The tilt is a refinement of viscous friction here; without either the error is far larger."""
    errors = {own: 9.0 for own in SUBSETS} | {("viscous",): 4.0, ("tilt",): 4.0 * share}
    with scripted() as patch:
        patch.setattr(confirmation, "settled", lambda fit: fit)
        patch.setattr(Scripted, "simpler", ("tilt", "viscous"))
        found = Scripted(errors, frozenset(), stages=(("tilt",),))
    assert found.now.names == (("tilt",) if stays else ("viscous",))


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_friction_that_the_losses_of_held_out_swings_confirm_may_raise_the_error(confirmed: bool) -> None:
    """The error is 2 % larger with the dry friction, more torque is missing beside it, and the balances of the fitted
    and of the held-out swings show it, or only those of the fitted."""
    errors = {own: 4.0 * (1.02 if "coulomb" in own else 1.0) for own in SUBSETS}
    held_out = SimpleNamespace(deviance=lambda names: 10.0 - 9.0 * (confirmed and "coulomb" in names))
    with scripted() as patch:
        patch.setattr(confirmation, "shows_in_balance", lambda before, after, _: "coulomb" in set(after) - set(before))
        patch.setattr(Named, "model", property(lambda self: self))
        patch.setattr(Named, "effects", (), raising=False)
        patch.setattr(Told, "torque", property(lambda own: _torque(1.0 + ("coulomb" in own.names))))
        patch.setattr(ScriptedEvidence, "held_out_balance", held_out)
        found = Scripted(errors, frozenset())
    assert found.now.names == (("coulomb",) if confirmed else ())


@pytest.mark.parametrize(
    ("name", "driven", "part"), [("tilt", True, True), ("tilt", False, False), ("spring", False, True)]
)
def test_a_zero_of_a_free_swing_is_no_part_of_something_unknown(name: str, driven: bool, part: bool) -> None:
    """What remains depends on the angle, and the effect, a function of the angle, explains nothing of it."""
    with scripted() as patch:
        patch.setattr(Named, "samples", SimpleNamespace(error_channel=0, driven=driven))
        patch.setattr(Named, "at_bounds", frozenset(), raising=False)
        patch.setattr(Told, "remaining", Remaining(0.5, ("theta",), ""))
        patch.setattr(Told, "missing_over", lambda *_: 1.0)
        found = Scripted({own: 4.0 - len(own) for own in SUBSETS}, frozenset())
        addition = Addition(name, (), (), 0.0)
        assert Confirmation._is_part_of_unknown(found, addition, found.bare) is part


@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("swells", [True, False])
def test_of_two_zeros_that_swell_beside_each_other_one_goes(swells: bool, driven: bool) -> None:
    """An offset stands for the viscous friction; without it less is lost than without the tilt."""
    share = {"coulomb": 0.5, "tilt": 0.5, "viscous": 0.7}
    errors = {own: 9.0 * math.prod(share[name] for name in own) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(Named, "samples", SimpleNamespace(error_channel=0, driven=driven))
        patch.setattr(confirmation, "CATALOGUE", {**CATALOGUE, "viscous": CATALOGUE["torque_bias"]})
        patch.setattr(Scripted, "_swells", lambda *_: swells)
        found = Scripted(errors, frozenset())
    assert found.now.names == (("coulomb", "tilt") if swells else NAMES)


@pytest.mark.parametrize("kept", NAMES)
def test_what_keeps_another_number_plausible_is_not_dropped(kept: str) -> None:
    """A spring and a friction, beside which a friction that gives like a spring is needless and without which it gives
    by more than the machine moves."""
    other = NAMES[NAMES.index(kept) - 1]
    fewer = {own: 4.0 - 0.1 * len(own) - 3.0 * (kept in own or other in own) for own in SUBSETS}
    with scripted() as patch:
        patch.setattr(confirmation, "is_plausible", lambda _, names: other not in names or kept in names)
        patch.setattr(confirmation, "is_lowered", lambda error, without, _: error < 0.5 * without)
        found = Scripted(fewer, frozenset())
    assert found.now.names == (kept,)


@pytest.mark.parametrize("another", [False, True])
def test_what_is_another_effect_without_its_fellow_does_not_take_its_place(another: bool) -> None:
    """The tilt alone errs least, but leans by several times as much as beside the friction that it was found with."""
    ratios = {own: (3.5 if "coulomb" in own else 5.0) - 0.01 * len(own) for own in SUBSETS}
    ratios |= {(): 9.0, ("tilt",): 2.0, ("coulomb", "tilt"): 3.475}
    with scripted() as patch:
        patch.setattr(Scripted, "_swells", lambda _, name, before, after: another and "coulomb" not in before)
        found = Scripted(ratios, frozenset(), TILT_IS_RARE)
    assert found.now.names == (("coulomb",) if another else ("tilt",))


def test_a_slight_effect_is_not_reconsidered_beside_one_that_it_contains() -> None:
    """Dry friction that falls as the machine warms up, beside dry friction: what one lacks the other has."""
    asked: list[str] = []
    with scripted() as patch:
        patch.setattr(Told, "fails_elsewhere", True)
        patch.setattr(Told, "remains", False)
        patch.setattr(confirmation, "scores", lambda _, names: asked.extend(names) or {})
        Scripted({own: 9.0 * 0.5 ** len(own) for own in SUBSETS}, frozenset())
    assert asked == ["spring"]


SEEN, ANOTHER, UNSEEN = (1.2, 0.01), (0.1, 0.01), (0.01, 0.01)


@pytest.mark.parametrize(
    ("drive", "along", "inertia", "said"),
    [
        (0.5, True, SEEN, True),
        (0.5, False, SEEN, False),
        (2.0, True, ANOTHER, True),
        (2.0, True, SEEN, False),
        (3.0, True, ANOTHER, False),
        (3.0, True, UNSEEN, True),
        (10.0, True, UNSEEN, False),
    ],
)
def test_friction_along_the_motion_is_told_alone_where_a_model_misses_more_than_the_drive_has_or_friction_leaves(
    drive: float, along: bool, inertia: tuple[float, float], said: bool
) -> None:
    """A torque of 1 is missing, and friction leaves a twentieth of the drive's squares."""
    friction = FrictionAlong((0.0, 1.0), (0.2, 0.01), (0.0, 1.0), inertia, 0.95)
    with scripted() as patch:
        patch.setattr(Told, "friction_along", friction if along else None)
        patch.setattr(Scripted, "_compare_frictions", lambda own: own.as_likely.append(own.bare))
        patch.setattr(Told, "torque", _torque(1.0, drive))
        patch.setattr(Told, "remaining", Remaining(0.5, (), ""))
        found = Scripted({own: 4.0 - len(own) for own in SUBSETS}, frozenset())
    assert found.friction is (friction if said else None)
    assert found.now.names == (() if said else NAMES)
    assert not found.unconfirmed and bool(found.as_likely) is not said
