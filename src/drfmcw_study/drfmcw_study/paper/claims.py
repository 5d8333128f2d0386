"""What the paper claims in numbers, beside what our code computes: exactly here, by Monte Carlo in `sections`."""

import dataclasses
import math

import numpy as np

from drfmcw_physics import air, link_budget
from drfmcw_physics.constants import SPEED_OF_LIGHT, ZERO_CELSIUS
from drfmcw_physics.oscillators import range_bias
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency, largest_range

from .experiments import IF_BAND, NOISE_FLOORS, floor_density, table_1

PRINTED_VELOCITY = 299704442.0
"""Propagation velocity that section V-B-4 prints for 25 degC and 103.25 kPa, dry [m/s]."""

CALIBRATION_WEATHER = (25.0, 103250.0, 0.0)
"""Temperature [degC], pressure [Pa] and relative humidity of section V-B-4's calibration."""

WEATHER_SPAN = (-12.0, 36.0)
"""Lowest and highest temperature measured at the crane in 2013 [degC]."""

PRESSURE_SPAN = (98700.0, 103800.0)
"""Pressure boundary values of section V-B-4 [Pa]."""

TEMPERATURE_LIMIT = 0.020
"""Fig. 9: largest error at 1000 m that the drift of both oscillators causes from -20 to +60 degC [m]."""

CALIBRATION_TEMPERATURE = 25.0
"""Temperature at which the paper's alphas are measured [degC]."""


@dataclasses.dataclass(frozen=True)
class Claim:
    """One numeric claim of the paper beside ours."""

    where: str  # in the paper
    paper: str  # what it says
    ours: str  # what we find
    agrees: bool
    why: str  # it differs, or what the agreement rests on
    known: bool = False  # a contradiction within the paper, also in docs/paper_errata.md

    @property
    def verdict(self) -> str:
        """'agrees' or 'differs'."""
        return 'agrees' if self.agrees else 'differs'


def millimetres(value: float, digits: int = 1, sign: bool = False) -> str:
    """Return a length [m] as text in mm."""
    return f'{value * 1e3:{"+" if sign else ""}.{digits}f} mm'


def weather_bias(
    temperature: np.ndarray | float, pressure: float, humidity: float, model: str, reference: float | None = None
) -> np.ndarray:
    """Return the range offset at 1000 m where the air differs from that of the calibration [m].

    Args:
        temperature: of the air [degC], array or scalar.
        pressure: [Pa].
        humidity: relative, 0..1.
        model: of the refractive index, for both.
        reference: velocity taken for the range [m/s]; None takes that of the paper's calibration weather.
    """
    index = air.refractive_index(np.asarray(temperature, float), pressure, humidity, model)
    calibrated = air.refractive_index(*CALIBRATION_WEATHER, model)
    used = SPEED_OF_LIGHT / calibrated if reference is None else reference
    return 1000.0 * (index * used / SPEED_OF_LIGHT - 1.0)


def slope_of_paper(limit: float = TEMPERATURE_LIMIT) -> float:
    """Return the slope of both oscillators that makes `limit` [m] at 1000 m and -20 degC by eq. 21 [1/K]."""
    deviation = math.sqrt(1.0 + limit / 1000.0) - 1.0  # alpha^2 - 1 = limit / R where both are equal
    return deviation / (CALIBRATION_TEMPERATURE + 20.0)


def drift_bias(temperature: np.ndarray | float, slope: float) -> np.ndarray:
    """Return the range error at 1000 m where both oscillators drift by `slope` [1/K] from 25 degC on, eq. 21 [m]."""
    alpha = 1.0 + slope * (np.asarray(temperature, float) - CALIBRATION_TEMPERATURE)
    return range_bias(1000.0, alpha, alpha)


def contradictions() -> list[Claim]:
    """Return where the paper contradicts itself or what it cites; all computed exactly."""
    return [
        _wet_term(),
        _velocity_of_light(),
        _reference_error(),
        _short_distance_limit(),
        _long_distance_limit(),
        _weather_bounds(),
        _power_at_15_m(),
        _sign_of_equation_21(),
        _doppler(),
    ]


