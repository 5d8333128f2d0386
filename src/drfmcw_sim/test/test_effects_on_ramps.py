"""Effects that shape a ramp, against their closed forms and recordings made by another hand."""

import math

import numpy as np
import pytest
from checkout import DATA
from effect_scenes import BOTH_ON, RATE, SEED, analogue, made, measured, sized
from scipy import integrate
from scipy.signal import hilbert

from drfmcw_physics.settings import ConfigurationError
from drfmcw_sim.effects import Effect
from drfmcw_sim.synthesis.signal_model import draw_sweeps


def curvature(t, deviation, duration):
    return deviation * (1.0 - (2.0 * t / duration - 1.0) ** 2)


def ripple(t, deviation, rate, phase=0.0):
    return deviation * np.sin(2.0 * np.pi * rate * t + phase)


def settling(t, step, natural_frequency, damping):
    turning = natural_frequency * math.sqrt(1.0 - damping**2)
    return np.where(
        t < 0,
        0.0,
        step
        * np.exp(-2.0 * np.pi * damping * natural_frequency * np.maximum(t, 0.0))
        * np.cos(2.0 * np.pi * turning * t),
    )


def shape(t, coefficients, bandwidth):
    """Frequency error of a rate made of Bernstein's polynomials, to which four coefficients without knots come down."""
    x = np.asarray(t) / 1e-3
    mean = sum(coefficients) / 4
    integral = sum(
        (c / mean - 1.0) * sum(math.comb(4, j) * x**j * (1.0 - x) ** (4 - j) for j in range(i + 1, 5)) / 4
        for i, c in enumerate(coefficients)
    )
    return bandwidth * integral


UNEVEN = [1.002, 0.999, 1.0005, 1.001]
SHAPES = [
    ('sweep_curvature', {'deviation': 20e3}, lambda t: curvature(t, 20e3, 1e-3)),
    ('sweep_ripple', {'deviation': 500.0, 'rate': 9e3}, lambda t: ripple(t, 500.0, 9e3)),
    ('sweep_ripple', {'deviation': -3e3, 'rate': 700.0, 'phase': 2.2}, lambda t: ripple(t, -3e3, 700.0, 2.2)),
    ('sweep_shape', {'relative_rate': UNEVEN}, lambda t: shape(t, UNEVEN, 150e6)),
    (
        'pll_settling',
        {'step': 60e3, 'natural_frequency': 18e3, 'damping': 0.35},
        lambda t: settling(t, 60e3, 18e3, 0.35),
    ),
    (
        'pll_settling',
        {'step': -30e3, 'natural_frequency': 5e4, 'damping': 1.0},
        lambda t: settling(t, -30e3, 5e4, 1.0),
    ),
]


@pytest.mark.parametrize(('name', 'parameters', 'error'), SHAPES)
def test_chirp_phase_is_the_integral_of_the_frequency_error(name, parameters, error):
    """Against adaptive quadrature; the station's own clock runs 30 ppm fast, and so does the frequency."""
    m = measured(1, alphas=(1.0, 1.00003))
    (effect,) = made([sized(name, **parameters)])
    times = np.array([0.0, 1e-6, 33e-6, 0.5e-3, 1e-3])
    phase = effect.chirp_phase(m.stations[1], times[None])[0]
    for u, value in zip(times, phase, strict=True):
        integral, _ = integrate.quad(lambda t: 1.00003 * error(1.00003 * t), 0.0, u, epsabs=1e-12, limit=500)
        assert value == pytest.approx(2.0 * np.pi * integral, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ('name', 'parameters', 'count', 'share'),
    [
        ('sweep_curvature', {'deviation': 20e3}, 5, 1e-9),  # its rate is linear over the ramp
        ('sweep_shape', {'relative_rate': UNEVEN}, 4, 1e-9),
        ('sweep_shape', {'relative_rate': UNEVEN}, 7, 1e-9),  # the knots of four coefficients are among those of seven
        ('sweep_ripple', {'deviation': -3e3, 'rate': 1e3, 'phase': 2.2}, 12, 1e-3),  # one turn
    ],
)
def test_coefficients_imitate_what_another_effect_does_to_a_chirp(name, parameters, count, share):
    """What is left of its phase is a straight line: another start phase and another frequency."""
    m = measured(1, alphas=(1.0, 1.0))
    station = m.stations[1]
    times = np.linspace(0.0, station.sweep.ramp_duration, 400)[None]
    (effect,) = made([sized(name, **parameters)])
    phase = effect.chirp_phase(station, times)[0]
    shape_of = Effect.registry['sweep_shape']
    imitation = shape_of(relative_rate=shape_of.imitating(phase, station.sweep, count), station=station.name)

    def bend(phase):
        return np.abs(phase - np.polyval(np.polyfit(times[0], phase, 1), times[0])).max()

    assert bend(phase - imitation.chirp_phase(station, times)[0]) < share * bend(phase)


