"""Constants of a finding, with units; "chosen" is a judgement of what a reader needs."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class ViewLimits:
    """What a finding names and shows."""

    central: float = 0.9
    """Share of an excess that a location's span holds [1]; chosen."""

    shown: float = 0.01
    """Share of the excess below which a location is not named [1]; chosen."""

    by_chance: float = 1e-4
    """Chance below which uneven codes are a mismatch with a location [1]; chosen."""

    predicted: float = 3.0
    """Doubt in standard deviations, to which a number must be predicted to count as misfit; chosen."""


VIEWS = ViewLimits()
