"""Figs. 9 and 10: temperature of the oscillators, and weather."""

from collections.abc import Sequence

import numpy as np

from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import range_bias
from drfmcw_physics.sweep import Mode

from . import claims, figures
from .claims import Claim, millimetres
from .experiments import (
    Outcome,
    Point,
    Run,
    site,
)
from .figures import (
    Marks,
    OscillatorCurve,
    WeatherBand,
    WeatherPanel,
)
from .section import NO_DELAY, NOMINAL, Finished, Section, column

CUBIC = 1.1e-10
"""Cubic coefficient of an AT-cut resonator around 25 degC, Bechmann, Ballato and Lukaszek 1962 [1/K^3]."""

_TEMPERATURES = (-20.0, 0.0, 25.0, 40.0, 60.0)


def fig9() -> Section:
    """Return the section on Fig. 9."""
    slope = claims.slope_of_paper()
    points = []
    for temperature in _TEMPERATURES:
        station = NO_DELAY | {'board_temperature': temperature, 'calibration_temperature': 25.0}
        drift = [{'effect': 'reference_clock_temperature', 'slope': slope * 1e6}]
        deviation = slope * (temperature - claims.CALIBRATION_TEMPERATURE)
        own = [{'effect': 'sample_clock_offset', 'deviation': (1.0 / (1.0 + deviation) - 1.0) * 1e6}]
        for name, effects in (('own', drift + own), ('shared', drift)):
            scenario = site('gantry', 1000.0, alphas=NOMINAL, station=station, effects=effects)
            points.append(Point(f'fig9 {temperature:.0f} {name}', scenario, Mode.LONG_DISTANCE))

    def finish(outcomes: Sequence[Outcome], run: Run) -> Finished:
        at = np.linspace(-20.0, 60.0, 161)
        t = at - claims.CALIBRATION_TEMPERATURE
        curves = [
            OscillatorCurve(label, deviation, range_bias(1000.0, 1.0 + deviation, 1.0 + deviation))
            for label, deviation in (
                (f'linear, {slope * 1e6:.3f} ppm/K', slope * t),
                ('AT cut, no slope at 25 °C', CUBIC * t**3),
                ('AT cut, -0.1 ppm/K at 25 °C', CUBIC * t**3 - 0.1e-6 * t),
                ('AT cut, -0.2 ppm/K at 25 °C', CUBIC * t**3 - 0.2e-6 * t),
            )
        ]
        marks = [
            Marks(label, np.array(_TEMPERATURES), column(part, 'bias'), column(part, 'bias_error'), filled)
            for part, label, filled in (
                (outcomes[::2], 'simulated, linear', True),
                (outcomes[1::2], 'the same, ADC runs from the reference', False),
            )
        ]
        expected = np.array([claims.drift_bias(x, slope) for x in _TEMPERATURES])
        away = np.abs(marks[0].bias - expected) / marks[0].bias_error
        largest = max(float(np.abs(curve.error).max()) for curve in curves[1:])
        one = (1.0 + claims.TEMPERATURE_LIMIT / 1000.0 * 2.0) ** 0.5 - 1.0
        text = f"""The paper gives no slope, only that the error at 1000 m lies below ±20 mm from -20 to +60 °C. By
eq. 21, both stations at the same temperature, that allows {1e6 * slope * 45:.1f} ppm at -20 °C: a linear drift of
{slope * 1e6:.3f} ppm/K of both references (dashed), or {one * 1e6 / 45:.3f} ppm/K where only one drifts. A typical
AT-cut crystal, {CUBIC * 1e12:.0f}e-12 (T - 25 °C)³ plus a slope set by the angle of the cut (Bechmann, Ballato and
Lukaszek 1962), is drawn for comparison; the paper does not say what its crystals are. The simulated stations know
the calibration at 25 °C only: within {away.max():.1f} standard errors of eq. 21. Where the ADC runs from the same
reference, half of the error remains."""
        found = (
            Claim(
                'V-B-3, Fig. 9',
                'error at 1000 m below ±20 mm from -20 to +60 °C, calibrated at 25 °C',
                f'at most {millimetres(largest)} with an AT cut; a linear drift may reach {slope * 1e6:.2f} ppm/K',
                largest < 0.0205,
                "typical crystals fit; the slope of the paper's own is not given",
            ),
        )
        return Finished(figures.temperature(at, curves, claims.TEMPERATURE_LIMIT, marks), text, found)

    return Section('fig9', 'Temperature of the reference oscillators', tuple(points), finish)


def fig10() -> Section:
    """Return the section on Fig. 10."""

    def finish(outcomes: Sequence[Outcome], run: Run) -> Finished:
        at = np.linspace(-20.0, 40.0, 121)
        slope = claims.slope_of_paper()

        def bounds(model: str, drift: float = 0.0, reference: float | None = None) -> tuple[np.ndarray, np.ndarray]:
            added = claims.drift_bias(at, drift)
            low, high = (
                claims.weather_bias(at, pressure, humidity, model, reference) + added
                for pressure, humidity in zip(claims.PRESSURE_SPAN, (0.0, 1.0), strict=True)
            )
            return low, high

        printed, itu = 'paper_eq23_as_printed', 'itu_r_p453'
        drift = f'oscillator drift {slope * 1e6:.2f} ppm/K'
        air = SPEED_OF_LIGHT / refractive_index(*claims.CALIBRATION_WEATHER, printed)
        shift = 1000.0 * (claims.PRINTED_VELOCITY / air - 1.0)
        blue, orange, green = figures.COLORS['A'], figures.COLORS['B'], figures.SECOND
        panels = [
            WeatherPanel(
                title='eq. 23 as printed (0.373)',
                limits=(-55.0, 85.0),
                legend='upper right',
                bands=[
                    WeatherBand('air alone', *bounds(printed), blue),
                    WeatherBand(f'with {drift}', *bounds(printed, slope), orange, filled=True),
                    WeatherBand(
                        'the same, range with the printed c', *bounds(printed, slope, claims.PRINTED_VELOCITY), '0.5'
                    ),
                ],
            ),
            WeatherPanel(
                title='wet term corrected (3.73)',
                limits=(-55.0, 300.0),
                legend='upper left',
                bands=[
                    WeatherBand('air alone, eq. 23 corrected', *bounds('paper_eq23_corrected'), blue),
                    WeatherBand('air alone, ITU-R P.453-14', *bounds(itu), green),
                    WeatherBand(f'ITU-R, {drift}', *bounds(itu, slope), orange, filled=True),
                ],
            ),
        ]
        with_drift = claims.weather_bounds(printed, slope)
        text = f"""Offset at 1000 m where the range is computed with the air of the calibration (25 °C, 103.25 kPa,
dry). Upper bound: 103.8 kPa and 100 % relative humidity; lower: 98.7 kPa, dry. The drift is the linear one of Fig.
9, rising with temperature, since the paper says that it softens the error. As printed, the sum stays within
{with_drift[0] * 1e3:+.0f} ... {with_drift[1] * 1e3:+.0f} mm between the dotted lines, the paper's ±28 mm; with the
right wet term humid heat alone gives {claims.weather_bounds(itu)[1] * 1e3:+.0f} mm. The printed c shifts everything
by {millimetres(shift)}. Weather sensors on site remove all of it."""
        return Finished(figures.weather(at, panels, claims.WEATHER_SPAN), text)

    return Section('fig10', 'Weather', (), finish)
