"""What was assumed about the samples, against the samples.

Each check gives one sentence: what is there, and where that contradicts the settings, what to set instead.
"""

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import SweepSettings

from ..formats.base import Numbers
from .codes import ACROSS, LARGE, Coder, are_half_a_range_off, byte_swapped, jumps
from .finding import Finding
from .order import order_findings
from .spectra import averaged_spectrum, near_zero, strongest

_KEPT = 1 << 22  # numbers kept for what needs whole sweeps
_JUMPS = 1e-3  # of the steps that go across the whole range: the coding is wrong
_FEW = 8  # different codes, below which nothing can be said of rails
_COVERED = 0.75  # of the ramp that the samples should cover
_UNEVEN = 2.0  # times as often as the odd ones the even codes occur, or the other way round
_RAILS = (0.002, 0.005)  # of the used range: widths of a rail, whose codes scatter
_PILED = 8.0  # times as many samples on a rail as beside it: the receiver limits there
_OTHER_CODING = 'wrapped, offset binary or unsigned codes were imported with another samples: coding'
_WRONG_SIDE = 10.0  # dB by which the wrong side band exceeds the right one
_COHERENT = 0.5  # correlation of I and Q at the strongest line that shows how they stand
_CERTAIN, _STRONG = 20.0, 100.0  # its square times the sweeps, or the line over the median: no noise does that
_ASKEW, _UNLIKE = 25.0, 6.0  # degrees off 90, and dB apart, that no imbalance of a receiver reaches


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


def findings(
    statistics: Statistics, sweep: SweepSettings, full_scale: float, coder: Coder | None = None
) -> list[Finding]:
    """Return what the samples of one station say about the settings.

    Args:
        statistics: of all its sweeps.
        sweep: its settings.
        full_scale: of the ADC [LSB].
        coder: that made the codes of a file's numbers; None where the codes are all that is known.
    """
    kept = statistics.kept
    iq = kept.shape[2] == 2
    signal = kept[..., 0] + 1j * kept[..., 1] if iq else kept[..., 0]
    result = [_whole(coder.roundings if coder else 0.0), *_codes(statistics.histogram, full_scale)]
    result.append(_offset(statistics.histogram, full_scale))
    wrapping = _wrapping(kept, full_scale, coder)
    result.append(wrapping)
    if wrapping.agrees:
        result.append(_rails(statistics.histogram))
    result += _dead(statistics, sweep)
    result += order_findings(signal)
    spectrum = averaged_spectrum(signal)
    result.append(_sides(spectrum, sweep) if iq else Finding(True, 'a real IF cannot show the sign of the ramp'))
    if iq:
        result.append(_quadrature(kept))
    result.append(_line(spectrum, sweep, iq))
    return [f for f in result if f.sentence]


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
    if len(used) < _FEW:
        return [Finding(False, f'{text}: too few to be samples of an IF: samples: bits, span or span_codes is wrong')]
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


def _wrapping(kept: Numbers, full_scale: float, coder: Coder | None) -> Finding:
    """Say whether codes jump across the range, and which other reading of the same bits does not."""
    across, large = (jumps(kept, full_scale, least) for least in (ACROSS, LARGE))
    text = 'of the steps from sample to sample go across the whole range'
    if large > _JUMPS and are_half_a_range_off(kept, full_scale):
        return Finding(False, f'{large:.1%} {text}: {coder.other_coding if coder else _OTHER_CODING}')
    if across <= _JUMPS:
        return Finding(True, 'no jumps across the whole range')
    if full_scale == 32768.0 and jumps(byte_swapped(kept), full_scale) < 0.1 * across:
        return Finding(False, f'{across:.1%} {text}: set the other byte order (options: byte_order of a raw file)')
    return Finding(False, f'{across:.1%} {text}: check samples: bits and coding, and the layout')


