"""Which figures of the paper there are."""

from collections.abc import Callable

from . import distance, environment, offsets, spectrum
from .section import Section

SECTIONS: dict[str, Callable[[], Section]] = {
    'fig6': spectrum.fig6,
    'fig7': offsets.fig7,
    'fig8': offsets.fig8,
    'fig9': environment.fig9,
    'fig10': environment.fig10,
    'fig11': distance.fig11,
    'fig12': distance.fig12,
}
"""How to make each section, by name."""
