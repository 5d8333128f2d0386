"""Beat frequencies against their truth, their own standard deviation and their promises. All random seeds are fixed."""

import collections
import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drfmcw_node.estimators.estimation import EstimatorSettings, Flag
from drfmcw_node.estimators.registry import estimator
from drfmcw_node.estimators.spectral import ChirpZ
from drfmcw_node.processing.early import EarlySweeps
from drfmcw_node.processing.excerpt import INTERVAL, Excerpt
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Beat, Sweep
from drfmcw_physics.bounds import additive_std
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, Role, SweepSettings, residual_chirp

FULL_SCALE = 8192.0
FIRST = SweepSettings('master', 'slave')
SECOND = SweepSettings('slave', 'master', role=Role.SECOND)
LOOP = SweepSettings('radar', 'radar', mode=Mode.LONG_DISTANCE, start_delay=0.0)
RESULTS = ('flags', 'frequency', 'frequency_std', 'independent_std', 'phase', 'power', 'snr', 'spectrum')


def calibration(station, alpha=1.0, floor=math.nan, level=math.nan):
    return Calibration(station, alpha=alpha, noise_floor=floor, phase_noise_level=level, phase_noise_corner=2e5)


def made(sweep=FIRST, iq=False, own=None, peer=None, **changes):
    return estimator(sweep, EstimatorSettings(**changes), iq, own, peer)


def instants(sweep):
    return np.arange(sweep.sample_count) / sweep.sample_rate


def sampled(wave):
    return np.round(wave).astype(np.int16)


def floor_variance(floor, sweep=FIRST):
    """Variance per sample [LSB^2] of a density [dBm/Hz] at the antenna port."""
    return 10 ** ((floor - sweep.full_scale_power) / 10) * FULL_SCALE**2 / 4 * sweep.sample_rate


def noisy_lines(rng, sweep, frequency, amplitude, floor, count, noises=()):
    """Real lines of random phase in white noise, with the phase noise of `noises`."""
    n = sweep.sample_count
    phase = 2 * np.pi * frequency * instants(sweep) + rng.uniform(0, 2 * np.pi, (count, 1))
    for noise in noises:
        f = np.fft.rfftfreq(4 * n, 1 / sweep.sample_rate)
        scale = 4 * n * np.sqrt(noise.phase_density(f) * f[1] / 4)
        drawn = scale * (rng.normal(size=(count, len(f))) + 1j * rng.normal(size=(count, len(f))))
        phase = phase + np.fft.irfft(drawn, 4 * n)[:, :n]
    wave = amplitude * np.cos(phase) + math.sqrt(floor_variance(floor)) * rng.normal(size=(count, n))
    return sampled(wave)


@given(frequency=st.floats(20e3, 1.0e6), phase=st.floats(-3.1, 3.1), amplitude=st.floats(100.0, 8000.0))
@settings(max_examples=60, deadline=None, derandomize=True)
@pytest.mark.parametrize('sweep', [FIRST, SECOND, LOOP], ids=['first', 'second', 'loop'])
@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_clean_line(name, sweep, frequency, phase, amplitude):
    """Frequency, phase at mid-sweep, power of a line in 1 LSB of noise; the bounds are 5 sigma of it and more."""
    t = instants(sweep)
    wave = amplitude * np.cos(2 * np.pi * frequency * (t - sweep.ramp_duration / 2) + phase)
    wave += np.random.default_rng(2).normal(size=t.shape)
    result = made(sweep, estimator=name)(sampled(wave)[None], FULL_SCALE)
    assert abs(result.frequency[0] - frequency) < 0.1 + 150.0 / amplitude
    assert abs(math.remainder(result.phase[0] - phase, 2 * math.pi)) < 1e-3 + 0.5 / amplitude
    level = 20 * math.log10(amplitude / FULL_SCALE) + sweep.full_scale_power
    assert abs(result.power[0] - level) < 0.01 + 3.0 / amplitude
    assert not result.flags[0] & (Flag.WEAK_SIGNAL | Flag.CLIPPED | Flag.AMBIGUOUS)


