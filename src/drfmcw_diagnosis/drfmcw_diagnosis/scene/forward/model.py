"""Lines of a scene fitted to some of its samples and tried on the others."""

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np

from ..limits import NOISE, SHAPE
from ..material import Material
from ..noise import Noise, noise
from .limits import FORWARD
from .misfit import Misfit, of_blocks, of_sweeps
from .simulated import Lines
from .tracks import Solved, Sweeps, Tracks, lines, slopes, solve


@dataclasses.dataclass(frozen=True)
class Scene:
    """Sweeps that are fitted and sweeps, or blocks of samples, that are held out."""

    material: Material
    fitted: Sweeps
    held_out: Sweeps
    held: np.ndarray  # (N,) samples held out, where sweeps are too few to hold any out
    floor: Noise
    first: int  # sample of the recorded sweeps at which these begin
    moving: bool = False  # what repeats with the ramp was taken away as the mean of the sweeps fitted

    @property
    def by_sweeps(self) -> bool:
        """Whole sweeps are held out."""
        return not self.held.any()

    @functools.cached_property
    def simulated_lines(self) -> Lines:
        """Its lines as the simulator makes them."""
        return Lines(self.material, self.first, len(self.held))


@dataclasses.dataclass(frozen=True)
class Straight:
    """Lines of a straight ramp and what they leave."""

    scene: Scene
    tracks: Tracks
    fitted: Misfit
    held_out: Misfit


