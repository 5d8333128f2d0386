"""`calibrate station NAME`: readings and recordings of one station on the bench become its calibration document."""

import argparse
import csv
import dataclasses
import io
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_node.sources.recording import recorded_frames
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.calibration.document import Document, implausible, read_document
from drfmcw_ros.calibration.store import CalibrationStore, state_directory
from drfmcw_ros.commands.cli import write_atomically

from ..recordings import read_ranges
from .counter import COMMAND, Counter, read_counter
from .curve import SHAPES, Curve, fit
from .noise import receiver_noise
from .oscillator import oscillator_noise
from .path import KnownPath, path_calibration
from .readings import CLOCKS, Reading, deviations, read_csv, typed
from .report import (
    clock_sentence,
    noise_sentence,
    oscillator_sentence,
    path_sentences,
    response_sentence,
    write_plot,
)
from .response import line_response
from .station import with_clocks, with_noise, with_oscillator, with_path

_MOST_SWEEPS = 200  # for phase noise, which more would not improve
_STD_OF = {'cable': 'length_std', 'baseline': 'length_std', 'delay': 'delay_std'}  # options that state a path


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    summary = 'calibrate one station indoors: clocks, noise floor, delay'
    parser = commands.add_parser('station', help=summary, description=__doc__)
    parser.add_argument('station', metavar='NAME', help='name of the station')
    add_damage_option(parser)
    clocks = parser.add_argument_group('clocks: readings of a frequency counter')
    clocks.add_argument(
        '--reading', action='append', default=[], metavar='CLOCK:HZ@DEGC',
        help='one reading, as reference:100.0037e6@25 or adc:2.0480184e6@25 (repeatable)',
    )  # fmt: skip
    clocks.add_argument('--csv', metavar='FILE', help='readings: columns clock, frequency, temperature, perhaps std')
    clocks.add_argument('--counter', metavar='ADDRESS', help='read a counter: HOST:PORT or a VISA resource name')
    clocks.add_argument('--scpi', default=COMMAND, metavar='QUERY', help=f"the counter's query ({COMMAND})")
    clocks.add_argument('--reference-input', type=int, default=1, metavar='N', help="reference's input of the counter")
    clocks.add_argument('--adc-input', type=int, default=2, metavar='N', help="ADC clock's input; 0: not connected")
    clocks.add_argument('--count', type=int, default=10, metavar='N', help='readings of the counter to average (10)')
    clocks.add_argument('--keep', metavar='FILE', help="append the counter's readings to a CSV file and end there")
    clocks.add_argument('--temperature', type=float, default=25.0, metavar='DEGC', help='of the board, now (25)')
    clocks.add_argument('--reference-nominal', type=float, default=100e6, metavar='HZ', help='nominal (100e6)')
    clocks.add_argument('--adc-nominal', type=float, default=2.048e6, metavar='HZ', help='nominal (2.048e6)')
    clocks.add_argument('--reading-std', type=float, default=0.02, metavar='PPM', help='of one reading (0.02)')
    clocks.add_argument('--time-base-std', type=float, default=0.02, metavar='PPM', help="of the counter's own (0.02)")
    clocks.add_argument('--shape', choices=('auto', *SHAPES), default='auto', help='of the curve over temperature')
    clocks.add_argument('--plot', metavar='FILE', help='plot readings, curves and residuals')
    sweeps = parser.add_argument_group('recordings')
    sweeps.add_argument('--terminated', metavar='RECORDING', help='antennas terminated: noise floor, IF response')
    sweeps.add_argument(
        '--path', action='append', default=[], metavar='RECORDING',
        help='through a cable or over a known baseline: delay, T_off, phase noise; several temperatures give the '
        'slope, several T_off the IF response (repeatable)',
    )  # fmt: skip
    sweeps.add_argument('--cable', type=float, metavar='M', help='length of the cable')
    sweeps.add_argument('--velocity-factor', type=float, default=1.0, metavar='X', help='of the cable (1: electrical)')
    sweeps.add_argument('--baseline', type=float, metavar='M', help='distance between the antennas')
    sweeps.add_argument('--length-std', type=float, metavar='M', help='standard deviation of the length')
    sweeps.add_argument('--delay', type=float, metavar='S', help='of the path, instead of a length')
    sweeps.add_argument('--delay-std', type=float, metavar='S', help='its standard deviation')
    sweeps.add_argument('--with', dest='peer', metavar='FILE', help="the peer's calibration (stored, else recorded)")
    result = parser.add_argument_group('result')
    result.add_argument('--from', dest='base', metavar='FILE', help='document to complete (the stored one, if any)')
    result.add_argument('--out', metavar='FILE', help='document to write (NAME.calibration.yaml)')
    result.add_argument('--store', action='store_true', help='store it in the state directory too')
    result.add_argument('--state', default='', metavar='DIR', help='state directory (the one of this user)')
    for name, meaning in (('operator', 'who calibrates'), ('instrument', 'with what'), ('note', 'kept with it')):
        result.add_argument(f'--{name}', default='', metavar='TEXT', help=meaning)
    parser.set_defaults(work=_run)


