"""How to search a recording for an effect: plain data that the effect declares and the diagnosis reads."""

import dataclasses
from collections.abc import Mapping

import numpy as np

WAVE = 0.0517
"""Wavelength of the carrier for which recipes are written [m], that of Table 1; see `Recipe.at`."""


@dataclasses.dataclass(frozen=True)
class Recipe:
    """How to search for one effect.

    A search starts at each point of `grid`, or where the scanner `scan` finds that the data suggest the effect. It then
    scales the effect's template by `size`, and refines every parameter in `prior`. All parameters go by their declared
    names.
    """

    # parameters
    size: str  # the parameter in proportion to which the effect grows; '' where there is none
    start: Mapping[str, float]  # where the fit begins, of parameters that neither grid nor scanner gives
    prior: Mapping[str, float]  # plausible magnitude of every fitted parameter: the fit pays for freedom by it
    grid: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    defining: tuple[str, ...] = ()  # where one of these is zero, it is another effect
    decibel: bool = False  # the size is in decibels
    order: int = 1  # power of the size with which the effect grows: 2 where only its power shows
    quadrature: tuple[str, float] = ('', 0.0)  # parameter, and the step of it that turns the phase by a quarter
    # phase, and length on whose carrier phase it comes: their sum in mid-sweep is fitted in place of the phase, since
    # the data determine it far better than either
    carrier: tuple[str, str] = ('', '')
    wavelength: float = WAVE  # of the carrier in mid-sweep [m]
    limits: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)  # where narrower than declared
    per_group: bool = False  # the size differs from group to group: parameters size[0], size[1], ...
    within_recording: tuple[str, ...] = ()  # times [s] that count only up to the recording's length
    within_sweep: tuple[str, ...] = ()  # times [s] that count only up to some lengths of the sweep
    # numbers of coefficients to try of the one parameter, a list: this is no start by itself, but takes the place of
    # several effects that shape the chirp
    coefficients: tuple[int, ...] = ()
    each_sweep: str = ''  # probability of the effect in a sweep, of which a recording holds one outcome
    steps: Mapping[str, float] = dataclasses.field(default_factory=dict)  # of numerical derivatives, where not 1 %
    least_steps: Mapping[str, float] = dataclasses.field(default_factory=dict)  # of these, where 1 % of a size is less

    # scan
    scan: str = ''  # scanner of the diagnosis that finds starting points: see drfmcw_diagnosis.search.starts.scanners
    scanned: str = ''  # parameter that the scanner finds
    scanned_with: tuple[str, ...] = ()  # further parameters that it finds
    cells: int = 1  # independent starting points among which a scan chooses: what chance is counted over
    tries: tuple[float, ...] = ()  # what a scanner tries that only says where; in its own terms
    repeats: bool = False  # several may act at once, a resolution cell of the scanner apart

    # stations and calibration
    together: bool = False  # search at both stations together too, not only at each
    added_to: Mapping[str, str] = dataclasses.field(default_factory=dict)  # {parameter: field of Calibration}
    times: Mapping[str, str] = dataclasses.field(default_factory=dict)  # as `added_to`, where the start is a factor

    # what recordings show of it, and how exactly
    lookalikes: bool = False  # other places of `scanned` resemble the right one until all other effects are known
    fringes: bool = False  # it raises and lowers the received power with the distance
    needs_reference: bool = False  # it shows only against a reference that measures another distance
    trust: Mapping[str, float] = dataclasses.field(default_factory=dict)  # limit of the model: [dB], or relative
    incoherence: Mapping[str, float] = dataclasses.field(default_factory=dict)  # per unit, doubt of the coherence

    @property
    def may_vanish(self) -> bool:
        """Whether the effect has one size that may be zero: neither a level in decibels nor one of each group."""
        return bool(self.size) and not (self.decibel or self.per_group)

    def at(self, wavelength: float) -> 'Recipe':
        """Return the recipe for another wavelength of the carrier [m]."""
        if not self.carrier[0]:
            return self
        return dataclasses.replace(self, wavelength=wavelength)

    def step(self, name: str, value: float) -> float:
        """Return the step of a numerical derivative at `value`."""
        name = name.partition('[')[0]
        if name in self.steps:
            return self.steps[name]
        least = self.least_steps.get(name, 0.01 * abs(self.start.get(name, 1e-3 * self.prior[name])))
        return max(0.01 * abs(value), least)


def geometric(low: float, high: float, count: int) -> tuple[float, ...]:
    """Return `count` values from `low` to `high` in equal ratios."""
    return tuple(np.geomspace(low, high, count).tolist())
