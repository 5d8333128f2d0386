"""A recording on one HTML page that needs nothing else: no network, no scripts, pictures inside."""

import base64
import dataclasses
from pathlib import Path

import numpy as np

from drfmcw_fusion.offline import Replay, replay_recording
from drfmcw_fusion.replayed.statistics import reference_at
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.pages import templates

from ..convert.checks import Statistics, findings
from ..convert.finding import Finding
from . import measures, plots
from .sweeps import StationSweeps, read_sweeps

_TEMPLATES = templates('drfmcw_import.look')


@dataclasses.dataclass(frozen=True)
class Tile:
    """A figure that is seen first."""

    name: str
    value: str
    note: str


@dataclasses.dataclass(frozen=True)
class Panel:
    """A picture and what it shows; a panel without a picture says why there is none."""

    title: str
    note: str
    image: str = ''  # data URI


@dataclasses.dataclass(frozen=True)
class Section:
    """One station."""

    name: str
    summary: str
    tiles: tuple[Tile, ...]
    findings: tuple[Finding, ...]
    panels: tuple[Panel, ...]


def render(path: Path | str) -> str:
    """Return the page of a recording.

    Raises:
        ConfigurationError: it cannot be read, or lacks samples or settings.
    """
    data = read_sweeps(path)
    sections = tuple(map(_section, data))
    names = ' and '.join(s.name for s in sections)
    itself = ', which hears itself' if len(data) == 1 and data[0].sweep.hears_itself else ''
    warnings = [(s.name, f.sentence) for s in sections for f in s.findings if not f.agrees]
    return _TEMPLATES.get_template('view.html').render(
        name=Path(path).resolve().name,
        headline=f'Station{"s" if len(data) > 1 else ""} {names}{itself}',
        sections=sections,
        warnings=warnings,
        ranges=_ranges(path),
    )


def _uri(png: bytes) -> str:
    return f'data:image/png;base64,{base64.b64encode(png).decode()}'


def _hertz(value: float, digits: int = 5) -> str:
    factor, unit = plots.frequency_unit(abs(value))
    return f'{value / factor:.{digits}g} {unit}'


def _seconds(value: float, digits: int = 5) -> str:
    factor, unit = plots.time_unit(value)
    return f'{value / factor:.{digits}g} {unit}'


def _section(data: StationSweeps) -> Section:
    run = measures.still_run(data)
    spectrum = measures.averaged(data, run)
    return Section(
        data.sweep.station,
        _summary(data),
        _tiles(data, spectrum),
        tuple(_checked(data)),
        tuple(_panels(data, run, spectrum)),
    )


def _summary(data: StationSweeps) -> str:
    sweep = data.sweep
    peer = 'its own signal' if sweep.hears_itself else f"station '{sweep.peer}'"
    text = (
        f'Listens to {peer}. The ramp starts at {sweep.start_frequency / 1e9:.6g} GHz and '
        f'{"rises" if sweep.bandwidth > 0 else "falls"} by {_hertz(abs(sweep.bandwidth))} in '
        f'{_seconds(sweep.ramp_duration)}; {sweep.sample_count} {"I/Q" if data.iq else "real"} samples at '
        f'{_hertz(sweep.sample_rate)} cover {_seconds(sweep.record_duration)}.'
    )
    if data.settings > 1:
        text += (
            f' The recording holds {data.settings} settings; {data.of_setting} of {data.read} sweeps have this one, '
            'the others are left out here.'
        )
    if data.read < data.recorded:
        text += f' Every {round(data.recorded / data.read)}th sweep is shown.'
    return text


def _tiles(data: StationSweeps, spectrum: measures.Spectrum) -> tuple[Tile, ...]:
    sweep = data.sweep
    used = max(abs(int(data.samples.min())), abs(int(data.samples.max()))) / data.full_scale
    snr = spectrum.level - spectrum.floor
    resolution = SPEED_OF_LIGHT / abs(sweep.bandwidth)
    tiles = [
        Tile('sweeps', str(data.recorded), f'of {_seconds(float(data.time[-1]) or sweep.record_duration)}'),
        Tile('strongest line', _hertz(spectrum.line), f'{spectrum.level:.1f} dBFS, {snr:.0f} dB above the median')
        if spectrum.has_line
        else Tile('strongest line', 'none', 'the samples hold one value'),
        Tile('largest sample', f'{used:.0%}', f'of full scale, {data.full_scale:g} LSB'),
        Tile('resolution', f'{resolution:.3g} m', 'of path: speed of light over the bandwidth'),
    ]
    if sweep.hears_itself and spectrum.has_line:
        delay = abs(spectrum.line / sweep.chirp_rate)
        tiles.insert(
            2,
            Tile(
                'delay of that line',
                f'{delay * 1e9:.5g} ns',
                f'{delay * SPEED_OF_LIGHT:.4g} m of path in air, a target at half of it',
            ),
        )
    return tuple(tiles)


def _checked(data: StationSweeps) -> list[Finding]:
    statistics = Statistics()
    statistics.add(data.samples)
    return findings(statistics, data.sweep, data.full_scale)


