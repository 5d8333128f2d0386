"""One sentence about the samples."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Finding:
    """What is there, and where that contradicts the settings, what to set instead."""

    agrees: bool  # False: a warning
    sentence: str