def scene(m: Material, unusable: np.ndarray | None = None) -> Scene | None:
    """Return the sweeps of a recording, those fitted and those held out apart, None with too few samples.

    Args:
        m: sweeps.
        unusable: samples (n, N) that no line describes, which are neither fitted nor held out.
    """
    first, last = _span(m)
    if last - first < FORWARD.fewest or not np.any(m.signal):
        return None
    rows = np.arange(len(m.signal))
    most = max(FORWARD.values // (last - first), 1)
    if len(rows) > most:  # spread over the recording, since tracks are smooth
        rows = rows[np.unique(np.round(np.linspace(0, len(rows) - 1, most)).astype(int))]
    place = np.linspace(-1.0, 1.0, len(m.signal))[rows] if len(m.signal) > 1 else np.zeros(1)
    usable = np.ones(m.signal.shape, bool) if unusable is None else ~unusable
    usable = usable[:, first:last]
    signal, used = m.signal[rows, first:last], usable[rows]
    clear = np.asarray(usable.all(axis=1))
    quiet = clear if clear.sum() >= min(NOISE.doppler, max(len(clear) // 4, 1)) else np.ones(len(m.signal), bool)
    floor = noise(np.where(usable, m.signal[:, first:last], 0.0)[quiet])
    whole = Sweeps(signal, place, used)
    held = np.zeros(last - first, bool)
    if len(rows) >= FORWARD.sweeps_held:
        out = np.arange(len(rows)) % FORWARD.third == FORWARD.third - 1
        return Scene(m, whole.rows(~out), whole.rows(out), held, floor, first)
    length = max(1, (last - first) // FORWARD.blocks)
    held = np.arange(last - first) // length % SHAPE.every == SHAPE.every // 2
    return Scene(m, Sweeps(signal, place, used & ~held), whole, held, floor, first)


def moving(s: Scene) -> Scene | None:
    """Return the sweeps without what repeats with the ramp, None where too few sweeps are fitted to learn that.

    At rest, targets of any number, leakage and settling together may have any waveform. What is linear does to the
    lines that are left what it does to all.
    """
    if not s.by_sweeps or len(s.fitted.place) < NOISE.doppler or not s.fitted.used.all():
        return None
    still = s.fitted.signal.mean(axis=0)
    parts = (dataclasses.replace(x, signal=x.signal - still) for x in (s.fitted, s.held_out))
    return dataclasses.replace(s, fitted=next(parts), held_out=next(parts), moving=True)


def _span(m: Material) -> tuple[int, int]:
    """Return the samples between which every line is there: from the delay of one at the highest frequency on."""
    last = m.nominal_end
    highest = m.rate if m.iq else 0.5 * m.rate
    delay = highest * m.duration / max(abs(m.bandwidth), 1.0)
    first = min(math.ceil(delay * m.rate), last // FORWARD.dead)
    return first, min(last, first + FORWARD.longest)


def straight(s: Scene) -> Straight:
    """Return the lines of a straight ramp that the sweeps demand."""
    order = FORWARD.order if len(s.fitted.place) >= FORWARD.sweeps_of_tracks else 1
    some = max(FORWARD.first // s.fitted.signal.shape[1], 1)
    rows = np.unique(np.round(np.linspace(0, len(s.fitted.place) - 1, some)).astype(int))
    found = lines(s.fitted, s.floor, order, lines(s.fitted.rows(rows), s.floor, order))
    return Straight(s, found, *judged(s, found))


def multiples(found: Straight) -> bool:
    """Return whether lines describe all, and the weaker ones stand at multiples of the strongest one's frequency."""
    s, lines_ = found.scene, found.tracks
    if len(lines_) < 2 or found.held_out.probability < FORWARD.chance:
        return False
    size = np.mean(np.abs(solve(s.fitted, lines_).phasor) ** 2, axis=0)
    frequency = lines_.frequency[:, 0]
    first = frequency[int(np.argmax(size))]
    orders = np.array([-3, -2, 2, 3]) if s.material.iq else np.array([2, 3])
    expected = (orders * first + 0.5) % 1.0 - 0.5
    if not s.material.iq:
        expected = np.abs(expected)
    apart = np.abs(np.delete(frequency, int(np.argmax(size)))[:, None] - expected).min(axis=1)
    return bool(np.all(apart < 1.0 / len(s.held)))


def judged(s: Scene, tracks: Tracks) -> tuple[Misfit, Misfit]:
    """Return the misfit of lines on the samples fitted and on those held out."""

    def described(sweeps: Sweeps) -> tuple[Solved, np.ndarray]:
        found = solve(sweeps, tracks)
        return found, found.model

    return judged_by(s, described, len(tracks))


def judged_by(s: Scene, described: Callable[[Sweeps], tuple[Solved, np.ndarray]], count: int) -> tuple[Misfit, Misfit]:
    """Return the misfit of so many lines on the samples fitted and on those held out.

    `described` returns the lines of sweeps with their amplitudes, and the samples (n, N) that these make.
    """
    own, whole = described(s.fitted)
    parameters = (2.0 if s.material.iq else 1.0) + 2.0 * count
    learnt = len(s.fitted.place) if s.moving else 0
    inside = of_sweeps(s.fitted, s.fitted.signal - whole, parameters, s.floor, learnt, own=s.moving)
    if s.by_sweeps:
        _, outside = described(s.held_out)
        return inside, of_sweeps(s.held_out, s.held_out.signal - outside, parameters, s.floor, learnt)
    return inside, of_blocks(s.fitted, own, s.held, slopes(s.fitted, own), s.floor, whole)


@dataclasses.dataclass(frozen=True)
class Scatter:
    """Samples that were not fitted as noise of a power of their own, which the sweeps fitted show."""

    before: float  # misfit per degree of freedom of what was held out, all samples alike
    after: float  # the same with that noise
    gain: float  # of the logarithm of the likelihood of what was held out
    above: float  # power of what the lines leave in these samples over that at the same time in other sweeps [1]


def scattered(found: Straight) -> Scatter:
    """Return what noise of its own in the samples that are not used explains of the sweeps held out.

    What the lines leave is compared with what they leave at the same time in other sweeps, so that lines which do not
    describe the sweeps are no such noise.
    """
    s = found.scene
    parts = 2.0 if s.material.iq else 1.0
    inside, outside = (np.abs(x.signal - solve(x, found.tracks).model) ** 2 for x in (s.fitted, s.held_out))
    loud, tried = ~s.fitted.used & ~s.held, ~s.held_out.used
    nothing = Scatter(found.held_out.per_freedom, found.held_out.per_freedom, 0.0, 1.0)
    if not loud.any() or not tried.any():
        return nothing
    quiet = np.sum(np.where(s.fitted.used, inside, 0.0), axis=0) + s.floor.mean
    usual = np.broadcast_to(quiet / (s.fitted.used.sum(axis=0) + 1.0), outside.shape)
    above = max(float(np.mean((inside / usual[0])[loud])), 1.0)
    there, beside = outside[tried], usual[tried]
    gain = 0.5 * parts * float(np.sum(there / beside * (1.0 - 1.0 / above) - math.log(above)))
    others = found.held_out.per_freedom * float(s.held_out.used.sum())
    before, after = others + np.sum(there) / s.floor.mean, others + np.sum(there / (beside * above))
    return Scatter(float(before) / tried.size, float(after) / tried.size, gain, above)
