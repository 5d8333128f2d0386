"""What the comparison counts of an effect, against what theory gives."""

import dataclasses
import math

import numpy as np
import pytest
from checkout import DATA
from scenes import record, scene

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.engine import diagnose
from drfmcw_diagnosis.features.adc_codes import piled
from drfmcw_diagnosis.features.extractor import Extractor, ramp_spectrum
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_physics.constants import DECIBELS_PER_NEPER
from drfmcw_sim.effects import Effect


def test_all_of_an_amplitude_slope_counts_but_its_mean():
    """A slope of s Np per sample over K samples has s^2 (K^3 - K) / 12 beside its mean."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    slope = 0.05
    template = comparison.template((Effect.registry['amplitude_slope'](station='slave', slope=slope),))
    std = comparison.std['ramp'][:, 1]  # amplitude at the second station
    assert np.isinf(std[:, 0]).all() and np.isfinite(std[:, 1:]).all()
    terms, step = std.shape[1], comparison.time[1] - comparison.time[0]
    each = slope / DECIBELS_PER_NEPER * step / 1e-3
    whole = each**2 * (terms**3 - terms) / 12.0
    expected = math.sqrt(np.sum(whole / std[:, 1] ** 2))
    counted = template[comparison.entries.where(kind='ramp', station=1)]
    assert np.linalg.norm(counted) == pytest.approx(expected, rel=0.03)


def test_a_quiet_receiver_shows_what_a_noisy_one_hides(tmp_path):
    """Sum and difference of the phases have the noise of the receiver 20 dB noisier in common: beside it, both show it.

    What noise alone leaves has the variance one, to 5 standard deviations: a false failure in a million.
    """
    noisy = {'effect': 'noise_floor', 'station': 'slave', 'excess': 20.0}
    standing = {'distances': [120.0, 210.0, 320.0], 'sweeps': 40}
    scenario = scene({'standing': standing}, effects=[noisy], reference={'range_std': 0.005})
    comparison = Comparison(read_dataset(record(scenario, tmp_path / 'r')))
    whitening, of_ramp = Fitting(comparison).whitening, comparison.entries.where(kind='ramp')
    bend = comparison.template((Effect.registry['sweep_curvature'](station='master', deviation=100.0),))
    assert np.sum(whitening(bend)[of_ramp] ** 2) > 5.0 * np.sum(bend[of_ramp] ** 2)
    phases = of_ramp & (comparison.entries.station >= 2)
    left = whitening(comparison.residual)[phases]
    left = left[left != 0.0]
    assert abs(np.sum(left**2) - len(left)) < 5.0 * math.sqrt(2.0 * 1.1 * len(left))


def test_noise_behind_a_coupling_is_as_expected(tmp_path):
    """Its bands next to 0 Hz rise with the square of the frequency; chi-square fails with a chance of 1e-6."""
    coupling = {'effect': 'ac_coupling', 'station': 'slave', 'pole': 600e3}
    standing = {'distances': [120.0, 210.0, 320.0], 'sweeps': 40}
    scenario = scene({'standing': standing}, effects=[coupling], reference={'range_std': 0.005})
    comparison = Comparison(read_dataset(record(scenario, tmp_path / 'r')))
    template = comparison.template((Effect.registry['ac_coupling'](station='slave', pole=600e3),))
    left = (comparison.residual - template)[comparison.entries.where(kind='noise', station=1)]
    left = left[np.isfinite(left)]
    assert np.sum(left**2) < len(left) + 5.0 * math.sqrt(2.0 * len(left)) + 10.0


def test_the_median_of_few_sweeps_shows_a_steep_band(tmp_path):
    """Bins scatter by a fifth about a power that falls to nothing; their median is 0.3 dB below that of the power.

    The mean of 12 bands exceeds five standard deviations with a chance of 1e-6.
    """
    coupling = {'effect': 'ac_coupling', 'station': 'slave', 'pole': 45e3}
    standing = {'distances': np.linspace(300.0, 620.0, 12).tolist(), 'sweeps': 24}
    scenario = scene({'standing': standing}, effects=[coupling], reference={'range_std': 0.005})
    comparison = Comparison(read_dataset(record(scenario, tmp_path / 'r')))
    template = comparison.template((Effect.registry['ac_coupling'](station='slave', pole=45e3),))
    left = (comparison.residual - template)[comparison.entries.where(kind='noise', station=1)]
    lowest = left.reshape(12, -1)[:, 0]
    assert np.isfinite(lowest).all()
    assert abs(np.mean(lowest)) < 5.0 / math.sqrt(12.0)


@pytest.mark.parametrize('cut', range(0, 200, 10))
def test_both_stations_are_compared_over_the_same_spans(cut):
    """The later start of one window may leave out a span that the other one covers."""
    data = read_dataset(DATA / 'recording_0')
    sweeps = tuple(dataclasses.replace(s, cut=(cut / s.sample_rate, 0.0)) for s in data.sweeps[0])
    samples = tuple(data.samples_of(i)[:2] for i in data.topology.heard)
    features = Extractor(sweeps, data.calibration, data.topology)(samples, 32767.0, 1.0003)
    assert features.quiet.shape[:2] == (2, 2) and np.all(features.quiet > 0.0)


@pytest.mark.parametrize('period', [2, 4])
def test_interleaved_converters_leave_no_ripple(period):
    """The image of a line turns with the converters against it, by whole turns in each block of the sweep.

    Blocks of 19 samples would see a ripple of 1e-2 by four converters.
    """
    data = read_dataset(DATA / 'recording_0')
    sweep, step = data.sweeps[0][0], np.arange(data.sweeps[0][0].sample_count)
    phases = np.arange(8)[:, None] * (np.pi / 8)
    line = 9000.0 * np.cos(2.0 * np.pi * 150.3e3 / sweep.sample_rate * step + phases)
    gain = np.where(step % period == 0, 1.05, 1.0)
    extract = Extractor(data.sweeps[0], data.calibration, data.topology)
    clean, uneven = (extract((x, x), 32767.0, 1.0003).ramp.mean(axis=0) for x in (line, line * gain))
    change = ramp_spectrum(uneven - clean)[:, 3:]
    assert np.abs(change).max() < 2e-4


def test_even_harmonics_beside_a_slope_leave_nothing_of_the_ramp(tmp_path):
    """What squares make beside the line has the line's phase once, so half a turn of phases does not cancel it.

    The ramp leaves less than chance does once in 10 000; the recording is fixed.
    """
    effects = {'second_order_distortion': ('slave', 'second_order', 14.0), 'amplitude_slope': ('master', 'slope', 6.0)}
    entries = [{'effect': name, 'station': station, p: value} for name, (station, p, value) in effects.items()]
    standing = {'distances': [25.0, 45.0, 70.0, 100.0, 140.0], 'sweeps': 16}
    path = record(scene({'standing': standing}, effects=entries, reference={'range_std': 0.005}), tmp_path / 'r')
    fitting = Fitting(Comparison(read_dataset(path)))
    start = [
        (Candidate(name, station, Effect.registry[name].recipes[0], {}), {p: value})
        for name, (station, p, value) in effects.items()
    ]
    found = fitting.fit(start)
    fitting.trust(found)
    left = leftovers(fitting, fitting.fit(found.start))
    assert min(x.probability for x in left if x.kind == 'ramp') > 1e-4


@pytest.mark.parametrize('depth', [-0.3, 0.1, 1.0])
def test_samples_at_a_limit_follow_the_strength_of_each_sweep(depth, tmp_path):
    """A tenth of a decibel brings a hundred samples of 2000 to a limit; the link budget knows none of 0.4 dB.

    Counts of 16 sweeps, Poisson, are within 5 standard deviations and 5 % of the simulation's: the limiter's ends of a
    crest are rounded by noise. The recording is fixed.
    """
    standing = {'standing': {'distances': [30.0, 60.0, 90.0], 'sweeps': 16}}
    uneven = {'amplitude_scatter': 0.4}
    free = Comparison(read_dataset(record(scene(standing, timing=uneven), tmp_path / 'free')))
    line = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max())
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': line - depth}
    comparison = Comparison(read_dataset(record(scene(standing, timing=uneven, effects=[limiter]), tmp_path / 'r')))
    predicted = comparison.predict((Effect.registry['clipping'](station='slave', level=line - depth),))
    found, expected = comparison.measured.piled[0, 1], predicted.piled[0, 1]
    assert found > 20.0
    assert abs(found - expected) < 5.0 * comparison.std['piled'][0, 1] + 0.05 * found


def test_samples_at_a_limit_follow_a_line_that_rises_and_falls_within_the_ramp(tmp_path):
    """A second path makes it so, and the limit holds its crests: its power falls by more than its mean log amplitude.

    Counts of 16 sweeps, Poisson, are within 5 standard deviations and 1 % of the simulation's; by the power, 28 % more
    would pile up. The recording is fixed.
    """
    standing = {'standing': {'distances': [30.0, 60.0], 'sweeps': 16}}
    ground = {'effect': 'ground_reflection', 'coefficient': 0.6, 'height_product': 70.0}
    free = Comparison(read_dataset(record(scene(standing, effects=[ground]), tmp_path / 'free')))
    level = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max()) - 3.0
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': level}
    comparison = Comparison(read_dataset(record(scene(standing, effects=[ground, limiter]), tmp_path / 'r')))
    acting = [Effect.registry['ground_reflection'](coefficient=0.6, height_product=70.0)]
    predicted = comparison.predict((*acting, Effect.registry['clipping'](station='slave', level=level)))
    found, expected = comparison.measured.piled[0, 1], predicted.piled[0, 1]
    assert abs(found - expected) < 5.0 * comparison.std['piled'][0, 1] + 0.01 * found


def test_harmonics_lie_where_the_sweeps_that_reach_a_limit_have_them(tmp_path):
    """Few sweeps of 12 reach it, each at a frequency of its own; the strongest passes for one with a burst.

    No bin of 833 is off by 5 standard deviations; noise alone is in one of two thousand recordings. This one is fixed.
    """
    standing = {'standing': {'distances': [30.0, 60.0, 90.0], 'sweeps': 12}}
    uneven = {'amplitude_scatter': 0.4, 'start_delay_jitter': 4e-9}
    free = Comparison(read_dataset(record(scene(standing, timing=uneven), tmp_path / 'free')))
    level = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max()) + 0.3
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': level}
    comparison = Comparison(read_dataset(record(scene(standing, timing=uneven, effects=[limiter]), tmp_path / 'r')))
    assert comparison.recorded.sweeps[0].free[:, 1].sum() == 11
    left = comparison.residual - comparison.template((Effect.registry['clipping'](station='slave', level=level),))
    assert np.abs(left[comparison.entries.where(kind='lines', station=1, group=0)]).max() < 5.0


def test_noise_beside_a_limit_is_known_as_well_as_the_phases_of_few_sweeps(tmp_path):
    """At a quarter of the sampling rate a sweep meets the limit with all its crests or with none, by its phase.

    Then 12 sweeps miss the prediction of others by 9 standard deviations of the noise, but not by 4 of what is said of
    it; at a line 15 kHz away nothing is off, nor said to be. The recording is fixed.
    """
    standing = {'standing': {'distances': [30.0, 60.0], 'sweeps': 12}}
    quarter = {'start_delay_short': 3.5406e-6}
    free = Comparison(read_dataset(record(scene(standing, mode=quarter), tmp_path / 'free')))
    line = free.sweeps[0].line[:, 1].mean()
    assert abs(line - free.recorded.sample_rate / 4.0) < 50.0
    level = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max()) - 6.0
    limiter = {'effect': 'clipping', 'station': 'slave', 'level': level}
    comparison = Comparison(read_dataset(record(scene(standing, mode=quarter, effects=[limiter]), tmp_path / 'r')))
    effects = (Effect.registry['clipping'](station='slave', level=level),)
    left = comparison.residual - comparison.template(effects)
    doubt = comparison.scattering(effects) / comparison.std['noise']
    near, away = (left[comparison.entries.where(kind='noise', station=1, group=group)] for group in (0, 1))
    assert np.abs(near).max() > 6.0
    assert np.abs(near / np.hypot(1.0, doubt[0, 1])).max() < 4.0
    assert np.abs(away).max() < 4.0
    assert doubt[1, 1].max() < 3.0
    assert doubt[:, 0].max() < 0.01  # the other receiver


def test_a_band_that_only_the_modelled_line_fills_casts_no_doubt(tmp_path):
    """A curved ramp shifts the line out of a band which the model has it fill, and so knows no noise of."""
    curved = {'effect': 'sweep_curvature', 'station': 'slave', 'deviation': -26e3}
    standing = {'standing': {'distances': [30.0, 60.0], 'sweeps': 12}}
    path = record(scene(standing, mode={'start_delay_short': 3.24e-6}, effects=[curved]), tmp_path / 'r')
    fitting = Fitting(Comparison(read_dataset(path)))
    assert np.isnan(fitting.comparison.std['noise']).any()
    start = Candidate('second_order_distortion', 'slave', Effect.registry['second_order_distortion'].recipes[0], {})
    fitted = fitting.fit([(start, {'second_order': 0.5})], 0)
    assert np.isfinite(fitting.doubt(fitted)).all()


def test_noise_passes_a_distortion_with_the_line(tmp_path):
    """Noise blurs a limit, which takes 0.1 dB more of a line of about its height, and an even curve gives noise a mean.

    Level and mean are those of 60 sweeps to 5 standard deviations of their scatter. The recording is fixed.
    """
    standing = {'standing': {'distances': [260.0, 300.0, 340.0], 'sweeps': 60}}
    free = Comparison(read_dataset(record(scene(standing), tmp_path / 'free')))
    level = float(free.measured.amplitude[0, 1]) - 20.0 * math.log10(free.data.full_scale[1].max())
    effects = {'clipping': {'level': level - 2.0}, 'second_order_distortion': {'second_order': -20.0}}
    entries = [{'effect': name, 'station': 'slave', **values} for name, values in effects.items()]
    comparison = Comparison(read_dataset(record(scene(standing, effects=entries), tmp_path / 'r')))
    predicted = comparison.predict(tuple(Effect.registry[name](station='slave', **v) for name, v in effects.items()))
    for kind in ('amplitude', 'mean'):
        found, expected = (getattr(x, kind)[:, 1].ravel() for x in (comparison.measured, predicted))
        scatter = [getattr(s, kind)[:, 1].std() / math.sqrt(60.0) for s in comparison.sweeps]
        assert np.all(np.abs(found - expected) < 5.0 * np.array(scatter))


def test_a_modulation_shows_beside_bursts_in_sweeps_without_one(tmp_path):
    """It changes the ramp from sweep to sweep at its own rate; noise alone does so by as much once in a million."""
    bursts = {'probability': 0.25, 'level': -40.0, 'duration': 5e-5}
    modulation = {'deviation': 60.0, 'rate': 6e3}
    entries = [
        {'effect': name, 'station': 'slave', **values}
        for name, values in (('interference_burst', bursts), ('frequency_modulation', modulation))
    ]
    standing = {'standing': {'distances': [30.0, 60.0, 90.0, 130.0], 'sweeps': 24}}
    fitting = Fitting(Comparison(read_dataset(record(scene(standing, effects=entries), tmp_path / 'r'))))
    recipe = Effect.registry['interference_burst'].recipes[0]
    found = fitting.fit([(Candidate('interference_burst', 'slave', recipe, bursts), bursts)])
    fitting.trust(found)
    left = fitting.whitening(fitting.comparison.residual - found.template)
    left = left[fitting.comparison.entries.where(kind='flutter')]
    assert np.sum(left**2) > np.count_nonzero(left) + 5.0 * math.sqrt(2.0 * np.count_nonzero(left)) > 0.0


def test_distances_at_which_the_line_drowns_are_left_out(tmp_path):
    """Where noise may pass for the line, ranges are hundreds of metres off; what is near shows the loss."""
    loss = {'effect': 'amplitude_loss', 'loss': 38.0}
    standing = {'distances': [15.0, 30.0, 60.0, 250.0, 400.0], 'sweeps': 12}
    scenario = scene({'standing': standing}, effects=[loss], reference={'range_std': 0.005})
    found = diagnose(record(scenario, tmp_path / 'r'))
    assert any('hardly stand out of the noise' in said for said in found.not_testable)
    (named,) = found.explanation.effects
    assert named.effect == 'amplitude_loss'
    assert abs(named.parameters['loss'].value - 38.0) < 4.0 * named.parameters['loss'].std


def test_noise_raises_the_level_that_a_weak_line_shows(tmp_path):
    """By 1 dB, 7 standard deviations, at 400 m: levels are means of log amplitudes. Both agree to 4, one seed."""
    concealed = {'effect': 'noise_floor', 'station': 'slave', 'excess': 24.0}
    standing = {'distances': [120.0, 200.0, 300.0, 400.0], 'sweeps': 48}
    path = record(scene({'standing': standing}, effects=[concealed], reference={'range_std': 0.005}), tmp_path / 'r')
    comparison = Comparison(read_dataset(path))
    noisy = Effect.registry['noise_floor'](station='slave', excess=24.0)
    rise = (comparison.predict([noisy]).amplitude - comparison.plain.amplitude) / comparison.std['amplitude']
    assert abs(rise[0, 1]) < 0.1 and rise[3, 1] > 7.0
    rest = comparison.residual - comparison.template([noisy])
    assert np.abs(rest[comparison.entries.where(kind='amplitude')]).max() < 4.0


def test_phases_that_slip_in_the_noise_are_no_modulation(tmp_path):
    """At 10 dB in a block and less, sweeps slip by a turn, which raises slow terms by 8 standard deviations here.

    No number of what is compared exceeds 5, which noise does in one of a thousand such recordings; one seed.
    """
    concealed = {'effect': 'noise_floor', 'station': 'slave', 'excess': 22.0}
    standing = {'distances': [60.0, 120.0, 200.0, 300.0, 400.0], 'sweeps': 26}
    path = record(scene({'standing': standing}, effects=[concealed], reference={'range_std': 0.005}), tmp_path / 'r')
    comparison = Comparison(read_dataset(path))
    flutter = comparison.residual[comparison.entries.where(kind='flutter')].reshape(comparison.std['flutter'].shape)
    phases = flutter[:, [c.of_phase for c in comparison.recorded.channels]]
    assert phases[0].any()  # near ones are compared
    assert phases.max() < 5.0


def test_distances_at_which_a_spur_passes_for_the_line_are_left_out(tmp_path):
    """There the range is hundreds of metres off, at any distance that is compared less than a decimetre."""
    spur = {'effect': 'spur', 'station': 'slave', 'frequency': 561e3, 'level': -47.5}
    standing = {'distances': [30.0, 60.0, 120.0, 540.0, 700.0], 'sweeps': 8}
    path = record(scene({'standing': standing}, effects=[spur], reference={'range_std': 0.005}), tmp_path / 'r')
    comparison = Comparison(read_dataset(path))
    distances = [comparison.data.distance[m].mean() for m in comparison.members]
    assert 2 <= len(distances) < 5 and max(distances) < 540.0
    assert all(np.abs(comparison.recorded.range_error(g)).max() < 0.1 for g in range(len(distances)))


def test_a_crane_that_sways_gives_a_distortion_no_phase_of_its_own():
    """What a distortion adds at random phases has no mean after the signal's begin, however far the crane swings."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    sway = Effect.registry['sway'](amplitude=0.13, frequency=0.64)
    distortion = Effect.registry['second_order_distortion'](station='slave', second_order=-0.18)
    shown = comparison.template((sway, distortion))[comparison.entries.where(kind='transient', station=1)]
    assert np.sum(shown**2) < 0.5 * len(shown)


