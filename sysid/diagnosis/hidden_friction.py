"""Hidden friction: friction that predictions show where likelihood does not, beside something unknown."""

from __future__ import annotations

from itertools import combinations

from sysid.diagnosis.criteria import is_lowered, is_plausible, squared_size
from sysid.diagnosis.explanation import Explanation
from sysid.diagnosis.search import Addition
from sysid.estimation.energy_balance import FRICTIONS
from sysid.estimation.first_fit import COMMON
from sysid.estimation.horizon_fit import horizon_fit
from sysid.estimation.likelihood import p_value
from sysid.estimation.refits import settled


def hidden_friction(bare: Explanation) -> Explanation | None:
    """The explanation by friction, or by friction and an offset, with which a driven motion is predicted best; None if
    no more than the noise remains in fitted or in held-out data, or if no such explanation is sure.

    If a model lacks something that no known effect is, its likeliest numbers imitate that, and may predict worse with a
    friction that is there. So the numbers are those of `horizon_fit`, and their sizes have to be sure by its jackknife.
    Since nothing else speaks for them, they have to lower the held-out error as a rare effect has to (`rare_fall`); a
    larger set has to lower it by the `tolerance` again.
    """
    evidence, best = bare.evidence, None
    search, settings = evidence.search, evidence.settings
    if not (bare.fit.samples.driven and bare.remains):
        return None
    before = min(e.error.ratio for e in (bare, bare.predicting_best) if e is not None)
    if not before**2 > 1.0 + settings.remaining_error**2:
        return None
    visible = [n for n in COMMON if n in search.first and search.first[n].visible]
    sets = (names for k in range(1, len(visible) + 1) for names in combinations(visible, k))
    for names in (names for names in sets if not set(FRICTIONS).isdisjoint(names)):
        for trial in search.trial(bare.fit, names):
            fit = horizon_fit(settled(trial.fit), settings.ahead)
            if fit is None or not is_plausible(fit, names):
                continue
            sizes = {n: squared_size(fit, n) for n in names}
            additions = [Addition(n, search.inseparable(n), (), p_value(size, 1)) for n, size in sizes.items()]
            other = Explanation(evidence, tuple(additions), fit)
            least, fall = (before, settings.rare_fall) if best is None else (best.error.ratio, settings.tolerance)
            sure = all(size > settings.sure_size for size in sizes.values())
            if sure and is_lowered(other.error.ratio, least, fall):
                best = other
    return best
