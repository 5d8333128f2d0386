"""Wrong settings are given away by the samples, right ones raise no warning.

Each line of the tests is deterministic by its seed; with other seeds the false-alarm tests fail about once in 10 000.
"""

import dataclasses
import math

import numpy as np
import pytest

from drfmcw_import.convert.checks import Statistics, findings
from drfmcw_import.convert.codes import Coder
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


def warnings(codes, full_scale=FULL_SCALE, bandwidth=150e6, coder=None):
    statistics = Statistics()
    for block in np.array_split(codes, 3):
        statistics.add(block)
    return [f.sentence for f in findings(statistics, sweep(codes.shape[1], bandwidth), full_scale, coder)
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
    coder = Coder(12, 'signed', 1.0, False, 'float64', roundings=0.4)
    assert any('away from whole codes' in w for w in warnings(line(), coder=coder))


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


@pytest.mark.parametrize('angle', [0.0, 40.0, 150.0])
@pytest.mark.parametrize('sweeps', [3, 64])
def test_two_receivers_read_as_i_and_q_are_seen(sweeps, angle):
    """Two real channels stand as far apart as the direction of the echo puts them."""
    whole = line(sweeps=sweeps, iq=True).astype(float)
    turned = whole[..., 0] * math.cos(math.radians(angle)) + whole[..., 1] * math.sin(math.radians(angle))
    two = np.rint(np.stack([whole[..., 0], turned], axis=-1)).astype(np.int16)
    assert any(f'stand {angle:.0f} degrees apart' in w and 'layout: axes' in w for w in warnings(two))


def test_an_imbalance_of_a_receiver_is_no_wrong_layout():
    codes = line(iq=True)
    codes[..., 1] = np.rint(1.2 * codes[..., 1] + 0.2 * codes[..., 0])
    assert warnings(codes) == []


@pytest.mark.parametrize('blocks', [2, 4])
def test_blocks_read_as_one_sweep_are_seen(blocks):
    """Several receivers one behind the other: their phases differ."""
    each = [line(count=128, turns=3.7, seed=seed) for seed in range(blocks)]
    (said,) = warnings(np.concatenate(each, axis=1))
    assert f'hold {blocks} blocks' in said and 'before sample' in said


def test_a_block_whose_border_happens_to_fit_is_seen_by_the_others():
    """The signal is limited and stands still, as of Position2Go: steps to the rails are as large as the jumps."""
    time = np.arange(64)
    swell = 1.6 * np.sin(np.pi * (time + 0.5) / 64)
    blocks = ((0.3, 0.1), (1.9, 0.1), (4.4, -0.15), (0.9, 0.2))  # phase and constant of each
    each = [swell * np.cos(2 * np.pi * 0.047 * time + phase) + constant for phase, constant in blocks]
    one = np.clip(np.concatenate(each), -0.8, 0.8) * FULL_SCALE
    noise = np.random.default_rng(2).normal(0.0, 3.0, (16, 256))
    codes = np.rint(one + noise).astype(np.int16)[..., None]
    assert any('hold 4 blocks' in w for w in warnings(codes))
    assert not any('blocks' in w for w in warnings(codes[:, :64]))


@pytest.mark.parametrize('iq', [False, True])
def test_sweeps_that_are_cut_too_short_are_seen(iq):
    """Read with a quarter of their samples, three of four sweeps go on where the one before ends."""
    whole = line(sweeps=24, count=512, turns=21.3, iq=iq)
    (said,) = warnings(whole.reshape(96, 128, -1))
    assert '4 sweeps of 128 samples seem to be one' in said and 'size 512' in said


def test_pieces_of_one_sweep_are_seen():
    (said,) = warnings(line(sweeps=1, count=2000, turns=17.3).reshape(4, 500, 1))
    assert '4 sweeps of 500 samples seem to be one' in said and 'size 2000' in said


@pytest.mark.parametrize('turns', [16.0, 20.0, 20.3, 32.0, 42.7])
def test_a_target_that_stands_raises_no_warning(turns):
    """Its line repeats from sweep to sweep, also where it stands at a simple fraction of the sampling rate."""
    noise = np.random.default_rng(3).normal(0.0, 0.004, (64, 128, 1))
    one = 0.4 * np.cos(2 * np.pi * turns * np.arange(128) / 128 + 0.4)[:, None]
    assert warnings(np.rint((one + noise) * FULL_SCALE).astype(np.int16)) == []


@pytest.mark.parametrize('iq', [False, True])
def test_receivers_that_alternate_are_seen_by_their_steps(iq):
    """Two lines, each with a phase of its own at each receiver: no image is as strong as the line."""
    rng = np.random.default_rng(12)
    time, phase = np.arange(128), rng.uniform(0.0, 2 * np.pi, (64, 1))
    each = []
    for receiver in range(4):
        far, near = (2 * np.pi * f * time + phase + a * receiver for f, a in ((0.031, 0.4), (0.083, -0.7)))
        parts = np.stack([np.cos(far) + np.cos(near), np.sin(far) + np.sin(near)], axis=-1)[..., : 2 if iq else 1]
        each.append(0.2 * parts + rng.normal(0.0, 0.003, parts.shape))
    mixed = np.stack(each, axis=2).reshape(64, 512, -1)
    (said,) = warnings(np.rint(mixed * FULL_SCALE).astype(np.int16))
    assert '4 sources alternate sample by sample' in said


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


@pytest.mark.parametrize('codes', [[77], [-1, 0, 1], [-2048, 2047], list(range(-4, 5))])
def test_no_more_than_all_samples_stand_at_the_rails(codes):
    drawn = np.random.default_rng(1).choice(codes, (8, 64, 1)).astype(np.int16)
    for said in warnings(drawn):
        assert 'stand at the rails' not in said or float(said.split('%')[0]) <= 100.0


def test_limited_samples_do_not_pass_for_another_coding():
    """A limiter makes steps from rail to rail, which wrapped codes make as well."""
    limited = line(turns=78.1, amplitude=4.0)
    assert not any('whole range' in w for w in warnings(limited))


@pytest.mark.parametrize(
    'coding, stored, advice',
    [
        ('offset_binary', 'uint16', 'coding: wrapped'),
        ('signed', 'int16', 'type: uint16'),
        ('wrapped', 'int16', 'type: uint16'),
        ('signed', 'float64', 'coding: offset_binary'),
    ],
)
def test_the_right_coding_is_named(coding, stored, advice):
    codes = (line().astype(int) % 4096 - 2048).astype(np.int16)
    (said,) = warnings(codes, coder=Coder(12, coding, 1.0, True, stored))
    assert 'across the whole range' in said and advice in said


def test_another_byte_order_is_seen():
    codes = (line(amplitude=0.4) * 8).astype(np.int16).byteswap()
    assert any('byte order' in w for w in warnings(codes, 32768.0))


def test_samples_of_half_a_ramp_are_seen():
    half = dataclasses.replace(sweep(256), ramp_duration=2e-3, bandwidth=300e6)
    statistics = Statistics()
    statistics.add(line())
    (said,) = [f.sentence for f in findings(statistics, half, FULL_SCALE) if not f.agrees]
    assert 'cover 1000 us, 50% of the ramp of 2000 us' in said


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
    said = [f.sentence for f in findings(statistics, short, FULL_SCALE) if not f.agrees]
    assert any('sample_count: 204' in s for s in said)