def _wet_term() -> Claim:
    weather = (25.0, 101325.0, 0.5)
    printed, corrected, standard = (
        air.refractive_index(*weather, model)
        for model in ('paper_eq23_as_printed', 'paper_eq23_corrected', 'itu_r_p453')
    )
    missing = 1000.0 * (corrected - printed)
    return Claim(
        'eq. 23',
        'wet coefficient 0.373, pressures in kPa',
        f'as printed {millimetres(missing, 0)} are missing at 1 km in humid summer air (25 °C, 1013.25 hPa, 50 %); '
        f'with 3.73 it is within {millimetres(1000.0 * abs(corrected - standard))} of ITU-R P.453-14',
        bool(abs(printed - standard) < 5e-6),
        '0.373 belongs to hPa; with kPa it is 3.73. Default: ITU-R P.453-14',
        known=True,
    )


def _velocity_of_light() -> Claim:
    model = 'paper_eq23_corrected'
    ours = SPEED_OF_LIGHT / air.refractive_index(*CALIBRATION_WEATHER, model)
    printed_index = SPEED_OF_LIGHT / PRINTED_VELOCITY
    cold = 77.6e-5 * CALIBRATION_WEATHER[1] / 1000.0 / (printed_index - 1.0) - ZERO_CELSIUS
    dry, wet = (air.refractive_index(25.0, 103250.0, h) for h in (0.0, 1.0))
    humidity = (printed_index - dry) / (wet - dry)  # the index is linear in it
    standard = SPEED_OF_LIGHT / air.refractive_index(25.0, 101325.0, 0.0, model)
    return Claim(
        'V-B-4',
        f'c = {PRINTED_VELOCITY:.0f} m/s in dry air of 25 °C and 103.25 kPa',
        f'eq. 23 gives {ours:.0f} m/s, {millimetres(1000.0 * (ours / PRINTED_VELOCITY - 1.0))} per km away',
        bool(abs(ours - PRINTED_VELOCITY) < 1.0),
        f'the printed value fits dry air of {cold:.1f} °C, or 25 °C with {100 * humidity:.0f} % relative '
        f'humidity. If 103.25 kPa is a misprint of 101.325 kPa, that does not explain it: {standard:.0f} m/s',
        known=True,
    )


def _uncorrected_sum(first: float, second: float, first_clock: float, second_clock: float) -> float:
    """Return the range error at 1000 m in vacuum by eqs. 5 and 6 alone, T_off = 0.6 us [m]; arguments / nominal."""
    delay = 1000.0 / SPEED_OF_LIGHT
    one = SweepSettings('a', 'b', role=Role.FIRST, mode=Mode.LONG_DISTANCE, start_delay=0.6e-6)
    two = dataclasses.replace(one, station='b', peer='a', role=Role.SECOND)
    total = beat_frequency(one, delay, first, second) / first_clock
    total += beat_frequency(two, delay, second, first) / second_clock
    return total / (2.0 * one.chirp_rate) * SPEED_OF_LIGHT - 1000.0


def _reference_error() -> Claim:
    alpha = 1.0 + 40e-6
    one, both = range_bias(1000.0, alpha, 1.0), range_bias(1000.0, alpha, alpha)
    shared = _uncorrected_sum(alpha, alpha, alpha, alpha)
    return Claim(
        'V-B-2',
        '±40 ppm of a reference: about ±2 mm indoors, more than 100 mm at 1000 m',
        f'eqs. 19 to 21: {millimetres(one)} at 1000 m where one station is off by 40 ppm, {millimetres(both)} where '
        f'both are; ±2 mm belong to {2e-3 / one * 1000:.0f} m of path (one) or {2e-3 / both * 1000:.0f} m (both)',
        both > 0.1,
        f'if the ADC runs from the same reference it is {millimetres(shared)} for both',
        known=True,
    )


def _short_distance_limit() -> Claim:
    sweep = table_1()
    quarter = sweep.sample_rate / 4 / sweep.chirp_rate
    in_air = SPEED_OF_LIGHT / float(air.refractive_index(15.0, 101325.0, 0.5))
    centred = largest_range(dataclasses.replace(sweep, start_delay=quarter), in_air)
    on_site = largest_range(dataclasses.replace(sweep, start_delay=4e-6), in_air)
    rounded = largest_range(dataclasses.replace(sweep, start_delay=quarter), 3e8)
    return Claim(
        'V-C',
        'short-distance mode up to 1024 m, IF centred at a quarter of the sampling rate',
        f'{centred:.1f} m in air with T_off = {quarter * 1e6:.3f} µs; {on_site:.0f} m with the 4 µs used on site',
        bool(abs(centred - 1024.0) < 0.5),
        f'{rounded:.1f} m follow with c = 3e8 m/s. There the line of station 1 is at the Nyquist frequency and '
        'that of station 2 at 0 Hz, without margin',
        known=True,
    )


