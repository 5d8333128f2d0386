"""What a limiter cut off: a smooth signal in spans, of which clipped samples only say that it is beyond the limit."""

import numpy as np
from scipy.fft import idct

from ..finding.result import BeforeAfter, Fit
from .limits import JUDGE, SHAPE
from .material import Material
from .rails import Limit


def limited_fit(m: Material, found: Limit) -> Fit:
    """Return the misfit of smooth spans per degree of freedom, without and with the limit, on samples held out or not.

    Where a high-pass stands behind the limiter, its droop is taken off first. The noise is white.
    """
    parts = m.parts
    if found.pole is not None:
        parts = parts + np.cumsum(parts, axis=1) * (2.0 * np.pi * found.pole[0] / m.rate)
    span = min(JUDGE.span, parts.shape[1])
    count = parts.shape[1] // span
    signal = parts[:, : count * span].reshape(-1, span)
    at = found.at[:, : count * span].reshape(-1, span)
    basis = idct(np.eye(span, min(JUDGE.terms, span // 3)), axis=0, norm='ortho')
    held = np.arange(span) % SHAPE.every == SHAPE.every // 2
    inverse = np.linalg.pinv(basis[~held])
    plain = (signal[:, ~held] @ inverse.T) @ basis.T
    beyond = plain
    for _ in range(JUDGE.rounds):
        filled = np.where(at, np.where(signal > 0.0, np.maximum(signal, beyond), np.minimum(signal, beyond)), signal)
        beyond = (filled[:, ~held] @ inverse.T) @ basis.T
    explained = np.where(at & (np.abs(beyond) > np.abs(signal)) & (beyond * signal > 0.0), signal, beyond)
    figures = []
    for mask in (~held, held):
        before, after = (np.mean((signal - x)[:, mask] ** 2) / m.noise**2 for x in (plain, explained))
        figures.append(BeforeAfter(float(before), float(after)))
    return Fit(figures[0], figures[1])