@pytest.mark.parametrize('deviation', [2e-6, 20e-6, -40e-6])
@pytest.mark.parametrize('sweep', [FIRST, SECOND], ids=['first', 'second'])
@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_residual_chirp_is_taken_off(name, sweep, deviation):
    """With references apart the line keeps its power, and its frequency is that at the centre of the window."""
    own, peer = calibration(sweep.station, 1.0 + deviation), calibration(sweep.peer)
    chirp, center = residual_chirp(sweep, own.alpha, peer.alpha), sweep.window_center()
    t = instants(sweep) - center
    wave = 3000 * np.cos(2 * np.pi * (523_456.7 * t + chirp / 2 * t**2) + 0.3)
    result = made(sweep, own=own, peer=peer, estimator=name)(sampled(wave)[None], FULL_SCALE)
    assert abs(result.frequency[0] - 523_456.7) < 0.1
    assert abs(result.power[0] - (20 * math.log10(3000 / FULL_SCALE) - 20)) < 0.01
    lead = sweep.ramp_duration / 2 - center
    expected = 2 * math.pi * (523_456.7 * lead + chirp / 2 * lead**2) + 0.3
    assert abs(math.remainder(result.phase[0] - expected, 2 * math.pi)) < 2e-3


@pytest.mark.parametrize('deviation', [0.0, 20e-6])
@pytest.mark.parametrize('iq', [False, True], ids=['real', 'quadrature'])
@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_same_bits_whatever_the_batch(name, iq, deviation):
    """Live nodes take 1..k sweeps at once, the replay hundreds; both must give the same numbers."""
    rng = np.random.default_rng(3)
    noises = calibration('master', 1.0 + deviation, -140.0, -90.0), calibration('slave', 1.0, -140.0, -90.0)
    estimate = made(iq=iq, own=noises[0], peer=noises[1], estimator=name)
    width = FIRST.sample_count * (2 if iq else 1)
    lines = [noisy_lines(rng, FIRST, f, 300.0, -140.0, 1)[0] for f in rng.uniform(3e4, 9.5e5, 130)]
    samples = np.stack([np.repeat(x, 2) if iq else x for x in lines])
    everything = np.ones(len(samples), bool)
    together = estimate(samples, FULL_SCALE, everything)
    for size in (1, 2, 7, 64):
        for offset in (0, 1, 3):  # of the samples in memory [2 bytes]
            memory = np.empty(samples.size + offset, np.int16)[offset:].reshape(-1, width)
            memory[:] = samples
            parts = [
                estimate(memory[i : i + size], FULL_SCALE, everything[i : i + size])
                for i in range(0, len(memory), size)
            ]
            for field in RESULTS:
                split = np.concatenate([getattr(p, field) for p in parts])
                assert np.array_equal(split, getattr(together, field)), (field, size, offset)


