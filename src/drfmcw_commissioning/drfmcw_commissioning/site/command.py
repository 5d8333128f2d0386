"""`calibrate site RECORDING`: correct a pair's calibration by ranges beside reference distances."""

import argparse
import dataclasses
import os
from typing import Any

import numpy as np

from drfmcw_fusion.pipeline import Flag
from drfmcw_fusion.uncertainty import UNKNOWN
from drfmcw_physics.air import refractive_index
from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.calibration.document import Document, from_calibration, implausible, read_document
from drfmcw_ros.calibration.store import CalibrationStore, state_directory
from drfmcw_ros.commands.cli import write_atomically

from ..recordings import Ranges, read_ranges
from .candidates import candidates
from .fit import SiteFit, fit_site
from .groups import gather, read_marks
from .report import sentences, table
from .result import corrected
from .separability import Separability, separability

_PASSES = 2  # evaluations with corrected calibrations
_SENSORS = {'temperature': 0.5, 'pressure': 100.0, 'humidity': 0.05}
"""Accuracy of weather sensors on site [K, Pa, 1] (chosen: of good ones)."""


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    summary = 'calibrate a pair on site, by ranges beside reference distances'
    parser = commands.add_parser('site', help=summary, description=__doc__)
    parser.add_argument('recording', help='rosbag2 recording of both stations')
    add_damage_option(parser)
    parser.add_argument('--marks', metavar='FILE', help='known distances (columns range, std) instead of the reference')
    parser.add_argument(
        '--calibration',
        action='append',
        default=[],
        metavar='FILE',
        help='document to start from (repeatable; recorded)',
    )
    parser.add_argument('--velocity', choices=('standing', 'tracked'), default='standing', help='of the crane')
    parser.add_argument('--out', default='.', metavar='DIR', help='where NAME.calibration.yaml is written (.)')
    parser.add_argument('--store', action='store_true', help='store them in the state directory too')
    parser.add_argument('--state', default='', metavar='DIR', help='state directory (the one of this user)')
    parser.add_argument('--operator', default='', metavar='TEXT', help='who calibrates')
    parser.add_argument('--note', default='', metavar='TEXT', help='kept with it')
    parser.set_defaults(work=_run)


@dataclasses.dataclass(frozen=True)
class Site:
    """What ranges beside reference distances come to."""

    ranges: Ranges  # before any correction
    fit: SiteFit
    separability: Separability | None  # None where no calibration explains the site
    documents: list[Document]  # corrected, of the first and the second station
    sentences: list[str]


def calibrate_site(
    path: str, marks: str | None = None, given: list[Document] | None = None, velocity: str = 'standing'
) -> Site:
    """Return what a site determines of a pair's calibration, and what would determine the rest.

    Args:
        path: of the recording.
        marks: CSV file of known distances; None takes the recorded reference.
        given: documents used instead of the recorded calibrations.
        velocity: as FusionSettings.

    Raises:
        ConfigurationError: the recording lacks what is needed.
    """
    documents = given or []
    ranges = read_ranges(path, [d.calibration() for d in documents], velocity)
    if len(ranges.stations) < 2:
        raise ConfigurationError(
            f"{path}: '{ranges.stations[0]}' hears itself; a site needs the ranges of two stations"
        )
    for document in documents:
        if document.station not in ranges.stations:
            raise ConfigurationError(
                f"{path}: no station '{document.station}'{nearest(document.station, ranges.stations)}"
            )
    known = read_marks(marks) if marks else ()
    by_name = {d.station: d for d in documents}
    start = [by_name.get(c.station) or from_calibration(c) for c in ranges.calibrations]
    original = (ranges.calibrations[0], ranges.calibrations[1])
    groups = gather(ranges, known)
    offered = candidates(original, groups, _air_std(ranges))
    fit = fit_site(groups, original, offered)
    results, foreign = corrected(start, fit)
    for _ in range(_PASSES):
        if not fit.corrections:
            break
        # lines are evaluated anew: the references' difference smears them, which the fit's derivatives do not contain
        held = {c.candidate: c.value for c in fit.corrections if c.candidate.change is not None}
        now = read_ranges(path, [d.calibration() for d in results], velocity)
        fit = fit_site(gather(now, known), (now.calibrations[0], now.calibrations[1]), offered, held)
        results, foreign = corrected(start, fit)
    apart = separability(path, original, fit, bool(known)) if fit.explained.any() else None
    said = sentences(fit, apart, ranges.stations)
    said += [
        f'The {c.candidate.kind} belongs to no station and is not stored: check the weather sensors.' for c in foreign
    ]
    return Site(ranges, fit, apart, results, said)


def _air_std(ranges: Ranges) -> float:
    """Return the standard deviation of the refractivity [1e-6]: of sensors, or of unknown weather."""
    stale = any(result.flags & Flag.STALE_ENVIRONMENT for result in ranges.results)
    stds = UNKNOWN if stale else _SENSORS
    at = {'temperature': 15.0, 'pressure': 101325.0, 'humidity': 0.5}

    def index(values: dict[str, float]) -> float:
        return float(refractive_index(values['temperature'], values['pressure'], values['humidity']))

    changes = [index(at | {name: at[name] + std}) - index(at) for name, std in stds.items()]
    return 1e6 * float(np.linalg.norm(changes))


def _run(arguments: argparse.Namespace) -> None:
    given = [read_document(path) for path in arguments.calibration]
    site = calibrate_site(arguments.recording, arguments.marks, given, arguments.velocity)
    print(table(site.fit, site.ranges.stations))
    print('\n'.join(site.sentences))
    if site.separability is None:
        raise ConfigurationError(f'{arguments.recording}: no calibration explains this site; nothing is written')
    store = CalibrationStore(state_directory(os.environ, arguments.state))
    texts = {'operator': arguments.operator, 'note': arguments.note or f'site: {arguments.recording}'}
    for document in site.documents:
        document = dataclasses.replace(document, **texts, instrument='reference on site')
        refusal = implausible(document)
        if refusal:
            raise ConfigurationError(f"the result for '{document.station}' is implausible: {refusal}")
        if arguments.store:
            document = store.add(document)
        path = os.path.join(arguments.out, f'{document.station}.calibration.yaml')
        write_atomically(path, document.text())
        print(f'{path}: written' + (f', stored as version {document.version}' if arguments.store else ''))
    files = ' '.join(f'--calibration {os.path.join(arguments.out, d.station)}.calibration.yaml' for d in site.documents)
    print(f'check: ./drfmcw replay {arguments.recording} {files}')
