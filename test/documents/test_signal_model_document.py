"""docs/signal_model.md against the code: every name in it, its formulas where no other test holds them, its sizes."""

import ast
import dataclasses
import functools
import importlib
import importlib.util
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest
from checkout import ROOT
from simulated_pairs import if_turns, pair

from drfmcw_fusion.combination import Station as Combined
from drfmcw_fusion.combination import combine
from drfmcw_node.processing.records import Beat
from drfmcw_physics import bounds, link_budget
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration, range_bias
from drfmcw_physics.phase_noise import PhaseNoise, combination_gain
from drfmcw_physics.sweep import Mode, SweepSettings

DOCUMENT = ROOT / 'docs' / 'signal_model.md'
TEXT = DOCUMENT.read_text(encoding='utf-8')
SWEEP = SweepSettings('a', 'b')  # Table 1
NOISE = PhaseNoise(-90.0, 200e3)
FLOORS = {'A': -157.8, 'B': -140.7}  # [dBm/Hz]
MODES = [(Mode.SHORT_DISTANCE, 3.41e-6, 200.0), (Mode.LONG_DISTANCE, 0.6e-6, 1000.0)]


def module_of(name):
    """Return (module, rest of the name) of a dotted name."""
    parts = name.split('.')
    for end in range(len(parts), 0, -1):
        try:
            spec = importlib.util.find_spec('.'.join(parts[:end]))
        except ModuleNotFoundError:
            continue
        if spec:
            return importlib.import_module('.'.join(parts[:end])), parts[end:]
    raise AssertionError(f'{name}: no such module')


def member(owner, name):
    """Return an attribute, or the type of a dataclass field that has no default."""
    if dataclasses.is_dataclass(owner) and name in {f.name for f in dataclasses.fields(owner)}:
        return getattr(owner, name, str)
    return getattr(owner, name)


def test_names_in_the_document_are_those_of_the_code():
    names = re.findall(r'\[`(drfmcw_\w+(?:\.\w+)+)`\]\(([^)]*)\)', TEXT)
    assert len(names) > 80
    assert len(names) == len(re.findall(r'`drfmcw_\w+\.[\w.]+', TEXT)), 'a name without link'
    for name, link in names:
        module, rest = module_of(name)
        functools.reduce(member, rest, module)
        assert (DOCUMENT.parent / link).resolve() == Path(inspect.getfile(module)).resolve(), name


def test_tests_in_the_document_exist():
    names = re.findall(r'\[`(test_\w+)`\]\(([^)]*)\)', TEXT)
    assert len(names) > 50
    for name, link in names:
        tree = ast.parse((DOCUMENT.parent / link).read_text(encoding='utf-8'))
        assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}, (name, link)


def test_every_section_with_a_formula_says_where_it_is_computed_and_tested():
    for section in re.split(r'^##+ ', TEXT, flags=re.MULTILINE):
        last = section.rpartition('```')[2]
        if '```math' in section:
            assert '*Code*: ' in last and '*Test*: ' in last, section.splitlines()[0]


def test_formulas_are_what_github_renders():
    """Balanced; none of the macros GitHub refuses; nothing in a line that Markdown would take for its own."""
    blocks = re.findall(r'^```math\n(.*?)^```', TEXT, re.DOTALL | re.MULTILINE)
    rest = re.sub(r'`[^`]*`', '', re.sub(r'^```.*?^```', '', TEXT, flags=re.DOTALL | re.MULTILINE))
    inline = re.findall(r'\$([^$]*)\$', rest)
    assert rest.count('$') % 2 == 0
    for formula in blocks + inline:
        assert formula.count('{') == formula.count('}'), formula
        assert not re.search(r'\\(operatorname|newcommand|label|href)', formula), formula
    for formula in inline:
        assert formula == formula.strip() and '\n' not in formula, formula
        assert not re.search(r'\\[^A-Za-z]|[|*<`]|[)}]_', formula), formula


@pytest.mark.parametrize('receiver', [0, 1])
def test_phases_are_those_of_equations_16_and_17(receiver):
    """Term by term as the paper prints them, up to their constants; the integer phases keep 1e-8 turns."""
    delay, late, a1, a2 = 0.7e-6, 3.41e-6, 1 + 6e-6, 1 - 9e-6
    turns = if_turns(pair(1, delay, alphas=(a1, a2), clocks=(1.0, 1.0), start_delay=late), receiver)[0]
    f0, k = SWEEP.start_frequency, SWEEP.chirp_rate
    t = np.arange(2048) / SWEEP.sample_rate + late * receiver
    common = f0 * t * (a1 - a2) + k * t**2 / 2 * (a1**2 - a2**2) + k * t * a2**2 * late
    expected = common + a2**2 * k * t * delay if receiver == 0 else -common + a1**2 * k * t * delay
    error = turns - expected
    error -= error[0]
    assert np.max(np.abs(error - np.rint(error))) < 3e-8


