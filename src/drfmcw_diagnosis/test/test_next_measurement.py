"""Which measurement decides between explanations of one recording: what physics says, by simulation alone.

The recording conceals nothing; rivals are fitted to what the explanation taken for true adds to it, so that nothing
here is by chance. The simulated sweeps' noise comes from fixed streams.
"""

import copy
import dataclasses

import numpy as np
import pytest
from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.finding import wording
from drfmcw_diagnosis.finding.limits import SEPARATION
from drfmcw_diagnosis.finding.report import render_html
from drfmcw_diagnosis.finding.result import (
    BeforeAfter,
    Diagnosis,
    Estimate,
    Explanation,
    Fit,
    FoundEffect,
    NextMeasurement,
)
from drfmcw_diagnosis.next.further_sweeps import (
    Baseline,
    Exchanged,
    FurtherAway,
    MoreSweeps,
    OtherStartDelay,
    Repeated,
    supposed,
)
from drfmcw_diagnosis.next.instruments import (
    DrivePast,
    FrequencyCounter,
    PhaseNoiseMeter,
    SecondInstrument,
    TerminatedAntenna,
)
from drfmcw_diagnosis.next.ranking import measurements, ranked
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.fits.fitted import Fitted, FittedEffect
from drfmcw_diagnosis.search.fits.fitting import Fitting
from drfmcw_diagnosis.search.starts.bank import Candidate
from drfmcw_sim.effects import Effect

ROOT = 1e-3  # below which a separation is numerical noise [standard deviations]


@pytest.fixture(scope='module')
def recording():
    return Comparison(read_dataset(DATA / 'recording_0'))


@pytest.fixture(scope='module')
def warming():
    """The same sweeps, but both boards warm steadily by 12 K from the calibration temperature on."""
    data = read_dataset(DATA / 'recording_0')
    warm = 25.0 + 12.0 * data.time / data.time[-1]
    return Comparison(dataclasses.replace(data, board_temperature=np.stack([warm, warm])))


def candidate(effect, station, values):
    recipe = next(r for r in Effect.registry[effect].recipes if set(values) <= set(r.prior) and not r.per_group)
    return Candidate(effect, station, recipe, dict(values))


def true(comparison, effect, station='', **values):
    """An explanation taken for true."""
    chosen = candidate(effect, station, values)
    return Fitted((FittedEffect(chosen, dict(values), {}),), 0.0, comparison.template([chosen.build()]), 0.0)


def rival(comparison, truth, effect, station='', **values):
    """Another explanation, fitted to what the true one adds to the recording; values are where the fit begins."""
    like = copy.copy(comparison)
    like.residual = truth.template
    other = candidate(effect, station, values)
    return Fitting(like).fit([(other, dict(values))])


def separations(comparison, truth, other, *candidates):
    """Of one rival, in the order of the measurements."""
    found = ranked(Fitting(comparison), truth, [other], candidates)
    by_sentence = {m.sentence: m.separations[0] for m in found}
    return [by_sentence[c.sentence] for c in candidates]


def test_a_delay_and_an_offset_of_the_reference_are_separated_by_a_tape(recording):
    """Exactly degenerate: only what does not go through the reference instrument separates them."""
    truth = true(recording, 'delay_offset', delay=0.03)
    other = rival(recording, truth, 'reference_offset', offset=-0.005)
    found = ranked(Fitting(recording), truth, [other])
    deciding = {m.sentence for m in found if m.decides}
    assert deciding == {m.sentence for m in (Baseline(5.0), Baseline(15.0), SecondInstrument())}
    useless = [FrequencyCounter('alpha'), OtherStartDelay(), MoreSweeps(), FurtherAway()]
    assert max(separations(recording, truth, other, *useless)) < 0.1


def test_an_effect_of_known_size_shows_beside_nothing_else(recording):
    """One of 30 ps, 9 mm, whose size is not fitted: 9 standard deviations of a tape that is good to 1 mm."""
    nothing = Fitted((), 0.0, np.zeros(len(recording.residual)), 0.0)
    hidden = true(recording, 'delay_offset', delay=0.03)
    (effect,) = hidden.effects
    fixed = dataclasses.replace(effect.candidate.recipe, prior={})
    known = dataclasses.replace(effect, candidate=dataclasses.replace(effect.candidate, recipe=fixed))
    shown = separations(recording, nothing, dataclasses.replace(hidden, effects=(known,)), Baseline(15.0))
    assert shown[0] == pytest.approx(0.03 * 0.2998 / 1e-3, rel=0.1), 'over the error of the tape'
    assert separations(recording, nothing, hidden, Baseline(15.0))[0] < 0.05 * shown[0], 'a free size follows'


