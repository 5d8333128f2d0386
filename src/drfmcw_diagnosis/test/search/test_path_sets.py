"""Fewer effects of the path take the place of several that imitate them together."""

from checkout import DATA

from drfmcw_diagnosis.compare.comparison import Comparison
from drfmcw_diagnosis.recording.dataset import read_dataset
from drfmcw_diagnosis.search.path_sets import fewer
from drfmcw_diagnosis.search.search import Search
from drfmcw_sim.effects import Effect


def searched(*effects):
    """Return a search of what the effects themselves add to the model: a residual free of noise."""
    comparison = Comparison(read_dataset(DATA / 'recording_0'))
    comparison.residual = comparison.template([Effect.registry[name](**values) for name, values in effects])
    return Search(comparison)


def start(search, effect, station, **values):
    candidate = next(c for c in search.bank if c.key == (effect, station))
    return candidate, candidate.values | values


def test_a_scale_and_an_offset_are_no_air_and_three_clocks():
    """Nothing is by chance: air at its bound, both ADC clocks and a delay leave little, and two effects nothing."""
    search = searched(('reference_scale', {'scale': -594.0}), ('reference_offset', {'offset': 0.07}))
    imitation = search.fit(
        [
            start(search, 'air_refractivity', '', offset=480.0),
            start(search, 'sample_clock_offset', 'master', deviation=-80.0),
            start(search, 'sample_clock_offset', 'slave', deviation=-90.0),
            start(search, 'delay_offset', '', delay=-0.2),
        ]
    )
    found = fewer(search, imitation)
    assert {f.keys for f in found} >= {(('reference_offset', ''), ('reference_scale', ''))}
    assert all(len(f.effects) == 2 and f.misfit < imitation.misfit + 8.0 for f in found)


def test_effects_that_are_needed_stay():
    """A warming clock beside a ripple and a scale: one effect of the path in place of two fits far worse."""
    effects = (
        ('reference_scale', {'scale': 100.0}),
        ('reference_clock_temperature', {'station': 'slave', 'slope': -0.3}),
        ('sweep_ripple', {'station': 'master', 'deviation': 400.0, 'rate': 9000.0}),
    )
    search = searched(*effects)
    found = search.fit(
        [
            start(search, 'reference_scale', '', scale=90.0),
            start(search, 'reference_clock_temperature', 'slave', slope=-0.2),
        ]
    )
    assert fewer(search, found) == []
