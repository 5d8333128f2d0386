"""What was measured of one station, as the document that it keeps."""

import dataclasses
from typing import Any

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import (
    Clock,
    Delay,
    Document,
    IfResponse,
    StartDelay,
    Temperatures,
    triangle,
)

from .curve import Curve
from .noise import ReceiverNoise
from .oscillator import OscillatorNoise
from .path import PathCalibration
from .response import LineResponse


def with_clocks(document: Document, curves: dict[str, Curve]) -> Document:
    """Return the document with curves of the clocks 'reference' and 'adc', as far as they are given."""
    at = _reference(document, list(curves.values()))
    sections = {'reference': 'reference_clock', 'adc': 'sample_clock'}
    moved: dict[str, Any] = {sections[name]: _clock(curve.about(at)) for name, curve in curves.items()}
    document = _at(document, at, list(curves.values()))
    return dataclasses.replace(document, **moved)


def with_path(
    document: Document, found: PathCalibration, peer: str, nominal: float, response: LineResponse | None = None
) -> Document:
    """Return the document with the station's delay, which holds with this peer, and with its IF response.

    Args:
        document: of the station.
        found: what a known path determined of the pair.
        peer: the other station; the station itself where it hears itself.
        nominal: T_off as set [s].
        response: of the receiver to the line of the path, which replaces one of its noise; None keeps what is known.
    """
    at = _reference(document, [found.delay])
    curve = found.delay.about(at)
    delay = Delay(
        value=float(curve.coefficients[0]),
        std=curve.largest_std,
        slope=float(curve.coefficients[1]),
        slope_std=float(curve.covariance[1, 1]) ** 0.5,
        peer=peer,
    )
    document = dataclasses.replace(_at(document, at, [curve]), delay=delay)
    if response is not None:
        document = dataclasses.replace(document, if_response=_response(response, 'line'))
    if peer == document.station:
        return document
    start = StartDelay(nominal, found.excess, found.excess_std, found.jitter)
    return dataclasses.replace(document, start_delay=start)


def with_noise(document: Document, found: ReceiverNoise) -> Document:
    """Return the document with noise floor and response of the receiver."""
    noise = dataclasses.replace(document.noise, floor=found.floor, floor_std=found.floor_std)
    return dataclasses.replace(document, noise=noise, if_response=_response(found, 'noise'))


def _response(found: ReceiverNoise | LineResponse, of: str) -> IfResponse:
    frequency, gain, std = ([float(v) for v in values] for values in (found.frequency, found.gain, found.gain_std))
    return IfResponse(frequency, gain, std, of)


def with_oscillator(document: Document, found: OscillatorNoise) -> Document:
    """Return the document with the oscillator's phase noise."""
    noise = dataclasses.replace(
        document.noise,
        phase_level=found.level,
        phase_level_std=found.level_std,
        phase_corner=found.corner,
        phase_corner_std=found.corner_std,
    )
    return dataclasses.replace(document, noise=noise)


def _clock(curve: Curve) -> Clock:
    value, linear, quadratic, cubic = (float(c) for c in curve.coefficients)
    return Clock(1.0 + value, curve.largest_std, linear, quadratic, cubic, triangle(curve.covariance))


def _reference(document: Document, curves: list[Curve]) -> float:
    """Return the temperature at which all values are to be stated: the document's if it states curves already."""
    if document.calibration().depends_on_temperature:
        return document.temperature.reference
    bent = [curve for curve in curves if curve.high > curve.low]
    return (bent or curves)[0].temperature


def _at(document: Document, reference: float, curves: list[Curve]) -> Document:
    """Return the document with the range of temperatures that all its parts share."""
    ranges = [(curve.low, curve.high) for curve in curves if curve.high > curve.low]
    known = document.temperature
    if document.calibration().depends_on_temperature:
        ranges.append((known.low, known.high))
    if not ranges:
        return dataclasses.replace(document, temperature=Temperatures(reference))
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if not high > low:
        raise ConfigurationError('the parts of the calibration were measured at board temperatures that do not overlap')
    return dataclasses.replace(document, temperature=Temperatures(min(max(reference, low), high), low, high))