def test_air_and_scale_of_the_reference_are_separated_by_a_second_instrument(recording):
    """Both go with the distance; 15 m is too short, and 1.5 times the longest distance is no other distance."""
    truth = true(recording, 'air_refractivity', offset=20.0)
    other = rival(recording, truth, 'reference_scale', scale=-20.0)
    best = ranked(Fitting(recording), truth, [other])[0]
    assert best.sentence == SecondInstrument().sentence and best.decides == 1
    assert max(separations(recording, truth, other, Baseline(15.0), FurtherAway(), MoreSweeps())) < 1.0


def test_references_of_either_station_are_separated_by_a_counter_or_another_station(recording):
    """The IF knows the difference of the references only."""
    truth = true(recording, 'reference_clock_offset', 'master', deviation=0.2)
    other = rival(recording, truth, 'reference_clock_offset', 'slave', deviation=-0.2)
    counter, exchanged, longer, instrument = separations(
        recording, truth, other, FrequencyCounter('alpha'), Exchanged('slave'), MoreSweeps(), SecondInstrument()
    )
    assert counter == pytest.approx(0.2 * np.sqrt(2.0) / 0.01, rel=0.1)  # +0.2 and 0 ppm against 0 and -0.2 ppm
    assert exchanged > SEPARATION.separable
    assert longer < 0.5 and instrument < ROOT


def test_synthesisers_of_either_station_are_separated_by_another_station(recording):
    truth = true(recording, 'sweep_ripple', 'slave', deviation=60.0, rate=7000.0, phase=1.0)
    other = rival(recording, truth, 'sweep_ripple', 'master', deviation=60.0, rate=7000.0, phase=1.0 - np.pi)
    assert separations(recording, truth, other, Exchanged('master'))[0] > SEPARATION.separable
    assert separations(recording, truth, other, Repeated('as before'))[0] < 0.5 * SEPARATION.separable


def test_a_bent_ramp_is_supposed_at_other_distances_as_it_is(recording):
    """Its coefficients belong to the band, not to the distances: at one of these it adds what it adds at any."""
    effect = Effect.registry['sweep_shape'](relative_rate=(1.0, 1.0 + 2e-5, 1.0, 1.0, 1.0 - 1e-5), station='master')
    view = Repeated('as before').view(recording, 1)
    assert view is not None
    added = view.show((effect,))
    assert np.isfinite(added).all() and np.sum(added**2) > 100.0


def test_warming_and_ageing_of_a_clock_are_separated_by_heat_and_by_counters(warming):
    """Time and temperature run together in the recording, and nowhere else."""
    truth = true(warming, 'reference_clock_temperature', 'master', slope=0.02)
    other = rival(warming, truth, 'reference_clock_drift', 'master', rate=1.0)
    heated, warmer, hour, longer = separations(
        warming,
        truth,
        other,
        Repeated('heated', board=15.0, station='master'),
        FrequencyCounter('alpha', warmer=15.0),
        FrequencyCounter('alpha', later=3600.0),
        MoreSweeps(),
    )
    assert min(heated, warmer, hour) > SEPARATION.separable
    assert longer < 1.0


def test_delays_of_either_board_are_separated_by_heating_one(warming):
    truth = true(warming, 'delay_temperature', 'master', slope=10.0)
    other = rival(warming, truth, 'delay_temperature', 'slave', slope=10.0)
    one, both, counter = separations(
        warming,
        truth,
        other,
        Repeated('heated', board=15.0, station='slave'),
        Repeated('warmer', board=15.0, air=15.0),
        FrequencyCounter('alpha'),
    )
    assert one > SEPARATION.separable
    assert both < 0.1 and counter < ROOT


def test_noise_of_receivers_and_of_oscillators_is_separated_without_a_signal(recording):
    """At a level where both raise the noise alike: the floor stays when the antenna is off, the skirts do not."""
    truth = true(recording, 'noise_floor', 'master', excess=1.0)
    level = recording.data.calibration[0].phase_noise_level + 1.0
    other = rival(recording, truth, 'phase_noise', 'master', level=level, corner=120e3)
    terminated, analyser = separations(recording, truth, other, TerminatedAntenna(), PhaseNoiseMeter())
    assert terminated > 10.0
    assert analyser < terminated


