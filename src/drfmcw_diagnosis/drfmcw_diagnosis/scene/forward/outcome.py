"""What explanations of a scene leave of samples that were held out, each tested against the noise beside all lines."""

import dataclasses
import math

from ...finding.result import BeforeAfter, Fit
from ..bursts import Bursts
from ..limits import BURSTS
from ..lines import limited_fit
from ..material import Material
from ..rails import Limit
from ..ramps.ramp import Ramp
from .limits import FORWARD
from .misfit import bounded, tail
from .model import Straight, scattered, scene, straight
from .naming import Named


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Misfit per degree of freedom without and with what was found, and the chance of what is left."""

    fit: Fit
    chance: float  # of the misfit that is left on what was held out; NaN where it was not tested
    gain: float = 0.0  # of the logarithm of the likelihood of what was held out
    untested: str = ''  # what no test was made of, and why


def of_lines(found: Straight | None, effects: Named | None = None) -> Outcome:
    """Return what the lines of a straight ramp leave, and what they leave with effects; None: too few samples."""
    if found is None:
        nothing = BeforeAfter(math.nan, math.nan)
        said = f"Fewer than {FORWARD.fewest} samples of a sweep, or none but zeros: the scene's lines are not tested."
        return Outcome(Fit(nothing, nothing), math.nan, untested=said)
    before = found.fitted, found.held_out
    after = (effects.inside, effects.outside) if effects is not None else before
    inside, outside = (BeforeAfter(x.per_freedom, y.per_freedom) for x, y in zip(before, after, strict=True))
    return Outcome(Fit(inside, outside), after[1].probability)


def of_bursts(m: Material, found: Bursts, accepted: float) -> Outcome | None:
    """Return what lines and bursts leave, None where the bursts are no noise of their own."""
    held = scene(m, found.at)
    if held is None:
        return None
    fitted = straight(held)
    scatter = scattered(fitted)
    if scatter.above < BURSTS.above or bounded(scatter.gain) > accepted:
        return None
    inside = BeforeAfter(fitted.fitted.per_freedom, fitted.fitted.per_freedom)
    fit = Fit(inside, BeforeAfter(scatter.before, scatter.after))
    untested = 'What acts on all lines alike is not searched for beside bursts.'
    return Outcome(fit, fitted.held_out.probability, scatter.gain, untested)


def of_limit(m: Material, found: Limit) -> tuple[Outcome, str]:
    """Return what lines behind a limit leave, and that in words."""
    fit, count, said = limited_fit(m, found)
    gain = 0.5 * count * math.log(fit.held_out.before / fit.held_out.after)
    chance = tail(fit.held_out.after, count, m.floor.freedom)
    untested = 'Bursts, and what acts on all lines alike, are not searched for behind a limit.'
    return Outcome(fit, chance, max(gain, 0.0), untested), said


def of_ramp(found: Ramp) -> Outcome:
    """Return what the ramp that was learnt leaves of its lines."""
    m = found.material
    before, inside, outside = ((x / found.white) ** 2 for x in (found.nominal, found.fitted, found.held_out))
    count = float(sum(line.held.sum() for line in found.lines))
    chance = tail(outside, count, m.floor.freedom)
    return Outcome(Fit(BeforeAfter(before, inside), BeforeAfter(before, outside)), chance)