def rail_shares(histogram: Numbers) -> tuple[float, float]:
    """Return the shares of the samples at the lowest and the highest codes where they pile up, 0 where they do not."""
    used = np.flatnonzero(histogram)
    total = histogram.sum()
    counts = histogram[used[0] : used[-1] + 1]
    most = len(counts) // 2  # no sample counts at both rails
    shares = []
    for side in (counts, counts[::-1]):
        share = 0.0
        for width in {min(max(2, round(part * len(counts))), most) for part in _RAILS} - {0}:
            rail, beside = side[:width].sum(), side[width : min(2 * width, len(counts) - width)].sum()
            if rail > _PILED * max(beside, 1) and rail > 16:
                share = max(share, float(rail / total))
        shares.append(share)
    return shares[0], shares[1]


def _rails(histogram: Numbers) -> Finding:
    if np.count_nonzero(histogram) < _FEW:
        return Finding(True, '')
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
    elif sweep.record_duration < _COVERED * sweep.ramp_duration:
        result.append(
            Finding(
                False,
                f'the samples cover {sweep.record_duration * 1e6:.4g} us, '
                f'{sweep.record_duration / sweep.ramp_duration:.0%} of the ramp of {sweep.ramp_duration * 1e6:.4g} us: '
                "is this so, or is ramp_duration, sample_rate or the layout's number of samples wrong?",
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


def side_powers(spectrum: Numbers) -> tuple[float, float]:
    """Return the strongest power at positive and at negative frequencies, some bins around 0 Hz left out."""
    count = len(spectrum)
    guard = near_zero(count)
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


def _quadrature(kept: Numbers) -> Finding:
    """Say whether (n, N, 2) parts are I and Q: equal and 90 degrees apart, as two receivers or instants are not."""
    count = kept.shape[1]
    guard = near_zero(count)
    window = np.hanning(count + 2)[1:-1, None]
    parts = np.fft.fft((kept - kept.mean(axis=1, keepdims=True)) * window, axis=1)[:, guard : count // 2]
    power = np.mean(np.abs(parts) ** 2, axis=0)
    at = int(np.argmax(power.sum(axis=1)))
    first, second = power[at]
    if not first or not second:
        return Finding(True, '')
    between = complex(np.mean(parts[:, at, 0] * parts[:, at, 1].conj()) / np.sqrt(first * second))
    strong = first + second > _STRONG * np.median(power.sum(axis=1))
    if abs(between) < _COHERENT or not (strong or abs(between) ** 2 * len(kept) > _CERTAIN):
        return Finding(True, '')
    angle, apart = abs(float(np.degrees(np.angle(between)))), 10.0 * abs(float(np.log10(first / second)))
    text = f'at the strongest line I and Q stand {angle:.0f} degrees apart and differ by {apart:.1f} dB'
    if abs(angle - 90.0) < _ASKEW and apart < _UNLIKE:
        return Finding(True, text)
    return Finding(False, f'{text}: they are no I and Q of one receiver: check where iq stands in layout: axes')


def _line(spectrum: Numbers, sweep: SweepSettings, iq: bool) -> Finding:
    count = len(spectrum)
    if not spectrum.any():
        return Finding(False, 'there is no line')
    at = strongest(spectrum, iq)
    half = spectrum if iq else spectrum[: count // 2]
    snr = 10.0 * float(np.log10(max(spectrum[at], 1e-30) / max(float(np.median(half)), 1e-30)))
    bins = at if at < count / 2 else at - count
    frequency = bins * sweep.sample_rate / count
    delay = abs(frequency / sweep.chirp_rate)
    text = (
        f'strongest line at {frequency / 1e3:.4g} kHz ({snr:.0f} dB above the median), a path of {delay * 1e9:.4g} ns '
        f'or a target at {delay * SPEED_OF_LIGHT / 2:.4g} m'
    )
    if abs(bins) > 0.48 * count:
        return Finding(False, f'{text}: at the Nyquist frequency; samples of two sources may alternate, or a sign does')
    if sweep.hears_itself and delay > min(sweep.ramp_duration, sweep.record_duration):
        return Finding(False, f'{text}: later than a sweep lasts: bandwidth, ramp_duration or sample_rate is wrong')
    return Finding(True, text)
