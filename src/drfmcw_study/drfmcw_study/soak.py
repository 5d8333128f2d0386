"""`drfmcw soak`: the classes of stations and fusion, or the gateway, for hours of sweeps at full speed; what grows?"""

import dataclasses
import gc
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.stats import t as student

from drfmcw_fusion.pipeline import RangeFusion
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Sweep
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import Parser, guarded, write_atomically
from drfmcw_sim.synthesis.signal_model import synthesise

from .campaign.faults import Fault
from .campaign.measuring import Case, conditions, fresh_fusion, give_weather, processor_of, scenario_of, sweeps_of

SWEEPS = 400
"""Different sweeps, given again and again with new numbers, stamps and one bit of noise: fusion refuses repetitions."""
BATCH = 50
"""Sweeps of each station that are given at once: those of a second, four times as fast as one after the other."""
_SITE_INTERVAL = 1_000_000_000  # between two readings of weather and board temperatures [ns]
_LOOPS_BETWEEN = 5  # two looks
_WARM_UP = 0.2  # share of the looks that is not judged: caches fill
_DAY = 24.0  # hours that growth is stated for
GROWTH_LIMIT = 5.0
"""Of memory in 24 h of sweeps, above which the upper end of its confidence interval must not be [MB]."""
_CONFIDENCE = 0.95
_PAGE = os.sysconf('SC_PAGE_SIZE')


@dataclasses.dataclass(frozen=True)
class Look:
    """What was found after some time."""

    hours: float  # of sweeps at 50 per second
    memory: float  # resident [MB]
    descriptors: int
    latency: float  # median time from a sweep to its range [ms]


@dataclasses.dataclass(frozen=True)
class Slope:
    """A straight line's slope, and the half width of its 95 % confidence interval."""

    value: float
    half_width: float

    @property
    def grows(self) -> bool:
        """Whether the slope is positive beyond chance."""
        return self.value - self.half_width > 0.0

    @property
    def most(self) -> float:
        """The upper end of the confidence interval."""
        return self.value + self.half_width


def slope(times: Sequence[float], values: Sequence[float]) -> Slope:
    """Return the slope of values over times with its confidence interval (least squares, Student's t)."""
    x, y = np.asarray(times), np.asarray(values)
    n = len(x)
    if n < 3 or not np.ptp(x):
        return Slope(math.nan, math.inf)
    spread = float(((x - x.mean()) ** 2).sum())
    value = float(((x - x.mean()) * (y - y.mean())).sum()) / spread
    residual = y - y.mean() - value * (x - x.mean())
    std = math.sqrt(float((residual**2).sum()) / (n - 2) / spread)
    return Slope(value, float(student.ppf(0.5 + _CONFIDENCE / 2.0, n - 2)) * std)


_UNITS = {'memory': 'memory [MB]', 'descriptors': 'descriptors', 'latency': 'median time of a sweep [ms]'}


class Soaked(Protocol):
    """What runs for hours of sweeps."""

    @property
    def process(self) -> int:
        """Return the identifier of the process that is looked at."""

    @property
    def hours(self) -> float:
        """Return for how many hours of sweeps it has run."""

    @property
    def account(self) -> str:
        """Return what happened beside the sweeps, '' for nothing."""

    def loop(self) -> list[float]:
        """Go on for a while; return the time that each sweep took [s]."""

    def settle(self) -> None:
        """Come to rest before a look: collect garbage, close what is no longer used."""

    def close(self) -> None:
        """End."""


