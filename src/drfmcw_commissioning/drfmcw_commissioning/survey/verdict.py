"""Each requirement beside what was measured: met, not met, or not shown by this recording."""

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence

from scipy.stats import beta

from .findings import BinFinding, PairFinding
from .requirements import Requirements


class Result(enum.Enum):
    """What a recording says about a requirement."""

    MET = 'met'
    NOT_MET = 'not met'
    NOT_SHOWN = 'not shown'
    """The recording cannot show it; it then counts as not met."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """One requirement of one pair."""

    pair: str
    name: str  # key of the requirement file
    required: str
    measured: str
    result: Result
    note: str = ''


def judge(finding: PairFinding, requirements: Requirements) -> list[Verdict]:
    """Return a verdict on each requirement that is asked."""
    bins = finding.judged_bins(requirements.bin_count)
    verdicts = [check(finding, requirements, bins) for check in _CHECKS]
    return [verdict for verdict in verdicts if verdict is not None]


def passes(verdicts: Sequence[Verdict]) -> bool:
    """Return whether all requirements are met and shown."""
    return bool(verdicts) and all(verdict.result is Result.MET for verdict in verdicts)


def interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a share."""
    tail = (1.0 - confidence) / 2.0
    low = float(beta.ppf(tail, successes, trials - successes + 1)) if successes else 0.0
    high = float(beta.ppf(1.0 - tail, successes + 1, trials - successes)) if successes < trials else 1.0
    return low, high


_Check = Callable[[PairFinding, Requirements, list[BinFinding]], Verdict | None]


def _compared(
    finding: PairFinding, name: str, limit: float, value: float, texts: tuple[str, str], missing: str, note: str = ''
) -> Verdict | None:
    """Return the verdict on a value that must not exceed a limit; texts: of the requirement, of the measurement."""
    if math.isnan(limit):
        return None
    if math.isnan(value):
        return Verdict(finding.pair, name, texts[0], 'unknown', Result.NOT_SHOWN, missing)
    result = Result.MET if value <= limit else Result.NOT_MET
    return Verdict(finding.pair, name, texts[0], texts[1], result, note)


_NO_REFERENCE = 'the recording holds no reference distances'


def _accuracy(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    texts = (
        f'{r.accuracy_share:.1%} of the errors within {1e3 * r.accuracy:g} mm',
        f'{r.accuracy_share:.1%} within {1e3 * f.accuracy:.1f} mm',
    )
    needed = math.ceil(1.0 / (1.0 - r.accuracy_share)) if r.accuracy_share < 1.0 else 0
    note = f'{f.compared} ranges' + ('' if f.compared >= needed else f'; such a share needs {needed}')
    return _compared(f, 'accuracy', r.accuracy, f.accuracy, texts, _NO_REFERENCE, note)


def _bias(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    known = [b for b in bins if math.isfinite(b.bias)]
    largest = max(known, key=lambda b: abs(b.bias), default=None)
    value = abs(largest.bias) if largest else math.nan
    texts = (f'at most {1e3 * r.bias:g} mm', f'{1e3 * value:.1f} mm')
    missing = f'no distance bin holds {r.bin_count} ranges with a reference'
    return _compared(f, 'bias', r.bias, value, texts, missing, f'at {largest.distances}' if largest else '')


def _rate(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    texts = (f'at least {r.rate:g} Hz', f'{f.lowest_rate:.0f} Hz in the poorest second')
    missing = 'no second of uninterrupted measuring is recorded'
    return _compared(f, 'rate', -r.rate, -f.lowest_rate, texts, missing, f'median {f.median_rate:.0f} Hz')


def _availability(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    low, high = interval(f.usable, f.sweeps) if f.sweeps else (0.0, 1.0)
    texts = (f'at least {100 * r.availability:g} %', f'{100 * f.availability:.3f} %')
    note = f'{f.usable} of {f.sweeps} sweeps; {100 * low:.2f} ... {100 * high:.2f} % (95 %, sweeps independent)'
    if low < r.availability <= f.availability:
        note += '; a longer recording would show it surely'
    return _compared(f, 'availability', -r.availability, -f.availability, texts, 'no sweep gave a range', note)


def _gap(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    texts = (f'at most {r.longest_gap:g} s', f'{f.longest_gap:.2f} s')
    return _compared(f, 'longest_gap', r.longest_gap, f.longest_gap, texts, 'no sweep gave a range')


def _margin(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    poorest = min(bins, key=lambda b: b.margin, default=None)
    value = poorest.margin if poorest else math.nan
    texts = (f'at least {r.fading_margin:g} dB', f'{value:.1f} dB')
    missing = f'no distance bin holds {r.bin_count} sweeps'
    note = f'at {poorest.distances}' if poorest else ''
    return _compared(f, 'fading_margin', -r.fading_margin, -value, texts, missing, note)


def _disturbed(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    poorest = max(bins, key=lambda b: b.disturbed, default=None)
    value = poorest.disturbed if poorest else math.nan
    texts = (f'at most {r.disturbed:.2%} of the sweeps', f'{value:.2%}')
    missing = f'no distance bin holds {r.bin_count} sweeps'
    note = f'at {poorest.distances}' if poorest and value else ''
    return _compared(f, 'disturbed', r.disturbed, value, texts, missing, note)


def _clocks(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    texts = (f'at most {r.clock_difference:g} ppm', f'{f.clock_difference:+.2f} ppm')
    missing = 'it needs two stations and a usable range'
    note = '' if abs(f.clock_difference) <= r.clock_difference else 'calibrate the stations again'
    return _compared(f, 'clock_difference', r.clock_difference, abs(f.clock_difference), texts, missing, note)


def _temperature(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    """Judge the board that is furthest beyond its limit: the calibration's own range, where it states one."""
    over = [board.distance - (0.0 if board.within else r.board_temperature) for board in f.boards]
    unknown = any(math.isnan(board.distance) for board in f.boards)
    worst = f.boards[over.index(max(over))] if f.boards and not unknown else None
    required, measured = f'at most {r.board_temperature:g} K from the calibration', ''
    if worst and worst.within:
        required = f'within the calibration, {worst.within[0]:g} to {worst.within[1]:g} degC'
        measured = f'{worst.distance:.1f} K beyond' if worst.distance else 'within'
    elif worst:
        measured = f'{worst.distance:.1f} K'
    missing = 'the recording lacks status or calibration of a station'
    limit = math.nan if math.isnan(r.board_temperature) else 0.0
    value = max(over) if worst else math.nan
    note = f"board of '{worst.station}'" if worst else ''
    return _compared(f, 'board_temperature', limit, value, (required, measured), missing, note)


def _wrong(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    share = f.wrong / f.compared if f.compared else math.nan
    texts = (f'at most {r.wrong:.3%} beyond the protection level', f'{f.wrong} of {f.compared} ranges')
    return _compared(f, 'wrong', r.wrong, share, texts, _NO_REFERENCE)


def _coverage(f: PairFinding, r: Requirements, bins: list[BinFinding]) -> Verdict | None:
    low, high = f.travel
    texts = (f'at least {r.coverage:.0%} of the travel', f'{f.covered:.0%} of {low:.0f} to {high:.0f} m')
    value = f.covered if math.isfinite(low) else math.nan
    note = f'bins of {r.bin_width:g} m with {r.bin_count} usable ranges'
    return _compared(f, 'coverage', -r.coverage, -value, texts, 'no distance is known', note)


_CHECKS: tuple[_Check, ...] = (
    _accuracy, _bias, _wrong, _rate, _availability, _gap, _coverage, _margin, _disturbed, _clocks, _temperature,
)  # fmt: skip
