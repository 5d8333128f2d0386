"""ApRES .dat: bursts of a text header and 16-bit numbers (British Antarctic Survey, RMB2 and later)."""

import dataclasses
import datetime
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from .base import Format, Numbers, Source

_BEGIN, _END = b'*** Burst Header ***', b'*** End Header ***'
_LONGEST = 1 << 16  # bytes of a header


@dataclasses.dataclass(frozen=True)
class ApresOptions:
    """The headers state everything."""


@dataclasses.dataclass(frozen=True)
class Burst:
    """One burst: its header, and where its numbers stand."""

    header: dict[str, str]
    offset: int  # of the first number [B]

    def value(self, *names: str, default: float = np.nan) -> float:
        """Return the first of some keys that the header has; lists give their first number."""
        for name in names:
            match = re.match(r'\s*([-+\d.eE]+)', self.header.get(name.lower(), ''))
            if match:
                return float(match.group(1))
        return default

    def count(self, name: str) -> int:
        """Return how many of a list of switches ('1,0,0,...') are on; 1 where the header has no such list."""
        switches = self.header.get(name.lower(), '1').split(',')
        return max(1, sum(s.strip() == '1' for s in switches))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(chirps, settings that alternate: antennas times attenuators, samples)."""
        settings = self.count('TxAnt') * self.count('RxAnt') * int(self.value('nAttenuators', default=1))
        return (
            int(self.value('NSubBursts', 'SubBursts in burst')),
            settings,
            int(self.value('N_ADC_SAMPLES', 'Samples')),
        )


def read_bursts(path: Path) -> list[Burst]:
    """Return the bursts of a file.

    Raises:
        ConfigurationError: it cannot be read, is truncated or no ApRES file, or its samples are averages.
    """
    bursts: list[Burst] = []
    try:
        size = path.stat().st_size
        with open(path, 'rb') as file:
            position = 0
            while position < size:
                file.seek(position)
                head = file.read(_LONGEST)
                begin, end = head.find(_BEGIN), head.find(_END)
                if begin < 0 or end < 0:
                    if bursts and not head.strip(b'\r\n \0'):
                        break
                    raise ConfigurationError(f'{path}: no burst header at byte {position}')
                text = head[begin + len(_BEGIN) : end].decode('latin-1')
                pairs = (re.split(r'[=:]', line, maxsplit=1) for line in text.splitlines())
                header = {pair[0].strip().lower(): pair[1].strip() for pair in pairs if len(pair) == 2}
                end += len(_END)
                end += len(head[end : end + 2]) - len(head[end : end + 2].lstrip(b'\r\n'))
                burst = Burst(header, position + end)
                if burst.value('Average', default=0):
                    raise ConfigurationError(
                        f'{path}: the radar stored averages of chirps (Average=1 or 2), not chirps'
                    )
                if not all(
                    np.isfinite([burst.value('NSubBursts', 'SubBursts in burst'), burst.value('N_ADC_SAMPLES')])
                ):
                    raise ConfigurationError(f'{path}: its header lacks NSubBursts or N_ADC_SAMPLES')
                position = burst.offset + 2 * int(np.prod(burst.shape))
                if position > size:
                    raise ConfigurationError(f'{path}: truncated in burst {len(bursts)}')
                bursts.append(burst)
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None
    return bursts


def _start_time(stated: str) -> str:
    for pattern in ('%Y-%m-%d %H:%M:%S', '%Y/%m/%d %H:%M:%S'):
        try:
            return datetime.datetime.strptime(stated, pattern).isoformat()
        except ValueError:
            continue
    return ''


@dataclasses.dataclass(frozen=True)
class Bursts:
    """All bursts of a file as one array [frame, chirp, transmitter, sample]."""

    path: Path
    bursts: tuple[Burst, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of each axis."""
        return (len(self.bursts), *self.bursts[0].shape)

    @property
    def dtype(self) -> Any:
        """Type of the numbers."""
        return np.dtype('<u2')

    def __getitem__(self, key: tuple[slice, ...]) -> Numbers:
        """Return a part, reading nothing else."""
        parts = [np.memmap(self.path, self.dtype, 'r', b.offset, b.shape)[key[1:]] for b in self.bursts[key[0]]]
        return np.stack(parts)


class ApresFormat(Format):
    """Sweep, rate and time come from the header; attenuator and antenna settings take turns as `transmitter`."""

    name = 'apres'
    title = 'ApRES `.dat`'
    suffixes = ('.dat',)
    options = ApresOptions

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return what the first burst's header states."""
        first = read_bursts(paths[0])[0]
        rate = 80e3 if first.value('SamplingFreqMode', default=0) == 1 else 40e3
        start, stop = first.value('StartFreq', default=200e6), first.value('StopFreq', default=400e6)
        radar: dict[str, Any] = {
            'start_frequency': start,
            'bandwidth': abs(stop - start),
            'ramp': 'up' if stop > start else 'down',
            'ramp_duration': first.value('Period', default=1.0),
            'sample_rate': rate,
        }
        if _start_time(first.header.get('time stamp', '')):
            radar['start_time'] = _start_time(first.header['time stamp'])
        return {
            'radar': radar,
            'samples': {'bits': 16, 'coding': 'offset_binary'},
            'layout': {'axes': ['frame', 'chirp', 'transmitter', 'sample']},
        }

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's bursts."""
        for path in paths:
            bursts = read_bursts(path)
            if len({b.shape for b in bursts}) > 1:
                raise ConfigurationError(f'{path}: its bursts differ in size: {sorted({b.shape for b in bursts})}')
            settings = bursts[0].shape[1]
            notes = (
                (f'each chirp was taken with {settings} settings; layout: transmitter chooses one',)
                if settings > 1
                else ()
            )
            yield Source(Bursts(path, tuple(bursts)), str(path), notes=notes)