def dense_phase(station, times, error):
    """Transmit phase at `times`, in turns, by 5-point Gauss quadrature of the frequency between them; 64-bit mantissa.

    Args:
        station: its alpha counts; its ramp starts at time 0.
        times: rising [s].
        error: of the frequency in the station's own time and Hz; none is None.
    """
    x = np.longdouble
    alpha, sweep = x(station.alpha[0]), station.sweep
    nodes, weights = np.polynomial.legendre.leggauss(5)
    edges = np.concatenate([[0.0], times]).astype(x)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    t = alpha * (middle[:, None] + half[:, None] * nodes.astype(x))
    frequency = x(sweep.start_frequency) + x(sweep.bandwidth) / x(sweep.ramp_duration) * t
    if error is not None:
        frequency = frequency + error(t.astype(float))
    return np.cumsum(alpha * np.sum(frequency * weights.astype(x), axis=1) * half)


@pytest.mark.parametrize('homodyne', [False, True])
@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
@pytest.mark.parametrize(('name', 'parameters', 'error'), SHAPES)
def test_shaped_chirps_against_the_time_domain(name, parameters, error, bandwidth, homodyne):
    """Received phase within 1e-6 rad of chirps integrated step by step, mixed sample by sample.

    The shape acts at every station; the float32 samples' own rounding is 2e-7 rad of angle and as much of I and Q.
    """
    m = measured(1, 300.0, homodyne=homodyne, waveform={'iq': True, 'bandwidth': bandwidth})
    effects = made([{'effect': name, **parameters}])
    falls = name == 'sweep_shape' and bandwidth < 0.0  # its error goes with the rate
    drawn = m.rows(slice(None))
    draw_sweeps(drawn, SEED)

    def signed(t):
        return -error(t) if falls else error(t)

    for receiver, signal in enumerate(analogue(m, effects)):
        own, peer = m.stations[receiver], m.stations[-1 - receiver]
        sample = np.arange(24, 2024)
        u = np.longdouble(sample) / (np.longdouble(own.sweep.sample_rate) * np.longdouble(own.sample_clock[0]))
        between = 0.0 if homodyne else (m.start_delay[0], -m.start_delay[0])[receiver]
        v = u - np.longdouble(between) - np.longdouble(m.paths[0].delay[0])
        phases = drawn.initial_phase[:, 0]
        turns = dense_phase(own, u, signed) - dense_phase(peer, v, signed)
        turns = turns + (0.0 if homodyne else phases[receiver] - phases[1 - receiver])
        difference = np.angle(signal[0, sample]) / (2.0 * np.pi) - turns
        difference = (difference - np.rint(difference)).astype(float)
        assert np.max(np.abs(2.0 * np.pi * difference)) < 1e-6


