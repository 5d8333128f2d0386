"""What a kind of number is: how it is measured, predicted, whitened, trusted, tested and shown."""

import abc
import dataclasses
import enum

import numpy as np

from ..measuring import Evidence
from ..predicting import Expected
from ..recorded_sweeps import RecordedSweeps
from . import chances
from .explained import Explained

Measured = tuple[np.ndarray, np.ndarray]
"""Values and their standard deviations, which are inf where nothing is known to compare with."""


class Of(enum.Enum):
    """What one row of a kind's numbers stands for."""

    STATION = 'one station with samples'
    CHANNEL = 'one series of the ramp, see `Extractor.channels`'
    PATH = 'the path between the stations'


@dataclasses.dataclass(frozen=True)
class Trust:
    """To what the forward model of a kind is trusted, relative to what an explanation adds."""

    usual: float | None = None  # None: as forward models are in general, see `Known.trust`
    beside_distortion: float | None = None  # where the explanation distorts the IF; None: no less than usual
    beside_bursts: float | None = None  # where the explanation comes and goes; None: no less than usual
    rest_beside_bursts: float = 0.0  # least doubt beside bursts [standard deviations of the number]


@dataclasses.dataclass(frozen=True)
class Shown:
    """The numbers of one kind that a plot shows: of one row, and of the group with the largest misfit."""

    recorded: RecordedSweeps
    row: int  # station or channel, -1 of the path
    group: int
    residual: np.ndarray  # measured less predicted without effects, of all rows and groups
    std: np.ndarray  # of the same
    curve: np.ndarray  # what the explanation adds, of the same
    whitened: np.ndarray  # residual over its standard deviation, of this row and group
    template: np.ndarray  # what the explanation adds, over the same

    def of_row(self, values: np.ndarray) -> np.ndarray:
        """Return the values of this row in all groups (G, ...)."""
        return values if self.row < 0 else values[:, self.row]


