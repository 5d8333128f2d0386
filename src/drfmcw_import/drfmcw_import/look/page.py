"""A recording on one HTML page that needs nothing else: no network, no scripts, pictures inside."""

import base64
import dataclasses
from pathlib import Path

import jinja2
import numpy as np

from drfmcw_fusion.offline import Replay, replay_recording
from drfmcw_node.estimation import EstimatorSettings
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError

from ..convert.checks import Finding, Statistics, findings
from . import measures, plots
from .sweeps import StationSweeps, read_sweeps

_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader('drfmcw_import.look', 'templates'),
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)


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
    itself = all(d.sweep.hears_itself for d in data)
    warnings = [(s.name, f.sentence) for s in sections for f in s.findings if not f.agrees]
    return _ENVIRONMENT.get_template('view.html').render(
        name=Path(path).resolve().name,
        headline=f'{names}: {"hears itself" if len(data) == 1 and itself else f"{len(data)} stations"}',
        sections=sections,
        warnings=warnings,
        ranges=_ranges(path),
    )


def _uri(png: bytes) -> str:
    return f'data:image/png;base64,{base64.b64encode(png).decode()}'


def _engineering(value: float, unit: tuple[float, str]) -> str:
    return f'{value / unit[0]:.5g} {unit[1]}'


def _hertz(value: float) -> str:
    return _engineering(value, plots.frequency_unit(abs(value)))


def _seconds(value: float) -> str:
    return _engineering(value, plots.time_unit(value))


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
        f'{"rises" if sweep.bandwidth > 0 else "falls"} by {_hertz(abs(sweep.bandwidth))} in {_seconds(sweep.ramp_duration)}; '
        f'{sweep.sample_count} {"I/Q" if data.iq else "real"} samples at {_hertz(sweep.sample_rate)} cover '
        f'{_seconds(sweep.record_duration)}.'
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
    resolution = SPEED_OF_LIGHT / abs(sweep.bandwidth) / (2.0 if sweep.hears_itself else 1.0)
    tiles = [
        Tile('sweeps', str(data.recorded), f'of {_seconds(float(data.time[-1]) or sweep.record_duration)}'),
        Tile('strongest line', _hertz(spectrum.line), f'{spectrum.level:.1f} dBFS, {spectrum.level - spectrum.floor:.0f} dB '
             'above the median of the spectrum'),
        Tile('largest sample', f'{used:.0%}', f'of full scale, {data.full_scale:g} LSB'),
        Tile('resolution', f'{resolution:.3g} m', 'speed of light over ' + ('twice ' if sweep.hears_itself else '')
             + 'the bandwidth'),
    ]  # fmt: skip
    if sweep.hears_itself:
        delay = abs(spectrum.line / sweep.chirp_rate)
        tiles.insert(2, Tile(
            'that line means', f'{delay * 1e9:.5g} ns', f'of delay: a target at {delay * SPEED_OF_LIGHT / 2:.4g} m in air',
        ))  # fmt: skip
    return tuple(tiles)


def _checked(data: StationSweeps) -> list[Finding]:
    statistics = Statistics()
    statistics.add(data.samples)
    return findings(statistics, data.sweep, data.full_scale, 0.0)


def _panels(data: StationSweeps, run: slice, spectrum: measures.Spectrum) -> list[Panel]:
    count = run.stop - run.start
    which = f'sweeps {run.start} to {run.stop - 1}' if count > 1 else f'sweep {run.start}'
    several = count < len(data.samples)
    sweep = data.sweep
    whole = len(data.samples)
    look = 'Curves that drift from sweep to sweep move; what stands upright repeats with the ramp.' if whole > 2 else (
        'One curve per sweep.'
    )  # fmt: skip
    panels = [
        Panel('IF over ramp time and sweep', f'{"The I part of each" if data.iq else "Each"} sweep as the ADC gave it. {look}',
              _uri(plots.samples(data))),
        Panel('Spectrogram', f'Short-time spectra over ramp time, averaged over {which}. A straight ramp and a fixed delay '
              'give horizontal lines; a bent ramp bends all of them in proportion to their delays.',
              _uri(plots.spectrogram(*measures.spectrogram(data, run), sweep.record_duration))),
        Panel('Averaged spectrum', _spectrum_note(data, which, several),
              _uri(plots.spectrum(spectrum, measures.marks(spectrum, sweep, data.iq), several))),
    ]  # fmt: skip
    course = measures.ramp_course(data, run, spectrum.line)
    title = 'Beat frequency over ramp time'
    if course is None:
        panels.append(Panel(title, 'The strongest line makes fewer than four turns in a sweep: too few to follow it.'))
    else:
        wander = float(np.std(course.frequency)) / abs(course.straight)
        panels.append(Panel(
            title, f'The strongest line followed along the ramp over {which} (filtered over {_seconds(course.width)}). '
            f'It wanders by {wander:.2%} rms about the straight line that the nominal ramp predicts; other lines within '
            f'{_hertz(1.0 / course.width)} add ripple.',
            _uri(plots.course(course, sweep.record_duration)),
        ))  # fmt: skip
    total, line = measures.sweep_powers(data)
    panels += [
        Panel('Codes of the ADC', 'How often each code occurs. Peaks at the ends mean limiting, gaps mean missing codes or '
              'scaled samples. Dashed: full scale, where it is within the picture.', _uri(plots.histogram(data))),
        Panel('Power over sweeps', 'Power of each sweep without its mean, and of its strongest line; a sine at full scale '
              'has 0 dBFS.', _uri(plots.power(data, total, line))),
    ]  # fmt: skip
    return panels


def _spectrum_note(data: StationSweeps, which: str, several: bool) -> str:
    image = ', "image" where an I/Q imbalance would mirror it' if data.iq else ''
    text = (
        f'Hann window. Dark: mean over {which}, in which the strongest line keeps its position'
        f'{"; pale: mean over all sweeps" if several else ""}. Marked: 0 Hz, Nyquist, the strongest line{image}, '
        '2× and 3× its harmonics (folded where they pass Nyquist). Dotted: median.'
    )
    return text


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
    reference = replay.reference.of('/'.join(pair))
    time = (stamps - stamps[0]) * 1e-9
    at = (reference.stamps - stamps[0]) * 1e-9
    note = (
        f'Estimator `ml`, each sweep by itself, calibration and weather applied as far as recorded: {int(finite.sum())} of '
        f'{len(own)} sweeps, median {np.median(distance[finite]):.4f} m, median stated standard deviation '
        f'{np.median(std[finite]) * 1e3:.3g} mm. It takes the strongest line for the target and the ramp for straight.'
    )
    return Panel(
        f'Range over time: {name}', note,
        _uri(plots.ranges(time[finite], distance[finite], std[finite], (at, reference.ranges))),
    )  # fmt: skip
