"""What was assumed about the samples, against the samples.

Each check gives one sentence: what is there, and where that contradicts the settings, what to set instead.
"""

import dataclasses

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import SweepSettings

from ..formats.base import Numbers

_KEPT = 1 << 22  # numbers kept for what needs whole sweeps
_UNEVEN = 2.0  # times as often as the odd ones the even codes occur, or the other way round
_RAILS = (0.002, 0.005)  # of the used range: widths of a rail, whose codes scatter
_PILED = 8.0  # times as many samples on a rail as beside it: the receiver limits there
_STEP = 4.0  # times the mean square step within: a border between blocks
_WRONG_SIDE = 10.0  # dB by which the wrong side band exceeds the right one
_MIRRORED = 6.0  # dB within which an image of each line shows interleaved sources
_PERIODS = (8, 6, 4, 3, 2)
_BLOCKS = (8, 4, 3, 2)


@dataclasses.dataclass(frozen=True)
class Finding:
    """One sentence about the samples."""

    agrees: bool  # False: a warning
    sentence: str


class Statistics:
    """Counts over all sweeps of one station, and the first of them in full."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.histogram = np.zeros(1 << 16, np.int64)  # of codes from -32768 on
        self.sweeps = 0
        self.constant = 0  # sweeps of one value only
        self._low: Numbers | None = None  # (N, iq) smallest code at each instant
        self._high: Numbers | None = None
        self._kept: list[Numbers] = []

    def add(self, codes: Numbers) -> None:
        """Take in (n, N, 1 or 2) int16 codes."""
        flat = codes.reshape(-1).astype(np.int64) + 32768
        self.histogram += np.bincount(flat, minlength=1 << 16)
        self.sweeps += len(codes)
        low, high = codes.min(axis=0), codes.max(axis=0)
        self.constant += int(np.sum((codes.max(axis=1) == codes.min(axis=1)).all(axis=-1)))
        self._low = low if self._low is None else np.minimum(self._low, low)
        self._high = high if self._high is None else np.maximum(self._high, high)
        room = _KEPT - sum(k.size for k in self._kept)
        if room > 0:
            count = max(1, room // max(1, codes[0].size)) if not self._kept else room // max(1, codes[0].size)
            self._kept.append(codes[:count].copy())

    @property
    def kept(self) -> Numbers:
        """The first sweeps, (n, N, iq) as floats."""
        return np.concatenate(self._kept).astype(float)

    @property
    def frozen(self) -> Numbers:
        """True at each instant whose code never changes, (N,)."""
        assert self._low is not None and self._high is not None
        return np.asarray((self._low == self._high).all(axis=-1))


def findings(statistics: Statistics, sweep: SweepSettings, full_scale: float, roundings: float) -> list[Finding]:
    """Return what the samples of one station say about the settings.

    Args:
        statistics: of all its sweeps.
        sweep: its settings.
        full_scale: of the ADC [LSB].
        roundings: largest distance of the file's numbers from whole codes [LSB].
    """
    kept = statistics.kept
    iq = kept.shape[2] == 2
    signal = kept[..., 0] + 1j * kept[..., 1] if iq else kept[..., 0]
    result = [_whole(roundings), *_codes(statistics.histogram, full_scale), _offset(statistics.histogram, full_scale)]
    result.append(_wrapping(kept, full_scale))
    result.append(_rails(statistics.histogram))
    result += _dead(statistics, sweep)
    result.append(_block_borders(kept))
    spectrum = averaged_spectrum(signal)
    result.append(_interleaving(spectrum, iq))
    result.append(_sides(spectrum, sweep) if iq else Finding(True, 'a real IF cannot show the sign of the ramp'))
    result += _line(spectrum, sweep, iq)
    return [f for f in result if f.sentence]


def averaged_spectrum(signal: Numbers) -> Numbers:
    """Return the mean power spectrum of (n, N) sweeps after a Hann window, all N bins, each sweep's mean removed."""
    window = np.hanning(signal.shape[1] + 2)[1:-1]
    power: Numbers = np.mean(np.abs(np.fft.fft((signal - signal.mean(axis=1, keepdims=True)) * window)) ** 2, axis=0)
    return power