@pytest.mark.parametrize(
    ('power', 'floor', 'level', 'excess'),
    [
        (-37.2, -156.8, -90.0, 0.0),  # 15 m, floor A: phase noise rules
        (-37.2, -140.7, -90.0, 0.0),  # 15 m, floor B
        (-59.7, -140.7, -90.0, 0.0),  # 200 m
        (-73.7, -156.8, -90.0, 0.0),  # 1000 m, floor A
        (-73.7, -140.7, -90.0, 0.0),  # 1000 m, floor B: additive noise rules
        (-67.7, -140.7, -90.0, 10.0),  # the floor has risen by 10 dB since calibration
        (-67.7, math.nan, math.nan, 0.0),  # nothing characterised: the noise is measured
    ],
)
@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_standard_deviation_is_true(name, power, floor, level, excess):
    """Chi-square of 600 errors over the reported variance; false failure 1e-5 each (4.4 sigma of 0.058)."""
    rng = np.random.default_rng(11)
    own, peer = calibration('master', 1.0, floor, level), calibration('slave', 1.0, floor, level)
    noises = [PhaseNoise(level, 2e5)] * 2 if math.isfinite(level) else []
    true_floor = (floor if math.isfinite(floor) else -140.7) + excess
    amplitude = FULL_SCALE * 10 ** ((power - FIRST.full_scale_power) / 20)
    samples = noisy_lines(rng, FIRST, 611_234.5, amplitude, true_floor, 600, noises)
    result = made(own=own, peer=peer, estimator=name)(samples, FULL_SCALE)
    chi_square = np.mean(((result.frequency - 611_234.5) / result.frequency_std) ** 2)
    assert abs(chi_square - 1.0) < 0.26
    quantisation = 10 * math.log10(1 + 1 / 12 / floor_variance(true_floor))
    assert abs(np.median(result.snr) - (power - true_floor - 30.0 - quantisation)) < 0.6


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_weak_lines_are_flagged_and_noise_is_no_line(name):
    """Below 13 dB nothing is valid; 500 sweeps of noise hold a false line with a probability of 1e-3 each at most."""
    rng = np.random.default_rng(5)
    samples = noisy_lines(rng, FIRST, 4e5, 0.0, -140.7, 500)
    weak = made(estimator=name)(samples, FULL_SCALE).flags & Flag.WEAK_SIGNAL > 0
    assert weak.mean() > 0.99  # false failure 1e-4


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_silence(name):
    """A sweep without any signal is no measurement."""
    result = made(estimator=name)(np.zeros((1, 2048), np.int16), FULL_SCALE)
    assert result.flags[0] & Flag.WEAK_SIGNAL
    assert math.isnan(result.frequency[0]) and math.isinf(result.frequency_std[0])


def flags_of(wave, sweep=FIRST, **changes):
    return Flag(int(made(sweep, **changes)(sampled(wave)[None], FULL_SCALE).flags[0]))


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_flags_say_what_is_wrong(name):
    """Each doubt raises its flag, and a plain line raises none."""
    t = instants(FIRST)
    noise = np.random.default_rng(6).normal(0, 6, t.shape)

    def flags(wave):
        return flags_of(wave, estimator=name)

    def line(frequency, amplitude=1000.0):
        return amplitude * np.cos(2 * np.pi * frequency * t) + noise

    assert flags(line(4.1e5)) == Flag.VALID
    assert flags(np.clip(line(4.1e5), -700, 700)) & Flag.CLIPPED
    assert flags(line(4.1e5, 8191.0)) & Flag.CLIPPED
    assert flags(line(8.5e3)) & Flag.NEAR_DC
    assert flags(line(2.0e3)) & (Flag.NEAR_DC | Flag.WEAK_SIGNAL)
    assert flags(line(1.0155e6)) & Flag.NEAR_NYQUIST
    assert flags(line(4.1e5) + line(5.3e5, 800.0)) & Flag.AMBIGUOUS
    assert flags(line(4.1e5) + line(5.3e5, 100.0)) == Flag.VALID
    assert flags(line(4.1e5) + 3000.0) == Flag.VALID  # a constant


@pytest.mark.parametrize('name', ['paper', 'hann'])
def test_leakage_at_dc_does_not_win(name):
    """A station that hears itself has a strong leakage below the line."""
    t = instants(LOOP)
    wave = 2000 * np.cos(2 * np.pi * 900.0 * t) + 150 * np.cos(2 * np.pi * 25_000.0 * t)
    assert abs(made(LOOP, estimator=name)(sampled(wave)[None], FULL_SCALE).frequency[0] - 25_000.0) < 20.0


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
@pytest.mark.parametrize('sign', [1, -1])
def test_quadrature_line_of_either_sign(sign, name):
    """A quadrature line has no mirror image; its frequency is reported positive."""
    t = instants(FIRST)
    phase = 2 * np.pi * 300_123.4 * (t - FIRST.ramp_duration / 2) + 0.7
    wave = 2000 * np.exp(1j * sign * phase)
    samples = sampled(np.column_stack([wave.real, wave.imag]).reshape(1, -1))
    result = made(iq=True, estimator=name)(samples, FULL_SCALE, np.ones(1, bool))
    assert abs(result.frequency[0] - 300_123.4) < 0.05
    assert abs(math.remainder(result.phase[0] - 0.7, 2 * math.pi)) < 1e-3
    assert abs(result.power[0] - (20 * math.log10(2000 / FULL_SCALE) - 20)) < 0.01
    axis = result.spectrum_start + result.spectrum_step * np.arange(result.spectrum.shape[1])
    assert abs(axis[result.spectrum[0].argmax()] - sign * 300_123.4) < 1000.0


