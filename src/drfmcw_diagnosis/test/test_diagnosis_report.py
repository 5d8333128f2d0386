"""Report and summary of a diagnosis: every verdict, every figure that matters, nothing from outside the page."""

import dataclasses
import html.parser
import io
import json
import math
import re

import numpy as np
import pytest
from rich.console import Console

from drfmcw_diagnosis.finding import quantities, wording
from drfmcw_diagnosis.finding.report import render_html
from drfmcw_diagnosis.finding.result import (
    BeforeAfter,
    Diagnosis,
    Estimate,
    Explanation,
    Fit,
    FoundEffect,
    Location,
    MisfitMap,
    Separability,
    Series,
)
from drfmcw_diagnosis.finding.summary import sentences, terminal
from drfmcw_sim.effects import Effect

DISTANCES = np.array([37.0, 75.0, 150.0, 250.0, 400.0, 550.0, 700.0, 850.0, 999.0])
SWEEPS = 24  # at each distance

RIPPLE = FoundEffect(
    'sweep_ripple',
    'master',
    {
        'deviation': Estimate(500.4, 3.1, 'Hz'),
        'rate': Estimate(9000.2, 12.4, 'Hz'),
        'phase': Estimate(0.02, 0.011, 'rad'),
    },
    412.6,
    0.0001,
)
SETTLING = FoundEffect(
    'pll_settling',
    'slave',
    {
        'step': Estimate(60120.0, 340.0, 'Hz'),
        'natural_frequency': Estimate(18010.0, 45.0, 'Hz'),
        'damping': Estimate(0.351, 0.004, '1'),
    },
    655.0,
    0.0001,
)
DELAY = FoundEffect('delay_temperature', 'master', {'slope': Estimate(6.12, 0.31, 'ps/K')}, 171.0, 0.0002, 0.0127)
CLIPPING = FoundEffect('clipping', 'slave', {'level': Estimate(-33.02, 0.05, 'dBFS')}, 96.3, 0.0011, -0.0004)
CLOCK = FoundEffect('reference_clock_offset', 'slave', {'deviation': Estimate(12.03, 0.14, 'ppm')}, 58.2, 0.0008)
SAMPLE_CLOCK = FoundEffect('sample_clock_offset', 'slave', {'deviation': Estimate(11.6, 0.15, 'ppm')}, 57.1, 0.0009)
AIR = FoundEffect('air_refractivity', None, {'offset': Estimate(12.2, 0.2, '1e-6')}, 56.9, 0.0009)
OFFSET = FoundEffect('reference_offset', None, {'offset': Estimate(-0.0121, 0.0004, 'm')}, 31.0, 0.0009)
MOTION = FoundEffect(
    'target_motion', None, {f'velocity[{i}]': Estimate(0.1 * i, 0.004, 'm/s') for i in range(3)}, 222.0, 0.0003
)


def ramp_series(station, curve, rng, n=240):
    """IF phase residual over the sweep, mean of many sweeps."""
    t = np.linspace(5e-6, 995e-6, n)
    std = np.full(n, 0.004)
    added = curve(t)
    return Series(
        'if_samples', station, 'ramp_time', t, added + std * rng.standard_normal(n), std, added, 'rad',
        f'IF phase of {station}, mean over 216 sweeps',
    )  # fmt: skip


def range_series(curve, rng):
    """Range error of every sweep, standing at nine distances."""
    x = np.repeat(DISTANCES, SWEEPS)
    std = 0.002 + 1.2e-5 * x
    added = curve(x)
    return Series(
        'range', None, 'range', x, added + std * rng.standard_normal(len(x)), std, added, 'm',
        'range minus reference, 216 sweep pairs',
    )  # fmt: skip


def amplitude_series(station, rng):
    """Received power of every setting."""
    std = np.full(9, 0.05)
    return Series(
        'amplitude', station, 'range', DISTANCES, std * rng.standard_normal(9), std, np.zeros(9), 'dB',
        f'received power of {station} against the link budget',
    )  # fmt: skip


