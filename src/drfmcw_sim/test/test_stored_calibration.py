"""Stations that publish a calibration other than their true state, and curves over the board temperature."""

import dataclasses

import numpy as np
import pytest

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import Clock, Document
from drfmcw_sim.scenario import scenario_from_mapping
from drfmcw_sim.timeline import Timeline

PAIR = [{'first': 'master', 'second': 'slave', 'standing': {'distances': [100.0], 'sweeps': 4}}]


def scenario(tmp_path, **master):
    mapping = {'stations': {'master': master, 'slave': {}}, 'pairs': PAIR}
    return scenario_from_mapping(mapping, str(tmp_path / 'scenario.yaml'))


def test_document_is_published_and_the_other_keys_stay_the_truth(tmp_path):
    document = Document('master', version=3, reference_clock=Clock(1.00001))
    (tmp_path / 'master.yaml').write_text(document.text())
    scene = scenario(tmp_path, alpha=1.00002, calibration='master.yaml')
    timeline = Timeline(scene)
    (event,) = (e for e in timeline.opening() if e.topic == '/master/calibration')
    assert (event.content.alpha, event.content.version) == (1.00001, 3)
    truth = timeline.measurements(timeline.slots(4), 0).stations[0]
    assert truth.alpha.tolist() == [1.00002] * 4


def test_document_of_another_station_is_refused(tmp_path):
    (tmp_path / 'slave.yaml').write_text(Document('slave').text())
    with pytest.raises(ConfigurationError, match=r"master: calibration slave\.yaml is of station 'slave'"):
        scenario(tmp_path, calibration='slave.yaml')
    with pytest.raises(ConfigurationError, match=r'none\.yaml: No such file'):
        scenario(tmp_path, calibration='none.yaml')


def test_clocks_and_delay_follow_the_board(tmp_path):
    """At 40 degC: the cubic of the reference, the ADC in proportion, and the slope of the delay."""
    curve = {'alpha': 1.00002, 'sample_clock_alpha': 1.00001, 'alpha_linear': -2e-7, 'alpha_cubic': 1e-10}
    timelines = [
        Timeline(scenario(tmp_path, **curve, delay=1e-8, delay_slope=3e-12, board_temperature=board))
        for board in (25.0, 40.0)
    ]
    cold, warm = (t.measurements(t.slots(4), 0) for t in timelines)
    change = -2e-7 * 15.0 + 1e-10 * 15.0**3
    assert warm.stations[0].alpha - cold.stations[0].alpha == pytest.approx(np.full(4, change), abs=1e-15)
    ratio = 1.00001 / 1.00002
    assert warm.stations[0].sample_clock - cold.stations[0].sample_clock == pytest.approx(change * ratio, abs=1e-15)
    assert warm.stations[1].alpha.tolist() == cold.stations[1].alpha.tolist()
    assert warm.paths[0].delay - cold.paths[0].delay == pytest.approx(np.full(4, 45e-12), abs=1e-20)


def test_published_curve_is_the_true_one(tmp_path):
    scene = scenario(tmp_path, alpha_linear=-2e-7, delay_slope=3e-12)
    published = scene.published_calibration('master')
    assert published == dataclasses.replace(scene.calibration('master'), frame_id='master_antenna')
    assert (published.alpha_linear, published.sample_clock_linear, published.delay_slope) == (-2e-7, -2e-7, 3e-12)
