"""Effects beside something that the registry lacks: which of them stand, and which are found."""

import pytest
from comparing import beginning, compared

from drfmcw_diagnosis.compare.steadiness import LIMITS as STEADINESS
from drfmcw_diagnosis.compare.steadiness import amplitude_modulations
from drfmcw_diagnosis.judging import curves
from drfmcw_diagnosis.judging.bursts import LIMITS as BURSTS
from drfmcw_diagnosis.judging.bursts import of_lines
from drfmcw_diagnosis.judging.standing import LIMITS, standings
from drfmcw_diagnosis.search import events
from drfmcw_diagnosis.search.leftovers import leftovers
from drfmcw_diagnosis.search.limits import SEARCH
from drfmcw_diagnosis.search.search import Search
from drfmcw_proof.cases.concealing import Applied
from drfmcw_sim.effects import Effect


def test_an_offset_far_beyond_what_a_jump_of_the_phase_shifts_stands(tmp_path):
    """A line through a jump of 0.25 rad is steeper by 6 cm at most; the recording is fixed, so nothing is by chance."""
    jump = Applied('phase_jump', 'slave', {'angle': 0.25, 'time': 0.00045})
    values = {'offset': 0.4}
    comparison = compared(tmp_path / 'r', 62, jump, Applied('reference_offset', None, values))
    search = Search(comparison, without=set(Effect.registry) - {'reference_offset'})
    found = search.fit([beginning('reference_offset', '', values)])
    search.set_aside = events.left(search, found, search.whitening_of(found, with_unknown=False))
    (standing,) = standings(search, search.trusted(found))
    assert len(search.set_aside) and standing.stands


@pytest.mark.parametrize(
    ('effect', 'values', 'stands'),
    [('phase_jump', {'angle': -1.4, 'time': 0.00073}, False), ('phase_noise', {'level': -83.0}, True)],
)
def test_a_jump_of_the_phase_is_no_noise_of_the_oscillator(tmp_path, effect, values, stands):
    """What it leaves beside the line repeats in each sweep; the recordings are fixed, so nothing is by chance."""
    comparison = compared(tmp_path / 'r', 62, Applied(effect, 'slave', values))
    search = Search(comparison, without=set(Effect.registry) - {'phase_noise'})
    found = search.fit([beginning('phase_noise', 'slave', {'level': -83.0, 'corner': 1e5})])
    search.set_aside = events.left(search, found, search.whitening_of(found, with_unknown=False))
    (standing,) = standings(search, search.trusted(found))
    assert standing.gain > 300.0
    assert standing.stands == (standing.repeated < LIMITS.repeated) == stands


@pytest.mark.parametrize(
    ('effect', 'station', 'values', 'modulated'),
    [
        ('swinging_echo', None,
         {'excess_range': 10.0, 'relative_power': -30.0, 'swing': 0.3, 'rate': 0.5, 'phase': 0.2}, True),
        ('frequency_modulation', 'master', {'deviation': 40.0, 'rate': 5e3}, False),
    ],
)  # fmt: skip
def test_an_echo_that_swings_is_no_modulation_of_an_oscillator(tmp_path, effect, station, values, modulated):
    """Over 10 m the line ripples at 5 kHz, with a phase of its own in each sweep: in its amplitude as well.

    The recordings are fixed, so nothing is by chance.
    """
    comparison = compared(tmp_path / 'r', 62, Applied(effect, station, values))
    oscillator = Effect.registry['frequency_modulation'](40.0, 5e3, station='master')
    (shown,) = amplitude_modulations(comparison, [oscillator])
    assert (shown > STEADINESS.of_amplitude) == modulated


@pytest.mark.parametrize(
    ('effect', 'values', 'of_line'),
    [
        ('sporadic_drop', {'count': 2, 'time': 5e-4, 'every': 4}, True),
        ('interference_burst', {'probability': 0.25, 'level': -62.0, 'duration': 5e-5}, False),
    ],
)
def test_samples_that_are_lost_in_some_sweeps_are_no_bursts(tmp_path, effect, values, of_line):
    """What they leave is the line's own power, the stronger the nearer; the recordings are fixed."""
    search = Search(
        compared(tmp_path / 'r', 62, Applied(effect, 'slave', values), sweeps=24), without=set(Effect.registry)
    )
    start = {'probability': 0.25, 'level': -62.0, 'duration': 5e-5}
    (ratio,) = of_lines(search, search.fit([beginning('interference_burst', 'slave', start)], 0))
    assert (ratio > BURSTS.nearer) == of_line


def beside_curves(path, concealed, tried):
    """Standings of effects beside the curves that are set aside, and how many these are."""
    distances = 26.4, 29.6, 36.8, 73.5, 76.2, 97.3, 245.8, 398.1, 405.9
    comparison = compared(path, 21, *concealed, settings=9, sweeps=14, distances=distances)
    search = Search(comparison, without=set(Effect.registry) - set(tried))
    found = search.fit([beginning(name, '', start) for name, start in tried.items()])
    unnamed = curves.left(search, found, search.whitening_of(found, with_unknown=False))
    search.count_as_noise(found, unnamed, search.templates_beside(found))
    return standings(search, search.trusted(found)), len(unnamed)


def test_an_offset_that_the_range_shows_stands_beside_a_delay_that_jumps(tmp_path):
    """The jump is set aside as a curve over time; the recording is fixed, so nothing is by chance."""
    jump = Applied('delay_step', 'slave', {'step': 0.96, 'time': 390.0})
    tried = {'reference_offset': {'offset': 0.2}}
    concealed = [jump, Applied('reference_offset', None, tried['reference_offset'])]
    (offset,), unnamed = beside_curves(tmp_path / 'r', concealed, tried)
    assert unnamed and offset.stands


