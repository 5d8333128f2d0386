"""What an explanation leaves in the data, beyond chance: then something is missing that it does not name."""

import dataclasses

import numpy as np
from scipy import stats

from ..compare.kinds.chances import Remainder, combined
from .fits.fitted import Fitted
from .fits.fitting import Fitting


@dataclasses.dataclass(frozen=True)
class Leftover:
    """What one kind of number at one station still holds."""

    kind: str
    station: int
    probability: float  # of so much by chance
    excess: float  # of squared whitened residuals over their number

    def at_least(self, excess: float) -> float:
        """Return an excess, or that which the chance stands for: an event, a step for instance, may hide in a sum."""
        return max(excess, float(stats.chi2.isf(max(self.probability, 1e-300), 1)))


def leftovers(
    fitting: Fitting, fitted: Fitted | None, slopes: np.ndarray | None = None, apart: bool = False
) -> list[Leftover]:
    """Return what each kind of number still holds, least probable first.

    What the forward models may be off by counts as noise, see `Fitting.doubt`. What is unknown does not: it is left.

    Args:
        fitting: of the recording.
        fitted: the explanation, None for none.
        slopes: of its parameters, see `Fitting.slopes`; None: computed.
        apart: leave out what is set aside, see `events`.
    """
    c = fitting.comparison
    template = fitted.template if fitted else np.zeros(len(c.residual))
    whitening = fitting.whitening_of(fitted, with_unknown=False)
    if apart:
        whitening = whitening.beside(fitting.set_aside)
    weight, rest = whitening.weight, whitening(c.residual - template)
    if slopes is None:
        slopes = fitting.slopes(fitted) if fitted else np.zeros((0, len(rest)))
    slopes = whitening(slopes)
    found = []
    usual = int(np.median([len(m) for m in c.members]))
    for kind, station in c.series():
        std = c.std[kind.name] if station < 0 else c.std[kind.name][:, station]
        left = Remainder(rest, weight, slopes, c.rows(kind, station), std, usual)
        z = left.nonzero
        if len(z) >= kind.fewest:
            probability = combined(kind.chances(left))
            found.append(Leftover(kind.name, station, probability, float(np.sum(z**2) - len(z))))
    # no effect of the registry makes codes uneven
    judged = ((station, codes) for station, codes in enumerate(c.codes) if codes is not None)
    found += [Leftover('codes', station, codes.probability, codes.excess) for station, codes in judged]
    count = len(found)
    found = [dataclasses.replace(f, probability=min(1.0, count * f.probability)) for f in found]
    return sorted(found, key=lambda f: f.probability)