@pytest.mark.parametrize('homodyne', [False, True])
@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
def test_rate_is_that_of_another_bandwidth(bandwidth, homodyne):
    """0.4 % too slow at every station: the phases of a ramp of 0.4 % less bandwidth that starts where this one does."""
    waveform = {'iq': True, 'bandwidth': bandwidth}
    stated, slow = (
        measured(2, 300.0, homodyne=homodyne, waveform=waveform | {'bandwidth': b})
        for b in (bandwidth, 0.996 * bandwidth)
    )
    effects = made([{'effect': 'sweep_rate', 'error': -0.4}])
    for a, b in zip(analogue(stated, effects), analogue(slow), strict=True):
        assert np.max(np.abs(np.angle(a[:, BOTH_ON] * np.conj(b[:, BOTH_ON])))) < 1e-6


def test_shape_of_any_mean_is_of_mean_one():
    """Coefficients twice as large are the same ramp; fewer than a cubic's are refused."""
    m = measured(1, alphas=(1.0, 1.0))
    one, twice = made([sized('sweep_shape', relative_rate=[f * r for r in UNEVEN]) for f in (1.0, 2.0)])
    t = np.linspace(0.0, 1e-3, 50)[None]
    assert np.allclose(one.chirp_phase(m.stations[1], t), twice.chirp_phase(m.stations[1], t), rtol=1e-9, atol=1e-6)
    with pytest.raises(ConfigurationError, match='too few'):
        made([sized('sweep_shape', relative_rate=[1.0, 1.0, 1.0])])


def test_nothing_of_a_ramp_is_received_outside_of_its_window():
    """Own samples by the own clock, the other's by its clock, when its chirp arrives; inside, every bit as it was."""
    m = measured(1, alphas=(1.0, 1.0), waveform={'iq': True})
    start, end = 50.2e-6, 900.3e-6
    tau, offset = m.paths[0].delay[0], m.start_delay[0]
    for name, late in (('slave', (tau + offset, 0.0)), ('master', (0.0, tau - offset))):  # when it counts zero
        entry = {'effect': 'ramp_window', 'station': name, 'start': start, 'end': end}
        for receiver, shift in enumerate(late):
            before, after = (analogue(m, made(entries))[receiver][0] for entries in ([], [entry]))
            time = np.arange(2048) / RATE - shift
            inside = (time >= start) & (time <= end)
            assert np.array_equal(after[inside], before[inside]) and np.all(before[inside])
            assert not after[~inside].any()
    apart = [sized('ramp_window', start=0.0, end=2e-4), {'effect': 'ramp_window', 'station': 'master', 'start': 5e-4}]
    assert not any(s.any() for s in analogue(m, made(apart)))  # never both at once


def test_hum_has_a_phase_of_its_own_in_each_sweep():
    """deviation / rate (cos psi - cos(2 pi rate u + psi)) at its own station, its negative a delay later at the other.

    psi, fitted to each of 40 sweeps, is uniform: its mean phasor exceeds 0.5 by chance once in 20000 (exp(-40 / 4)).
    """
    m = measured(40, alphas=(1.0, 1.0), waveform={'iq': True})
    deviation, rate = 300.0, 7e3
    effects = made([sized('frequency_modulation', deviation=deviation, rate=rate)])
    own, heard = (
        np.unwrap(np.angle(after * np.conj(before))[:, BOTH_ON], axis=1)
        for before, after in zip(analogue(m)[::-1], analogue(m, effects)[::-1], strict=True)
    )
    turn = 2.0 * np.pi * rate * np.arange(2048)[BOTH_ON] / RATE
    basis = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
    (cosine, sine, constant), *_ = np.linalg.lstsq(basis, own.T, rcond=None)
    psi = np.arctan2(sine, -cosine)
    assert np.hypot(cosine, sine) == pytest.approx(deviation / rate, rel=1e-4)
    assert constant == pytest.approx(deviation / rate * np.cos(psi), abs=1e-5)
    assert abs(np.mean(np.exp(1j * psi))) < 0.5
    late = turn - 2.0 * np.pi * rate * (m.paths[0].delay + m.start_delay)[:, None]
    expected = deviation / rate * (np.cos(late + psi[:, None]) - np.cos(psi[:, None]))
    assert np.max(np.abs(heard - expected)) < 1e-5