def _long_distance_limit() -> Claim:
    sweep = dataclasses.replace(table_1(), mode=Mode.LONG_DISTANCE, start_delay=0.0)
    in_air = SPEED_OF_LIGHT / float(air.refractive_index(15.0, 101325.0, 0.5))
    line = sweep.chirp_rate * 5000.0 / in_air
    longest = largest_range(sweep, in_air)
    power = link_budget.received_power(sweep.tx_eirp, sweep.rx_antenna_gain, 5000.0, sweep.center_frequency)
    return Claim(
        'V-C, VI',
        'maximum operational range 5000 m',
        f'the largest long-distance range of Table 1 is {longest:.0f} m (T_off = 0); at 5000 m the line would be at '
        f'{line / 1e3:.0f} kHz, above the Nyquist frequency of {sweep.sample_rate / 2e3:.0f} kHz',
        longest >= 5000.0,
        f'the link budget reaches it ({power:.1f} dBm at 5000 m), the waveform does not: a slower ramp or a faster ADC '
        'would',
        known=True,
    )


def weather_bounds(model: str, slope: float = 0.0, reference: float | None = None) -> tuple[float, float]:
    """Return the smallest and largest range offset at 1000 m between -12 and +36 degC [m].

    Args:
        model: of the refractive index.
        slope: drift of both oscillators [1/K].
        reference: as for `weather_bias`.
    """
    temperature = np.linspace(*WEATHER_SPAN, 97)
    drift = drift_bias(temperature, slope)
    lower = weather_bias(temperature, PRESSURE_SPAN[0], 0.0, model, reference) + drift
    upper = weather_bias(temperature, PRESSURE_SPAN[1], 1.0, model, reference) + drift
    return float(min(lower.min(), upper.min())), float(max(lower.max(), upper.max()))


def _span(bounds: tuple[float, float]) -> str:
    low, high = (round(b * 1e3) for b in bounds)  # whole numbers: no -0
    return f'{low:+d} ... {high:+d} mm'


def _weather_bounds() -> Claim:
    corrected, standard = (weather_bounds(m) for m in ('paper_eq23_corrected', 'itu_r_p453'))
    printed = weather_bounds('paper_eq23_as_printed')
    drifting = weather_bounds('paper_eq23_as_printed', slope_of_paper())
    by_printed = weather_bounds('paper_eq23_as_printed', slope_of_paper(), PRINTED_VELOCITY)
    return Claim(
        'V-B-4, Fig. 10',
        'less than ±28 mm at 1000 m from -12 to +36 °C, 98.7 to 103.8 kPa, 0 to 100 % relative humidity',
        f'{_span(corrected)} with the right wet term, {_span(standard)} with ITU-R P.453-14 (air alone)',
        max(map(abs, standard)) < 0.028,
        f'only the misprinted wet term keeps it small: {_span(printed)}, and {_span(drifting)} with an oscillator '
        f'drift that fills the ±20 mm of Fig. 9. With the printed c it would be {_span(by_printed)}: the figure was '
        'not made with that c',
        known=True,
    )


def _power_at_15_m() -> Claim:
    sweep = table_1()
    args = (sweep.tx_eirp, sweep.rx_antenna_gain)
    power = link_budget.received_power(*args, 15.0, sweep.center_frequency)
    distance = 15.0 * 10.0 ** ((power + 40.0) / 20.0)
    return Claim(
        'V-B',
        '-40 dBm at about 15 m',
        f'the link budget of Table 1 gives {power:.1f} dBm at 15 m; -40 dBm belong to {distance:.1f} m',
        abs(power + 40.0) < 1.0,
        'within what cables and connectors lose; nothing else depends on it',
        known=True,
    )


def _sign_of_equation_21() -> Claim:
    k, tau, a1, a2 = 150e9, 1000.0 / SPEED_OF_LIGHT, 1.0 + 40e-6, 1.0
    from_20 = k * tau * (a1**2 + a2**2 - 2.0) * SPEED_OF_LIGHT / (2.0 * k)
    f_if = k * tau * (a1**2 + a2**2)
    from_21 = f_if * SPEED_OF_LIGHT * (2.0 - a1**2 - a2**2) / (2.0 * k * (a1**2 + a2**2))
    return Claim(
        'eqs. 20, 21',
        'both give the distance bias',
        f'40 ppm at 1000 m: {millimetres(from_20, sign=True)} by eq. 20, {millimetres(from_21, sign=True)} by eq. 21',
        math.isclose(from_20, from_21, rel_tol=1e-3),
        'opposite signs: eq. 21 is the correction (true minus measured), eq. 20 the error. Ours is measured minus true '
        'throughout',
    )


