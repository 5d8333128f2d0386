"""Calibrating one station: a simulated counter, terminated antennas, a cable; what is stored, and what is refused."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated_counter import SimulatedCounter

from drfmcw_commissioning.calibrate import main
from drfmcw_commissioning.indoors.counter import Counter, read_counter
from drfmcw_commissioning.indoors.noise import receiver_noise
from drfmcw_commissioning.indoors.oscillator import oscillator_noise
from drfmcw_node.processing.records import Sweep
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import Clock, Document, read_document
from drfmcw_ros.calibration.store import CalibrationStore
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import scenario_from_mapping
from drfmcw_sim.timeline import Timeline

ALPHA, ADC = 1.0 + 37e-6, 1.0 + 18e-6
CABLE = 15.0
CLOCK = Clock(1.000002, 1e-9)  # of the master in `scenario`
DELAYS = {'master': 12.3e-9, 'slave': 15.8e-9}


def scenario(sweeps=40, board=25.0, **changes):
    """A pair through an attenuated cable, the references 4 ppm apart."""
    stations = {
        'master': {'alpha': 1.000002, 'delay': DELAYS['master'], 'delay_slope': 3e-12, 'board_temperature': board},
        'slave': {'alpha': 0.999998, 'delay': DELAYS['slave'], 'noise_floor': -137.7},
    }
    for name, values in changes.pop('stations', {}).items():
        stations[name] |= values
    mapping = {
        'stations': stations,
        'pairs': [
            {
                'first': 'master',
                'second': 'slave',
                'path_loss': 74.0,
                'standing': {'distances': [CABLE / 1.0003], 'sweeps': sweeps},
            }
        ],
        'weather': {'temperature': 25.0, 'humidity': 0.3},
        'reference': {'enabled': False},
        'seed': 4,
    }
    return scenario_from_mapping(mapping | changes, 'test')


def sweeps_of(scene, station, count):
    """The first sweeps of a station, and its settings."""
    timeline = Timeline(scene)
    events = [e for e in timeline.render(timeline.slots(count)) if e.topic == f'/{station}/if_samples']
    names = [field.name for field in dataclasses.fields(Sweep)]
    (settings,) = (s for s in timeline.sweep_settings(0) if s.station == station)
    return settings, [Sweep(**{name: getattr(e.content, name) for name in names}) for e in events]


# --- counter ---


def test_counter_is_read_and_named():
    with SimulatedCounter({1: 1e8 * ALPHA, 2: 2.048e6 * ADC}, std=1e-9) as simulated:
        with Counter(simulated.address) as counter:
            reference, adc = read_counter(counter, {'reference': 1, 'adc': 2}, 20, 31.0)
            assert counter.name == 'Simulated,Counter,7,1.0'
    assert reference.frequency / 1e8 == pytest.approx(ALPHA, abs=2e-9)  # nine standard deviations of the mean
    assert adc.frequency / 2.048e6 == pytest.approx(ADC, abs=2e-9)
    assert 0.3 < reference.std / (0.1 / math.sqrt(20)) < 3.0 and reference.temperature == 31.0
    assert simulated.asked[1] == 'MEAS:FREQ? DEF,DEF,(@1)'


@pytest.mark.parametrize(
    ('answer', 'reason'),
    [('9.91E37', "answers '9.91E37', which is no frequency"), ('overload', "answers 'overload'"), ('', 'no answer to')],
)
def test_counter_without_a_frequency_is_one_line(answer, reason):
    with SimulatedCounter({1: 1e8}, answer=answer) as simulated, Counter(simulated.address, timeout=3.0) as counter:
        with pytest.raises(ConfigurationError, match=reason) as error:
            counter.frequencies(1, 1)
    assert '\n' not in str(error.value)


def test_absent_counter_is_one_line(capsys):
    assert main(['station', 'master', '--counter', '127.0.0.1:1']) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and 'counter TCPIP0::127.0.0.1::1::SOCKET' in said


def test_readings_at_several_temperatures_become_a_stored_curve(tmp_path, monkeypatch, capsys):
    """A drifting clock is read at seven temperatures, one call each; the curve comes back within its 4 sigma."""
    monkeypatch.chdir(tmp_path)
    curve = np.array([37e-6, -2e-7, 0.0, 1e-10])
    with SimulatedCounter({}, std=2e-9) as simulated:
        for board in (-10, 0, 10, 20, 30, 40, 45):
            deviation = float(np.sum(curve * (board - 25.0) ** np.arange(4)))
            simulated.frequencies = {1: 1e8 * (1.0 + deviation), 2: 2.048e6 * (1.0 + deviation)}
            keep = ['--counter', simulated.address, '--keep', 'bench.csv', '--temperature', str(board)]
            assert main(['station', 'master', *keep, '--count', '5']) == 0
    arguments = ['--csv', 'bench.csv', '--plot', 'curve.png', '--operator', 'A. Operator', '--note', 'first']
    assert main(['station', 'master', *arguments, '--store', '--state', 'state', '--reading-std', '0.001']) == 0
    said = capsys.readouterr().out
    assert 'reference clock: +3' in said and 'cubic from -10 to 45 degC' in said and 'mm at 1 km' in said
    assert 'ppb rms, the largest' in said
    assert (tmp_path / 'curve.png').read_bytes().startswith(b'\x89PNG')
    document = read_document('master.calibration.yaml')
    assert document == CalibrationStore('state').newest('master')
    assert (document.version, document.operator, document.note) == (1, 'A. Operator', 'first')
    calibration = document.calibration()
    for board in (-10.0, 12.0, 45.0):
        true = 1.0 + float(np.sum(curve * (board - 25.0) ** np.arange(4)))
        assert float(calibration.alpha_at(board)) == pytest.approx(true, abs=4.0 * calibration.alpha_std)
    assert 2e-8 <= calibration.alpha_std < 2.5e-8  # the time base of the counter, mostly


# --- noise ---


@pytest.mark.parametrize('iq', [False, True])
def test_noise_floor_of_terminated_antennas(iq):
    """Within 4 of its standard deviations; the response is flat within 5 of its own (16 bands: 1e-5)."""
    terminated = scenario(
        stations={'slave': {'noise_floor': -137.7}}, pairs=[
            {'first': 'master', 'second': 'slave', 'path_loss': 300.0, 'standing': {'distances': [10.0], 'sweeps': 60}}
        ], waveform={'iq': iq},
    )  # fmt: skip
    found = receiver_noise(*sweeps_of(terminated, 'slave', 60))
    assert found.floor == pytest.approx(-137.7, abs=4.0 * found.floor_std)
    assert found.floor_std < 0.05
    assert np.all(np.abs(found.gain) < 5.0 * found.gain_std)


def test_a_line_in_the_noise_is_named():
    with pytest.raises(ConfigurationError, match=r"'slave' hears a line at .* kHz, .* dB above the noise: are its"):
        receiver_noise(*sweeps_of(scenario(), 'slave', 20))


# --- cable ---


def test_phase_noise_of_both_oscillators():
    """Level within 4 of its standard deviations and 0.5 dB for what neighbouring bins share."""
    settings, sweeps = sweeps_of(scenario(sweeps=100), 'master', 100)
    found = oscillator_noise(settings, sweeps)
    assert found.level == pytest.approx(-90.0, abs=4.0 * found.level_std + 0.5)
    assert found.level_std < 1.0
    assert found.corner == pytest.approx(200e3, abs=4.0 * found.corner_std + 20e3)


def test_stations_through_a_cable(tmp_path, monkeypatch, capsys):
    """Delay, its slope and T_off come out within 4 standard deviations (less the cable's own error: none here)."""
    monkeypatch.chdir(tmp_path)
    exact = {'noise_floor': -140.7}
    boards = (0.0, 20.0, 40.0)
    for board in boards:
        scene = scenario(board=board, stations={'slave': exact})
        scene = dataclasses.replace(scene, seed=int(board) + 1)
        write_recording(scene, f'cable_{board:g}')
    paths = [word for board in boards for word in ('--path', f'cable_{board:g}')]
    clocks = ['--reading', f'reference:{1e8 * 1.000002!r}', '--reading', f'adc:{2.048e6 * 1.000002!r}']
    length = ['--cable', '15', '--length-std', '0.005']
    assert main(['station', 'master', *clocks, *paths, *length, '--state', 'state', '--out', 'master.yaml']) == 0
    said = capsys.readouterr().out
    assert "How it divides between 'master' and 'slave' it does not show" in said
    document = read_document('master.yaml')
    air = CABLE / 1.0003 * 1.000301  # the scenario's cable is a length of air
    total = sum(DELAYS.values()) - DELAYS['slave']  # the recorded calibration of the slave states its own
    assert document.delay.value + (CABLE - air) / SPEED_OF_LIGHT == pytest.approx(total, abs=2e-12)
    assert document.delay.std == pytest.approx(0.005 / SPEED_OF_LIGHT, rel=0.05)
    assert document.delay.slope == pytest.approx(3e-12, abs=4.0 * document.delay.slope_std)
    assert document.delay.peer == 'slave'
    assert (document.temperature.low, document.temperature.high) == (0.0, 40.0)
    assert abs(document.start_delay.excess) < 4.0 * document.start_delay.std + 1e-9  # the slave's clock is exact
    assert document.start_delay.jitter == pytest.approx(2e-9, rel=0.3)
    assert document.noise.phase_level == pytest.approx(-90.0, abs=2.0)


def test_stations_over_a_known_baseline_or_delay(tmp_path, monkeypatch, capsys):
    """20 m of air, stated as a length and as a delay: the same delay within 4 standard deviations of its white part."""
    monkeypatch.chdir(tmp_path)
    length = 20.0
    pair = {'first': 'master', 'second': 'slave', 'standing': {'distances': [length], 'sweeps': 40}}
    scene = scenario(pairs=[pair], stations={'slave': {'noise_floor': -140.7}})
    write_recording(scene, 'air')
    w = scene.weather
    index = float(refractive_index(*(q.at(0.0) for q in (w.temperature, w.pressure, w.humidity))))
    found = []
    for known in (
        ['--baseline', f'{length}', '--length-std', '0.001'],
        ['--delay', f'{length * index / SPEED_OF_LIGHT!r}', '--delay-std', f'{1e-3 * index / SPEED_OF_LIGHT!r}'],
    ):
        words = ['--path', 'air', *known, '--from', 'clocks.yaml', '--out', 'out.yaml', '--state', 'state']
        Path('clocks.yaml').write_text(Document('master', reference_clock=CLOCK, sample_clock=CLOCK).text())
        assert main(['station', 'master', *words]) == 0, capsys.readouterr().err
        found.append(read_document('out.yaml').delay)
        assert found[-1].std == pytest.approx(1e-3 * index / SPEED_OF_LIGHT, rel=0.05)
        assert found[-1].value == pytest.approx(DELAYS['master'], abs=2e-12)
    # the weather sensors of the simulated site scatter by 0.2 K, 20 Pa and 1 %: 1e-6 of the path
    assert found[0].value == pytest.approx(found[1].value, abs=5e-6 * length / SPEED_OF_LIGHT)


def test_line_at_several_start_delays_shows_a_filter_before_the_noise(tmp_path, monkeypatch, capsys):
    """A pole at 400 kHz, behind which the noise enters: the line shows it, 5 frequencies within 5 of their sigma.

    The noise of terminated antennas, white behind the filter, does not.
    """
    monkeypatch.chdir(tmp_path)
    pole = 400e3
    effect = {'effect': 'if_filter', 'station': 'master', 'pole': pole, 'noise_behind': True}
    start_delays = (1.5e-6, 2.4e-6, 3.3e-6, 4.2e-6, 5.1e-6)
    for number, start_delay in enumerate(start_delays):
        write_recording(
            dataclasses.replace(scenario(effects=[effect], mode={'start_delay_short': start_delay}), seed=number),
            f'cable_{number}',
        )
    paths = [word for number in range(len(start_delays)) for word in ('--path', f'cable_{number}')]
    cable = ['--cable', '15', '--length-std', '0.005']
    assert main(['station', 'master', *paths, *cable, '--state', 'state', '--out', 'out.yaml']) == 0
    assert 'IF response: the line varies by' in capsys.readouterr().out
    response = read_document('out.yaml').if_response
    assert response.of == 'line' and len(response.frequency) == len(start_delays)
    frequency, gain, std = (np.array(values) for values in (response.frequency, response.gain, response.std))
    true = -10.0 * np.log10(1.0 + (frequency / pole) ** 2)
    assert np.ptp(true) > 4.0 and np.all(std < 0.1)
    assert np.all(np.abs(gain - (true - np.median(true))) < 5.0 * np.hypot(std, std[len(std) // 2]) + 0.01)
    terminated = scenario(
        effects=[effect],
        pairs=[
            {'first': 'master', 'second': 'slave', 'path_loss': 300.0, 'standing': {'distances': [10.0], 'sweeps': 60}}
        ],
    )
    noise = receiver_noise(*sweeps_of(terminated, 'master', 60))
    assert np.all(np.abs(noise.gain) < 5.0 * noise.gain_std)


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        ([], 'nothing to calibrate'),
        (['--reading', 'reference:1e8', '--reading-std', '0'], 'cannot be weighed'),
        (
            ['--path', 'none'],
            '--path needs one of --cable and --baseline, and --length-std; or --delay and --delay-std',
        ),
        (['--path', 'none', '--delay', '5e-8', '--length-std', '0.01'], '--path needs one of'),
        (['--path', 'none', '--delay', '0', '--delay-std', '0'], '--delay 0: must be above 0'),
        (['--path', 'none', '--cable', '15', '--length-std', '-1'], '--length-std -1: must not be below 0'),
        (['--path', 'none', '--cable', '15', '--length-std', '0.01'], 'none'),
        (['--terminated', 'none'], 'none'),
        (['--reading', 'reference:1e9'], 'ppm are plausible'),
        (['--reading', 'clock:1e8'], "unknown clock 'clock'"),
        (['--csv', 'none.csv'], 'none.csv: No such file'),
        (['--keep', 'x.csv', '--reading', 'adc:2.048e6'], 'give --counter'),
        (['--reading', 'reference:1e8', '--out', 'missing/x.yaml'], 'missing/x.yaml'),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, arguments, reason):
    monkeypatch.chdir(tmp_path)
    assert main(['station', 'master', '--state', 'state', *arguments]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and reason in said
    assert not list(tmp_path.iterdir())


# --- what is kept ---


def test_history_is_listed_shown_compared_and_rolled_back(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for frequency, note in (('100003700', 'first'), ('100003800', 'second')):
        words = ['--reading', f'reference:{frequency}', '--store', '--note', note, '--state', 'state']
        assert main(['station', 'master', *words]) == 0
    capsys.readouterr()
    state = ['--state', 'state']
    assert main(['list', *state]) == 0
    assert 'first' in (listed := capsys.readouterr().out) and 'second' in listed
    assert main(['diff', 'master', *state]) == 0
    said = capsys.readouterr().out
    assert 'version 1 -> 2' in said and 'reference_clock.value: 1.000037 -> 1.000038 (+1e-06)' in said
    assert main(['rollback', 'master', '--operator', 'B', *state]) == 0
    capsys.readouterr()
    assert main(['show', 'master', *state]) == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert (shown['version'], shown['operator'], shown['note']) == (3, 'B', 'version 1 again: first')
    assert shown['reference_clock']['value'] == pytest.approx(1.000037, abs=1e-12)
    assert main(['diff', 'master', '1', '3', *state]) == 0
    assert 'note: first -> version 1 again: first' in (said := capsys.readouterr().out) and 'value' not in said
    assert main(['store', 'master.calibration.yaml', *state]) == 0
    assert CalibrationStore('state').versions('master') == [1, 2, 3, 4]
    for words, reason in (
        (['show', 'slave'], "no calibration of 'slave'"),
        (['show', 'master', '--version', '9'], 'no calibration of version 9'),
        (['rollback', 'slave'], 'no version before the newest'),
        (['diff', 'slave'], 'two can be compared'),
        (['show', '../x'], 'is no name of a station'),
    ):
        capsys.readouterr()
        assert main([*words, *state]) == 2
        assert reason in capsys.readouterr().err