class Soak:
    """A pair of stations and a fusion that never stop."""

    def __init__(self, estimator: str = 'hann', batch: int = BATCH) -> None:
        """Simulate the sweeps and start; `batch` of them of each station are given at once."""
        self._batch = batch
        self._case = Case(Fault('none', 'clean'), 300.0, estimator, 0.0, SWEEPS, 1)
        scenario = scenario_of(self._case, ())
        m = conditions(scenario, self._case, 0.0)
        samples = synthesise(m, scenario.seed, scenario.effects)
        self._sweeps = sweeps_of(self._case, scenario, m, samples, samples)
        self._span = 2 * self._sweeps[-1].stamp - self._sweeps[-3].stamp - self._sweeps[0].stamp
        self.processor: StationProcessor = processor_of(self._case, scenario, m)
        """Of both stations."""
        self.fusion: RangeFusion = fresh_fusion(self._case, scenario, m)
        """Of the pair."""
        self._noise = np.random.default_rng(self._case.seed)
        self._site_stamp = 0
        self._loops = self._calls = self._ranges = self._flagged = 0
        self.process = os.getpid()
        """This one."""

    @property
    def account(self) -> str:
        """Return how much was given, and what came of it."""
        sweeps = self._loops * (len(self._sweeps) // 2)
        return (
            f'{sweeps} sweeps of each station in {self._calls} calls; {self._ranges} ranges, {self._flagged} flagged.'
        )

    @property
    def hours(self) -> float:
        """Return for how many hours of sweeps it has run."""
        return self._loops * self._span * 1e-9 / 3600.0

    def loop(self) -> list[float]:
        """Give all sweeps once more; return the mean time of a pair of sweeps of each batch [s]."""
        count = len(self._sweeps) // 2
        shift, numbers = self._loops * self._span, self._loops * count
        taken = []
        for first in range(0, len(self._sweeps), 2 * self._batch):
            batch = [self._again(s, shift, numbers) for s in self._sweeps[first : first + 2 * self._batch]]
            if batch[0].stamp >= self._site_stamp + _SITE_INTERVAL:
                self._give_site(batch[0].stamp)
            begin = time.perf_counter()
            for beat in self.processor.process(batch):
                self.fusion.add_lock(beat.station, beat.stamp, True)
                found = self.fusion.add_beat(beat, beat.stamp * 1e-9)
                self._ranges += found is not None
                self._flagged += found is not None and bool(found.flags)
            taken.append((time.perf_counter() - begin) / (len(batch) // 2))
            self._calls += 1
        self._loops += 1
        return taken

    def _give_site(self, stamp: int) -> None:
        """Give what comes once a second: weather, without which ranges go STALE_ENVIRONMENT, board temperatures."""
        give_weather(self.fusion, stamp)
        for station in ('master', 'slave'):
            for consumer in (self.processor, self.fusion):
                consumer.add_board_temperature(station, stamp, float(self._noise.normal(25.0, 0.1)))
        self._site_stamp = stamp

    def _again(self, sweep: Sweep, shift: int, numbers: int) -> Sweep:
        noise = self._noise.integers(0, 2, sweep.samples.shape, sweep.samples.dtype)
        stamp, number = sweep.stamp + shift, sweep.sweep_id + numbers
        return dataclasses.replace(sweep, stamp=stamp, sweep_id=number, samples=sweep.samples + noise)

    def settle(self) -> None:
        """Collect garbage."""
        gc.collect()

    def close(self) -> None:
        """End; nothing is left open."""


def run(hours: float, limit: float, soak: Soaked) -> list[Look]:
    """Run until so many hours of sweeps, or `limit` seconds of the clock, are over; return what was seen."""
    looks: list[Look] = []
    end = time.monotonic() + limit
    while soak.hours < hours and time.monotonic() < end:
        taken = [each for _ in range(_LOOPS_BETWEEN) for each in soak.loop()]
        soak.settle()
        process = Path('/proc') / str(soak.process)
        memory = int((process / 'statm').read_text().split()[1]) * _PAGE / 1e6
        looks.append(Look(soak.hours, memory, len(os.listdir(process / 'fd')), float(np.median(taken)) * 1e3))
    return looks


def judged_part(looks: Sequence[Look]) -> Sequence[Look]:
    """Return the looks after the warm-up."""
    return looks[round(_WARM_UP * len(looks)) :]


def judged(looks: Sequence[Look]) -> dict[str, Slope]:
    """Return the slopes per 24 hours of sweeps of what was seen after the warm-up."""
    kept = judged_part(looks)
    days = [look.hours / _DAY for look in kept]
    return {name: slope(days, [getattr(look, name) for look in kept]) for name in _UNITS}


def table(looks: Sequence[Look]) -> str:
    """Return what was seen as a Markdown table."""
    first, last = judged_part(looks)[0], looks[-1]
    rows = [
        f'| {last.hours:.2f} h of sweeps, {len(looks)} looks | at {first.hours:.2f} h | at the end | in 24 h (95 %) |',
        '| - | - | - | - |',
    ]
    for name, found in judged(looks).items():
        values = f'{getattr(first, name):.4g} | {getattr(last, name):.4g}'
        rows.append(f'| {_UNITS[name]} | {values} | {found.value:+.2g} +- {found.half_width:.2g} |')
    return '\n'.join(rows)


def leaks(looks: Sequence[Look]) -> list[str]:
    """Return why memory or descriptors may grow too much; empty where neither does."""
    slopes, found = judged(looks), []
    if math.isnan(slopes['memory'].value):
        return ['too short: three looks after the warm-up are needed to see what grows']
    if not slopes['memory'].most <= GROWTH_LIMIT:
        found.append(f'memory may grow by {slopes["memory"].most:.2g} MB in 24 h, more than {GROWTH_LIMIT:g}')
    if slopes['descriptors'].grows:
        found.append('the number of descriptors grows')
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 1 where memory may grow too much in 24 h, or descriptors do."""
    parser = Parser(prog='drfmcw soak', description=__doc__)
    parser.add_argument('hours', type=float, nargs='?', default=24.0, help='of sweeps at 50 per second (24)')
    parser.add_argument(
        '--limit', type=float, default=math.inf, metavar='MINUTES', help='stop after so long by the clock'
    )
    parser.add_argument('--estimator', default='hann', choices=('paper', 'hann', 'ml', 'pair'), help='of the stations')
    parser.add_argument(
        '--batch', type=int, metavar='N', help=f'sweeps of each station given at once ({BATCH}); 1: live'
    )
    parser.add_argument('--gateway', action='store_true', help='the servers for crane controllers, with their clients')
    parser.add_argument('--json', metavar='FILE', help='write every look')
    arguments = parser.parse_args(argv)

    def work() -> int:
        hours, limit = arguments.hours, arguments.limit
        if not (0.0 < hours < math.inf and limit > 0.0):
            raise ConfigurationError(f'{hours:g} hours, --limit {limit:g}: both must be above 0')
        batch = BATCH if arguments.batch is None else arguments.batch
        if batch < 1 or (arguments.gateway and arguments.batch is not None):
            raise ConfigurationError(
                f'--batch {batch}: at least 1, and not with --gateway, which takes them one by one'
            )
        soak = _gateway() if arguments.gateway else Soak(arguments.estimator, batch)
        return _soak(hours, limit, soak, arguments.json)

    return guarded(parser.prog, work)


def _gateway() -> Soaked:
    from .soak_gateway import GatewaySoak  # its libraries take a second to load

    return GatewaySoak()


def _soak(hours: float, limit: float, soak: Soaked, path: str | None) -> int:
    try:
        looks = run(hours, 60.0 * limit, soak)
    finally:
        soak.close()
    print(table(looks))
    if soak.account:
        print(soak.account)
    if path:
        write_atomically(path, json.dumps([dataclasses.asdict(look) for look in looks]) + '\n')
    found = leaks(looks)
    for reason in found:
        print(reason, file=sys.stderr)
    return 1 if found else 0


if __name__ == '__main__':
    sys.exit(main())