def _doppler() -> Claim:
    sweep = table_1()
    rate = sweep.center_frequency / sweep.chirp_rate
    return Claim(
        'left out',
        'a moving crane is not considered; error within ±20 mm',
        f'a moving crane shifts the range by {rate * 1e3:.2f} mm per m/s: {0.020 / rate:.2f} m/s use up the 20 mm',
        False,
        'Doppler shifts both lines alike and adds to f_IF. Corrected here: docs/velocity.md',
        known=True,
    )


def agreements() -> list[Claim]:
    """Return the claims on hardware and waveform that follow from Table 1; all computed exactly."""
    sweep = table_1()
    power = 10.0 ** (sweep.tx_eirp / 10.0)
    multiplied = -164.0 + 20.0 * math.log10(sweep.center_frequency / 100e6)
    ideal = 20.0 * math.log10(2.0**14) + 10.0 * math.log10(1.5)
    gain = float(link_budget.free_space_loss(1.0, 77e9) - link_budget.free_space_loss(1.0, 5.8e9))
    at_650 = [
        f'{beat_frequency(s, 650.0 / SPEED_OF_LIGHT, 1.0, 1.0) / 1e3:.0f}'
        for s in (
            dataclasses.replace(sweep, start_delay=4e-6),
            dataclasses.replace(sweep, start_delay=4e-6, role=int(Role.SECOND)),
        )
    ]
    a = 1.0 + 40e-6
    k_of_alpha = (a * sweep.bandwidth) / (sweep.ramp_duration / a)
    synchronisation = 0.020 / SPEED_OF_LIGHT
    at_5000 = float(link_budget.received_power(sweep.tx_eirp, sweep.rx_antenna_gain, 5000.0, sweep.center_frequency))
    in_bin = NOISE_FLOORS['B'] + 10.0 * math.log10(1.0 / sweep.ramp_duration / IF_BAND)
    margins = (at_5000 - NOISE_FLOORS['A'], at_5000 - in_bin)
    return [
        Claim(
            'III, Table 1',
            'EIRP limited to 25 mW; 13 dBm',
            f'13 dBm are {power:.1f} mW, {10 * math.log10(25.0 / power):.1f} dB below the limit',
            power <= 25.0,
            '',
        ),
        Claim(
            'I, Table 1',
            '5.8 GHz ISM band',
            f'the sweep covers {sweep.start_frequency / 1e6:.0f} to '
            f'{(sweep.start_frequency + sweep.bandwidth) / 1e6:.0f} MHz, the whole band',
            sweep.start_frequency >= 5725e6 and sweep.start_frequency + sweep.bandwidth <= 5875e6,
            'no margin for a detuned reference: 40 ppm move it by 0.23 MHz',
        ),
        Claim(
            'III',
            '100 MHz reference with good phase noise, -164 dBc/Hz at 100 kHz',
            f'multiplied to 5.8 GHz: {multiplied:.1f} dBc/Hz, {-90.0 - multiplied:.0f} dB below Table 1',
            multiplied < -110.0,
            "the synthesiser's own noise is what counts",
        ),
        Claim(
            'III',
            '14-bit ADC with at most 80 dB of signal-to-noise ratio',
            f'an ideal one has {ideal:.1f} dB',
            ideal >= 80.0,
            '',
        ),
        Claim('I', 'less path loss than at 77 GHz', f'{gain:.1f} dB less at any distance', gain > 0.0, ''),
        Claim(
            'II',
            'a synchronised system needs picoseconds',
            f'20 mm are {synchronisation * 1e12:.0f} ps of one-way delay, 1 mm is {synchronisation * 5e10:.1f} ps',
            synchronisation < 1e-9,
            '',
        ),
        Claim(
            'eq. 13',
            'chirp rate changes by (α² - 1) k',
            f'from α B_sw and T_sw/α with 40 ppm: {(k_of_alpha / sweep.chirp_rate - 1) * 1e6:.4f} ppm; '
            f'α² - 1 is {(a**2 - 1) * 1e6:.4f} ppm',
            math.isclose(k_of_alpha / sweep.chirp_rate, a**2, rel_tol=1e-12),
            '',
        ),
        Claim(
            'V-C',
            'long-distance mode beyond 650 m, so that no line nears 0 Hz or the Nyquist frequency',
            f'at 650 m with T_off = 4 µs the lines are at {" and ".join(at_650)} kHz of 1024 kHz',
            float(at_650[0]) < 1000.0 and float(at_650[1]) > 25.0,
            'with equal references; a difference of α moves both by 5.8 kHz per ppm',
        ),
        Claim(
            'V-C, Fig. 12',
            'signal-to-noise margin of about 10 dB at 5000 m',
            f'{margins[0]:.1f} dB over floor A in the whole IF band; {margins[1]:.1f} dB over floor B in a bin of '
            f'1 kHz, {margins[1] - 13.0:.1f} dB above the 13 dB that a line needs',
            8.0 < margins[0] < 12.0 and 8.0 < margins[1] - 13.0 < 12.0,
            'the paper does not say in which bandwidth; both readings give its 10 dB',
        ),
    ]


