"""Effects in a receiver, against their closed forms."""

import math

import numpy as np
import pytest
from effect_scenes import BOTH_ON, CHIRP, RATE, SEED, analogue, made, measured, sized

from drfmcw_sim.synthesis.signal_model import synthesise


def test_received_signal_falls_over_the_ramp():
    """The line's logarithmic amplitude has the slope over the station's own ramp, with an echo too; noise has none."""
    m = measured(2, waveform={'iq': True}, alphas=(1.0, 1.0))
    entry = sized('amplitude_slope', slope=3.0)
    with_echo = sized('echo', excess_range=7.5, relative_power=-20.0)
    for others in ([], [with_echo]):
        before, after = (analogue(m, made(entries))[1][:, BOTH_ON] for entries in (others, [*others, entry]))
        time = np.arange(2048)[BOTH_ON] / RATE
        fitted = np.polyfit(time / 1e-3, 20.0 * np.log10(np.abs(after / before)).T, 1)
        assert fitted[0] == pytest.approx(-3.0, abs=1e-4)
        assert fitted[1] == pytest.approx(0.0, abs=1e-4)
    for station in m.stations:
        station.received_power[:] = -300.0
    assert np.array_equal(synthesise(m, SEED)[1], synthesise(m, SEED, made([entry]))[1])


def received(entry, signal, iq=False):
    """A signal [LSB] after the receive hook of an effect at the slave."""
    m = measured(1, waveform={'iq': iq}, alphas=(1.0, 1.0))
    (effect,) = made([entry])
    signal = np.array(signal, np.float32)[None]
    effect.receive(signal, m.stations[1], m, lambda: [np.random.default_rng(1)])
    return signal[0].astype(float)


def tone(amplitude, cycles, count=2048):
    """A cosine with a whole number of cycles in the record."""
    return amplitude * np.cos(2.0 * np.pi * cycles * np.arange(count) / count)


def line(signal, cycles):
    """Complex amplitude of a line with that many cycles in the record."""
    return 2.0 * np.mean(signal * np.exp(-2j * np.pi * cycles * np.arange(len(signal)) / len(signal)))


def test_compression_makes_a_third_harmonic():
    """x - c x^3 of A cos: A - 3/4 c A^3 at f and -1/4 c A^3 at 3f, also where 3f aliases."""
    for cycles, third in ((100, 300), (500, 2048 - 1500)):
        for level in (0.0, -6.0):
            a = 10 ** (level / 20)
            signal = received(sized('compression', third_order=0.2), tone(8192.0 * a, cycles)) / 8192.0
            assert line(signal, cycles) == pytest.approx(a - 0.75 * 0.2 * a**3, abs=1e-6)
            assert line(signal, third) == pytest.approx(-0.25 * 0.2 * a**3, abs=1e-6)


def test_second_order_makes_a_second_harmonic_and_a_mean():
    """x + c x^2 of A cos: c A^2 / 2 at 2f and as the mean, also where 2f aliases; -20 log10(c A / 2) below the line."""
    for cycles, second in ((100, 200), (700, 2048 - 1400)):
        for a in (1.0, 0.5):
            signal = received(sized('second_order_distortion', second_order=-0.2), tone(8192.0 * a, cycles)) / 8192.0
            assert line(signal, cycles) == pytest.approx(a, abs=1e-6)
            assert line(signal, second) == pytest.approx(-0.5 * 0.2 * a**2, abs=1e-6)
            assert np.mean(signal) == pytest.approx(-0.5 * 0.2 * a**2, abs=1e-6)
            below = 20.0 * math.log10(abs(line(signal, cycles)) / abs(line(signal, second)))
            assert below == pytest.approx(-20.0 * math.log10(0.2 * a / 2.0), abs=1e-3)


def test_leakage_is_a_line_at_its_delay():
    """A constant without delay; with one a line at k delay, its phase f_0 delay less half of what the chirp adds."""
    level = 8192.0 * 10 ** (-40.0 / 20)
    constant = received(sized('tx_leakage', level=-40.0), np.zeros(2048))
    assert constant[:2048] == pytest.approx(level)
    for delay in (40e-9, 700e-9):
        added = received(sized('tx_leakage', level=-40.0, delay=1e9 * delay), np.zeros((2048, 2)), iq=True)
        wave = added[:, 0] + 1j * added[:, 1]
        first = math.ceil(delay * RATE)  # before, the leaked chirp has not arrived
        assert not wave[:first].any()
        turns = np.arange(first, 2048) / RATE * CHIRP * delay + 5.725e9 * delay - 0.5 * CHIRP * delay**2
        assert np.max(np.abs(wave[first:] - level * np.exp(2j * np.pi * turns))) < 1e-4
        real = received(sized('tx_leakage', level=-40.0, delay=1e9 * delay), np.zeros(2048))
        assert np.array_equal(real, added[:, 0])