def spectrum_series(station, rng, n=2048):
    """IF spectrum over the noise it should have."""
    f = np.linspace(0.0, 1.0e6, n)
    std = np.full(n, 0.3)
    return Series(
        'if_spectrum', station, 'if_frequency', f, std * rng.standard_normal(n), std, np.zeros(n), 'dB',
        f'noise of {station} against its calibrated floor',
    )  # fmt: skip


def misfit_map(rng, excess, explained=True, stations=('master', 'slave')):
    rows = tuple(f'{level} of {s}' for s in stations for level in ('IF phase', 'noise'))
    if len(stations) == 2:
        rows = (*rows, 'range')
    columns = tuple(f'{i}/6' for i in range(1, 7))
    noise = rng.chisquare(60, (2, len(rows), len(columns))) / 60
    noise[:, -1, 4:] = np.nan
    before = noise[0].copy()
    before[0] += excess * (0.4 + np.sin(np.arange(6)) ** 2)
    return MisfitMap(rows, columns, before, noise[1] if explained else before)


def many_series(rng):
    return (
        ramp_series('slave', np.zeros_like, rng),
        amplitude_series('master', rng),
        amplitude_series('slave', rng),
        spectrum_series('master', rng),
        spectrum_series('slave', rng),
        dataclasses.replace(amplitude_series('master', rng), axis='board_temperature', x=np.linspace(15.0, 41.0, 9)),
    )


def made(verdict='explained', effects=(RIPPLE,), alternatives=(), more=lambda rng: (), **changes):
    """A diagnosis that is physically sensible: what the effect adds is a sine of 500 Hz at 9 kHz in the sweep."""
    rng = np.random.default_rng(7)
    mismatch = verdict != 'consistent'

    def phase(t):
        return 500.0 / 9000.0 * (1.0 - np.cos(2.0 * np.pi * 9000.0 * t)) if mismatch else np.zeros_like(t)

    def error(x):
        return 1.3e-3 + 1.16e-5 * x if mismatch else np.zeros_like(x)

    series = (
        ramp_series('master', phase, rng),
        range_series(error, rng),
        *more(rng),
    )
    if verdict == 'unexplained':
        series = tuple(dataclasses.replace(s, curve=0.5 * s.curve) for s in series)
    explanation = Explanation(tuple(effects), sum(e.log_evidence_gain for e in effects)) if effects else None
    if explanation is None:
        series = tuple(dataclasses.replace(s, curve=np.zeros_like(s.curve)) for s in series)
    names = tuple(wording.explanation_title(e) for e in (explanation, *alternatives) if e is not None)
    distance = np.abs(np.subtract.outer(*2 * [np.arange(len(names)) * (1.7 if verdict == 'ambiguous' else 23.4)]))
    after = {True: (1.003, 1.012, 0.00011, 0.0091), False: (8.31, 8.42, 0.0083, 0.0124)}[explanation is not None]
    before = (8.31, 8.42, 0.0083, 0.0124) if mismatch else (0.998, 1.004, -0.0002, 0.0088)
    if not mismatch:
        after = before
    return dataclasses.replace(
        Diagnosis(
            recording='recordings/recording_2',
            verdict=verdict,
            significance=0.0001 if mismatch else 0.43,
            false_alarm_rate=0.01,
            locations=(
                Location('if_samples', 'master', 'ramp_time', 12e-6, 950e-6, 0.874),
                Location('range', None, 'range', 37.0, 999.0, 0.113),
            )
            if mismatch
            else (),
            explanation=explanation,
            alternatives=tuple(alternatives),
            next_measurement=None,
            fit=Fit(*(BeforeAfter(b, a) for b, a in zip(before, after, strict=True))),
            refined_config='out/refined.yaml' if explanation else None,
            not_testable=('reference_lag: the crane stands at every distance, so a late reference changes nothing',),
            sentences=(),
            series=series,
            misfit_map=misfit_map(rng, 22.0 if mismatch else 0.0, explanation is not None),
            separability=Separability(names, distance) if len(names) > 1 else None,
            sweeps_fitted=144,
            sweeps_held_out=72,
        ),
        **changes,
    )