def _panels(data: StationSweeps, run: slice, spectrum: measures.Spectrum) -> list[Panel]:
    several = run.stop - run.start < len(data.samples)
    which = _which(run, len(data.samples))
    sweep = data.sweep
    low = plots.is_low(spectrum.line, sweep.sample_rate / 2)
    pictures = [measures.spectrogram(data, run)]
    if low:
        pictures.append(measures.spectrogram(data, run, 3.0 / abs(spectrum.line)))
    beside = ' Right: low frequencies, with a longer window.' if low else ''
    over_ramp = (
        f'Short-time spectra over ramp time{which}. A straight ramp and a fixed delay give horizontal lines; a bent '
        f'ramp bends all of them in proportion to their delays.{beside}'
    )
    codes = (
        'How often each code occurs. Peaks at the ends mean limiting, gaps mean missing codes or scaled samples. '
        'Dashed: full scale, where it is within the picture.'
    )
    marks = measures.marks(spectrum, sweep, data.iq)
    panels = [
        Panel('IF over ramp time and sweep', _samples_note(data), _uri(plots.samples(data, spectrum.line))),
        Panel('Spectrogram', over_ramp, _uri(plots.spectrogram(pictures, sweep.record_duration, spectrum.line))),
        Panel(
            'Averaged spectrum',
            _spectrum_note(data, which, several, low),
            _uri(plots.spectrum(spectrum, marks, several)),
        ),
        _course_panel(data, run, spectrum.line, which),
        Panel('Codes of the ADC', codes, _uri(plots.histogram(data))),
    ]
    total, line = measures.sweep_powers(data)
    note = 'Power of each sweep without its mean, and of its strongest line; a sine at full scale has 0 dBFS.'
    if len(total) > 2:
        panels.append(Panel('Power over sweeps', note, _uri(plots.power(data, total, line))))
    else:
        panels.append(Panel('Power', f'{note} Here: {total[0]:.2f} dBFS, {line[0]:.2f} dBFS.'))
    return panels


def _which(run: slice, count: int) -> str:
    if count == 1:
        return ''
    return (
        f', averaged over sweeps {run.start} to {run.stop - 1}'
        if run.stop - run.start > 1
        else f' of sweep {run.start}'
    )


def _samples_note(data: StationSweeps) -> str:
    part = 'The I part of each sweep' if data.iq else 'Each sweep'
    if len(data.samples) < 3:
        return f'{part} as the ADC gave it.'
    return (
        f'{part} as the ADC gave it. What stands upright repeats with the ramp; what leans moves from sweep to sweep.'
    )


def _course_panel(data: StationSweeps, run: slice, line: float, which: str) -> Panel:
    title = 'Beat frequency over ramp time'
    course = measures.ramp_course(data, run, line)
    if line == 0.0:
        return Panel(title, 'There is no line to follow.')
    if course is None:
        return Panel(title, 'The strongest line makes fewer than four turns in a sweep: too few to follow it.')
    wander = float(np.std(course.frequency)) / abs(course.straight)
    note = (
        f'The strongest line followed along the ramp{which} (filtered over {_seconds(course.width, 3)}). It wanders '
        f'by {wander:.2g} of its frequency (rms) about the straight line that the nominal ramp predicts. Other lines '
        f'within {_hertz(1.0 / course.width, 3)} add ripple, and where the line fades its frequency jumps.'
    )
    return Panel(title, note, _uri(plots.course(course, data.sweep.record_duration)))


def _spectrum_note(data: StationSweeps, which: str, several: bool, low: bool) -> str:
    image = ', its image (where an I/Q imbalance would mirror it)' if data.iq else ''
    rest = ', in which the strongest line keeps its position; pale: all sweeps' if several else ''
    return (
        f'Hann window{which}{rest}. Marked: 0 Hz, Nyquist, the strongest line{image}, and 2× and 3×, its harmonics, '
        f'folded where they pass Nyquist. Dotted: median.{" Right: low frequencies enlarged." if low else ""}'
    )


def _ranges(path: Path | str) -> list[Panel]:
    """Return a panel for each pair of stations; a sentence where no range comes out."""
    title = 'Range over time'
    try:
        replay = replay_recording(str(path), EstimatorSettings(estimator='ml'))
    except ConfigurationError as error:
        return [Panel(title, f'No ranges: {error}.')]
    pairs = sorted({(r.first_station, r.second_station) for r in replay.results})
    if not pairs:
        return [Panel(title, f'No ranges from {replay.sweeps} sweeps: {"; ".join(replay.dropped) or "no line found"}.')]
    return [_range_panel(replay, pair) for pair in pairs]


def _range_panel(replay: Replay, pair: tuple[str, str]) -> Panel:
    own = [r for r in replay.results if (r.first_station, r.second_station) == pair]
    name = '/'.join(dict.fromkeys(pair))
    stamps = np.array([r.stamp for r in own], np.int64)
    distance = np.array([r.range for r in own])
    std = np.array([r.range_std for r in own])
    finite = np.isfinite(distance)
    if not finite.any():
        return Panel(f'Range over time: {name}', f'None of {len(own)} sweeps gave a range.')
    std = np.where(np.isfinite(std), std, 0.0)
    reference = reference_at(replay.reference.of('/'.join(pair)), stamps)
    time = (stamps - stamps[0]) * 1e-9
    note = (
        'Maximum-likelihood estimator, each sweep by itself, calibration and weather applied as far as recorded: '
        f'{int(finite.sum())} of {len(own)} sweeps, median {np.median(distance[finite]):.4f} m, median stated '
        f'standard deviation {np.median(std[finite]) * 1e3:.3g} mm. It takes the strongest line for the target and '
        'the ramp for straight.'
    )
    if pair[0] == pair[1]:
        note += ' A station that hears itself measures the whole path: a target stands at half of it.'
    if finite.sum() < 3:
        return Panel(f'Range: {name}', note)
    return Panel(
        f'Range over time: {name}',
        note,
        _uri(plots.ranges(time[finite], distance[finite], std[finite], reference[finite])),
    )
