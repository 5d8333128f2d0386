"""Constants of findings on several recordings; "chosen" is a judgement of what a reader needs."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class JointLimits:
    """When recordings agree."""

    sigmas: float = 3.0
    """Standard deviations within which a size is that of the others, or nothing [1]; chosen."""

    disagreement: float = 0.01
    """Chance of estimates that differ so much, below which recordings disagree [1]; chosen."""


JOINT = JointLimits()
