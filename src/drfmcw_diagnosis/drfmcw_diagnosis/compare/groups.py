"""The numbers that a recording and its model are compared by, group by group, and how groups are made of sweeps."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from drfmcw_sim.effects import Effect
from drfmcw_sim.measurements import Measurements

from ..features.extractor import Extractor, SweepFeatures

_COHERENT = 0.5  # mean of the phasors of a group's sweeps beyond which their phases count as one
_POOL = 30.0  # sweeps that the scatter in all groups counts for in each


@dataclasses.dataclass(frozen=True)
class Entries:
    """What the numbers of the vector are; arrays (n,)."""

    kind: np.ndarray  # as the fields of `Groups`
    station: np.ndarray  # number among those with samples, -1 for the path; of ramp: number of the channel
    group: np.ndarray
    position: np.ndarray  # cosine term, bin, band or sweep

    def where(self, **wanted) -> np.ndarray:
        """Return which entries have all the values given."""
        chosen = np.ones(len(self.kind), bool)
        for name, value in wanted.items():
            chosen &= np.isin(getattr(self, name), value)
        return chosen

    def kinds(self) -> list[tuple[str, int]]:
        """Return kinds with the stations each may have, in order."""
        return [(str(k), int(s)) for k in dict.fromkeys(self.kind) for s in np.unique(self.station)]


@dataclasses.dataclass(frozen=True)
class Groups:
    """Features of each of G groups, measured or predicted; S stations with samples, Q parts of a sample (2 with iq)."""

    ramp: np.ndarray  # (G, 2 S, K) cosine series, mean over the group
    flutter: (
        np.ndarray
    )  # (G, 2 S, K) variance of the same from sweep to sweep over that of terms around [1]; 1 for none
    lines: np.ndarray  # (G, S, B) power of narrow lines over the noise around [1]; 1 for none
    mean: np.ndarray  # (G, S, Q) [LSB]
    harmonic: np.ndarray  # (G, S, 2 H) over the line [1]
    piled: np.ndarray  # (G, S) samples of a sweep at its outermost codes, more than beside them
    burst: np.ndarray  # (G, S, 3) of `features.unevenness`
    noise: np.ndarray  # (G, S, BANDS) [dB of 1 LSB^2 per sample]
    coherence: np.ndarray  # (G, OFFSETS) of both lines' phase noise, imaginary part [1]
    beat: np.ndarray  # (G,) [Hz]
    amplitude: np.ndarray  # (G, S) [dB of 1 LSB]
    range: np.ndarray  # (G,) beyond the reference [m]
    velocity: np.ndarray  # (G,) slope of the reference [m/s]
    movement: np.ndarray  # (n sweeps,) within the group [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """The groups of one setting of the sweep."""

    groups: np.ndarray  # their places among all
    local: list[np.ndarray]  # rows of `all` of each
    all: Measurements  # nominal, one per sweep
    steady: Measurements  # nominal, one per group under its mean conditions
    extract: Extractor


def acted(part: Part, effects: Sequence[Effect]) -> Measurements:
    """Return the groups' steady conditions after effects."""
    state = part.steady.rows(slice(None))
    for effect in sorted(effects, key=lambda e: e.stage):
        effect.prepare(state)
    return state


def align(
    part: Part, rows: Measurements, copies: int, sweeps: Sequence[SweepFeatures], effects: Sequence[Effect]
) -> np.ndarray:
    """Give the line of a station that hears itself the measured phase; return the mean delay added (G,) [s].

    Its phase is no free one as that of a pair, but follows from the delay, which nobody knows to a part of a
    wavelength: less than that is added. Where the phases of a group's sweeps differ, the copies' lie evenly over
    half a turn.

    Args:
        part: groups of one setting.
        rows: their steady conditions, as often as there are copies; the delays are changed.
        copies: number of them.
        sweeps: measured features of all groups.
        effects: may change the delay.
    """
    added = np.zeros((copies, len(part.groups)))
    if len(part.steady.stations) == 2:
        return added[0]
    state = acted(part, effects)
    (station,) = state.stations
    delay, sweep = state.paths[0].delay, station.sweep
    carrier = station.alpha * sweep.center_frequency
    own = carrier * delay - 0.5 * sweep.chirp_rate * delay**2  # turns in mid-sweep
    for row, g in enumerate(part.groups):
        phasor = np.mean(np.exp(1j * sweep.line_sign() * sweeps[g].carrier))
        turns = np.arange(copies) / (2.0 * copies)
        if abs(phasor) > _COHERENT:
            turns = np.angle(phasor) / (2.0 * np.pi) - own[row]
        added[:, row] = (turns - np.rint(turns)) / carrier[row]
    rows.paths[0].delay += added.ravel()
    return added.mean(axis=0)


def pooled(values: Sequence[np.ndarray], expected: np.ndarray | None = None) -> np.ndarray:
    """Return standard deviations within groups (G, k), each drawn towards what all groups together say.

    Few sweeps tell their own scatter badly: taken alone it would make large residuals far too likely.

    Args:
        values: of each group (n, k).
        expected: variance of each group (G,) up to a common factor; None where all are alike.
    """
    freedom = np.array([len(v) - 1 for v in values])[:, None]
    own = np.array([v.var(axis=0, ddof=1) for v in values])
    shape = np.ones((len(values), 1)) if expected is None else expected[:, None]
    common = (freedom * own).sum(axis=0) / (freedom * shape).sum(axis=0) * shape
    return np.sqrt((freedom * own + _POOL * common) / (freedom + _POOL))


def joined(groups: Sequence[Groups]) -> Groups:
    """Return single groups' features as one; movements one after another."""
    stacked = {f.name: np.stack([getattr(g, f.name) for g in groups]) for f in dataclasses.fields(Groups)[:-1]}
    return Groups(**stacked, movement=np.concatenate([g.movement for g in groups]))


def steady(m: Measurements, local: Sequence[np.ndarray]) -> Measurements:
    """Return one measurement per group, under the group's mean conditions; `local` are the groups' rows of `m`."""
    result = m.rows(np.array([rows[0] for rows in local]))

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([values[rows].mean() for rows in local])

    for station, source in zip(result.stations, m.stations, strict=True):
        for name in ('received_power', 'temperature'):
            getattr(station, name)[:] = mean(getattr(source, name))
    for path, source in zip(result.paths, m.paths, strict=True):
        path.delay[:] = mean(source.delay)
    for name in ('range', 'time', 'velocity', 'refractive_index'):
        getattr(result, name)[:] = mean(getattr(m, name))
    return result
