"""Configuration: what is wrong is named, with where and the nearest valid word."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drfmcw_physics.settings import ConfigurationError, from_mapping, parameter, read_yaml


@dataclasses.dataclass(frozen=True)
class Inner:
    speed: float = parameter(1.0, unit='m/s', bounds=(0.0, 10.0), description='speed')


@dataclasses.dataclass(frozen=True)
class Outer:
    name: str = parameter(description='name')
    count: int = parameter(3, bounds=(0, 9), description='count')
    kind: str = parameter('near', choices=('near', 'far'), description='kind')
    inner: Inner = Inner()


@pytest.mark.parametrize(
    ('mapping', 'message'),
    [
        ({'name': 'a', 'cuont': 1}, "site.yaml: unknown key 'cuont'; did you mean 'count'?"),
        ({'name': 'a', 'inner': {'sped': 1}}, "site.yaml: inner: unknown key 'sped'; did you mean 'speed'?"),
        ({'count': 1}, "site.yaml: key 'name' is missing"),
        ({'name': 'a', 'count': 12}, 'site.yaml: count = 12 is outside 0 ... 9'),
        ({'name': 'a', 'count': 1.5}, 'site.yaml: count must be a whole number, not 1.5'),
        ({'name': 'a', 'kind': 'fra'}, "site.yaml: kind: 'fra' is not valid; did you mean 'far'?"),
        ({'name': 'a', 'inner': {'speed': float('nan')}}, 'site.yaml: inner: speed must be a number, not NaN'),
        ({'name': 'a', 'inner': {'speed': -1}}, 'site.yaml: inner: speed = -1 m/s is outside 0 ... 10 m/s'),
        ({'name': 7}, 'site.yaml: name must be a string, not 7'),
        ({'name': 'a', 'inner': [1]}, 'site.yaml: inner: expected a mapping of settings, not [1]'),
    ],
)
def test_wrong_settings_are_named(mapping, message):
    with pytest.raises(ConfigurationError) as caught:
        from_mapping(Outer, mapping, 'site.yaml')
    assert str(caught.value) == message


@given(st.text(min_size=1), st.integers(0, 9), st.sampled_from(['near', 'far']), st.floats(0, 10))
def test_right_settings_arrive(name, count, kind, speed):
    mapping = {'name': name, 'count': count, 'kind': kind, 'inner': {'speed': speed}}
    assert from_mapping(Outer, mapping, 'x') == Outer(name, count, kind, Inner(speed))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: 1\na: 2\n', "line 2: key 'a' is given twice"),
        ('a: [1,\n', 'line 2'),
        ('- 1\n', 'expected a mapping of settings'),
        (None, 'No such file'),
    ],
)
def test_unreadable_yaml_says_where(tmp_path, text, message):
    path = tmp_path / 'site.yaml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        read_yaml(path)
    assert str(caught.value).startswith(str(path))