@pytest.mark.parametrize(('mode', 'late', 'distance'), MODES)
def test_sum_of_both_phases_is_that_of_the_path(mode, late, distance):
    """tau (2 f(t) - k (T_off + tau)), station 2's phase referred back by f_2 T_off; initial phases cancel."""
    delay, middle = distance / SPEED_OF_LIGHT, 1024
    m = pair(1, delay, start_delay=late, mode=int(mode))
    m.initial_phase[:, 0] = 0.3, 0.9
    total = sum(if_turns(m, receiver)[0, middle] for receiver in (0, 1))
    total -= SWEEP.chirp_rate * (delay - late) * late
    f = SWEEP.start_frequency + SWEEP.chirp_rate * middle / SWEEP.sample_rate
    error = total - delay * (2 * f - SWEEP.chirp_rate * (late + delay))
    assert abs(error - round(error)) < 1e-7


def beat_sum(mode, late, delay, rate=0.0):
    """Return the slope of D_1 + D_2 at the windows' centre [Hz], sampled fast enough for every line."""
    total = 0.0
    for receiver in (0, 1):
        fast = {'sample_rate': 8.192e6, 'sample_count': 8192}
        m = pair(1, delay, rate, start_delay=late, mode=int(mode), **fast)
        turns = np.unwrap(if_turns(m, receiver)[0], period=1.0)
        milliseconds = (np.arange(len(turns)) / 8.192e6 - m.stations[receiver].sweep.window_center()) * 1e3
        total += np.polynomial.polynomial.polyfit(milliseconds, turns, 2)[1] * 1e3
    return total, m.stations[0].sweep


@pytest.mark.parametrize(('mode', 'late', 'distance'), MODES)
def test_motion_reads_as_range(mode, late, distance):
    """f_c / k + t_c per velocity, but for the age of the chirp that arrives."""
    speed, delay = 2.0, distance / SPEED_OF_LIGHT
    moving, sweep = beat_sum(mode, late, delay, speed / SPEED_OF_LIGHT)
    standing, _ = beat_sum(mode, late, delay)
    measured = (moving - standing) * SPEED_OF_LIGHT / (2 * sweep.chirp_rate) / speed
    center = sweep.window_center()
    predicted = (sweep.start_frequency + sweep.chirp_rate * center) / sweep.chirp_rate + center
    assert measured - predicted == pytest.approx(-(delay + late / 2), abs=1e-8)


def lines(distance, floor, iq=False):
    """Return (both stations' lines and their noise, delay) at a distance [m] with a floor [dBm/Hz]."""
    delay = distance / SPEED_OF_LIGHT
    late = 3.41e-6 if distance < 650 else 0.6e-6
    power = link_budget.received_power(SWEEP.tx_eirp, SWEEP.rx_antenna_gain, distance, SWEEP.center_frequency)
    ratio = 10 ** ((power - floor) / 10)
    k = SWEEP.chirp_rate
    return tuple(bounds.LineNoise(ratio, abs(f), 2.048e6, iq) for f in (k * (late + delay), k * (late - delay))), delay


def range_bound(distance, floor, iq=False):
    """Return the Cramer-Rao bound of a sweep pair's range [m]."""
    of, delay = lines(distance, floor, iq)
    bound = bounds.coloured_bound(of, (NOISE, NOISE), SWEEP.ramp_duration, delay).frequency
    return bound * SPEED_OF_LIGHT / (2 * SWEEP.chirp_rate)


def test_mirror_line_is_the_floor_of_a_real_if():
    assert range_bound(15.0, FLOORS['A']) == pytest.approx(0.17e-3, abs=0.005e-3)
    assert range_bound(15.0, FLOORS['A'], iq=True) < 0.02e-3