@pytest.mark.parametrize(
    ('better', 'effect', 'values', 'other', 'start'),
    [
        (
            [FrequencyCounter('sample_clock', accuracy=a) for a in (1e-6, 3e-7, 1e-7, 1e-8)],
            'sample_clock_offset',
            {'deviation': 10.0},
            'delay_offset',
            {'delay': -0.02},
        ),
        (
            [Baseline(5.0, millimetres=a) for a in (10.0, 3.0, 1.0)],
            'delay_offset',
            {'delay': 0.03},
            'reference_offset',
            {'offset': -0.005},
        ),
        (
            [SecondInstrument(millimetres=a) for a in (10.0, 3.0, 1.0)],
            'air_refractivity',
            {'offset': 20.0},
            'reference_scale',
            {'scale': -20.0},
        ),
        (
            [MoreSweeps(times=n) for n in (2, 4, 16)],
            'sample_clock_offset',
            {'deviation': 30.0},
            'reference_offset',
            {'offset': 0.015},
        ),
    ],
)
def test_a_better_instrument_separates_more(recording, better, effect, values, other, start):
    station = 'master' if Effect.registry[effect].of == 'station' else ''
    truth = true(recording, effect, station, **values)
    found = separations(recording, truth, rival(recording, truth, other, **start), *better)
    assert found == sorted(found) and found[-1] > 1.5 * found[0] > 0.0


def test_what_predicts_the_same_is_never_separated(recording):
    truth = true(recording, 'echo', excess_range=7.5, relative_power=-30.0, phase=0.0)
    found = ranked(Fitting(recording), truth, [truth])
    assert len(found) > 15
    assert max(m.separation for m in found) < ROOT and not any(m.decides for m in found)


def test_measurements_of_what_explanations_may_belong_to_anything_are_left_out(recording):
    """A delay may be in the station that is exchanged, or in the other one."""
    truth = true(recording, 'delay_offset', delay=0.03)
    sentences = [m.sentence for m in ranked(Fitting(recording), truth, [truth], [Exchanged('master'), Baseline(5.0)])]
    assert sentences == [Baseline(5.0).sentence]


def test_a_late_reference_is_seen_where_the_crane_drives_past_a_mark(recording):
    """It reads 0.1 m less on the way out and 0.1 m more on the way back; an offset stays the same."""
    show = DrivePast(speed=0.5).view(recording, 5).show
    std = np.hypot(5e-3, np.median(recording.data.reference_std))
    assert show((Effect.registry['reference_lag'](lag=0.2),)) == pytest.approx(np.array([-0.1, 0.1]) / std, rel=1e-6)
    assert show((Effect.registry['reference_offset'](offset=0.02),)) == pytest.approx(0.02 / std, rel=1e-6)


def test_a_slant_is_seen_by_a_second_instrument_beside_a_horizontal_reference(recording):
    """sqrt(R^2 + h^2) - R is missing in the reference, most of all at the shortest distance."""
    near, far = SecondInstrument().view(recording, 5).show((Effect.registry['slant_geometry'](height_difference=5.0),))
    distance = np.sort(recording.data.distance)
    std = np.hypot(1e-3 * (1.0 + 1e-3 * distance[0]), np.median(recording.data.reference_std) / np.sqrt(24.0))
    assert near == pytest.approx(-(np.hypot(distance[0], 5.0) - distance[0]) / std, rel=0.05)
    assert abs(far) < 0.1 * abs(near)


def test_without_a_reference_nothing_is_compared_with_it():
    data = read_dataset(DATA / 'recording_0')
    nothing = np.full(len(data), np.nan)
    alone = dataclasses.replace(data, reference=nothing, reference_std=nothing)
    alone.__dict__['distance'] = data.distance  # what the lines would show, without the time that takes
    comparison = Comparison(alone, np.arange(96))
    assert SecondInstrument().view(comparison, 5) is None and DrivePast().view(comparison, 5) is None
    view = Repeated('as before').view(comparison, 5)
    shown = view.show((Effect.registry['air_refractivity'](offset=50.0),))
    assert not np.any(shown[view.comparison.entries.where(kind=['range', 'velocity'])])


