"""Where a test finds what lies in the checkout, whichever package's folder it stands in."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'
DATA = ROOT / 'test' / 'data'
"""Four of the practice recordings, made by another hand: 0 conceals nothing, 2 a ripple, 5 motion, 6 a settling PLL.

The files of 2, 5 and 6 are compressed, every message as it was."""
SHARED = ROOT.parent / 'shared' / 'recordings'
"""More recordings, used where they are there; no test needs them."""


def practice_recording(number: int) -> Path:
    """Path of a practice recording, of the checkout if it holds it; it need not exist."""
    own = DATA / f'recording_{number}'
    return own if own.exists() else SHARED / 'practice' / own.name
