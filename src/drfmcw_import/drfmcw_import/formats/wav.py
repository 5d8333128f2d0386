"""WAV: one channel holds the IF, another one says when each sweep starts."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError, parameter

from .base import Format, Numbers, Source

_SHIFT = {'PCM_S8': 24, 'PCM_U8': 24, 'PCM_16': 16, 'PCM_24': 8, 'PCM_32': 0}
_BLOCK = 1 << 20  # frames read at once
_REGULAR = 0.5  # of the edges that a sync channel has one period after the last one, at least
_TWO_VALUED = 1.35  # kurtosis: a square wave has 1, a sine 1.5, noise 3


@dataclasses.dataclass(frozen=True)
class WavOptions:
    """Options of WAV files."""

    sync_channel: int = parameter(
        -1, bounds=(-2, 63), description='channel that switches with each sweep; -1: found, -2: there is none'
    )
    edge: str = parameter('rising', choices=('rising', 'falling'), description='edge at which a sweep starts')
    channels: list[int] = parameter(
        [], bounds=(0, 63), description='channels of the IF (two for I and Q); empty: all but the sync channel'
    )
    sweep_duration: float = parameter(
        float('nan'),
        unit='s',
        bounds=(1e-6, 1e3),
        nan_means='to the next edge',
        description='how much is cut out after each edge',
    )


class WavFile:
    """Codes of a WAV file, read piece by piece."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            ConfigurationError: it cannot be read.
        """
        import soundfile

        self.path = path
        try:
            self._file = soundfile.SoundFile(str(path))
        except (OSError, RuntimeError) as error:
            raise ConfigurationError(f'{path}: no WAV file ({error})') from None
        self.rate = float(self._file.samplerate)
        self.channels = int(self._file.channels)
        self.frames = int(self._file.frames)
        self.bits = 32 - _SHIFT[self._file.subtype] if self._file.subtype in _SHIFT else 0  # 0: floats

    def read(self, start: int, count: int) -> Numbers:
        """Return codes (floats where the file holds floats), (count, channels)."""
        self._file.seek(start)
        block: Numbers = self._file.read(count, dtype='int32' if self.bits else 'float64', always_2d=True)
        return block >> (32 - self.bits) if self.bits else block

    def blocks(self) -> Iterator[tuple[int, Numbers]]:
        """Yield (first frame, codes) of the whole file."""
        for start in range(0, self.frames, _BLOCK):
            yield start, self.read(start, _BLOCK)


@dataclasses.dataclass(frozen=True)
class CutSweeps:
    """Sweeps cut out of a WAV file: [chirp, sample], or [chirp, sample, channel] for several channels."""

    file: WavFile
    starts: Numbers  # first frame of each sweep
    length: int  # frames
    channels: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of each axis."""
        size = (len(self.starts), self.length)
        return size if len(self.channels) == 1 else (*size, len(self.channels))

    @property
    def dtype(self) -> Any:
        """Type of the numbers."""
        return np.dtype(f'int{32 if self.file.bits > 16 else 16}' if self.file.bits else 'float64')

    def __getitem__(self, key: tuple[slice, ...]) -> Numbers:
        """Return some sweeps; only the first axis is cut before reading."""
        sweeps = [self.file.read(int(s), self.length)[:, list(self.channels)] for s in self.starts[key[0]]]
        block = np.stack(sweeps).astype(self.dtype).reshape(len(sweeps), *self.shape[1:])
        return block[(slice(None), *key[1:])]


def find_sync_channel(file: WavFile) -> int:
    """Return the channel that takes two values, like a square wave.

    Raises:
        ConfigurationError: none does.
    """
    block = file.read(0, _BLOCK).astype(float)
    block -= np.percentile(block, [2, 98], axis=0).mean(axis=0)  # the middle between the levels, whatever their shares
    power = np.maximum(np.mean(block**2, axis=0), 1e-300)
    kurtosis = np.mean(block**4, axis=0) / power**2
    best = int(np.argmin(kurtosis))
    if kurtosis[best] > _TWO_VALUED:
        raise ConfigurationError(
            f'{file.path}: no channel switches between two levels (kurtosis '
            f'{", ".join(f"{k:.2f}" for k in kurtosis)}; a square wave has 1): set options: sync_channel, -2 where '
            'there is none'
        )
    return best


def edges(file: WavFile, channel: int, rising: bool) -> Numbers:
    """Return the instants at which the sync channel crosses its middle, interpolated between samples [samples].

    A crossing counts where the level was beyond a quarter of the swing on the other side since the last one, so that
    noise around the middle makes none.
    """
    low, high = np.inf, -np.inf
    for _, block in file.blocks():
        level = block[:, channel]
        low, high = min(low, float(np.percentile(level, 2))), max(high, float(np.percentile(level, 98)))
    middle, quarter = (low + high) / 2, (high - low) / 4
    found: list[float] = []
    armed, last = False, 0.0
    for start, block in file.blocks():
        level = (block[:, channel] - middle) * (1.0 if rising else -1.0)
        level = np.concatenate([[last], level])
        state = np.where(level > quarter, 1, np.where(level < -quarter, -1, 0))
        marks = np.flatnonzero(state)
        before = np.concatenate([[-1 if armed else 1], state[marks][:-1]]) if len(marks) else np.empty(0)
        for mark in marks[(before < 0) & (state[marks] > 0)]:
            at = mark
            while at > 0 and level[at - 1] >= 0.0:
                at -= 1
            below = level[at - 1] if at > 0 else 0.0
            found.append(start - 1 + at - level[at] / (level[at] - below) if level[at] > below else start - 1 + at)
        if len(marks):
            armed = bool(state[marks[-1]] < 0)
        last = float(level[-1])
    return np.array(found)


