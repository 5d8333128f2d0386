"""Wrong settings are given away by the samples, right ones raise no warning.

Each line of the tests is deterministic by its seed; with other seeds the false-alarm tests fail about once in 10 000.
"""

import math

import numpy as np
import pytest

from drfmcw_import.convert.checks import Statistics, findings
from drfmcw_physics.sweep import SweepSettings

FULL_SCALE = 2048.0


def sweep(count, bandwidth=150e6):
    nan = math.nan
    return SweepSettings(
        station='radar', peer='radar', mode=1, bandwidth=bandwidth, ramp_duration=1e-3, start_delay=0.0,
        sample_rate=count / 1e-3, sample_count=count, tx_eirp=nan, rx_antenna_gain=nan, full_scale_power=nan,
    )  # fmt: skip


def line(sweeps=64, count=256, turns=13.3, amplitude=0.4, iq=False, seed=5):
    """Return codes (sweeps, count, 1 or 2) of one line whose phase differs from sweep to sweep, with noise."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2 * np.pi, (sweeps, 1))
    signal = amplitude * np.exp(1j * (2 * np.pi * turns * np.arange(count) / count + phase))
    parts = np.stack([signal.real, signal.imag], axis=-1)[..., : 2 if iq else 1]
    return np.rint((parts + rng.normal(0.0, 0.01, parts.shape)) * FULL_SCALE).clip(-2048, 2047).astype(np.int16)


def warnings(codes, full_scale=FULL_SCALE, bandwidth=150e6, roundings=0.0):
    statistics = Statistics()
    for block in np.array_split(codes, 3):
        statistics.add(block)
    return [f.sentence for f in findings(statistics, sweep(codes.shape[1], bandwidth), full_scale, roundings)
            if not f.agrees]  # fmt: skip


@pytest.mark.parametrize('iq', [False, True])
@pytest.mark.parametrize('count', [64, 100, 256, 2048])
@pytest.mark.parametrize('share', [0.02, 0.09, 0.21, 0.33, 0.43])
def test_right_settings_raise_no_warning(iq, count, share):
    """Whatever the length of sweeps and wherever the line stands, down to two turns."""
    assert warnings(line(count=count, turns=max(3.4, share * count), iq=iq)) == []


def test_noise_alone_raises_no_warning():
    assert warnings(line(amplitude=0.0)) == []


def test_left_justified_codes_are_seen():
    (said,) = warnings((line() * 16).astype(np.int16), 32768.0)
    assert 'all 16 apart' in said and 'span: 16' in said and 'bits: 12' in said


def test_a_lowest_bit_that_mostly_sticks_is_seen():
    stuck = line()
    stuck[:48] &= ~1
    (said,) = warnings(stuck)
    ratio = float(said.split('occurs ')[1].split(' times')[0])
    assert 5.0 < ratio < 10.0  # three quarters of the sweeps even, one quarter either: 7 to 1


def test_scaled_codes_are_seen():
    assert any('never occur' in w for w in warnings(np.rint(line(sweeps=512) * 1.37).astype(np.int16), 4096.0))


def test_numbers_between_codes_are_seen():
    assert any('away from whole codes' in w for w in warnings(line(), roundings=0.4))


def test_offset_binary_read_as_signed_is_seen():
    assert any('no code has the other sign' in w for w in warnings(line() // 2 + 1024))


def test_wrapped_codes_read_as_offset_binary_are_seen():
    wrapped = (line().astype(int) % 4096 - 2048).astype(np.int16)
    assert any('across the whole range' in w and 'wrapped' in w for w in warnings(wrapped))


@pytest.mark.parametrize('bandwidth', [150e6, -150e6])
def test_swapped_iq_is_seen(bandwidth):
    right = line(iq=True) if bandwidth > 0 else line(iq=True)[..., ::-1]
    assert warnings(right, bandwidth=bandwidth) == []
    (said,) = warnings(right[..., ::-1], bandwidth=bandwidth)
    assert 'swap_iq: true' in said


@pytest.mark.parametrize('blocks', [2, 4])
def test_blocks_read_as_one_sweep_are_seen(blocks):
    """Several receivers one behind the other: their phases differ."""
    each = [line(count=128, turns=3.7, seed=seed) for seed in range(blocks)]
    (said,) = warnings(np.concatenate(each, axis=1))
    assert f'hold {blocks} blocks' in said and 'before sample' in said


@pytest.mark.parametrize('sources', [2, 4])
def test_sources_that_alternate_are_seen(sources):
    each = [line(count=256 // sources, turns=5.3, seed=seed) for seed in range(sources)]
    mixed = np.stack(each, axis=2).reshape(64, 256, 1)
    assert any('alternate sample by sample' in w and f'size {sources}' in w for w in warnings(mixed))


def test_clipping_is_seen_with_its_share():
    clipped = line(amplitude=1.6)
    true = np.mean(np.abs(clipped) >= 2047)
    (said,) = warnings(clipped)
    assert 'stand at the rails' in said
    assert abs(float(said.split('%')[0]) / 100 - true) < 0.05


def test_dead_samples_and_dead_sweeps_are_seen():
    dead = line()
    dead[:, :9] = 7
    assert any('skip_samples: 9' in w for w in warnings(dead))
    dead = line()
    dead[3:5] = 0
    assert any('2 of 64 sweeps have one value only' in w for w in warnings(dead))


def test_samples_beyond_the_ramp_are_seen():
    statistics = Statistics()
    codes = line()
    statistics.add(codes)
    short = sweep(256)
    short = SweepSettings(**{**vars(short), 'ramp_duration': 0.8e-3})
    said = [f.sentence for f in findings(statistics, short, FULL_SCALE, 0.0) if not f.agrees]
    assert any('sample_count: 204' in s for s in said)