def exact_claims() -> list[Claim]:
    """Return all claims that need no Monte Carlo."""
    return contradictions() + agreements()


def parameters() -> list[tuple[str, str]]:
    """Return Table 1 and what follows from it as (name, value with unit)."""
    sweep = table_1()
    in_air = SPEED_OF_LIGHT / float(air.refractive_index(15.0, 101325.0, 0.5))
    quarter = sweep.sample_rate / 4 / sweep.chirp_rate
    long_distance = dataclasses.replace(sweep, mode=Mode.LONG_DISTANCE, start_delay=0.0)
    power = {
        d: link_budget.received_power(sweep.tx_eirp, sweep.rx_antenna_gain, d, sweep.center_frequency)
        for d in (15.0, 1000.0, 5000.0)
    }
    thermal = link_budget.noise_density(0.0)
    rows = [
        ('start frequency f_0 (Table 1)', f'{sweep.start_frequency / 1e6:.0f} MHz'),
        ('bandwidth B_sw (Table 1)', f'{sweep.bandwidth / 1e6:.0f} MHz'),
        ('ramp duration T_sw (Table 1)', f'{sweep.ramp_duration * 1e3:.0f} ms'),
        ('sampling rate f_s (Table 1)', f'{sweep.sample_rate / 1e6:.3f} MS/s, {sweep.sample_count} samples per sweep'),
        ('TX power (Table 1)', f'{sweep.tx_eirp:.0f} dBm EIRP, {10 ** (sweep.tx_eirp / 10):.1f} mW'),
        ('antenna gains (Table 1)', f'TX 9 dBi (after {sweep.tx_eirp - 9:.0f} dBm), RX {sweep.rx_antenna_gain:g} dBi'),
        ('phase noise (Table 1)', '-90 dBc/Hz at 100 kHz; assumed shape: one pole, corner 200 kHz'),
        ('chirp rate k = B_sw / T_sw', f'{sweep.chirp_rate / 1e9:.0f} GHz/s'),
        ('1 Hz of f_IF is', f'{in_air / (2 * sweep.chirp_rate) * 1e3:.3f} mm of range'),
        ('1 FFT bin (1 kHz) of f_IF is', f'{in_air / (2 * sweep.chirp_rate) / sweep.ramp_duration:.3f} m'),
        ('resolution of one station, c / B_sw (one way)', f'{in_air / sweep.bandwidth:.2f} m'),
        ('sum of both carrier phases repeats every', f'{in_air / sweep.center_frequency / 2 * 1e3:.2f} mm'),
        ('Doppler', f'{sweep.center_frequency / sweep.chirp_rate * 1e3:.2f} mm per m/s'),
        ('largest range, short distance, T_off = f_s / (4 k)', _range(sweep, quarter, in_air)),
        ('largest range, short distance, T_off = 4 µs', _range(sweep, 4e-6, in_air)),
        ('largest range, long distance, T_off = 0', _range(long_distance, 0.0, in_air)),
        ('received power at 15 / 1000 / 5000 m', ' / '.join(f'{p:.1f}' for p in power.values()) + ' dBm'),
        *(
            (
                f'noise floor {name}',
                f'{NOISE_FLOORS[name]:.1f} dBm in {IF_BAND / 1e6:.3f} MHz, {floor_density(name):.1f} dBm/Hz, '
                f'noise figure {floor_density(name) - thermal:.0f} dB',
            )
            for name in NOISE_FLOORS
        ),
    ]  # fmt: skip
    return rows


def _range(sweep: SweepSettings, start_delay: float, velocity: float) -> str:
    return f'{largest_range(dataclasses.replace(sweep, start_delay=start_delay), velocity):.0f} m'