def loss_of_white_weights(distance, floor):
    """Return by how much equal weights exceed the bound under coloured noise [1]."""
    of, delay = lines(distance, floor)
    duration = SWEEP.ramp_duration
    variance = 2 * bounds.phase_noise_std(NOISE, duration, 'boxcar', delay) ** 2
    for line in of:
        inverse = 1 / (line.carrier_to_noise * duration)
        inverse += 2 * float(bounds.image_noise_ratio(NOISE, line.frequency, duration, line.sample_rate))
        variance += bounds.additive_std(1 / inverse, duration) ** 2
    best = bounds.coloured_bound(of, (NOISE, NOISE), duration, delay).frequency
    return math.sqrt(variance) / best - 1


def largest_loss_of_white_weights():
    return max(loss_of_white_weights(d, f) for d in (15.0, 50.0, 200.0, 500.0, 1000.0) for f in FLOORS.values())


def test_white_weights_lose_almost_nothing():
    """Maximum likelihood without the phase noise's covariance stays within 0.3 % of the bound, up to 1 km."""
    assert -1e-3 < largest_loss_of_white_weights() < 3e-3


def combined(mode, late, distance, alpha, jitter):
    """Return the combination of noise-free lines, T_off other than nominal by `jitter` [s]."""
    m = pair(1, distance / SPEED_OF_LIGHT, alphas=(alpha, 1.0), clocks=(1.0, 1.0), start_delay=late, mode=int(mode))
    m.start_delay = m.start_delay + jitter
    stations = []
    for receiver, s in enumerate(m.stations):
        turns = np.unwrap(if_turns(m, receiver)[0], period=1.0)
        milliseconds = (np.arange(2048) / SWEEP.sample_rate - s.sweep.window_center()) * 1e3
        slope = np.polynomial.polynomial.polyfit(milliseconds, turns, 2)[1] * 1e3
        phase = 2 * math.pi * turns[1024] * np.sign(slope)  # half a ramp after the sweep start, of the positive line
        beat = Beat(s.name, s.sweep.peer, 0, 0, abs(slope), 1.0, phase, -60.0, 40.0, 0)
        stations.append(Combined(beat, s.sweep, Calibration(s.name, alpha=s.alpha[0])))
    return combine(*stations)


@pytest.mark.parametrize('alpha', [1.0, 1 + 40e-6])
@pytest.mark.parametrize(('mode', 'late', 'distance'), MODES)
def test_combined_phase_is_free_of_start_delay_jitter(mode, late, distance, alpha):
    """5 ns of jitter, which would be 0.06 mm, leave less than 0.0005 mm."""
    late_one, nominal = (combined(mode, late, distance, alpha, jitter) for jitter in (5e-9, 0.0))
    change = (late_one.carrier_phase - nominal.carrier_phase) / (2 * math.pi)
    assert abs(change - round(change)) * SPEED_OF_LIGHT / (2 * SWEEP.center_frequency) < 5e-7


@pytest.mark.parametrize('alpha', [1.0, 1 + 40e-6])
@pytest.mark.parametrize(('mode', 'late', 'distance'), MODES)
def test_combined_phase_counts_the_path_at_its_frequency(mode, late, distance, alpha):
    """20 m further, the phase has turned as often as half wavelengths of `phase_frequency` fit in: to 0.01 mm."""
    near, far = (combined(mode, late, d, alpha, 0.0) for d in (distance, distance + 20.0))
    turns = (far.carrier_phase - near.carrier_phase) / (2 * math.pi)
    half_wave = SPEED_OF_LIGHT / (near.phase_frequency + far.phase_frequency)
    left = turns - 20.0 / half_wave
    assert abs(left - round(left)) * half_wave < 1e-5


