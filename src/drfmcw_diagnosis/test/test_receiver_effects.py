"""Effects of the receiver and its ramp are found in a small recording, by name, station and size."""

import pytest
from scenes import record, scene

from drfmcw_diagnosis.engine import diagnose

STANDING = {'distances': [120.0, 160.0, 210.0, 260.0, 320.0, 390.0], 'sweeps': 12}


@pytest.mark.parametrize(
    ('effect', 'station', 'parameter', 'true'),
    [
        ('amplitude_slope', 'slave', 'slope', 0.4),
        ('amplitude_slope', '', 'slope', 0.6),
        ('second_order_distortion', 'slave', 'second_order', 0.5),
        ('ac_coupling', 'slave', 'pole', 30e3),
        ('sweep_rate', 'slave', 'error', 1e-4),
    ],
)
def test_a_concealed_effect_is_found(tmp_path, effect, station, parameter, true):
    """Its size lies within 4 standard deviations; the recording is fixed, so nothing is by chance."""
    concealed = {'effect': effect, 'station': station, parameter: true}
    scenario = scene({'standing': STANDING}, effects=[concealed], reference={'range_std': 0.005})
    found = diagnose(record(scenario, tmp_path / 'r'))
    assert found.verdict in ('explained', 'ambiguous')
    (finding,) = found.explanation.effects
    assert (finding.effect, finding.station or '') == (effect, station)
    value = finding.parameters[parameter]
    assert abs(value.value - true) < 4.0 * value.std