def _run(arguments: argparse.Namespace) -> None:
    _check(arguments)
    store = CalibrationStore(state_directory(os.environ, arguments.state))
    document = _base(arguments, store)
    said: list[str] = []
    readings, instrument = _readings(arguments)
    if arguments.keep:
        _keep(arguments.keep, readings)
        print(f'{arguments.keep}: {len(readings)} readings more, at {arguments.temperature:g} degC')
        return
    if readings:
        curves = _curves(readings, arguments)
        document = with_clocks(document, curves)
        said += [clock_sentence(name, curve) for name, curve in curves.items()]
        if arguments.plot:
            write_plot(curves, f'{arguments.station}: clocks', arguments.plot)
    if arguments.terminated:
        settings, frames = recorded_frames(arguments.terminated, arguments.station)
        found = receiver_noise(settings, [sweep for sweep, _ in frames])
        document = with_noise(document, found)
        said.append(noise_sentence(found))
    if arguments.path:
        document, lines = _over_path(document, arguments, store)
        said += lines
    if not said:
        raise ConfigurationError('nothing to calibrate: give --reading, --csv, --counter, --terminated or --path')
    texts = {'operator': arguments.operator, 'instrument': arguments.instrument or instrument, 'note': arguments.note}
    document = dataclasses.replace(document, **{name: text for name, text in texts.items() if text})
    refusal = implausible(document)
    if refusal:
        raise ConfigurationError(f'the result is implausible: {refusal}')
    out = arguments.out or f'{arguments.station}.calibration.yaml'
    if arguments.store:
        document = store.add(document)
    write_atomically(out, document.text())
    print('\n'.join(f'{arguments.station}, {line}' if line[0].islower() else f'  {line}' for line in said))
    print(f'{out}: written' + (f', stored as version {document.version}' if arguments.store else ''))


def _check(arguments: argparse.Namespace) -> None:
    if arguments.path:
        _check_path(arguments)
    if arguments.count < 1:
        raise ConfigurationError(f'--count {arguments.count}: at least 1')
    for name in ('reading_std', 'time_base_std'):
        if not getattr(arguments, name) >= 0.0:
            raise ConfigurationError(f'--{name.replace("_", "-")} {getattr(arguments, name):g}: not below 0')
    if not arguments.reading_std > 0.0:
        raise ConfigurationError('--reading-std 0: a reading without any uncertainty cannot be weighed')
    if arguments.keep and not arguments.counter:
        raise ConfigurationError("--keep keeps a counter's readings: give --counter")


def _check_path(arguments: argparse.Namespace) -> None:
    known = [name for name in _STD_OF if getattr(arguments, name) is not None]
    stds = [name for name in sorted(set(_STD_OF.values())) if getattr(arguments, name) is not None]
    if len(known) != 1 or stds != [_STD_OF[known[0]]]:
        raise ConfigurationError(
            '--path needs one of --cable and --baseline, and --length-std; or --delay and --delay-std'
        )
    value, std = getattr(arguments, known[0]), getattr(arguments, stds[0])
    if not 0.0 < value < math.inf:
        raise ConfigurationError(f'--{known[0]} {value:g}: must be above 0')
    if not 0.0 <= std < math.inf:
        raise ConfigurationError(f'--{stds[0].replace("_", "-")} {std:g}: must not be below 0')
    if not 0.1 <= arguments.velocity_factor <= 1.0:
        raise ConfigurationError(f'--velocity-factor {arguments.velocity_factor:g}: must be 0.1 to 1')


def _known_path(arguments: argparse.Namespace) -> KnownPath:
    if arguments.delay is not None:
        return KnownPath.of_delay(arguments.delay, arguments.delay_std)
    if arguments.baseline is not None:
        return KnownPath(arguments.baseline, arguments.length_std, in_air=True)
    return KnownPath(arguments.cable, arguments.length_std, False, arguments.velocity_factor)