def test_air_does_not_move_a_crane_that_stands():
    """Readings of the reference scatter by millimetres: 500 ppm of that moves nothing, though a phase would show it."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    moved = comparison.template((Effect.registry['air_refractivity'](offset=-500.0),))
    assert comparison.recorded.standing.all() and np.isfinite(comparison.std['movement']).all()
    assert np.abs(moved[comparison.entries.where(kind='movement')]).max() < 1e-6


def test_the_strongest_line_that_is_tried_fits_single_precision():
    """A fit that overflows goes on with parameters that are no numbers."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    effect = Effect.registry['amplitude_loss']
    lowest, _ = effect.recipes[0].limits['loss']
    assert np.isfinite(comparison.template((effect(loss=lowest),))).all()


@pytest.mark.parametrize('name', ['sweep_curvature', 'second_order_distortion'])
def test_the_ramp_follows_a_strong_bend_without_steps(name):
    """No bin of a line that bends by 20 kHz is the strongest for long; the third difference of three steps shows it."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))

    def template(step: int) -> np.ndarray:
        bend = Effect.registry['sweep_curvature'](station='slave', deviation=-20670.0 + 10.0 * step)
        if name == 'sweep_curvature':
            return comparison.template((bend,))[comparison.entries.where(kind='ramp')]
        bent = dataclasses.replace(bend, deviation=-20670.0)
        return comparison.template((bent, Effect.registry[name](second_order=0.525 + 1e-3 * step)))

    first, second, third, last = (template(step) for step in range(4))
    assert np.linalg.norm(last - 3.0 * (third - second) - first) < 0.1 * np.linalg.norm(last - first)


def test_codes_at_which_a_crest_ends_change_little():
    """A square has a sharp edge, whose place among the codes is chance: it changes the pile by 35 % at most.

    Among codes that lie elsewhere for each sweep it changes the mean of many by less than 10 %.
    """
    phase = 2.0 * np.pi * (np.arange(2000) * 0.1234 + np.linspace(0.0, 1.0, 44)[:, None])
    line = np.sin(phase) + 0.01 * np.random.default_rng(5).standard_normal(phase.shape)
    found = [piled(600.0 * line**2 + edge).mean() for edge in np.arange(0.0, 1.0, 0.1)]
    assert max(found) - min(found) < 0.1 * max(found)
    sharp = [piled(np.rint(600.0 * line**2 + edge)).mean() for edge in np.arange(0.0, 1.0, 0.1)]
    assert max(sharp) - min(sharp) < 0.35 * max(sharp)