def test_one_stations_samples_are_enough():
    """Station 1 alone takes an error of T_off for a distance; a counter still separates its ADC clock from a delay."""
    data = read_dataset(DATA / 'recording_0')
    comparison = Comparison(dataclasses.replace(data, samples=(data.samples[0], None)))
    truth = true(comparison, 'sample_clock_offset', 'master', deviation=10.0)
    other = rival(comparison, truth, 'delay_offset', delay=-0.02)
    found = ranked(Fitting(comparison), truth, [other])
    assert found[0].sentence == FrequencyCounter('sample_clock').sentence and found[0].decides
    assert all(np.isfinite(m.separation) for m in found)


def test_simulated_sweeps_scatter_as_they_are_said_to(recording):
    """Nothing is concealed in them: mean squares are 1 but for so many numbers; the streams are fixed."""
    for measurement in (Repeated('as before'), Repeated('weaker', attenuation=10.0), OtherStartDelay()):
        made = measurement.view(recording, 5).comparison
        for kind, low, high in (('ramp', 0.9, 1.1), ('lines', 0.9, 1.1), ('noise', 0.5, 1.5), ('range', 0.1, 3.0)):
            numbers = made.residual[made.entries.where(kind=kind)]
            numbers = numbers[numbers != 0.0]
            assert low < np.mean(numbers**2) < high, (measurement, kind)


def test_a_driving_crane_is_measured_standing():
    """The drive's own sweeps give noise and settings; further ones are made at its distances, one group at each."""
    comparison = Comparison(read_dataset(DATA / 'recording_5'))
    made = Repeated('as before').view(comparison, 4).comparison
    assert len(made.members) == 4 and made.standing.all()
    assert np.mean(made.residual[made.entries.where(kind='ramp')] ** 2) < 1.1


def test_every_measurement_says_what_to_do():
    sentences = [m.sentence for m in measurements(('master', 'slave'))]
    assert len(set(sentences)) == len(sentences)
    assert all(s[0].isupper() and s.endswith('.') and '{' not in s for s in sentences)


# --- what is said of them ---


def explanation(effect, station, **values):
    parameters = {name: Estimate(value, 0.01 * abs(value), 'ppm') for name, value in values.items()}
    return Explanation((FoundEffect(effect, station, parameters, 50.0, 1e-6),), 50.0)


def diagnosis(*found):
    return Diagnosis(
        recording='r',
        verdict='ambiguous',
        significance=1e-6,
        false_alarm_rate=0.01,
        locations=(),
        explanation=explanation('sample_clock_offset', 'master', deviation=3.0),
        alternatives=(
            explanation('reference_scale', None, scale=3.0),
            explanation('reference_clock_offset', 'slave', deviation=1.0),
        ),
        next_measurement=found[0].sentence if found[0].decides else None,
        fit=Fit(BeforeAfter(2.0, 1.0), BeforeAfter(2.0, 1.0)),
        refined_config=None,
        not_testable=(),
        sentences=(),
        measurements=found,
    )


def test_the_finding_ranks_measurements_by_what_they_decide():
    both, one, none = (
        NextMeasurement('Weigh both.', (5.0, 7.0)),
        NextMeasurement('Weigh one.', (1.0, 90.0)),
        NextMeasurement('Look at it.', (0.1, 3.0)),
    )
    assert [(m.decides, m.separation) for m in (both, one, none)] == [(2, 5.0), (1, 90.0), (0, 3.0)]
    written = diagnosis(both, one, none).as_object()
    assert written['measurements'][1] == {
        'measurement': 'Weigh one.',
        'separation': 90.0,
        'decides': 1,
        'separations': [1.0, 90.0],
    }
    said = ' '.join(wording.sentences(diagnosis(both, one, none)))
    assert 'Weigh both.' in said and 'both rivals' in said and 'Weigh one (90: reference clock offset at slave)' in said
    page = render_html(diagnosis(both, one, none))
    assert all(m.sentence in page for m in (both, one, none)) and 'Reference clock offset at slave' in page


def test_the_finding_says_so_where_nothing_decides():
    said = ' '.join(wording.sentences(diagnosis(NextMeasurement('Look at it.', (0.1, 3.0)))))
    assert 'none would decide' in said and '3.0 standard deviations' in said
    said = ' '.join(wording.sentences(diagnosis(NextMeasurement('Look at it.', (0.0, 0.1)))))
    assert 'none would separate them' in said


def test_a_crane_at_a_known_baseline_stands(recording):
    """The slope of a distance that is exactly known is rounding alone."""
    made = supposed(recording, Baseline(15.0).conditions(recording, 12))
    assert made.recorded.standing.all()
    assert np.abs(made.residual[made.entries.where(kind='velocity')]).max() < 1e-3