def _base(arguments: argparse.Namespace, store: CalibrationStore) -> Document:
    """Return the document to complete."""
    if arguments.base:
        document = read_document(arguments.base)
        if document.station != arguments.station:
            raise ConfigurationError(f"{arguments.base}: is of station '{document.station}'")
        return document
    return store.newest(arguments.station) or Document(arguments.station)


def _readings(arguments: argparse.Namespace) -> tuple[list[Reading], str]:
    """Return all readings, and the name of the counter that gave some."""
    readings = [typed(text, arguments.temperature) for text in arguments.reading]
    if arguments.csv:
        readings += read_csv(arguments.csv)
    if not arguments.counter:
        return readings, ''
    inputs = {'reference': arguments.reference_input, 'adc': arguments.adc_input}
    with Counter(arguments.counter, arguments.scpi) as counter:
        connected = {clock: number for clock, number in inputs.items() if number}
        return readings + read_counter(counter, connected, arguments.count, arguments.temperature), counter.name


def _keep(path: str, readings: list[Reading]) -> None:
    """Append readings to a CSV file, as a whole."""
    try:
        before = Path(path).read_text(encoding='utf-8') if Path(path).exists() else ''
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    if not before:
        writer.writerow(('clock', 'frequency', 'temperature', 'std'))
    for r in readings:
        writer.writerow((r.clock, repr(r.frequency), r.temperature, '' if np.isnan(r.std) else f'{r.std:.3g}'))
    write_atomically(path, before + text.getvalue())


def _curves(readings: list[Reading], arguments: argparse.Namespace) -> dict[str, Curve]:
    curves = {}
    nominal = {'reference': arguments.reference_nominal, 'adc': arguments.adc_nominal}
    for clock in CLOCKS:
        values, board, stds = deviations(readings, clock, nominal[clock])
        if not values:
            continue
        usual = 1e-6 * arguments.reading_std
        sigma = [usual if np.isnan(std) else max(std, 0.1 * usual) for std in stds]
        curves[clock] = fit(values, board, sigma, 1e-6 * arguments.time_base_std, arguments.shape)
    return curves


def _over_path(
    document: Document, arguments: argparse.Namespace, store: CalibrationStore
) -> tuple[Document, list[str]]:
    """Return the document completed by recordings over a known path, and what they say."""
    station = arguments.station
    settings, frames = recorded_frames(arguments.path[0], station)
    peer = settings.peer
    calibrations = _calibrations(document, peer, arguments, store)
    runs = [read_ranges(name, calibrations, station=station) for name in arguments.path]
    for name, run in zip(arguments.path, runs, strict=True):
        if set(run.stations) != {station, peer}:
            raise ConfigurationError(f"{name}: holds ranges of {' and '.join(run.stations)}, not with '{peer}'")
    board, peer_delays = [], []
    for run in runs:
        own = run.stations.index(station)
        board.append(run.board[own])
        others = [i for i in range(len(run.stations)) if i != own]
        peer_delays.append(np.zeros(len(run.results)))
        for i in others:
            peer_delays[-1] += run.calibrations[i].delay_at(run.board[i])
    results = [result for run in runs for result in run.results]
    found = path_calibration(results, np.concatenate(board), np.concatenate(peer_delays), _known_path(arguments))
    response = line_response([beat for run in runs for beat in run.beats if beat.station == station])
    document = with_path(document, found, peer, settings.start_delay, response)
    said = path_sentences(station, peer, found)
    if response is not None:
        said.append(response_sentence(response))
    if peer != station:
        noise = oscillator_noise(settings, [sweep for sweep, _ in frames[:_MOST_SWEEPS]])
        document = with_oscillator(document, noise)
        said.append(oscillator_sentence(noise))
    return document, said


def _calibrations(
    document: Document, peer: str, arguments: argparse.Namespace, store: CalibrationStore
) -> list[Calibration]:
    """Return both stations' calibrations as known so far; the station's own delay is what is sought."""
    own = dataclasses.replace(document.calibration(), delay=0.0, delay_std=0.0, delay_slope=0.0, delay_peer='')
    if peer == own.station:
        return [own]
    known = read_document(arguments.peer) if arguments.peer else store.newest(peer)
    if known is not None and known.station != peer:
        raise ConfigurationError(f"{arguments.peer}: is of station '{known.station}', the peer is '{peer}'")
    return [own] if known is None else [own, known.calibration()]