@pytest.mark.parametrize(('effect', 'values', 'stands'), [
    ('rail_bend', {'height': 0.15, 'length': 2000.0}, False), ('air_refractivity', {'offset': 130.0}, True),
])  # fmt: skip
def test_a_bent_rail_is_no_air_where_most_distances_are_near(tmp_path, effect, values, stands):
    """A slope follows it but for a few per cent, which show only beside a free constant; fixed recordings."""
    distances = 28.3, 36.0, 42.8, 46.5, 62.7, 80.1, 92.5, 109.5, 308.9, 906.3
    concealed = Applied(effect, None, values)
    comparison = compared(tmp_path / 'r', 21, concealed, settings=10, sweeps=14, distances=distances)
    search = Search(comparison, without=set(Effect.registry) - {'air_refractivity'})
    found = search.trusted(search.fit([beginning('air_refractivity', '', {'offset': 130.0})]))
    (air,) = standings(search, found)
    assert air.stands == stands


@pytest.mark.parametrize(
    ('effect', 'values', 'stands'),
    [('rail_bend', {'height': -0.19, 'length': 487.0}, False), ('reference_scale', {'scale': 500.0}, True)],
)
def test_a_bent_rail_is_no_scale_because_fringes_show_it(tmp_path, effect, values, stands):
    """A reflection shows where the crane stands, and a scale fits that about; the range shows that it is none.

    The recording is fixed, so nothing is by chance.
    """
    fringes = {'coefficient': 0.098, 'height_product': 180.2}
    concealed = [Applied('ground_reflection', None, fringes), Applied(effect, None, values)]
    tried = {'ground_reflection': fringes, 'reference_scale': {'scale': 500.0}}
    (_, scale), unnamed = beside_curves(tmp_path / 'r', concealed, tried)
    assert bool(unnamed) is not stands and scale.stands == stands


@pytest.mark.parametrize(
    ('named', 'unknown'),
    [
        (
            Applied('spur', 'master', {'frequency': 74854.0, 'level': -55.5}),
            Applied('fixed_reflector', None, {'position': 230.5, 'relative_power': -13.0, 'phase': 0.86}),
        ),
        (
            Applied('clipping', 'master', {'level': -25.6}),
            Applied('delay_step', 'master', {'step': 5.5, 'time': 60.0}),
        ),
    ],
    ids=['a spur among lines', 'a limit at the nearest distance'],
)
def test_what_nothing_else_does_stands_beside_something_unknown(tmp_path, named, unknown):
    """Other lines in the spectrum spoil no spur, and only a limit piles samples up. The recordings are fixed."""
    search = Search(compared(tmp_path / 'r', 62, named, unknown), without=set(Effect.registry) - {named.effect})
    found = search.trusted(search.fit([beginning(named.effect, named.station, named.parameters)]))
    (standing,) = standings(search, found)
    assert leftovers(search, found)[0].probability < 1e-9 and standing.stands


def test_a_line_of_something_with_a_period_is_no_spur(tmp_path):
    """A triangle has lines at odd multiples of its frequency; the recording is fixed, so nothing is by chance."""
    dither = Applied('adc_dither', 'master', {'amplitude': 40.0, 'period': 13.0})
    values = {'frequency': 2.048e6 / 13.0, 'level': -50.0}
    search = Search(compared(tmp_path / 'r', 62, dither), without=set(Effect.registry) - {'spur'})
    found = search.trusted(search.fit([beginning('spur', 'master', values)]))
    (standing,) = standings(search, found)
    assert standing.has_evidence and not standing.stands


@pytest.mark.parametrize(
    ('concealed', 'periodic'),
    [
        ((Applied('adc_dither', 'master', {'amplitude': 6.0, 'period': 21.42}),), True),
        (
            tuple(
                Applied('spur', 'master', {'frequency': frequency, 'level': level})
                for frequency, level in ((95583.0, -64.4), (288950.0, -84.0))
            ),
            False,
        ),
    ],
    ids=['a triangle', 'two lines, one two bins off'],
)
def test_a_line_and_its_harmonic_are_no_two_spurs(tmp_path, concealed, periodic):
    """What has a period has both lines, and they leave nothing; the recordings are fixed."""
    search = Search(compared(tmp_path / 'r', 62, *concealed), without=set(Effect.registry) - {'spur'})
    lines = [
        beginning('spur', 'master', {'frequency': number * 2.048e6 / 21.42 + beside, 'level': level})
        for number, beside, level in ((1, 0.0, -64.0), (3, 0.0 if periodic else 2100.0, -84.0))
    ]
    found = search.trusted(search.fit(lines))
    assert not any(x.kind == 'lines' and x.probability < 0.01 for x in leftovers(search, found))
    assert [standing.stands for standing in standings(search, found)] == [not periodic] * 2


def test_what_fits_alike_at_the_other_station_is_found_beside_something_unknown(tmp_path):
    """A hum of either oscillator is in both lines, whatever else the scan for its rate finds; a fixed recording."""
    hum = {'deviation': 868.8, 'rate': 4076.7}
    effects = Applied('frequency_modulation', 'slave', hum), Applied('rail_bend', None, {'height': 0.46, 'length': 824})
    search = Search(compared(tmp_path / 'r', 62, *effects), without=set(Effect.registry) - {'frequency_modulation'})
    found = search.trusted(search.fit([beginning('frequency_modulation', 'master', hum)]))
    other = next(f for f in search.exchanges(found) if f.keys == (('frequency_modulation', 'slave'),))
    assert abs(other.misfit - found.misfit) < SEARCH.rival
    assert other.effects[0].values == pytest.approx(found.effects[0].values, rel=0.05)