def no_reference():
    diagnosis = made(effects=(SETTLING,), alternatives=(Explanation((RIPPLE,), 301.0),))
    fit = dataclasses.replace(diagnosis.fit, range_bias=None, range_std=None)
    return dataclasses.replace(
        diagnosis,
        fit=fit,
        series=tuple(s for s in diagnosis.series if s.level != 'range'),
        locations=diagnosis.locations[:1],
        not_testable=('reference_lag, reference_offset, reference_scale: the recording holds no reference range',),
    )


def one_station():
    diagnosis = made()
    return dataclasses.replace(
        diagnosis,
        locations=diagnosis.locations[:1],
        series=tuple(s for s in diagnosis.series if s.station == 'master'),
        misfit_map=misfit_map(np.random.default_rng(3), 9.0, stations=('master',)),
        fit=dataclasses.replace(diagnosis.fit, range_bias=None, range_std=None),
        not_testable=(
            'everything of slave: its if_samples are missing',
            'master or slave: a ramp error of one station cannot be separated from the same error of the other',
            'range: it takes both stations',
        ),
    )


CASES = {
    'consistent': made('consistent', ()),
    'explained': made(alternatives=(Explanation((SETTLING,), 301.0), Explanation((CLOCK,), 58.2)), more=many_series),
    'two': made(effects=(DELAY, CLIPPING), alternatives=(Explanation((DELAY,), 171.0), Explanation((CLIPPING,), 88.0))),
    'ambiguous': made(
        'ambiguous',
        (CLOCK,),
        (Explanation((SAMPLE_CLOCK,), 57.1), Explanation((AIR,), 56.9), Explanation((OFFSET, AIR), 56.0)),
        next_measurement="Read the slave's reference with a frequency counter to 0.01 ppm: it would separate the first "
        'two by 47 standard deviations; a second T_off of 8 us: 12.',
    ),
    'unexplained': made('unexplained', ()),
    'unexplained, best given': made(
        'unexplained',
        (SETTLING,),
        fit=Fit(BeforeAfter(8.31, 3.74), BeforeAfter(8.42, 3.91), BeforeAfter(0.0083, 0.0041)),
    ),
    'many settings': made(effects=(MOTION,)),
    'no reference': no_reference(),
    'one station': one_station(),
}
VOID = {'meta', 'img', 'br', 'hr', 'link', 'input', 'col'}