def test_clipping_is_a_limiter():
    """A sine of twice the limit keeps the fundamental of a clipped sine; one below the limit is not touched."""
    limit = 8192.0 * 10 ** (-33.0 / 20)
    for ratio in (2.0, 1.2):
        signal = received(sized('clipping', level=-33.0), tone(ratio * limit, 101))
        assert np.max(np.abs(signal)) == pytest.approx(limit, rel=1e-6)
        share = 2.0 / np.pi * (math.asin(1 / ratio) + math.sqrt(1 - 1 / ratio**2) / ratio)
        assert abs(line(signal, 101)) == pytest.approx(ratio * limit * share, rel=1e-4)
    below = tone(0.99 * limit, 101).astype(np.float32)
    assert np.array_equal(received(sized('clipping', level=-33.0), below), below.astype(float))


def test_filter_halves_the_power_at_its_pole():
    """1/sqrt(2) and -45 degrees at the pole, 1 / (1 + j f / pole) at all frequencies, mirrored in a quadrature IF."""
    middle = slice(500, 1500)  # the record's ends ring
    n = np.arange(2048)
    for pole, frequency in ((3e5, 3e5), (3e5, 1e5), (1.5e6, 3e5), (3e5, 8e5)):
        wave = 2.0 * np.pi * frequency / RATE * n
        expected = 1.0 / (1.0 + 1j * frequency / pole)
        if pole == frequency:
            assert abs(expected) == pytest.approx(math.sqrt(0.5)) and np.angle(expected) == pytest.approx(-np.pi / 4)
        kernel = np.hanning(1000) * np.exp(-1j * wave[middle])
        real = received(sized('if_filter', pole=pole), 1000.0 * np.cos(wave))
        measured_ = np.sum(real[middle] * kernel) / np.sum(np.cos(wave[middle]) * kernel) / 1000.0
        assert measured_ == pytest.approx(expected, abs=2e-5)
        for sign in (1.0, -1.0):
            stacked = 1000.0 * np.stack([np.cos(wave), sign * np.sin(wave)], axis=-1)
            both = received(sized('if_filter', pole=pole), stacked, iq=True)
            both = both[:, 0] + 1j * both[:, 1]
            kernel = np.hanning(1000) * np.exp(-1j * sign * wave[middle])
            filtered = np.sum(both[middle] * kernel) / np.sum(np.hanning(1000)) / 1000.0
            assert filtered == pytest.approx(expected if sign > 0 else np.conj(expected), abs=2e-5)


def test_coupling_passes_a_line_and_forgets_a_constant():
    """j f / (pole + j f) of a line; a step decays to 1/e in 1 / (2 pi pole), also over many times the record.

    The step is that of a record that begins: band-limited, it counts from half a sample before its first sample, and
    the cut at Nyquist rings by pole / (f_s / 2) / (pi n) n samples from it.
    """
    middle, n = slice(500, 1500), np.arange(2048)
    for pole, frequency in ((3e5, 3e5), (3e4, 1e5), (1e3, 8e5), (30.0, 3e5)):
        wave = 2.0 * np.pi * frequency / RATE * n
        expected = 1j * frequency / (pole + 1j * frequency)
        kernel = np.hanning(1000) * np.exp(-1j * wave[middle])
        passed = received(sized('ac_coupling', pole=pole), 1000.0 * np.cos(wave))
        found = np.sum(passed[middle] * kernel) / np.sum(np.cos(wave[middle]) * kernel) / 1000.0
        assert found == pytest.approx(expected, abs=5e-5)
        step = received(sized('ac_coupling', pole=pole), np.full(2048, 1000.0))
        decay = 1000.0 * np.exp(-2.0 * np.pi * pole * (n + 0.5) / RATE)
        ringing = 1000.0 * pole / (RATE / 2) / np.pi / np.minimum(n + 1.0, 2048.0 - n)
        assert np.all(np.abs(step - decay)[20:-20] < ringing[20:-20] + 0.01)


