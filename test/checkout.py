"""Where a test finds what lies in the checkout, whichever package's folder it stands in."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'
DATA = ROOT / 'test' / 'data'
"""Two of the practice recordings: recording_0 stands, recording_5 moves."""