class Page(html.parser.HTMLParser):
    """Checks nesting, collects text and addresses."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.addresses, self.tags = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open
        self.text = ' '.join(' '.join(self.words).replace('\N{NO-BREAK SPACE}', ' ').split())

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [v for k, v in attrs if k in ('src', 'href', 'data', 'action', 'srcset')]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ['style']:
            self.words.append(data)


def printed(diagnosis, width=100):
    console = Console(file=io.StringIO(), width=width)
    console.print(terminal(diagnosis))
    return console.file.getvalue()


@pytest.fixture(scope='module', params=CASES)
def case(request):
    """A diagnosis and its page; every case is rendered once."""
    diagnosis = CASES[request.param]
    return diagnosis, render_html(diagnosis)


def test_page_is_whole_and_needs_nothing_else(case):
    diagnosis, text = case
    page = Page(text)
    assert len(text.encode()) < 3e6
    assert 'script' not in page.tags and 'link' not in page.tags
    assert all(address.startswith('data:image/png;base64,') for address in page.addresses)
    assert not re.search(r'https?:|@import|url\(', text)
    assert len(page.addresses) >= len(diagnosis.series)


def test_page_holds_every_figure(case):
    diagnosis, text = case
    said = Page(text).text
    assert diagnosis.verdict in said
    for sentence in (*sentences(diagnosis), *diagnosis.not_testable):
        assert ' '.join(sentence.split()) in said
    for location in diagnosis.locations:
        assert wording.span(location) in said
        assert quantities.share(location.share) in said
    for explanation in (diagnosis.explanation, *diagnosis.alternatives):
        for found in explanation.effects if explanation else ():
            for name, estimate in found.parameters.items():
                assert name.replace('_', ' ') in said
                assert quantities.quantity(estimate.value, estimate.std, estimate.unit) in said
    for figure in (diagnosis.fit.fitted, diagnosis.fit.held_out):
        assert quantities.misfit(figure.before) in said and (
            not diagnosis.explanation or quantities.misfit(figure.after) in said
        )
    if diagnosis.fit.range_bias:
        assert all(
            x.removesuffix(' mm') in said for x in wording.millimetres(*dataclasses.astuple(diagnosis.fit.range_bias))
        )
    else:
        assert 'its error is not known' in said
    assert diagnosis.refined_config is None or f'./drfmcw simulate {diagnosis.refined_config}' in said


@pytest.mark.parametrize('name', CASES)
def test_terminal_says_the_sentences(name):
    diagnosis = CASES[name]
    flat = ' '.join(printed(diagnosis, 200).split())
    assert diagnosis.verdict.upper() in flat
    for sentence in sentences(diagnosis):
        assert all(word in flat for word in sentence.split())
    assert max(map(len, printed(diagnosis, 80).splitlines())) <= 80


@pytest.mark.parametrize('name', CASES)
def test_sentences_name_effect_station_size_and_unit(name):
    diagnosis = CASES[name]
    said = ' '.join(sentences(diagnosis))
    for found in diagnosis.explanation.effects if diagnosis.explanation and diagnosis.verdict != 'unexplained' else ():
        assert found.effect.split('_')[-1] in said.lower()
        assert found.station is None or f'at {found.station}' in said
        for estimate in found.parameters.values():
            assert quantities.quantity(estimate.value, estimate.std, estimate.unit) in said
    if diagnosis.verdict == 'unexplained' and not diagnosis.explanation:
        assert not any(
            effect.replace('_', ' ') in said
            for effect in Effect.registry
            if '_' in effect and effect != 'reference_lag'
        )
    assert wording.chance(diagnosis.significance) in said
    assert '1 of 100 recordings' in said  # the false-alarm setting
    if diagnosis.next_measurement:
        assert diagnosis.next_measurement in said


def test_every_effect_is_described_by_its_own_declaration():
    for name, cls in Effect.registry.items():
        station = 'master' if cls.of == 'station' else None
        listed = {k: v if isinstance(v, list) else [v] for k, v in cls.example.items()}
        sizes = {k if len(v) == 1 else f'{k}[{i}]': x for k, v in listed.items() for i, x in enumerate(v)}
        found = FoundEffect(name, station, {k: Estimate(x, abs(x) / 40, '1') for k, x in sizes.items()}, 50.0, 0.001)
        words = wording.effect_words(found)
        assert words.description == ' '.join(cls.__doc__.split())
        assert words.headline and words.formula == cls.formula
        assert sum(bool(p.description) for p in words.parameters) == len(cls.example)  # of a list the first one's
        text = wording.effect_sentence(found)
        assert text.endswith('.') and '..' not in text


@pytest.mark.parametrize(
    'value, std, unit, expected',
    [
        (500.4, 3.1, 'Hz', '500 ± 3 Hz'),
        (9000.2, 12.4, 'Hz', '9000 ± 12 Hz'),
        (60120.0, 340.0, 'Hz', '60.1 ± 0.3 kHz'),
        (-0.3512, 0.0123, 'ppm/K', '-0.351 ± 0.012 ppm/K'),
        (0.0, 0.02, 'ppm', '0.000 ± 0.020 ppm'),
        (-0.0121, 0.0004, 'm', '-12.1 ± 0.4 mm'),
        (5e-5, 1e-6, 's', '50.0 ± 1.0 µs'),
        (12.2, 0.2, '1e-6', '(12.20 ± 0.20)·10⁻⁶'),
        (0.1, 0.0296, '1', '0.10 ± 0.03'),
        (7.5, math.nan, 'm', '7.500 m (uncertainty unknown)'),
    ],
)
def test_quantities_have_sensible_digits(value, std, unit, expected):
    assert quantities.quantity(value, std, unit) == expected


def test_chance_and_spans():
    assert wording.chance(0.0001) == '1 of 10 000 recordings'
    assert wording.chance(1 / 1001) == '1 of 1000 recordings'
    assert wording.chance(0.43) == '43 of 100 recordings'
    assert wording.chance(1e-9) == 'fewer than 1 of a million recordings'
    location = Location('if_samples', 'master', 'ramp_time', 12e-6, 950e-6, 0.9)
    assert wording.span(location) == 'time in the sweep 12 to 950 µs'
    assert wording.span(dataclasses.replace(location, axis='range', start=400.0, end=400.0)) == 'distance 400 m'


def test_names_are_escaped():
    name = '<img src="http://x/y">&$\\frac$[red]'
    effect = dataclasses.replace(RIPPLE, station=name)
    diagnosis = made(
        effects=(effect,), alternatives=(Explanation((dataclasses.replace(SETTLING, station=name),), 3.0),)
    )
    diagnosis = dataclasses.replace(
        diagnosis,
        recording=f'a b/{name}',
        locations=(Location('if_samples', name, 'ramp_time', 1e-5, 9e-4, 1.0),),
        series=(dataclasses.replace(diagnosis.series[0], station=name, label=f'IF phase of {name}'),),
        not_testable=(f'{name} is odd',),
        misfit_map=dataclasses.replace(diagnosis.misfit_map, rows=(name, *diagnosis.misfit_map.rows[1:])),
    )
    text = render_html(diagnosis)
    page = Page(text)
    assert all(address.startswith('data:') for address in page.addresses)
    assert f'IF phase of {name}' in page.text
    assert '<img src="http' not in text
    assert '[red]' in printed(diagnosis, 400)


def test_same_diagnosis_gives_the_same_page():
    diagnosis = dataclasses.replace(CASES['one station'], series=CASES['one station'].series[:1])
    assert render_html(diagnosis) == render_html(diagnosis)


def test_odd_numbers_still_make_a_page():
    diagnosis = CASES['explained']
    hole = np.where(np.arange(240) % 7 == 0, np.nan, diagnosis.series[0].residual)
    Page(
        render_html(
            dataclasses.replace(
                diagnosis,
                fit=Fit(BeforeAfter(math.nan, math.nan), BeforeAfter(math.nan, math.nan)),
                series=(
                    dataclasses.replace(diagnosis.series[0], residual=hole),
                    dataclasses.replace(diagnosis.series[0], std=np.zeros(240)),
                    ramp_series('slave', np.zeros_like, np.random.default_rng(1), 0),
                ),
                misfit_map=MisfitMap((), (), np.zeros((0, 0)), np.zeros((0, 0))),
                significance=math.nan,
                command='./drfmcw diagnose somewhere',
                locations=(Location('noise', None, 'humidity', math.nan, math.nan, math.nan),),
            )
        )
    )


def test_object_has_the_fields_of_the_interface():
    effect_keys = {'effect', 'station', 'parameters', 'log_evidence_gain', 'p_value'}
    for diagnosis in CASES.values():
        got = json.loads(json.dumps(diagnosis.as_object(), allow_nan=False))
        wanted = 'verdict significance locations effects alternatives next_measurement fit refined_config'
        assert set(wanted.split()) <= set(got)
        assert got['verdict'] in ('consistent', 'explained', 'ambiguous', 'unexplained')
        assert 0.0 <= got['significance'] <= 1.0
        for place in got['locations']:
            assert set(place) >= {'level', 'station', 'axis', 'from', 'to', 'share'}
        for found in [*got['effects'], *(e for a in got['alternatives'] for e in a['effects'])]:
            assert set(found) >= effect_keys
            assert found['effect'] in Effect.registry
            for value in found['parameters'].values():
                assert set(value) >= {'value', 'std', 'unit'}
        assert all(set(a) >= {'effects', 'log_evidence_gain'} for a in got['alternatives'])
        assert set(got['fit']) >= {'fitted', 'held_out', 'range_bias', 'range_std'}
        assert all(figure is None or set(figure) == {'before', 'after'} for figure in got['fit'].values())
        assert (got['fit']['range_bias'] is None) == (diagnosis.fit.range_bias is None)