def test_settling_is_an_exponential():
    """Its level as the sweep starts, 1/e of it a time constant later, in I alone."""
    added = received(sized('receiver_settling', level=-40.0, time_constant=2e-4), np.zeros(2048))
    assert added == pytest.approx(81.92 * np.exp(-np.arange(2048) / RATE / 2e-4), rel=1e-5)
    both = received(sized('receiver_settling', level=-40.0, time_constant=2e-4), np.zeros((2048, 2)), iq=True)
    assert np.array_equal(both[:, 0], added) and not both[:, 1].any()


def test_imbalance_makes_an_image():
    """Q is cos(D - 90 deg - phase), gain times: (1 + g exp(-j phase)) / 2 at f, (1 - g exp(j phase)) / 2 at -f."""
    turn = 2.0 * np.pi * 100.0 * np.arange(2048) / 2048
    stacked = 1000.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    for gain, phase in ((0.5, 2.0), (-1.0, 0.0), (0.0, -5.0)):
        found = received(sized('iq_imbalance', gain=gain, phase=phase), stacked, iq=True)
        g, angle = 10.0 ** (gain / 20.0), math.radians(phase)
        assert found[:, 0] == pytest.approx(stacked[:, 0], abs=1e-4)
        assert found[:, 1] == pytest.approx(1000.0 * g * np.cos(turn - math.pi / 2 - angle), abs=1e-3)
        spectrum = np.fft.fft(found[:, 0] + 1j * found[:, 1]) / 2048 / 1000.0
        assert spectrum[100] == pytest.approx(0.5 * (1.0 + g * np.exp(-1j * angle)), abs=1e-6)
        assert spectrum[-100] == pytest.approx(0.5 * (1.0 - g * np.exp(1j * angle)), abs=1e-6)
    real = tone(1000.0, 100).astype(np.float32)
    assert np.array_equal(received(sized('iq_imbalance', gain=1.0, phase=5.0), real), real)


def test_filter_acts_on_noise_too():
    """White noise leaves with the mean of |H|^2; 300 sweeps of 1900 samples, correlated over 3: 0.4 %; within 3 %."""
    m = measured(300)
    for station in m.stations:
        station.received_power[:] = -300.0
    noise = synthesise(m, SEED, quantised=False)[1]
    filtered = synthesise(m, SEED, made([sized('if_filter', pole=2e5)]), quantised=False)[1]
    nyquist = RATE / 2.0
    expected = 2e5 / nyquist * math.atan(nyquist / 2e5)
    assert np.var(filtered[:, 100:-48]) / np.var(noise[:, 100:-48]) == pytest.approx(expected, rel=0.03)
    behind = synthesise(m, SEED, made([sized('if_filter', pole=2e5, noise_behind=True)]), quantised=False)[1]
    assert np.allclose(behind, noise, atol=1e-6)
    m = measured(2)  # the signal is filtered all the same, and an amplifier sees both
    for station in m.stations:
        station.phase_noise = None
    entries = [sized('if_filter', pole=2e5), sized('compression', third_order=50.0)]
    behind = [entries[0] | {'noise_behind': True}, entries[1]]
    assert np.array_equal(analogue(m, made(entries))[1], analogue(m, made(behind))[1])
    signal = analogue(m, made(entries[:1]))[1] + (synthesise(m, SEED, quantised=False)[1] - analogue(m)[1])
    whole = synthesise(m, SEED, made(behind), quantised=False)[1]
    assert np.max(np.abs(whole - signal * (1.0 - 50.0 * (signal / 8192.0) ** 2))) < 1e-3


def test_filter_lies_before_amplifier_and_adc():
    """Whatever the order in the list: filtered, compressed, clipped."""
    m = measured(2)
    entries = [sized('clipping', level=-48.0), sized('compression', third_order=1.0), sized('if_filter', pole=3e5)]
    signal = synthesise(m, SEED, noise=False, quantised=False)[1]
    for effect in made(entries[::-1]):
        effect.receive(signal, m.stations[1], m, None)
    assert np.array_equal(signal, synthesise(m, SEED, made(entries), noise=False, quantised=False)[1])