def _regular(found: Numbers) -> Numbers:
    """Return which edges come one period after the last one; a pause of the recording is no jitter."""
    apart = np.diff(found)
    period = float(np.median(apart))
    return np.asarray(np.abs(apart - period) < 0.02 * period)


class WavFormat(Format):
    """Sweeps are cut at the edges of the sync channel, at the first sample behind each, and read piece by piece."""

    name = 'wav'
    title = 'WAV `.wav`, with a sync channel'
    suffixes = ('.wav', '.flac')
    options = WavOptions

    def facts(self, paths: Sequence[Path]) -> dict[str, dict[str, Any]]:
        """Return the sampling rate, the bits and the axes."""
        file = WavFile(paths[0])
        signal = self._channels(file)
        axes = ['chirp', 'sample'] if self.chosen.sync_channel > -2 else ['sample']
        stated: dict[str, dict[str, Any]] = {'radar': {'sample_rate': file.rate}, 'layout': {'axes': axes}}
        if len(signal) > 1:
            stated['layout']['axes'] = [*axes, 'iq']
        if file.bits:
            stated['samples'] = {'bits': file.bits}
        return stated

    def _sync(self, file: WavFile) -> int:
        channel = int(self.chosen.sync_channel)
        if channel >= file.channels:
            raise ConfigurationError(f'{file.path}: options: sync_channel = {channel}, but there are {file.channels}')
        return find_sync_channel(file) if channel == -1 else channel

    def _channels(self, file: WavFile) -> tuple[int, ...]:
        sync = self._sync(file)
        chosen = tuple(self.chosen.channels) or tuple(c for c in range(file.channels) if c != sync)
        if not chosen or max(chosen) >= file.channels:
            raise ConfigurationError(f'{file.path}: options: channels = {list(chosen)}, but there are {file.channels}')
        return chosen

    def sources(self, paths: Sequence[Path]) -> Iterator[Source]:
        """Yield each file's sweeps."""
        for path in paths:
            file = WavFile(path)
            sync, channels = self._sync(file), self._channels(file)
            if sync < 0:
                whole = CutSweeps(file, np.zeros(1, int), file.frames, channels)
                yield Source(np.asarray(whole[(slice(None),)][0]), str(path))
                continue
            found = edges(file, sync, self.chosen.edge == 'rising')
            if len(found) < 2:
                raise ConfigurationError(f'{path}: channel {sync} has {len(found)} {self.chosen.edge} edges, no sweeps')
            self._require_regular(file, sync, found)
            period = float(np.median(np.diff(found)))
            length = round(self.chosen.sweep_duration * file.rate) if self.chosen.sweep_duration > 0 else int(period)
            starts = np.ceil(found).astype(int)
            whole_ones = starts + length <= file.frames
            starts, found = starts[whole_ones], found[whole_ones]
            yield Source(
                CutSweeps(file, starts, length, channels),
                str(path),
                (found - found[0]) / file.rate,
                (self._regularity(sync, found, starts, file.rate),),
            )

    def _require_regular(self, file: WavFile, channel: int, found: Numbers) -> None:
        """Refuse a channel whose edges come at any time: it holds no sync signal.

        Raises:
            ConfigurationError: fewer than half of the edges come one period after the last one.
        """
        regular = _regular(found)
        if regular.mean() >= _REGULAR:
            return
        advice = ''
        with contextlib.suppress(ConfigurationError):
            advice = f'; channel {find_sync_channel(file)} switches between two levels'
        raise ConfigurationError(
            f'{file.path}: options: sync_channel = {channel}: only {regular.mean():.0%} of its {len(found)} edges come '
            f'one period after the last one, so it is no sync channel{advice}'
        )

    def _regularity(self, channel: int, found: Numbers, starts: Numbers, rate: float) -> str:
        period = float(np.median(np.diff(found)))
        regular = _regular(found)
        jitter = float(np.std(np.diff(found)[regular]) / np.sqrt(2.0)) if regular.any() else float('nan')
        cut = float(np.std(starts - found))
        pauses = int(np.sum(~regular))
        return (
            f'channel {channel} switches: {len(found)} {self.chosen.edge} edges every {period / rate * 1e3:.4f} ms '
            f'({period:.2f} samples); they jitter by {jitter:.2f} samples, and cutting at whole samples moves sample '
            '0 '
            f'by another {cut:.2f} samples (standard deviations)' + (f'; {pauses} gaps' if pauses else '')
        )
