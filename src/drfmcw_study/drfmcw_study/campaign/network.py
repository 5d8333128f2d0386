"""Networks that lose, delay, reorder, repeat and cut what the stations send to the fusion.

In: beats of both stations, a network. Out: what the fusion makes of them, when, and how much it kept meanwhile. The
network is a seeded model in front of the fusion's own class; time is that of arrival.
"""

import dataclasses
import heapq
import math
from collections.abc import Sequence

import numpy as np

from drfmcw_fusion.pipeline import Flag, RangeResult
from drfmcw_node.processing.records import Beat
from drfmcw_sim.synthesis.signal_model import synthesise

from .faults import Fault
from .measuring import (
    CLEAN,
    INTERVAL,
    UNUSABLE,
    WRONG,
    Case,
    beats_of,
    conditions,
    fresh_fusion,
    scenario_of,
    sweeps_of,
)

NETWORK_SWEEPS = 800
"""Least number of a case, for the longest cut to end."""
_BEAT_BITS = 8.0 * 250  # of a beat on the wire, with its headers
_QUEUE = 0.3  # that a link of limited rate holds back before it drops [s]


@dataclasses.dataclass(frozen=True)
class Link:
    """One station's way to the fusion."""

    loss: float = 0.0  # probability
    delay: float = 0.0  # [s]
    jitter: float = 0.0  # uniform, on top of the delay; larger than the sweep interval, it reorders [s]
    repeated: float = 0.0  # probability that a result comes twice
    rate: float = math.inf  # [bit/s], shared with the other traffic
    others: float = 0.0  # of that [bit/s]
    cuts: tuple[tuple[float, float], ...] = ()  # from, to, after the fault's begin; what is sent meanwhile is lost [s]
    held: bool = False  # what is sent during a cut comes after it instead, in one burst


@dataclasses.dataclass(frozen=True)
class Network:
    """Both stations' links."""

    name: str
    first: Link
    second: Link

    def last_cut(self) -> float:
        """Return when the last cut ends, after the fault's begin; 0 for none [s]."""
        return max((end for link in (self.first, self.second) for _, end in link.cuts), default=0.0)


@dataclasses.dataclass(frozen=True)
class NetworkRow:
    """What came of a network, summed over cases."""

    name: str
    sweeps: int
    valid: int
    wrong: int
    beyond: int
    resets: int  # of the velocity track: ranges of unknown velocity without a pause of the data before them
    recovery: float  # after the last cut, until a range is valid, at most [s]
    kept: int  # results that the fusion kept, at most


def networks() -> list[Network]:
    """Return every network of the campaign."""
    cut = ((2.0, 12.0),)
    bad = Link(loss=0.2, delay=0.2, jitter=0.1, repeated=0.1)
    found = [Network(name, link, link) for name, link in (
        ('20 % loss', Link(loss=0.2)),
        ('200 ms delay', Link(delay=0.2)),
        ('100 to 300 ms, reordered', Link(delay=0.1, jitter=0.2)),
        ('half of all repeated, reordered', Link(jitter=0.1, repeated=0.5)),
        ('2 Mbit/s beside 1.95 Mbit/s of others', Link(rate=2e6, others=1.95e6)),
        ('cut for 10 s', Link(cuts=cut)),
        ('held up for 10 s, then all at once', Link(cuts=cut, held=True)),
        ('all of it', dataclasses.replace(bad, rate=2e6, others=1.8e6, cuts=cut)),
    )]  # fmt: skip
    return [
        *found,
        Network('cut for 10 s, one station', Link(), Link(cuts=cut)),
        Network('held up for 10 s, one station', Link(), Link(cuts=cut, held=True)),
        Network('cut for 0.5 s, every second', *[Link(cuts=tuple((t + 0.5, t + 1.0) for t in range(10)))] * 2),
        Network('200 ms delay and 20 % loss, one station', Link(), bad),
    ]