def sizes():
    """Yield (words of the row, size as it stands there) of the document's last section."""
    k, f0, fc = SWEEP.chirp_rate, SWEEP.start_frequency, SWEEP.center_frequency
    ramp, rate, light = SWEEP.ramp_duration, SWEEP.sample_rate, SPEED_OF_LIGHT
    acceleration = 10.0 / light
    apart = (1 + 40e-6) ** 2 - 1
    yield 'fourth power', f'{k * acceleration**2 / 8 * ramp**4:.0e} turns'
    yield '3 c_3 a b^2', f'{2 * math.pi * 3 * (0.5 * k * acceleration / rate**3) * 2048 * 32**2:.0e} rad'
    # int32 to float32, its unit, the product: half a unit in the last place each, at half a turn
    yield 'float32', f'{2 * math.pi * 2.0**-26 + math.pi * 2.0**-24 + 2.0**-23:.0e} rad'
    yield 'time of arrival', f'{2.0 * (1000.0 / light) / 2 * 1e6:.1f} µm'
    yield 'change of the acceleration', f'{1.0 * ramp**3 / 6:.1e} m'
    yield 'Friis at mid-sweep', f'{20 * math.log10(1 + SWEEP.bandwidth / f0):.2f} dB'
    yield 'warm-up', f'{fc * 2e-6 / 300.0 * ramp:.2f} Hz'
    yield 'above $f_s/2$', f'{(1 - 2 / math.pi * math.atan(rate / 2 / NOISE.corner)) * 100:.1f} %'
    yield 'periodic', f'{math.exp(-8):.1e}'
    yield 'second order of the drift', f'{(math.pi * 40e-6 * 1024) ** 2 / 2 * 100:.1f} %'
    yield 'dispersion', f'{k * 100e-12:.0f} Hz'
    yield 'white weights', f'{largest_loss_of_white_weights() * 100:.2f} %'
    variance = pair(1, floor=FLOORS['A']).stations[0].noise_std()[0] ** 2
    yield '1/12 LSB²', f'{10 * math.log10(1 + 1 / 12 / variance):.2f} dB'
    yield (
        'with the nominal $T_\\mathrm{off}$: jitter of 2 ns, ref',
        f'{apart * k * 2e-9 * light / (2 * k) * 1e3:.3f} mm',
    )
    mode, late, distance = MODES[1]
    delay = distance / light
    center = dataclasses.replace(SWEEP, mode=int(mode), start_delay=late).window_center()
    yield 'half wavelength', f'{((f0 + k * center) * 2 - (2 * fc - k * (late + 2 * delay))) / (2 * fc):.1e}'
    yield 'Doppler', f'{(delay + late / 2) * 1e6:.1f} µm'
    yield 'hardware delay', f'{10e-9 / 2 * apart / 2 * light * 1e3:.2f} mm'
    # range_bias is the reference's alone; ADCs that run from it count half of it back
    yield 'calibration', f'{(range_bias(1000.0, 1 + 1e-6, 1 + 1e-6) - 1000.0 * 1e-6) * 1e3:.1f} mm'


def test_sizes_of_what_is_left_out():
    rows = [line for line in TEXT.partition('## Where the model stops')[2].splitlines() if line.startswith('| ')]
    expected = list(sizes())
    for words, size in expected:
        (row,) = [r for r in rows if words in r.split(' | ')[0]]
        assert size in row.split(' | ')[1], (row, size)
    assert sum(any(c.isdigit() for c in r.split(' | ')[-1]) for r in rows) == len(expected)


def test_numbers_in_the_text():
    powers = {
        d: link_budget.received_power(SWEEP.tx_eirp, SWEEP.rx_antenna_gain, d, SWEEP.center_frequency)
        for d in (15.0, 1000.0)
    }
    amplitudes = [pair(1, power=p).stations[0] for p in powers.values()]
    near, far = (float(s.amplitude(s.received_power)[0]) for s in amplitudes)
    deviations = {name: pair(1, floor=floor).stations[0].noise_std()[0] for name, floor in FLOORS.items()}
    modes = [dataclasses.replace(SWEEP, mode=int(mode), start_delay=late) for mode, late, _ in MODES]
    starts = [m.analysis_window()[0] - m.start_delay for m in modes]
    center = modes[0].window_center()
    gains = [10 * math.log10(combination_gain(1e4, d / SPEED_OF_LIGHT)) for d in powers]
    for words in (
        f'{gains[0]:.0f} dB at 10 kHz and 15 m, {gains[1]:.1f} dB at 1 km',
        f'{powers[15.0]:.1f} dBm and {near:.0f} LSB at 15 m, {powers[1000.0]:.1f} dBm and {far:.0f} LSB at 1000 m',
        f'is {deviations["B"]:.2f} LSB, floor A',
        f'{deviations["A"]:.2f} LSB. The ADC',
        f'({starts[0] * 1e6:.2f} µs in short-distance, {starts[1] * 1e6:.2f} µs in long-distance mode)',
        f'{SPEED_OF_LIGHT / 1.0003 / (2 * SWEEP.center_frequency) * 1e3:.2f} mm',
        f'{SWEEP.center_frequency / SWEEP.chirp_rate * 1e3:.2f} mm + {center * 1e3:.2f} mm per m/s',
        f'= {bounds.additive_factor("boxcar"):.3f} without window',
        f'{bounds.additive_factor("hann"):.3f}\nwith a Hann window',
        f'= {2 * math.pi * SWEEP.center_frequency * SWEEP.ramp_duration:.1e}'.replace('e+0', 'e') + ' rad',
    ):
        assert words in TEXT, words