def test_spectrum_of_a_full_scale_sine_reads_zero():
    """The spectrum is float32 in dBFS, one bin per 1/T."""
    t = instants(FIRST)
    wave = (FULL_SCALE - 1) * np.cos(2 * np.pi * 400e3 * t)
    result = made()(sampled(wave)[None], FULL_SCALE, np.ones(1, bool))
    assert result.spectrum.dtype == np.float32 and result.spectrum.shape == (1, 1025)
    assert result.spectrum_step == 1000.0
    assert abs(result.spectrum[0].max()) < 0.01 and result.spectrum[0].argmax() == 400


@pytest.mark.parametrize('window', ['boxcar', 'hann', 'blackmanharris'])
def test_windows_reach_their_own_bound(window):
    """The additive bound holds for each window; 400 errors, false failure 1e-5 (4.4 sigma of 0.035)."""
    rng = np.random.default_rng(8)
    samples = noisy_lines(rng, LOOP, 512_345.6, 1000.0, -120.0, 400)
    result = made(LOOP, window=window)(samples, FULL_SCALE)
    snr = 1000.0**2 / 2 / (2 * floor_variance(-120.0) / LOOP.sample_rate / LOOP.ramp_duration)
    ratio = np.std(result.frequency - 512_345.6) / additive_std(snr, LOOP.ramp_duration, window)
    assert abs(ratio - 1.0) < 0.16


@pytest.mark.parametrize('name', ['paper', 'hann', 'ml'])
def test_any_sweep_length(name):
    """A sample count with a large prime factor, a second-long sweep."""
    long = dataclasses.replace(LOOP, sample_rate=40e3, sample_count=40001, ramp_duration=1.0)
    wave = 5000 * np.cos(2 * np.pi * 1234.567 * instants(long))
    assert abs(made(long, estimator=name)(sampled(wave)[None], 32768.0).frequency[0] - 1234.567) < 1e-4


def test_impossible_settings_are_refused():
    with pytest.raises(ConfigurationError, match='minimum_frequency'):
        EstimatorSettings(minimum_frequency=5e5, maximum_frequency=4e5)
    with pytest.raises(ConfigurationError, match="window = 'blackman' is for estimator 'paper'"):
        EstimatorSettings(estimator='ml', window='blackman')
    with pytest.raises(ConfigurationError, match='no frequency to search'):
        made(minimum_frequency=2e6)
    with pytest.raises(ConfigurationError, match='fewer than 16 samples'):
        made(dataclasses.replace(FIRST, start_delay=0.999e-3))


def sweep_at(stamp, number=0, **changes):
    wave = 1000 * np.cos(2 * np.pi * 4.1e5 * instants(FIRST) + stamp)
    return Sweep('master', 'slave', number, FULL_SCALE, False, sampled(wave), stamp, **changes)


