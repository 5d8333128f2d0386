"""Writing imported sweeps as a recording."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError, from_mapping, read_yaml
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagWriter, typestore
from drfmcw_ros.graph.messages import ImplausibleError, check
from drfmcw_ros.graph.topics import STATION_TOPICS

from ..formats.base import Format, Numbers, Source, choose_format
from .checks import Statistics, findings
from .codes import Coder, coder
from .finding import Finding
from .layout import Layout, lay_out, sample_slice, split_triangle, sweep_times
from .settings import ImportSettings, filled

_SECOND = 1_000_000_000


@dataclasses.dataclass(frozen=True)
class Imported:
    """What was written."""

    sweeps: int  # of each station
    settings: tuple[SweepSettings, ...]  # of each station
    iq: bool
    notes: tuple[str, ...]  # what was found in the files and assumed
    findings: tuple[tuple[Finding, ...], ...]  # of each station


def read_settings(path: Path | str, files: Sequence[Path]) -> tuple[ImportSettings, Format, list[str]]:
    """Return settings, format with its options, and what the files themselves stated.

    Raises:
        ConfigurationError: unknown key, wrong or missing value, unknown format, or an unreadable file.
    """
    given = read_yaml(path)
    name = given.get('format', '')
    kind = choose_format(name if isinstance(name, str) else str(name), files)
    options = from_mapping(kind.options, given.get('options'), f'{path}: options')
    chosen = kind(options)
    try:
        whole, notes = filled(given, chosen.facts(files))
        settings: ImportSettings = from_mapping(ImportSettings, whole, str(path))
    except ConfigurationError as error:
        text = str(error)
        raise ConfigurationError(
            text if text.startswith((str(path), *map(str, files))) else f'{path}: {text}'
        ) from None
    return settings, chosen, notes


class Importer:
    """Converts files into one recording."""

    def __init__(self, settings: ImportSettings, kind: Format) -> None:
        """Take validated settings and the format with its options."""
        self._settings, self._format = settings, kind
        self._ramps = 2 if settings.radar.ramp == 'triangle' else 1
        self._sweeps: list[SweepSettings] = []
        self._statistics = [Statistics() for _ in range(self._ramps)]
        self._coder: Coder | None = None
        self._iq: bool | None = None
        self._count = 0
        self._notes: list[str] = []
        self._contradictions: list[Finding] = []

    def run(
        self,
        files: Sequence[Path],
        out: Path | str,
        storage: str = 'mcap',
        overwrite: bool = False,
        progress: Callable[[int], None] | None = None,
    ) -> Imported:
        """Write the recording; `progress` is called with the number of sweeps so far.

        Raises:
            ConfigurationError: files, settings and data do not fit, or the recording cannot be written.
        """
        stated = self._format.sizes(files)
        with BagWriter(out, storage, overwrite) as bag:
            begin = 0.0
            for source in self._format.sources(files):
                begin = self._take(source, stated, bag, begin, progress)
            if not self._count:
                raise ConfigurationError(f'{files[0]}: holds no sweeps')
            assert self._coder is not None
            checked = tuple(
                (*self._contradictions, *findings(s, w, self._coder.full_scale, self._coder))
                for s, w in zip(self._statistics, self._sweeps, strict=True)
            )
            return Imported(self._count, tuple(self._sweeps), bool(self._iq), tuple(self._notes), checked)

    def _take(
        self,
        source: Source,
        stated: dict[str, int],
        bag: BagWriter,
        begin: float,
        progress: Callable[[int], None] | None,
    ) -> float:
        """Write one file's sweeps, which begin at `begin` [s]; return when the next file's do.

        `stated` is how many of each axis the files state beside their numbers.
        """
        layout = lay_out(source, self._settings.layout)
        sizes = layout.sizes
        if contradiction := contradicted(layout, stated):
            self._contradictions.append(contradiction)
        radar = self._settings.radar
        times = source.times
        if times is None:
            times = sweep_times(sizes['frame'], sizes['chirp'], radar.period(), radar.frame_time)
        self._note(source, layout)
        if self._coder is None:
            self._coder = coder(self._settings.samples, layout.array.dtype)
            if self._coder.shift:
                self._notes.append(
                    f'the lowest {self._coder.shift} of {self._coder.bits} bits are left out: samples have 16'
                )
        done = 0
        for block in layout.blocks():
            codes = self._chosen(self._coder, block, source.name)
            self._start(codes, bag, source.name)
            self._write(codes, bag, begin + times[done : done + len(codes)])
            done += len(codes)
            if progress is not None:
                progress(self._count)
        last = float(times[-1]) + radar.period()
        return begin + max(last, sizes['frame'] * radar.frame_time if np.isfinite(radar.frame_time) else last)

    def _note(self, source: Source, layout: Layout) -> None:
        sizes = ', '.join(f'{n} {a}' for a, n in zip(layout.axes, layout.array.shape, strict=True))
        self._notes.append(f'{source.name}: {layout.array.dtype} numbers, {sizes}')
        self._notes.extend(source.notes)

    def _chosen(self, code: Coder, block: Numbers, name: str) -> Numbers:
        """Return int16 codes of the receiver chosen, (sweeps, ramps, samples, iq)."""
        chosen = self._settings.layout
        block = block[:, chosen.transmitter]
        if chosen.average:
            codes = np.rint(code.codes(block, name).astype(float).mean(axis=2)).astype(np.int16)
        else:
            codes = code.codes(block[:, :, chosen.receiver], name)
        codes = split_triangle(codes, self._ramps)
        if codes.shape[1] != self._ramps:
            raise ConfigurationError(f'{name}: layout: has an axis ramp, but radar: ramp is not triangle')
        if codes.shape[-1] == 2 and chosen.swap_iq:
            codes = codes[..., ::-1]
        kept: Numbers = codes[:, :, sample_slice(chosen, codes.shape[2], name)]
        return kept

    def _start(self, codes: Numbers, bag: BagWriter, name: str) -> None:
        """Write settings and calibration before the first sweep; refuse files of different sweeps."""
        count, iq = codes.shape[2], codes.shape[3] == 2
        if self._sweeps:
            if (count, iq) != (self._sweeps[0].sample_count, self._iq):
                raise ConfigurationError(
                    f'{name}: its sweeps have {count} samples, those before {self._sweeps[0].sample_count}'
                )
            return
        if count < 16:
            raise ConfigurationError(
                f'{name}: sweeps of {count} samples are too short, at least 16 are needed: check layout'
            )
        self._iq = iq
        radar = self._settings.radar
        skipped = self._settings.layout.skip_samples / radar.sample_rate
        if radar.first_sample + skipped >= radar.ramp_duration:
            raise ConfigurationError(f'{name}: layout: skip_samples leaves nothing of the ramp')
        self._sweeps = dataclasses.replace(radar, first_sample=radar.first_sample + skipped).sweeps(count)
        for sweep in self._sweeps:
            calibration = Calibration(sweep.station, delay=radar.delay, stamp=radar.start, frame_id=sweep.station)
            for topic, content in (('sweep_config', sweep), ('calibration', calibration)):
                kind = STATION_TOPICS[topic]
                message = as_rosbags(content, kind)
                try:
                    check(message)
                except ImplausibleError as error:
                    raise ConfigurationError(f'{name}: {error}') from None
                bag.write(f'/{sweep.station}/{topic}', kind, radar.start, message)

    def _write(self, codes: Numbers, bag: BagWriter, times: Numbers) -> None:
        assert self._coder is not None
        kind, types = STATION_TOPICS['if_samples'], typestore().types
        start = self._settings.radar.start
        later = [0.0, self._settings.radar.ramp_duration][: self._ramps]
        for ramp, statistics in enumerate(self._statistics):
            statistics.add(codes[:, ramp])
        for row, time in zip(codes, times, strict=True):
            for ramp, sweep in enumerate(self._sweeps):
                stamp = start + round((float(time) + later[ramp]) * _SECOND)
                message = types[kind](
                    header=_header(stamp, sweep.station),
                    station=sweep.station,
                    peer=sweep.peer,
                    sweep_id=self._count,
                    full_scale=self._coder.full_scale,
                    iq=bool(self._iq),
                    samples=np.ascontiguousarray(row[ramp]).reshape(-1),
                )
                bag.write(f'/{sweep.station}/if_samples', kind, stamp, message)
            self._count += 1


def contradicted(layout: Layout, stated: dict[str, int]) -> Finding | None:
    """Return the warning where a file states other sizes than its axes have, {axis: size}, None where it does not."""
    sizes = layout.sizes
    other = {axis: size for axis, size in stated.items() if sizes[axis] != size}
    if not other:
        return None
    have, should = (', '.join(f'{values[a]} {a}s' for a in other) for values in (sizes, stated))
    return Finding(False, f'{layout.name}: its axes have {have}, but the settings beside it state {should}: check axes')


def _header(stamp: int, frame: str) -> Any:
    types = typestore().types
    seconds, nanoseconds = divmod(stamp, _SECOND)
    time = types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=nanoseconds)
    return types['std_msgs/msg/Header'](stamp=time, frame_id=frame)


def as_rosbags(content: Any, kind: str) -> Any:
    """Return a dataclass with a message's fields, stamp and frame_id as message of rosbags."""
    cls: Any = typestore().types[kind]
    names = {f.name for f in dataclasses.fields(cls)} & {f.name for f in dataclasses.fields(content)}
    return cls(header=_header(content.stamp, content.frame_id), **{name: getattr(content, name) for name in names})