def local_maxima(power: Numbers) -> Numbers:
    """Return powers with zero where they are no local maximum along the last axis: the skirt of 0 Hz is no line."""
    around = np.pad(power, [(0, 0)] * (power.ndim - 1) + [(1, 1)], mode='edge')
    peaks: Numbers = np.where((power >= around[..., :-2]) & (power >= around[..., 2:]), power, 0.0)
    return peaks


def _whole(roundings: float) -> Finding:
    if roundings == 0.0:
        return Finding(True, '')
    if roundings > 0.05:
        return Finding(
            False,
            f'the numbers of the file are up to {roundings:.2f} codes away from whole codes: samples: bits, span or '
            'span_codes is wrong, or the file holds filtered or averaged samples',
        )
    return Finding(True, f'the numbers of the file are whole codes to {roundings:.1g} LSB')


def _codes(histogram: Numbers, full_scale: float) -> list[Finding]:
    used = np.flatnonzero(histogram) - 32768
    low, high = int(used[0]), int(used[-1])
    step = int(np.gcd.reduce(np.diff(used))) if len(used) > 1 else 1
    share = max(abs(low), abs(high)) / full_scale
    span = high - low + 1
    text = f'codes {low} ... {high} ({share:.0%} of full scale {full_scale:g}), {len(used)} different'
    if step > 1:
        spare = int(np.log2(step))
        return [
            Finding(
                False,
                f'{text}, all {step} apart: the ADC has about {spare} bits fewer: set samples: span: {step}, '
                f'span_codes: 1 and bits: {max(1, int(np.log2(2 * full_scale)) - spare)}',
            )
        ]
    unused = span - len(used)
    if unused:
        text += f'; {unused} in between never occur'
    # where neighbours occur often, each code should; rails, where samples pile up, left out
    edge = span // 100 + 1
    occurring = histogram[low + 32768 + edge : high + 32769 - edge]
    if len(occurring) < 64:
        return [Finding(True, text)]
    dense = np.convolve(occurring, np.ones(33) / 33, 'same') > 20.0
    missing = int(np.sum(dense & (occurring == 0)))
    if missing > 0.1 * max(1, int(dense.sum())):
        return [
            Finding(
                False,
                f'{text}: {missing} of {int(dense.sum())} codes never occur where their neighbours often do: the '
                'file was scaled, or the ADC misses codes: check samples: bits, span and span_codes',
            )
        ]
    return [Finding(True, text), _parity(occurring)]


def _parity(occurring: Numbers) -> Finding:
    """Compare how often even and odd codes occur."""
    first, second = int(occurring[::2].sum()), int(occurring[1::2].sum())
    if first + second > 2000 and max(first, second) > _UNEVEN * min(first, second):
        ratio = max(first, second) / max(min(first, second), 1)
        return Finding(
            False,
            f'every other code occurs {ratio:.1f} times as often as those between: the lowest bit is mostly stuck, or '
            'the file holds doubled codes: count on one bit fewer; no setting mends it',
        )
    return Finding(True, '')


def _offset(histogram: Numbers, full_scale: float) -> Finding:
    codes = np.arange(-32768, 32768)
    total = histogram.sum()
    mean = float(np.dot(histogram, codes) / total)
    one_sided = histogram[:32768].sum() == 0 or histogram[32768:].sum() == 0
    text = f'mean {mean:.1f} LSB ({mean / full_scale:+.1%} of full scale)'
    if one_sided and total > 100 and abs(mean) > full_scale / 32:
        return Finding(
            False,
            f'{text}, and no code has the other sign: set samples: coding: offset_binary or signed, or other bits',
        )
    return Finding(True, text)


