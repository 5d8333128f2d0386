"""What effects change of both stations' lines: relative changes of the noise-free signals, and of what is received."""

import dataclasses
import math

import numpy as np

from ..generator.model import FIRST, SECOND, Scene, Stream, clean, digitise, receive

_OFF = 0.5  # of a line's amplitude, below which it counts as silent
TURNS = 16
"""Realisations of phases that nobody knows, evenly over the circle."""
_HALVES = tuple(range(0, TURNS, 2)), tuple(range(1, TURNS, 2))  # under one realisation of the noise and another


def is_heard(before: Scene, after: Scene, station: int) -> bool:
    """Return whether something acts on what a station receives, noise and all."""
    return any(hooks[station] for scene in (before, after) for hooks in (scene.analogue, scene.digital))


@dataclasses.dataclass(frozen=True)
class Changes:
    """Relative changes [rows, samples] of both stations."""

    first: list[np.ndarray]  # under one realisation of the noise, the mean over unknown phases
    again: list[np.ndarray]  # under another
    supports: np.ndarray  # bool [2, rows, samples], where signals are on
    own: list[np.ndarray] | None  # differences from that mean at unknown phases [turns, rows, samples], after
    own_before: list[np.ndarray] | None


def changes(before: Scene, after: Scene, rows: np.ndarray) -> Changes:
    """Return what is changed from one scene to another in some sweeps.

    Args:
        before: without the effects.
        after: with them.
        rows: of the sweeps.
    """
    first: list[np.ndarray] = []
    again: list[np.ndarray] = []
    supports: list[np.ndarray] = []
    own: list[np.ndarray] = []
    own_before: list[np.ndarray] = []
    for s in (FIRST, SECOND):
        olds, news = _turned(before, s, rows), _turned(after, s, rows)
        old, new = np.mean(olds, axis=0), np.mean(news, axis=0)
        # where a chirp is off, a filter's response to its edge is no line whose change could be measured
        was_on, stays_on = (np.abs(x) > _OFF * np.abs(x).max(axis=1, keepdims=True) for x in (old, new))
        on = was_on & stays_on
        ratio = np.where(on, new / np.where(on, old, 1.0), 1.0)
        smooth = np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio), axis=1)
        smooth = np.where(on, smooth, np.where(was_on, -1.0, 0.0))  # where a chirp is now off, all of the line is gone
        pair = [smooth, smooth]
        hooked = is_heard(before, after, s)
        turning = [hooked and any(station == s for *_, station in scene.own_phases) for scene in (before, after)]
        if hooked:
            heard = [_heard(before, after, s, rows, new.real, i, any(turning)) for i in (0, 1)]
            pair = [smooth + relative_change(np.mean(changed - plain, axis=0), new, on) for plain, changed in heard]
        scenes = zip(turning, (own_before, own), (0, 1), (olds, news), (old, new), strict=True)
        for is_turning, found, which, turned, mean in scenes:
            differences = np.zeros((TURNS, *new.shape), complex)
            differences += np.where(on, (turned - mean) / np.where(on, mean, 1.0), 0.0)
            if is_turning:
                differences += relative_change(
                    np.concatenate([x[which] - np.mean(x[which], axis=0) for x in heard]), new, on
                )
            found.append(differences)
        first.append(pair[0])
        again.append(pair[1])
        supports.append(was_on)
    return Changes(
        first, again, np.array(supports), own if after.own_phases else None, own_before if before.own_phases else None
    )


def relative_change(change: np.ndarray, carrier: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Return the relative change g of analytic signals, from one of real samples; zero where the carrier is off."""
    count = change.shape[-1]
    spectrum = np.fft.fft(change)
    turning = np.sum(carrier[:, 1:] * np.conj(carrier[:, :-1]), axis=1)
    positive = np.angle(turning) > 0.0
    frequency = np.arange(count)
    upper = 2.0 * ((frequency > 0) & (frequency < count // 2))
    lower = 2.0 * (frequency > count // 2)
    upper[0] = lower[0] = math.sqrt(2.0)  # a constant has one side-band: its energy is counted alike
    analytic = np.fft.ifft(spectrum * np.where(positive[:, None], upper, lower))
    return np.where(on, analytic / np.where(on, carrier, 1.0), 0.0)


def _turned(scene: Scene, station: int, rows: np.ndarray) -> np.ndarray:
    """Return the noise-free IF [turns, rows, samples], once where no oscillator is modulated at a phase of its own."""
    if not any(scene.hums):
        return clean(scene, station, rows)[None]
    turned = [dataclasses.replace(scene, advance=turn / TURNS) for half in _HALVES for turn in half]
    return np.array([clean(one, station, rows) for one in turned])


def _heard(
    before: Scene, after: Scene, station: int, rows: np.ndarray, rays: np.ndarray, half: int, turning: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return what a station receives by the hooks of either scene [turns, rows, samples], at every other phase."""
    random = before.stream(Stream.EFFECT, 99, half, station, int(rows[0]))
    noise = random.standard_normal(rays.shape) * before.noise_std(station)[rows, None]
    plain, changed = [], []
    for turn in _HALVES[half] if turning else (0,):
        advance = turn / TURNS
        one = dataclasses.replace(after, advance=advance)
        other = dataclasses.replace(one, analogue=before.analogue, own_phases=before.own_phases)
        received = receive(other, station, rows, rays, noise), receive(one, station, rows, rays, noise)
        if after.digital[station]:
            received = digitise(before, station, rows, received[0]), digitise(after, station, rows, received[1])
        plain.append(received[0].astype(float))
        changed.append(received[1].astype(float))
    return np.array(plain), np.array(changed)
