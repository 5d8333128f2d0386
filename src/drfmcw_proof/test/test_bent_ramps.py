"""A bent ramp and the simple effects that resemble it: which is named, and which are listed."""

import pytest
from comparing import beginning, compared

from drfmcw_diagnosis.judging.verdict import judged
from drfmcw_diagnosis.search.bent_ramps import unified
from drfmcw_diagnosis.search.search import Search
from drfmcw_diagnosis.search.selection import searched
from drfmcw_proof.cases.concealing import Applied
from drfmcw_sim.effects import Effect

BENDING = {'sweep_shape', 'sweep_curvature', 'sweep_ripple', 'sweep_rate'}


def bent(path, *effects, among=BENDING):
    """What is said of a recording, of which effects that bend the ramp are tried. It is fixed, so nothing is by chance.

    Returns:
        verdict, effects, and those of all explanations.
    """
    search = Search(compared(path, 62, *effects), without=set(Effect.registry) - among)
    judgement = judged(search, searched(search, 0.01), 0.01)
    listed = [judgement.explanation, *judgement.alternatives]
    return judgement.verdict, judgement.explanation.keys, [f.keys for f in listed]


def test_a_strong_curvature_is_no_spline_that_looks_like_one(tmp_path):
    """Of splines as strong as it is, fewer than one in a million are parabolas to within the noise."""
    verdict, named, _ = bent(tmp_path / 'r', Applied('sweep_curvature', 'master', {'deviation': 300.0}))
    assert verdict == 'explained' and named == (('sweep_curvature', 'master'),)


def test_a_spline_that_looks_like_a_curvature_is_listed_at_either_station(tmp_path):
    """Of 15 sigma; both stations hear the difference of their ramps."""
    shape = {'relative_rate': (1.000001, 1.0, 1.0000005, 0.9999992, 0.9999994)}
    verdict, _, listed = bent(tmp_path / 'r', Applied('sweep_shape', 'slave', shape))
    assert verdict == 'ambiguous'
    assert {keys for keys in listed if 'sweep_shape' in dict(keys)} == {
        (('sweep_shape', station),) for station in ('master', 'slave')
    }
    assert len(set(listed)) == len(listed)


def test_a_spline_that_nothing_resembles_is_found_beside_an_effect(tmp_path):
    """Beside its curvature, which no simple effect of the ramp takes up; at either station, as above."""
    shape = {'relative_rate': tuple(1.0 + 4e-6 * x for x in (0.0, -1.0, 0.0, 1.0, 0.0))}
    clock = Applied('reference_clock_offset', 'master', {'deviation': 3.0})
    among = {'sweep_shape', 'reference_clock_offset'}
    _, named, _ = bent(tmp_path / 'r', Applied('sweep_shape', 'slave', shape), clock, among=among)
    assert {effect for effect, _ in named} == among


def test_a_spline_takes_the_place_of_either_of_two_effects_that_shape_the_chirp(tmp_path):
    """A ripple imitates it, beside a settling of its station, which is there."""
    shape = {'relative_rate': tuple(1.0 + 2e-6 * x for x in (0.6, 1.8, -0.9, -0.7, -0.8))}
    settling = {'step': -16.5e3, 'natural_frequency': 37e3, 'damping': 0.51}
    concealed = Applied('sweep_shape', 'slave', shape), Applied('pll_settling', 'slave', settling)
    search = Search(compared(tmp_path / 'r', 62, *concealed))
    ripple = {'deviation': 50.0, 'rate': 790.0, 'phase': 5.5}
    start = beginning('pll_settling', 'slave', settling), beginning('sweep_ripple', 'slave', ripple)
    imitated = search.fit(start, 20)
    better = [set(fitted.keys) for fitted in unified(search, imitated, 1) if fitted.misfit < imitated.misfit]
    assert {('pll_settling', 'slave'), ('sweep_shape', 'slave')} in better


def test_a_spline_is_named_beside_an_error_of_the_reference_without_a_name(tmp_path):
    """A rail that bends by 0.8 m hides how well it fits until it is set aside."""
    shape = {'relative_rate': tuple(1.0 + 1e-6 * x for x in (-4.0, 3.8, -4.4, -5.3, 9.8))}
    rail = Applied('rail_bend', None, {'height': -0.76, 'length': 870.0})
    among = {'sweep_shape', 'sweep_curvature', 'air_refractivity'}
    _, named, _ = bent(tmp_path / 'r', Applied('sweep_shape', 'slave', shape), rail, among=among)
    assert [effect for effect, _ in named] == ['sweep_shape']


def test_a_spline_that_no_simple_effect_resembles_is_no_event(tmp_path):
    """An event within the sweep explains most of it, and is set aside until the spline is tried in its place."""
    shape = {'relative_rate': tuple(1.0 + 1e-6 * x for x in (-1.01, 0.62, -0.67, -1.13, 2.19))}
    clock = Applied('reference_clock_temperature', 'slave', {'slope': -0.0154})
    among = {'sweep_shape', 'sweep_curvature', 'reference_clock_temperature'}
    _, _, listed = bent(tmp_path / 'r', Applied('sweep_shape', 'master', shape), clock, among=among)
    assert (('reference_clock_temperature', 'slave'), ('sweep_shape', 'master')) in listed


@pytest.mark.parametrize(
    'relative_rate',
    [(-0.173, 0.145, 0.467, -0.265, -0.173), (-0.063, -0.049, -0.562, -0.674, 1.348)],
    ids=['before any simple effect is credible', 'in the place of a sweep rate'],
)
def test_a_spline_alone_is_no_event(tmp_path, relative_rate):
    """Its rate deviates by up to 1.3 ppm; an event within the sweep explains much of it."""
    shape = {'relative_rate': tuple(1.0 + 1e-6 * x for x in relative_rate)}
    among = {'sweep_shape', 'sweep_rate', 'sweep_curvature', 'reference_offset'}
    verdict, _, listed = bent(tmp_path / 'r', Applied('sweep_shape', 'master', shape), among=among)
    assert verdict == 'ambiguous' and (('sweep_shape', 'master'),) in listed