def _wrapping(kept: Numbers, full_scale: float) -> Finding:
    steps = np.abs(np.diff(kept, axis=1))
    share = float(np.mean(steps > 1.8 * full_scale))
    if share > 1e-3:
        return Finding(
            False,
            f'{share:.1%} of the steps from sample to sample go across the whole range: negative codes seem to be '
            'read as large ones or offset ones as signed: try samples: coding: wrapped, offset_binary or signed, or '
            'the other byte order',
        )
    return Finding(True, 'no jumps across the whole range')


def rail_shares(histogram: Numbers) -> tuple[float, float]:
    """Return the shares of the samples at the lowest and the highest codes where they pile up, 0 where they do not."""
    used = np.flatnonzero(histogram)
    total = histogram.sum()
    counts = histogram[used[0] : used[-1] + 1]
    shares = []
    for side in (counts, counts[::-1]):
        share = 0.0
        for width in (max(2, round(part * len(counts))) for part in _RAILS):
            rail, beside = side[:width].sum(), side[width : 2 * width].sum()
            if rail > _PILED * max(beside, 1) and rail > 16:
                share = max(share, float(rail / total))
        shares.append(share)
    return shares[0], shares[1]


def _rails(histogram: Numbers) -> Finding:
    low, high = rail_shares(histogram)
    if low + high > 1e-3:
        return Finding(
            False,
            f'{low + high:.1%} of the samples stand at the rails ({low:.1%} low, {high:.1%} high): the receiver limits',
        )
    return Finding(True, 'no samples pile up at the rails')


def _dead(statistics: Statistics, sweep: SweepSettings) -> list[Finding]:
    result = []
    if statistics.constant:
        result.append(
            Finding(False, f'{statistics.constant} of {statistics.sweeps} sweeps have one value only: leave them out')
        )
    frozen = statistics.frozen
    if statistics.sweeps >= 4 and frozen.any() and not frozen.all():
        first = int(np.argmin(frozen)) if frozen[0] else 0
        advice = f': set layout: skip_samples: {first}' if first else ''
        result.append(
            Finding(False, f'{int(frozen.sum())} of {len(frozen)} samples have the same code in every sweep{advice}')
        )
    repeated = kept_runs(statistics.kept)
    if repeated > 0.05:
        result.append(
            Finding(
                False, f'{repeated:.0%} of the samples stand in runs of eight or more equal ones: held or dead samples'
            )
        )
    if sweep.record_duration > sweep.ramp_duration * (1.0 + 2.0 / sweep.sample_count):
        result.append(
            Finding(
                False,
                f'the samples cover {sweep.record_duration * 1e6:.4g} us, the ramp {sweep.ramp_duration * 1e6:.4g} '
                f'us: set layout: sample_count: {int(sweep.ramp_duration * sweep.sample_rate)}, or correct '
                'ramp_duration or sample_rate',
            )
        )
    return result or [Finding(True, 'no dead samples')]


def kept_runs(kept: Numbers) -> float:
    """Return the share of (n, N, iq) samples that stand in runs of eight or more equal ones, not at the rails."""
    inside = (kept[:, 1:] > kept.min()) & (kept[:, 1:] < kept.max())
    same = ((np.diff(kept, axis=1) == 0.0) & inside).astype(int)
    if same.shape[1] < 7:
        return 0.0
    sums = np.cumsum(np.pad(same, ((0, 0), (1, 0), (0, 0))), axis=1)
    return float(np.mean(sums[:, 7:] - sums[:, :-7] == 7))