def test_processor_goes_by_stamp():
    """Settings hold from their stamp on, in whatever order they arrive; what cannot be evaluated is counted."""
    processor = StationProcessor()
    assert processor.process([sweep_at(5)]) == []
    processor.add_calibration(calibration('master'))
    processor.add_sweep_config(dataclasses.replace(FIRST, stamp=20, full_scale_power=-10.0))
    processor.add_sweep_config(dataclasses.replace(FIRST, stamp=10))
    assert processor.process([sweep_at(15)]) == []
    processor.add_calibration(calibration('slave'))
    beats = processor.process([sweep_at(s, i) for i, s in enumerate((9, 10, 19, 20, 21))])
    assert [b.sweep_id for b in beats] == [1, 2, 3, 4]
    assert np.round(np.diff([b.power for b in beats]), 2).tolist() == [0.0, 10.0, 0.0]
    assert processor.dropped.total() == 3 and processor.sweeps == 7
    assert processor.process([sweep_at(20, 3)]) == beats[2:3]


def test_processor_refuses_bad_sweeps_with_a_reason():
    processor = StationProcessor()
    for station in ('master', 'slave'):
        processor.add_calibration(calibration(station))
    processor.add_sweep_config(FIRST)
    good = sweep_at(1)
    bad = [
        dataclasses.replace(good, samples=good.samples[:-1]),
        dataclasses.replace(good, iq=True),
        dataclasses.replace(good, full_scale=math.nan),
        dataclasses.replace(good, samples=good.samples.astype(float)),
        dataclasses.replace(good, peer='nobody'),
    ]
    assert len(processor.process([*bad, good])) == 1
    assert len(processor.dropped) == 5 and set(processor.dropped.values()) == {1}
    assert any('2047 samples of master, but 2048' in reason for reason in processor.dropped)


def test_spectra_are_decimated_by_sweep_number():
    processor = StationProcessor()
    for station in ('master', 'slave'):
        processor.add_calibration(calibration(station))
    processor.add_sweep_config(FIRST)
    sweeps = [sweep_at(i + 1, i) for i in range(7)]
    beats, spectra = processor.process_with_spectra(sweeps, lambda sweep: sweep.sweep_id % 3 == 0)
    assert [s.sweep_id for s in spectra] == [0, 3, 6] and len(beats) == 7
    assert processor.process(sweeps) == beats


def test_excerpt_has_ten_sweeps_a_second_of_each_peer_with_line_and_spectrum():
    """Sweeps of two peers, 200 a second of each, evaluated in batches of three; a dropped one is not missed."""
    processor, excerpt = StationProcessor(), Excerpt()
    for station in ('master', 'slave', 'tower'):
        processor.add_calibration(calibration(station))
    for peer in ('slave', 'tower'):
        processor.add_sweep_config(dataclasses.replace(FIRST, peer=peer))
    sweeps = [dataclasses.replace(sweep_at(1 + i, i), peer=('slave', 'tower')[i % 2]) for i in range(402)]
    found = collections.defaultdict(list)
    for i in range(0, len(sweeps), 3):
        excerpt.begin(i / 400.0)
        beats, spectra = processor.process_with_spectra(sweeps[i : i + 3], excerpt.choose)
        assert [s.sweep_id for s in spectra] == [b.sweep_id for b in beats if excerpt.holds(b)]
        assert all(excerpt.holds(spectrum) for spectrum in spectra)
        for spectrum in spectra:
            found[spectrum.peer].append(i / 400.0)
    for times in found.values():
        assert 9 <= len(times) <= 11 and min(np.diff(times)) >= INTERVAL
    assert set(found) == {'slave', 'tower'}


def test_excerpt_has_both_stations_of_a_pair():
    excerpt = Excerpt()
    excerpt.begin(5.0)
    first = sweep_at(1, 3)
    assert excerpt.choose(first) and not excerpt.choose(first)
    of = dict(sweep_id=3, flags=0, frequency=1.0, frequency_std=1.0, phase=0.0, power=0.0, snr=0.0, stamp=1)
    assert excerpt.holds(Beat('slave', 'master', **of)) and excerpt.holds(Beat('master', 'slave', **of))
    assert not excerpt.holds(Beat('slave', 'tower', **of))
    excerpt.begin(5.01)
    assert not excerpt.holds(Beat('slave', 'master', **of))


