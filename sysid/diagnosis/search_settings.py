"""Search settings: the thresholds that an effect has to pass before it is added, with their reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sysid.errors import InvalidInput
from sysid.estimation.prediction import BLOCKS, HORIZON

SHORTEST_HORIZON, LONGEST_HORIZON = 0.02, 600.0
"""Shortest and longest horizon [s] that can be asked for."""


@dataclass(frozen=True)
class SearchSettings:
    """What counts as evidence, and what counts as large enough to matter.

    The collinearity of two effects is the cosine between their sensitivities (`collinearity`): 1 if this log cannot
    tell them apart.

    Attributes
    ----------
    price : float
        Decrease of the deviance (-2 log likelihood) that an effect has to bring for each of its numbers: noise alone
        brings more than 3 in 1 of 12 logs.
    tolerance : float
        An effect matters if it lowers the error of predictions by this share; to stay, a rare one has to lower the
        held-out error by more (`Confirmation`).
    noise_share : float
        Smallest change of predictions that matters, in units of the sensor noise.
    horizon : float or None
        How far ahead [s] predictions have to be right, at most as far as is `foreseeable` and as the longest held-out
        record; None: as far as they tell of the machine (`telling_horizon`).
    steps : int
        Most additions.
    samples : int
        Most samples of a log that are searched, spread over it: with more, intervals would be narrower, but a search
        would take minutes.
    blocks : int
        Number of stretches that are left out in turn in the cross-validation of a candidate.
    trials : int
        Most single effects that a round fits at first; as many others again if none of these pays.
    least_promise : float
        Least expected merit of an effect that is fitted at first, as a share of the largest expected merit.
    always_tried : tuple of str
        Effects that are fitted in every round in which a random torque is needed, since it may hide them.
    composites : tuple of tuples of str
        Effects that come together and may not pay alone; what does not pay beside the others is dropped.
    simulated_trials : int
        Most candidates that are fitted after the model was simulated, which is done if no effect pays otherwise.
    simulated_share : float
        Share of the disturbances that are left in that simulation.
    nearly_as_good : float
        Least merit of a trial that is chosen for its better predictions, as a share of the best merit.
    sure_size : float
        Least squared size of an effect, per number and in units of its variance: two standard deviations.
    clear_size : float
        Squared size from which leaving the effect out is not tried: ten standard deviations.
    recurrences : float
        How often a ripple or a periodic torque has to come back within a record.
    count_sd : float
        Largest sd of that count: of a pattern that really comes back, a log tells it to a few hundredths.
    same_collinearity : float
        Collinearity from which two effects are the same to this log.
    high_collinearity : float
        Collinearity from which telling two effects apart takes 100 times the evidence of finding one.
    equal_deviance : float
        Difference of the deviance below which effects of a high collinearity are the same to this log, too: where the
        fit is far from the truth, their sensitivities differ a little, but what they explain does not.
    rival_collinearity : float
        Collinearity from which two effects are rivals.
    close_deviance : float
        Difference of the deviance below which rivals explain a log equally well.
    balance_deviance : float
        Decrease of the deviance of an energy balance (`EnergyBalance`) from which its frictions matter, however little
        predictions show of them.
    remaining_error : float
        Error of predictions beyond the noise, as a multiple of the noise, from which something that matters is still
        missing.
    unseen_error_factor : float
        Ratio of the held-out error to that of what was fitted, from which something is missing that shows only in
        held-out data; right models stay below 1.15.
    rare_from : float
        Rarity from which an effect counts as rare.
    rare_fall : float
        A rare effect has to lower the held-out error's excess over the noise by this share, which halves its square.
        One that explains less is likelier a part of something unknown.
    explained_share : float
        Least share of the missing torque that a function of one quantity has to explain if what remains depends on that
        quantity, too: it could be a part of something unknown. If what remains depends on others as well, the share is
        of what this quantity predicts.
    decisive_fall : float
        An addition with which more torque is missing stays if it lowers the held-out error's excess over the noise by
        this share.
    swollen_factor : float
        If a zero grows by this factor when another zero is added, the two make up for each other. A rare effect of
        which a number grows by it when another addition is left out is another effect.
    farther_factor : float
        A model leaves far more torque missing than friction along the motion does if it is by this factor.
    inertia_factor : float
        A model has quite another inertia than the torque along the motion shows if they differ by this factor.

    Raises
    ------
    InvalidInput
        For a tolerance that is not from 0 to below 1, or a horizon that is not from 0.02 to 600 s.
    """

    price: float = 3.0
    tolerance: float = 0.02
    noise_share: float = 0.07
    horizon: float | None = None
    steps: int = 6
    samples: int = 6000
    blocks: int = BLOCKS
    trials: int = 5
    least_promise: float = 0.2
    always_tried: tuple[str, ...] = ("coulomb", "viscous", "tilt", "delay")
    composites: tuple[tuple[str, ...], ...] = (
        ("viscous", "coulomb"),
        ("coulomb", "tilt"),
        ("viscous", "tilt"),
        ("coulomb", "delay"),
        ("viscous", "coulomb", "tilt"),
        ("viscous", "coulomb", "torque_bias"),
        ("viscous", "coulomb", "drag"),
        ("coulomb", "drag"),
        ("lag", "dead_zone"),
        ("saturation", "spring"),
        ("spring", "torque_bias"),
        ("coulomb", "spring", "torque_bias"),
        ("viscous", "spring"),
        ("viscous", "spring", "torque_bias"),
        ("torque_speed_limit", "coulomb", "delay"),
        ("coulomb", "flexible_transmission"),
    )
    simulated_trials: int = 3
    simulated_share: float = 1e-3
    nearly_as_good: float = 0.5
    sure_size: float = 4.0
    clear_size: float = 100.0
    recurrences: float = 2.0
    count_sd: float = 0.15
    same_collinearity: float = 1.0 - 1e-5
    high_collinearity: float = 0.995
    equal_deviance: float = 0.1
    rival_collinearity: float = 0.8
    close_deviance: float = 3.0
    balance_deviance: float = 10.0
    remaining_error: float = 0.3
    unseen_error_factor: float = 1.25
    rare_from: float = 1.5
    rare_fall: float = 1.0 - math.sqrt(0.5)
    explained_share: float = 2.0 / 3.0
    decisive_fall: float = 0.5
    swollen_factor: float = 3.0
    farther_factor: float = 1.5
    inertia_factor: float = 1.5

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance < 1.0:
            raise InvalidInput(f"tolerance = {self.tolerance:g}: expected a share below 1, such as 0.02")
        if self.horizon is not None and not SHORTEST_HORIZON <= self.horizon <= LONGEST_HORIZON:
            choices = f"expected {SHORTEST_HORIZON:g} to {LONGEST_HORIZON:g} s"
            raise InvalidInput(f"horizon = {self.horizon:g}: {choices}")

    @property
    def ahead(self) -> float:
        """The horizon [s]; a second if none is asked for."""
        return HORIZON if self.horizon is None else self.horizon


DEFAULT = SearchSettings()