def _block_borders(kept: Numbers) -> Finding:
    """Compare the mean square step across possible borders of blocks with that within."""
    steps = np.mean(np.diff(kept, axis=1) ** 2, axis=(0, 2))  # (N - 1,)
    count = kept.shape[1]
    for blocks in _BLOCKS:
        if count % blocks or count // blocks < 8:
            continue
        at = np.arange(1, blocks) * (count // blocks) - 1
        within = np.delete(steps, at)
        level = float(np.mean(within))
        if level > 0.0 and np.min(steps[at]) > max(_STEP * level, float(np.percentile(within, 99))):
            return Finding(
                False,
                f'steps between blocks of {count // blocks} samples are {np.mean(steps[at]) / level:.0f} times (mean '
                f'square) those within: a sweep seems to hold {blocks} blocks: put receiver, iq, ramp or chirp as an '
                f'axis of size {blocks} before sample',
            )
    return Finding(True, 'no jumps at the borders of blocks')


def _interleaving(spectrum: Numbers, iq: bool) -> Finding:
    """Look for images of the strongest line at multiples of 1 / p of the sampling rate: p sources."""
    count = len(spectrum)
    guard = max(3, count // 128)
    usable = local_maxima(spectrum)
    usable[:guard] = usable[count - guard + 1 :] = 0.0
    if not iq:
        usable[count // 2 + 1 :] = 0.0
    floor = float(np.median(spectrum))
    line = int(np.argmax(usable))
    if usable[line] < 30.0 * floor:
        return Finding(True, '')
    for period in _PERIODS:
        if count % period:
            continue
        images = [(line + count * m // period) % count for m in range(1, period)]
        apart = [min(abs(i - j) % count for j in (line, count - line)) > 2 * guard for i in images]
        strengths = [max(spectrum[(i + d) % count] for d in (-1, 0, 1)) for i in images]
        if all(apart) and min(strengths) > max(10.0 * floor, usable[line] * 10 ** (-_MIRRORED / 10)):
            return Finding(
                False,
                f'each line has images at {period - 1} multiple(s) of 1/{period} of the sampling rate: {period} '
                f'sources alternate sample by sample: put receiver or iq as an axis of size {period} behind sample',
            )
    return Finding(True, 'no images as of sources that alternate sample by sample')


def side_powers(spectrum: Numbers) -> tuple[float, float]:
    """Return the strongest power at positive and at negative frequencies, some bins around 0 Hz left out."""
    count = len(spectrum)
    guard = max(3, count // 128)
    return float(spectrum[guard : count // 2].max()), float(spectrum[count // 2 + 1 : count - guard + 1].max())


def _sides(spectrum: Numbers, sweep: SweepSettings) -> Finding:
    positive, negative = side_powers(spectrum)
    right, wrong = (positive, negative) if sweep.bandwidth > 0 else (negative, positive)
    ratio = 10.0 * float(np.log10(max(wrong, 1e-30) / max(right, 1e-30)))
    ramp = 'rising' if sweep.bandwidth > 0 else 'falling'
    side = 'positive' if sweep.bandwidth > 0 else 'negative'
    if ratio > _WRONG_SIDE:
        return Finding(
            False,
            f'the strongest line stands {ratio:.1f} dB above its image on the wrong side for a {ramp} ramp: set '
            'layout: swap_iq: true, or the other radar: ramp',
        )
    return Finding(
        True,
        f'the strongest line of the {side} side, where a {ramp} ramp puts it, stands {abs(ratio):.1f} dB '
        f'{"below" if ratio > 0.0 else "above"} the strongest of the other side',
    )


def _line(spectrum: Numbers, sweep: SweepSettings, iq: bool) -> list[Finding]:
    count = len(spectrum)
    half = spectrum if iq else spectrum[: count // 2]
    guard = max(3, count // 128)
    inner = local_maxima(half)
    inner[:guard] = 0.0
    if iq:
        inner[count - guard + 1 :] = 0.0
    at = int(np.argmax(inner))
    snr = 10.0 * float(np.log10(max(inner[at], 1e-30) / max(float(np.median(half)), 1e-30)))
    bins = at if at < count / 2 else at - count
    frequency = bins * sweep.sample_rate / count
    distance = abs(frequency / sweep.chirp_rate) * SPEED_OF_LIGHT / 2
    text = (
        f'strongest line at {frequency / 1e3:.4g} kHz ({snr:.0f} dB above the median), a path of '
        f'{abs(frequency / sweep.chirp_rate) * 1e9:.4g} ns or a target at {distance:.4g} m'
    )
    if abs(bins) > 0.48 * count:
        return [
            Finding(False, f'{text}: at the Nyquist frequency; samples of two sources may alternate, or a sign does')
        ]
    return [Finding(True, text)]
