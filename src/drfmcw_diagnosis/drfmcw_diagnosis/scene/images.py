"""Images at -f of what the two parts of a quadrature receiver do not treat alike."""

import dataclasses
import math

import numpy as np

from .limits import IMAGES
from .material import Material


@dataclasses.dataclass(frozen=True)
class Image:
    """Image over the conjugate of its line."""

    ratio: complex
    std: float
    lines: int  # from which it comes
    scatter: float  # from line to line [1]

    @property
    def gain(self) -> float:
        """Gain of Q over I [dB]."""
        return 20.0 * math.log10(abs(self._quadrature))

    @property
    def phase(self) -> float:
        """Phase of Q beyond 90 degrees [deg]."""
        return math.degrees(math.atan2(self._quadrature.imag, self._quadrature.real))

    @property
    def _quadrature(self) -> complex:
        # x = I + jQ of a line e^{jD} is (1 + q)/2 e^{jD} + (1 - q)/2 e^{-jD}* with q = g e^{-j phi}: image over line
        ratio = self.ratio
        return ((1.0 - ratio) / (1.0 + ratio)).conjugate()


def image(m: Material) -> Image | None:
    """Return the image that all strong lines agree on, None where they do not, or for a real receiver."""
    found = measured(m)
    if found is None or found.lines < 3 or found.scatter > IMAGES.agree * abs(found.ratio):
        return None
    return found if abs(found.ratio) >= max(IMAGES.least, IMAGES.sigma * found.std) else None


def measured(m: Material) -> Image | None:
    """Return what stands at the images of the strongest lines, whatever it is; None without such lines.

    Moving lines decide where there are any: nothing else stands at -f with the opposite Doppler shift. A static line
    shares its mirror with returns of other ranges only by chance, so several must agree.
    """
    if not m.iq:
        return None
    count, length = m.signal.shape
    ends = np.hanning(length + 2)[1:-1]
    slow = np.hanning(count + 2)[1:-1][:, None] if count >= 8 else np.ones((count, 1))
    cells = np.fft.fft2(m.signal * ends * slow)
    mirrored = np.conj(np.roll(cells[::-1, ::-1], (1, 1), axis=(0, 1)))
    power = np.abs(cells) ** 2
    floor = float(np.median(power))
    doppler = np.minimum(np.arange(count), count - np.arange(count))
    beat = np.minimum(np.arange(length), length - np.arange(length))
    eligible = (beat[None, :] > 4) & (power > floor * 10.0 ** (IMAGES.strong / 10.0))
    eligible &= power > np.abs(mirrored) ** 2
    own = power > IMAGES.beside * power.max(axis=0)  # no sidelobe of a line at this distance that stands still
    moving = eligible & own & (doppler[:, None] >= IMAGES.moving) if count >= 8 else np.zeros_like(eligible)
    chosen = moving if moving.any() else eligible
    if not chosen.any():
        return None
    order = np.argsort(np.where(chosen, power, 0.0), axis=None)[::-1][: IMAGES.lines]
    order = order[chosen.ravel()[order]]
    line, mirror = cells.ravel()[order], mirrored.ravel()[order]
    ratio = complex(np.sum(mirror * np.conj(line)) / np.sum(np.abs(line) ** 2))
    each = mirror / line
    weight = np.abs(line) ** 2 / np.sum(np.abs(line) ** 2)
    scatter = float(np.sqrt(np.sum(weight * np.abs(each - ratio) ** 2)))
    noise = math.sqrt(floor / float(np.sum(np.abs(line) ** 2)))
    std = math.hypot(noise, scatter / math.sqrt(max(len(order) - 1, 1)))
    return Image(ratio, std, len(order), scatter)
