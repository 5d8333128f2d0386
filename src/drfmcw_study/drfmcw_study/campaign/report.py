"""What the campaign found, as Markdown."""

import dataclasses
from collections.abc import Iterable, Sequence

from scipy.stats import beta

from .measuring import WRONG
from .network import NetworkRow, network_table

_CONFIDENCE = 0.95


@dataclasses.dataclass(frozen=True)
class Row:
    """Sum over the cases of one fault and size."""

    fault: str
    size: str
    sweeps: int
    valid: int
    wrong: int
    beyond: int
    undetected: int
    worst: float

    @property
    def rate(self) -> float:
        """Share of the sweeps that were valid and wrong."""
        return self.wrong / self.sweeps

    @property
    def bound(self) -> float:
        """Upper confidence bound of that share (Clopper and Pearson 1934, one-sided 95 %)."""
        return bound(self.wrong, self.sweeps)


def bound(count: int, of: int) -> float:
    """Return the upper 95 % confidence bound of a rate by `count` of `of`."""
    return 1.0 if count >= of else float(beta.ppf(_CONFIDENCE, count + 1, of - count))


def table(rows: Iterable[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        '| fault | size | sweeps | valid | valid and wrong | 95 % bound | beyond protection level '
        '| seen after, at most | largest error of a valid range |',
        '| - | - | - | - | - | - | - | - | - |',
    ]
    for row in rows:
        seen = 'not flagged' if row.undetected >= row.sweeps else f'{row.undetected} sweeps'
        lines.append(
            f'| {row.fault} | {row.size} | {row.sweeps} | {row.valid / row.sweeps:.2%} | {row.wrong} '
            f'| {row.bound:.1e} | {row.beyond} | {seen} | {row.worst * 1e3:.1f} mm |'
        )
    return '\n'.join(lines)


def _networks(links: Sequence[NetworkRow]) -> str:
    if not links:
        return ''
    return f"""## Networks

What the stations send reaches the fusion over links that lose, delay, reorder, repeat and cut it: 60 m at 1.5 m/s and
300 m standing with `ml`, 900 m at 1.5 m/s with `hann`, 50 sweeps/s. Results that come in time are put in order;
others are refused. *Valid* is of all sweeps measured; what never arrives is not.

{network_table(links)}

"""


def document(rows: list[Row], links: Sequence[NetworkRow], command: str) -> str:
    """Return docs/reliability.md."""
    clean = rows[0]
    wrong, beyond, sweeps = (sum(getattr(row, name) for row in rows) for name in ('wrong', 'beyond', 'sweeps'))
    return f"""# Reliability

Written by `{command}`; do not edit. How each test works: [integrity](integrity.md).

Each fault acts from a sweep on, on pairs that were clean before: standing and moving at 1.5 m/s, at 60, 300 and
900 m, with every estimator, through the simulator and the classes of the nodes. *Valid* is a finite range with a stated
standard deviation; *wrong* is off by more than {WRONG:g} of them. A doubtful range counts as valid, with the larger
standard deviation that is published.

{table(rows)}

Of {sweeps} sweeps {wrong} were valid and wrong, and {beyond} were valid and beyond their protection level (95 % bound
{bound(beyond, sweeps):.1e}; the goal is 1e-5). Clean: {clean.sweeps - clean.valid} of {clean.sweeps} were refused
(95 % bound {bound(clean.sweeps - clean.valid, clean.sweeps):.1e}).

{_networks(links)}## What the data cannot show

| fault | how large it may be | what would show it |
| - | - | - |
| second path within the resolution that rises | tenths of a metre, within the protection level | the site's map |
| direct path blocked from the first sweep on | the excess length | a reference instrument, the map of the site |
| constant extra delay (cable, calibration) | any; 0.3 m/ns | an indoor calibration, SD/LD cross-check |
| both references off by the same amount | 1 mm per km and ppm of one of them | a second reference |
| slow clock drift within `clock_tolerance` | doubted, with a larger standard deviation | calibration |
| a line of the peer's own power and T_off | `start_delay_tolerance`: 3 m | more stations |
"""