@dataclasses.dataclass(frozen=True)
class Plotted:
    """Numbers of one kind along their axis, (n,) each."""

    x: np.ndarray
    residual: np.ndarray
    std: np.ndarray
    curve: np.ndarray
    unit: str
    where: str = ''  # at which of several distances


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind(abc.ABC):
    """One kind of number that a recording and its model are compared by.

    A recording has G groups of sweeps and S stations with samples. The numbers of a kind are an array (G, ...) if it
    stands for the path, else (G, rows, ...), or (n,) with one number per sweep.
    """

    name: str
    level: str  # level of the interface to which a misfit belongs, `Location.level`
    axis: str  # axis of the interface along which it extends, `Location.axis`
    label: str = ''  # in reports; the station's name follows
    unit: str = '1'  # of the numbers
    of: Of = Of.STATION
    per_sweep: bool = False  # one number per sweep instead of some per group
    of_all: bool = False  # of all groups together: it stands at the first one, where it has no scatter
    of_converter: bool = False  # an uneven ADC shows in it as well
    has_gaps: bool = False  # numbers that are NaN are not compared
    trust: Trust = Trust()
    averages: bool = False  # more sweeps improve it: the noise of sweeps exceeds the limits of the model
    rounded: bool = False  # to whole samples: what hardly differs may stand one apart, which promises no separation
    exact: bool = False  # predicted without approximation, so that what is left is no error of a model
    unmistakable: bool = False  # nothing without a name changes it, if the converter's codes are even
    rests_on: str = ''  # kind of number of both stations to which it is relative: none is known better than that
    divisible: bool = False  # both halves of its numbers confirm each other where no other distance or kind does
    sparse: bool = False  # an effect changes few of its numbers, and the others say nothing of that effect
    of_begin: bool = False  # it shows the begin of the signal, which a real receiver may have forgotten
    needs_conditions: bool = False  # compared only where settings, calibrations or reference say what to expect
    needs_reference: bool = False  # one of these conditions is the reference's distance
    fewest: int = 4  # numbers with which a leftover is tested
    correlated: float = 1.1  # numbers that share their noise, by which their count is divided
    scatter_freedom: int = 0  # degrees of freedom per sweep, if the numbers' own scatter alone gives their std; else 0

    # --- comparison ---

    @abc.abstractmethod
    def measured(self, evidence: Evidence) -> Measured:
        """Return the numbers of all groups and their standard deviations."""

    @abc.abstractmethod
    def predicted(self, expected: Expected) -> np.ndarray:
        """Return the numbers of the groups of one setting, as the model with some effects has them."""

    def limited(self, std: np.ndarray, expected: list[Expected]) -> np.ndarray:
        """Return standard deviations (G, ...) that include what the model without effects is trusted to."""
        return std

    def in_pairs(self, evidence: Evidence) -> tuple[tuple[int, int], np.ndarray]:
        """Return two rows and by how much the noise of their numbers is correlated (G, K); by default nothing is."""
        return (0, 0), np.zeros((0, 0))

    def common_errors(self, std: np.ndarray, expected: list[Expected]) -> list[np.ndarray]:
        """Return what the model without effects may be off by in many numbers at once, one standard deviation each.

        Args:
            std: standard deviations of the numbers (G, ...).
            expected: the model without effects, setting by setting.
        """
        return []

    def whitened(self, values: np.ndarray, plain: np.ndarray, std: np.ndarray, recorded: RecordedSweeps) -> np.ndarray:
        """Return numbers beyond those of the plain model as standard normals: 0 where they are not compared."""
        over: np.ndarray = (values - plain) / std
        return np.nan_to_num(over) if self.has_gaps else over

    def rows(self, values: np.ndarray) -> np.ndarray:
        """Return whitened numbers (G, ...) of one array per row and group: (G, rows, positions)."""
        rows = 1 if self.of is Of.PATH else values.shape[1]
        return values.reshape(len(values), rows, -1)

    # --- doubt and leftovers ---

    def doubt(self, explained: Explained, template: np.ndarray, nonlinear: np.ndarray) -> np.ndarray:
        """Return how far each whitened number may be off because the forward models are not exact (n,).

        Args:
            explained: what is known of the explanation.
            template: what it adds to the numbers of this kind, whitened (n,).
            nonlinear: what of that its distortion and its bursts add (n,).
        """
        trust = explained.trust if self.trust.usual is None else self.trust.usual
        doubt: np.ndarray = trust * self.uncertain(explained, np.abs(template))
        if explained.distorting and self.trust.beside_distortion is not None:
            doubt = np.maximum(doubt, self.trust.beside_distortion * self.uncertain(explained, np.abs(nonlinear)))
        if explained.bursting:
            chance = self.by_chance(nonlinear, explained.std[self.name].ravel())
            doubt = np.maximum(np.maximum(doubt, chance), self.trust.rest_beside_bursts)
        return doubt

    def by_chance(self, added: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Return how far what bursts add to numbers is off because a group holds a few of them by chance (n,).

        Args:
            added: by the bursts, whitened (n,).
            std: of the numbers (n,).
        """
        return (self.trust.beside_bursts or 0.0) * np.abs(added)

    def uncertain(self, explained: Explained, size: np.ndarray) -> np.ndarray:
        """Return that to which the trust is relative (n,): usually the `size` (n,) of what an explanation adds."""
        return size

    def chances(self, left: chances.Remainder) -> list[float]:
        """Return the chances of what an explanation leaves in one row, one for each way of looking at it."""
        return chances.amounts(left.nonzero, self.correlated, self.scatter_freedom * (left.usual_count - 1))

    # --- views: by default one number per group, over the distance ---

    def receiver(self, recorded: RecordedSweeps, row: int) -> int:
        """Return the station with samples to which a row belongs, -1 for none."""
        return row

    def words(self, recorded: RecordedSweeps, row: int) -> str:
        """Return what a row is called in reports."""
        return self.label

    def profile(self, recorded: RecordedSweeps, z: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (x, squares) of one row's whitened residuals along the kind's axis; x in the axis' unit.

        By default one sum of squares per group, over the distance.

        Args:
            recorded: the sweeps.
            z: whitened residuals (n,), group by group, as many of each.
            positions: of the same, as in `Entries`.
        """
        return self.over_groups(recorded), np.sum(z.reshape(len(recorded.members), -1) ** 2, axis=1)

    def over_groups(self, recorded: RecordedSweeps) -> np.ndarray:
        """Return where each group stands along the axis (G,)."""
        return recorded.distance

    def plotted(self, shown: Shown) -> Plotted:
        """Return the numbers of one row along the axis."""
        residual, std, curve = (shown.of_row(v).reshape(len(v), -1) for v in (shown.residual, shown.std, shown.curve))
        # of several numbers, parts of a harmonic for instance, that with the largest misfit
        largest = int(np.nansum((residual / std) ** 2, axis=0).argmax())
        x = self.over_groups(shown.recorded)
        return Plotted(x, residual[:, largest], std[:, largest], curve[:, largest], self.unit)


def at_distance(shown: Shown) -> str:
    """Return at which distance the group of a plot stands, in words."""
    return f' at {shown.recorded.distance[shown.group]:.0f} m'
