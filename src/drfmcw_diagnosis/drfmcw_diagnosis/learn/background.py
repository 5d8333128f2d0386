"""What the sweeps of a station repeat beside their line: a curve that adds to the IF, one value per sample."""

import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter1d

from drfmcw_sim.synthesis.measured import Term

from ..features.extractor import as_complex
from .evidence import LeftOver
from .limits import LEARNING
from .smoothing import Sample, first_terms


def background(left: LeftOver, station: int) -> tuple[Term, ...]:
    """Return the repeating background of a station, in I and Q apart; nothing where none is beyond chance.

    Cosine terms of the mean over all sweeps are kept up to where held-out sweeps are predicted best, and single ones
    that stand out.
    """
    c = left.comparison
    parts, rate = c.recorded.topology.parts, c.recorded.sample_rate
    full_scale = float(np.median(c.data.full_scale[c.heard[station]]))
    found = []
    for part, quantity in zip(range(parts), ('background', 'background_q'), strict=False):
        series = [
            scipy.fft.dct(_beside_line(left, station, g)[part::parts], norm='ortho', axis=1)
            for g in range(len(c.members))
        ]
        kept = _repeated(series)
        if kept.any():
            wave = scipy.fft.idct(kept, norm='ortho') / full_scale
            time = np.arange(len(wave)) / rate
            found.append(Term(quantity, c.receivers[station], '', '', np.zeros(1), time, wave[None]))
    return tuple(found)


def _repeated(series: list[np.ndarray]) -> np.ndarray:
    """Return the cosine terms (N,) that sweeps share; `series` of each group (n, N)."""
    folds = min(LEARNING.folds, *(len(x) for x in series), LEARNING.folds)
    split = [np.concatenate([np.array_split(x, folds)[f] for x in series]) for f in range(folds)]
    every = np.concatenate(series)
    variance = uniform_filter1d(every.var(axis=0, ddof=1), LEARNING.neighbours, mode='nearest')
    values = np.stack([x.mean(axis=0) for x in split])[:, None]
    sample = Sample(values, np.array([[float(len(x))] for x in split]), variance[None])
    mean = every.mean(axis=0)
    chosen = np.abs(mean) * np.sqrt(len(every) / np.maximum(variance, 1e-300)) > LEARNING.narrow
    chosen[: first_terms(sample)] = True
    return np.where(chosen, mean, 0.0)


def _beside_line(left: LeftOver, station: int, group: int) -> np.ndarray:
    """Return a group's samples without their line, zero outside of the analysis window (n P, N); I and Q in turn."""
    c = left.comparison
    heard = c.heard[station]
    sweeps = c.data.sweeps[c.data.setting[c.members[group][0]]]
    start, end = sweeps[heard].analysis_window()
    iq = c.recorded.topology.iq
    samples = as_complex(c.data.samples_of(heard)[c.members[group]].astype(float), iq)
    frequency = c.sweeps[group].line[:, station] / sweeps[heard].sample_rate
    count = samples.shape[1]
    index = np.arange(count)
    inside = (index >= np.ceil(start * sweeps[heard].sample_rate)) & (index < end * sweeps[heard].sample_rate)
    envelope = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, inside.sum()), LEARNING.envelope - 1)
    result = np.zeros(samples.shape, samples.dtype)
    for begin in range(0, len(samples), LEARNING.chunk):
        rows = slice(begin, begin + LEARNING.chunk)
        result[rows, inside] = _rest(samples[rows][:, inside], frequency[rows], index[inside], envelope)
    if not iq:
        return result
    return np.stack([result.real, result.imag], axis=1).reshape(-1, count)


def _rest(samples: np.ndarray, frequency: np.ndarray, index: np.ndarray, envelope: np.ndarray) -> np.ndarray:
    """Return samples (n, N), real or complex, less the line of a frequency (n,) [cycles per sample] with an envelope.

    Args:
        samples: of sweeps.
        frequency: of their lines.
        index: of the samples (N,).
        envelope: basis of the line's envelope over them (N, E).
    """
    carrier = np.exp(2j * np.pi * frequency[:, None] * index)
    if np.iscomplexobj(samples):
        below = np.abs(np.sum(samples * carrier, axis=1)) > np.abs(np.sum(samples * carrier.conj(), axis=1))
        carrier = np.where(below[:, None], carrier.conj(), carrier)
        basis = carrier[..., None] * envelope
    else:
        basis = np.concatenate([carrier.real[..., None] * envelope, carrier.imag[..., None] * envelope], axis=2)
    normal = np.einsum('nke,nkf->nef', basis.conj(), basis)
    overlap = np.einsum('nke,nk->ne', basis.conj(), samples)
    amplitude = np.linalg.solve(normal, overlap[..., None])[..., 0]
    rest: np.ndarray = samples - np.einsum('nke,ne->nk', basis, amplitude)
    return rest