def test_sweeps_that_overtake_their_settings_wait_in_order_and_not_for_ever():
    processor = StationProcessor()
    early = EarlySweeps(processor)
    sweeps = [Sweep('master', 'slave', i, FULL_SCALE, False, np.zeros(2048, np.int16), 100 + i) for i in range(4)]
    assert early.release(sweeps[:1], 0.0) == []
    processor.add_sweep_config(FIRST)
    processor.add_calibration(calibration('master'))
    assert early.release(sweeps[1:2], 1.0) == []
    processor.add_calibration(calibration('slave'))
    assert early.release(sweeps[2:3], 2.0) == sweeps[:3]
    stranger = dataclasses.replace(sweeps[3], peer='nobody')
    assert early.release([stranger], 3.0) == []
    assert early.release([], 10.0) == [stranger]
    assert processor.process([stranger]) == []
    assert sum(processor.dropped.values()) == 1


def own_echo(velocity, sweeps=100, count=1000, distance=60.0):
    """Sweeps of a straight ramp from 24 GHz, 500 MHz in 1 ms, whose path changes, with 1 LSB of noise, and settings."""
    settings = SweepSettings(
        'radar', 'radar', mode=Mode.LONG_DISTANCE, start_frequency=24e9, bandwidth=500e6, ramp_duration=1e-3,
        start_delay=0.0, sample_rate=count / 1e-3, sample_count=count,
    )  # fmt: skip
    time = np.arange(count) / settings.sample_rate
    begin = 2e-3 * np.arange(sweeps)[:, None]
    delay = (distance + velocity * (begin + time)) / 299792458.0
    turns = settings.start_frequency * delay + settings.chirp_rate * (delay * time - delay**2 / 2.0)
    noise = np.random.default_rng(1).normal(size=(sweeps, count))
    return np.rint(500.0 * np.cos(2.0 * np.pi * turns) + noise).astype(np.int16), settings


@pytest.mark.parametrize('velocity', [0.0, 3.0, -3.0, 30.0])
def test_a_target_that_moves_is_no_bent_ramp(velocity):
    """Its line changes by 2 B v / c over the sweep, 10 Hz at 3 m/s; false alarms below 1e-4 in 100 sweeps."""
    samples, settings = own_echo(velocity)
    found = estimator(settings, EstimatorSettings(estimator='ml'))(samples, 2048.0)
    assert not np.any(found.flags & Flag.MODEL_MISMATCH)


def test_a_bent_ramp_is_one_whether_the_target_moves_or_not():
    samples, settings = own_echo(3.0)
    share = np.linspace(0.0, 1.0, samples.shape[1])
    bent = own_echo(3.0)[0][:, np.clip(np.rint(1000 * (share + 0.01 * np.sin(6 * np.pi * share))), 0, 999).astype(int)]
    found = estimator(settings, EstimatorSettings(estimator='ml'))(bent, 2048.0)
    assert np.all(found.flags & Flag.MODEL_MISMATCH)


@pytest.mark.parametrize(
    ('count', 'length', 'points', 'span'),
    [(2048, 2048, 33, 2.0), (1001, 1008, 65, 16.0), (4096, 5000, 1025, 1.0), (17, 18, 5, 2.0)],
)
def test_zoom_is_the_spectrum_between_bins(count, length, points, span):
    """The sum itself, term by term, to less than the rounding of float32; the same bits for each sweep alone."""
    rng = np.random.default_rng(1)
    center = count / 2 - 0.3
    zoom = ChirpZ(count, length, points, span, center)
    samples = rng.standard_normal((3, count)).astype(np.float32)
    bins = rng.integers(1, length // 2, 3)
    found = zoom(samples, bins)
    cycles = (bins[:, None] + zoom.offsets)[..., None] * (np.arange(count) - center) / length
    expected = (np.exp(-2j * np.pi * cycles) * samples[:, None]).sum(axis=2)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(samples).sum(axis=1).min()
    for row in range(3):
        assert np.array_equal(zoom(samples[row : row + 1], bins[row : row + 1])[0], found[row])