def arrivals(beats: Sequence[Beat], link: Link, begin: float, rng: np.random.Generator) -> list[tuple[float, Beat]]:
    """Return (time [s], beat) of what a link delivers; it is good before `begin` [s]."""
    found: list[tuple[float, Beat]] = []
    free = -math.inf
    for beat in beats:
        sent = beat.stamp * 1e-9
        if sent < begin:
            found.append((sent, beat))
            continue
        if rng.random() < link.loss:
            continue
        for copies in range(1 + (rng.random() < link.repeated)):
            cut = next((end for start, end in link.cuts if start <= sent - begin < end), None)
            if cut is not None and not link.held:
                break
            at = sent if cut is None else begin + cut
            if math.isfinite(link.rate):
                free = max(free, at) + _BEAT_BITS / max(link.rate - link.others, 1.0)
                if free - at > _QUEUE:
                    free -= _BEAT_BITS / max(link.rate - link.others, 1.0)
                    break
                at = free
            found.append((at + link.delay + rng.uniform(0.0, link.jitter) * (1 + copies), beat))
    return found


def measure_network(
    network: Network, distance: float, estimator: str, speed: float, sweeps: int, seed: int
) -> NetworkRow:
    """Return what comes of one case; arguments as of `measuring.Case`."""
    case = Case(Fault('network', network.name), distance, estimator, speed, sweeps, seed)
    scenario = scenario_of(case, ())
    m = conditions(scenario, case, 0.0)
    samples = synthesise(m, scenario.seed, scenario.effects)
    beats = beats_of(case, scenario, m, sweeps_of(case, scenario, m, samples, samples))
    names = [station.sweep.station for station in m.stations]
    start = min(beat.stamp for beat in beats) * 1e-9
    begin = start + CLEAN * INTERVAL
    rng = np.random.default_rng(seed + 3)
    queue = []
    for name, link in zip(names, (network.first, network.second), strict=True):
        own = [beat for beat in beats if beat.station == name]
        queue += arrivals(own, link, begin, rng)
    fusion = fresh_fusion(case, scenario, m)
    results: list[tuple[float, RangeResult]] = []
    kept = 0
    order = [(at, number, beat) for number, (at, beat) in enumerate(queue)]
    heapq.heapify(order)
    while order:
        at, _, beat = heapq.heappop(order)
        result = fusion.add_beat(beat, at)
        kept = max(kept, fusion.waiting())
        if result is not None:
            results.append((at, result))
    return _row(network, results, [float(r) for r in m.range], begin, kept)


def _row(
    network: Network, results: list[tuple[float, RangeResult]], truth: list[float], begin: float, kept: int
) -> NetworkRow:
    valid = wrong = beyond = resets = 0
    restored = begin + network.last_cut()
    recovery, last = math.inf, -math.inf
    confirmed = False
    for at, result in results:
        useless = result.flags & UNUSABLE
        unknown = bool(result.flags & Flag.UNKNOWN_VELOCITY)
        if useless:
            continue
        paused = abs(result.stamp * 1e-9 - last) > 0.9
        resets += unknown and confirmed and not paused
        confirmed = not unknown
        last = result.stamp * 1e-9
        if unknown or not math.isfinite(result.range) or result.sweep_id < CLEAN:
            continue
        error = abs(result.range - truth[result.sweep_id])
        valid += 1
        wrong += error > WRONG * result.range_std
        beyond += error > result.protection_level
        if at >= restored:
            recovery = min(recovery, at - restored)
    return NetworkRow(network.name, len(truth) - CLEAN, valid, wrong, beyond, resets, recovery, kept)


def network_row(network: Network, sweeps: int, seed: int) -> NetworkRow:
    """Return the sum over distances, speeds and estimators."""
    rows = [
        measure_network(network, distance, estimator, speed, sweeps, seed)
        for distance, estimator, speed in ((60.0, 'ml', 1.5), (300.0, 'ml', 0.0), (900.0, 'hann', 1.5))
    ]
    return NetworkRow(
        network.name,
        sweeps=sum(row.sweeps for row in rows),
        valid=sum(row.valid for row in rows),
        wrong=sum(row.wrong for row in rows),
        beyond=sum(row.beyond for row in rows),
        resets=sum(row.resets for row in rows),
        recovery=max(row.recovery for row in rows),
        kept=max(row.kept for row in rows),
    )


def network_table(rows: Sequence[NetworkRow]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        '| network | sweeps | valid | valid and wrong | beyond protection level | resets of the track '
        '| valid again after the last cut | results kept, at most |',
        '| - | - | - | - | - | - | - | - |',
    ]
    lines += [
        f'| {row.name} | {row.sweeps} | {row.valid / row.sweeps:.1%} | {row.wrong} | {row.beyond} | {row.resets} '
        f'| {row.recovery * 1e3:.0f} ms | {row.kept} |'
        for row in rows
    ]
    return '\n'.join(lines)