def test_ripple_in_closed_form():
    """(deviation / rate) (1 - cos 2 pi rate t), and nothing at the start whatever its phase."""
    m = measured(1, alphas=(1.0, 1.0))
    (effect,) = made([sized('sweep_ripple', deviation=500.0, rate=9000.0)])
    t = np.linspace(0.0, 1e-3, 500)[None]
    assert np.allclose(
        effect.chirp_phase(m.stations[1], t), 500 / 9000 * (1 - np.cos(2 * np.pi * 9000 * t)), atol=1e-12
    )
    (shifted,) = made([sized('sweep_ripple', deviation=500.0, rate=9000.0, phase=1.0)])
    assert shifted.chirp_phase(m.stations[1], t)[0, 0] == 0.0


# --- recordings made by another hand ---


def shape_of(phase):
    """Phase over the sweep without its parabola, weighted by a Hann window [..., samples]."""
    window = np.hanning(phase.shape[-1])
    basis = np.vander(np.linspace(-1.0, 1.0, len(window)), 3)
    coefficients, *_ = np.linalg.lstsq(basis * window[:, None], (phase * window).T, rcond=None)
    return (phase - (basis @ coefficients).T) * np.sqrt(window)


@pytest.mark.parametrize(
    ('recording', 'entries'),
    [
        (2, [sized('sweep_ripple', deviation=500.0, rate=9000.0, phase=p) for p in (0.0, math.pi / 2)]),
        (6, [sized('pll_settling', step=60e3, natural_frequency=18e3, damping=0.35)]),
    ],
)
def test_ramp_shapes_recorded_by_another_hand(recording, entries):
    """The IF phase's shape in a recording is that of the effect that the recording conceals, times one.

    24 sweeps at each of four distances, both stations; a shape is found to 1 %, mostly by how the analytic signal
    of a real record bends at its ends; within 4 %. The ripple's phase is unknown: two quadratures.
    """
    bag = pytest.importorskip('drfmcw_ros.bag.files')
    station = {2: 'master', 6: 'slave'}[recording]
    latest, sweeps = {}, {}
    with bag.BagReader(DATA / f'recording_{recording}') as reader:
        for topic, _, message in reader.messages():
            if topic.endswith('if_samples') and latest['/reference/range'].range < 200.0:
                place = 25 * round(latest['/reference/range'].range / 25)  # near enough: the ramps differ by ns
                sweeps.setdefault((message.station, place), []).append(message.samples)
            latest[topic] = message
    alphas = tuple(latest[f'/{name}/calibration'].alpha for name in ('master', 'slave'))
    rows = slice(40, 2000)
    found = []
    for (receiver, place), recorded in sweeps.items():
        if len(recorded) < 20:
            continue
        number = ('master', 'slave').index(receiver)
        m = measured(1, float(place), alphas=alphas, waveform={'iq': True})
        nominal = analogue(m)[number][0]
        sign = np.sign(np.angle(nominal[1001] / nominal[1000]))  # a real IF shows the positive line
        changed = [analogue(m, made([e | {'station': station}]))[number][0] for e in entries]
        templates = [shape_of(sign * np.unwrap(np.angle(c * np.conj(nominal))[rows])) for c in changed]
        phase = np.unwrap(np.angle(hilbert(np.array(recorded, float), axis=1)), axis=1)[:, rows]
        weights, *_ = np.linalg.lstsq(np.array(templates).T, shape_of(phase).mean(axis=0), rcond=None)
        found.append(weights)
    assert len(found) >= 4
    size = np.linalg.norm(found, axis=1) if len(entries) > 1 else np.array(found)[:, 0]
    assert np.mean(size) == pytest.approx(1.0, abs=0.04)
