"""Phrases: both languages complete, every flag in words, numbers that do not jump."""

import ast
import math
import re
from pathlib import Path

import pytest

import drfmcw_host
from drfmcw_fusion.integrity.checks import Test as IntegrityTest
from drfmcw_fusion.pipeline import Flag as RangeFlag
from drfmcw_host.words import flags
from drfmcw_host.words.numbers import distance, general, number, size, span
from drfmcw_host.words.phrases import PHRASES, phrase
from drfmcw_node.estimators.estimation import Flag as LineFlag
from drfmcw_physics.sweep import Mode

PACKAGE = Path(drfmcw_host.__file__).parent
SAME = {'title', 'now.mode', 'stations.pll', 'stations.link'}


def test_both_languages_say_everything():
    for key, (english, german) in PHRASES.items():
        assert english.strip() and german.strip(), key
        assert set(re.findall(r'{(\w+)}', english)) == set(re.findall(r'{(\w+)}', german)), key


def test_every_flag_has_words():
    wanted = {f'range.{f.name}' for f in RangeFlag if f} | {f'line.{f.name}' for f in LineFlag if f}
    wanted |= {f'test.{t.name}' for t in IntegrityTest if t} | {f'mode.{m.name}' for m in Mode}
    prefixes = ('range.', 'line.', 'test.', 'mode.')
    assert {key for key in PHRASES if key.startswith(prefixes)} == wanted


@pytest.mark.parametrize('language', ['en', 'de'])
def test_combined_flags_are_said_one_by_one(language):
    both = RangeFlag.WEAK_SIGNAL | RangeFlag.STALE_ENVIRONMENT
    assert flags.range_flags(int(both), language) == [
        phrase('range.WEAK_SIGNAL', language),
        phrase('range.STALE_ENVIRONMENT', language),
    ]
    assert flags.range_flags(0, language) == []


def test_quality_follows_what_a_controller_does():
    """The table of docs/sensors_and_flags.md: what a controller drops is not to be used."""
    dropped = {RangeFlag.WEAK_SIGNAL, RangeFlag.MODE_MISMATCH, RangeFlag.OUT_OF_LIMITS, RangeFlag.SIGNAL_QUALITY}
    for flag in RangeFlag:
        if flag:
            assert flags.quality(flag) == ('unusable' if flag in dropped else 'doubtful')
    assert flags.quality(0) == 'good'


def test_unknown_bits_are_shown_not_hidden():
    assert '4096' in ' '.join(flags.failed_tests(4096, 'en'))


def test_every_phrase_is_used_and_every_used_one_exists():
    texts = set()
    for module in PACKAGE.rglob('*.py'):
        if module.name != 'phrases.py':
            tree = ast.parse(module.read_text(encoding='utf-8'))
            texts |= {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    stems = {text for text in texts if text.endswith('.')}
    for key in PHRASES:
        stem = key.rpartition('.')[0] + '.'
        assert key in texts or stem in stems or key.startswith(('range.', 'line.', 'test.')), key


def test_numbers_have_fixed_digits():
    assert distance(1000.0, 'en') == '1000.000' and distance(math.nan, 'en') == '–'
    assert number(-0.001234, 2, 'en', 1e3, sign=True) == '-1.23'
    assert number(math.inf, 1, 'en') == '∞'


def test_german_numbers_have_commas():
    assert distance(1234.5, 'de') == '1234,500' and number(0.25, 1, 'de', 10.0, sign=True) == '+2,5'
    assert span(0.26, 'de') == '0,3 s' and size(1.4e9, 'de') == '1,4 GB' and general(1.5e-9, 3, 'de') == '1,5e-09'


@pytest.mark.parametrize(
    ('seconds', 'text'),
    [(0.26, '0.3 s'), (42.4, '42 s'), (187.0, '3:07 min'), (7500.0, '2:05 h'), (400_000.0, '4 d'), (math.inf, '–')],
)
def test_ages_are_readable(seconds, text):
    assert span(seconds, 'en') == text


def test_sizes_are_readable():
    assert [size(n, 'en') for n in (12, 1500, 8.1e8, 1.4e9)] == ['12 B', '1.5 kB', '810 MB', '1.4 GB']
