"""Small files of every format, written here from one simulated sweep, and what must come out of them."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import soundfile
import yaml
import zarr

RADAR = {'start_frequency': 5.725e9, 'bandwidth': 150e6, 'ramp_duration': 1e-3, 'sample_rate': 64e3}
SWEEPS, SAMPLES = 6, 64


def codes(receivers=1, iq=False, bits=12, seed=7, count=SWEEPS):
    """Return int16 codes (sweeps, receivers, samples, 1 or 2) of a line with noise; of each receiver its own."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES)
    line = np.exp(1j * (2 * np.pi * 0.11 * t + np.arange(count)[:, None, None] * 0.3 + np.arange(receivers)[:, None]))
    signal = np.stack([line.real, line.imag], axis=-1)[..., : 2 if iq else 1]
    noise = rng.normal(0.0, 0.02, signal.shape)
    return np.rint((0.6 * signal + noise) * 2 ** (bits - 1)).astype(np.int16)


@dataclasses.dataclass(frozen=True)
class Case:
    """Writes files into a directory; returns them, the settings, and the codes (sweeps, samples, 1 or 2) expected."""

    name: str
    write: Callable[[Path], tuple[list[Path], dict, np.ndarray]]


CASES = []


def case(function):
    CASES.append(Case(function.__name__, function))
    return function


@case
def npy_real(folder):
    own = codes()
    np.save(folder / 'a.npy', own[:, 0, :, 0])
    return [folder / 'a.npy'], {'radar': RADAR, 'samples': {'bits': 12}}, own[:, 0]


@case
def npy_complex_offset_binary_of_frames(folder):
    own = codes(receivers=3, iq=True)
    stored = (own + 2048).reshape(2, 3, 3, SAMPLES, 2)  # frame, chirp, receiver, sample
    np.save(folder / 'a.npy', stored[..., 0] + 1j * stored[..., 1])
    layout = {'axes': ['frame', 'chirp', 'receiver', 'sample'], 'receiver': 1}
    samples = {'bits': 12, 'coding': 'offset_binary'}
    return [folder / 'a.npy'], {'radar': RADAR, 'layout': layout, 'samples': samples}, own[:, 1]


@case
def npz_wrapped(folder):
    own = codes(bits=16)
    np.savez(folder / 'a.npz', other=np.zeros(3), sweeps=own[:, 0, :, 0].astype(np.int64) % 65536)
    settings = {'radar': RADAR, 'samples': {'bits': 16, 'coding': 'wrapped'}, 'options': {'array': 'sweeps'}}
    return [folder / 'a.npz'], settings, own[:, 0]


@case
def several_files(folder):
    own = codes()
    paths = [folder / f'{i}.npy' for i in range(SWEEPS)]
    for path, sweep in zip(paths, own, strict=True):
        np.save(path, sweep[0, :, 0])
    return paths, {'radar': RADAR, 'samples': {'bits': 12}}, own[:, 0]


@case
def matlab_5_in_volts(folder):
    own = codes()
    scipy.io.savemat(folder / 'a.mat', {'v': (own[:, 0, :, 0] + 2048) * 3.3 / 4096})
    samples = {'bits': 12, 'span': 3.3, 'coding': 'offset_binary'}
    return [folder / 'a.mat'], {'radar': RADAR, 'samples': samples}, own[:, 0]


@case
def matlab_7_3(folder):
    own = codes(iq=True)
    with h5py.File(folder / 'a.mat', 'w', userblock_size=512) as file:  # axes reversed, complex a struct
        kind = np.dtype([('real', 'f8'), ('imag', 'f8')])
        stored = np.empty((SAMPLES, SWEEPS), kind)
        stored['real'], stored['imag'] = own[:, 0, :, 0].T, own[:, 0, :, 1].T
        file['iq'] = stored
    with open(folder / 'a.mat', 'r+b') as file:
        file.write(b'MATLAB 7.3 MAT-file')
    settings = {'radar': RADAR, 'layout': {'axes': ['chirp', 'sample']}, 'samples': {'bits': 12}}
    return [folder / 'a.mat'], settings, own[:, 0]


@case
def hdf5_receivers_averaged(folder):
    own = codes(receivers=2)
    with h5py.File(folder / 'a.h5', 'w') as file:
        file['group/if'] = own[..., 0].transpose(0, 2, 1)
    layout = {'axes': ['chirp', 'sample', 'receiver'], 'average': True}
    expected = np.rint(own.astype(float).mean(axis=1)).astype(np.int16)
    return [folder / 'a.h5'], {'radar': RADAR, 'layout': layout, 'samples': {'bits': 12}}, expected


@case
def hdf5_flat(folder):
    own = codes(iq=True)
    with h5py.File(folder / 'a.h5', 'w') as file:
        file['if'] = own[:, 0].ravel()
    layout = {'axes': ['chirp', 'sample', 'iq'], 'shape': [-1, SAMPLES, 2]}
    return [folder / 'a.h5'], {'radar': RADAR, 'layout': layout, 'samples': {'bits': 12}}, own[:, 0]


@case
def zarr_group(folder):
    own = codes()
    group = zarr.open_group(str(folder / 'a.zarr'), mode='w')
    array = group.create_array if hasattr(group, 'create_array') else group.create_dataset
    array('chirps', shape=(SWEEPS, SAMPLES), chunks=(2, SAMPLES), dtype='i2')[:] = own[:, 0, :, 0]
    return [folder / 'a.zarr'], {'radar': RADAR, 'samples': {'bits': 12}}, own[:, 0]


@case
def csv_with_header_and_columns(folder):
    own = codes(iq=True)
    rows = own[:, 0].reshape(-1, 2)
    lines = [f'{n * 1e-6},{i},{q}' for n, (i, q) in enumerate(rows)]
    (folder / 'a.csv').write_text('# radar\ntime,I,Q\n' + '\n'.join(lines) + '\n')
    layout = {'axes': ['chirp', 'sample', 'iq'], 'shape': [-1, SAMPLES, 2]}
    settings = {'radar': RADAR, 'layout': layout, 'samples': {'bits': 12}, 'options': {'columns': [1, 2]}}
    return [folder / 'a.csv'], settings, own[:, 0]


@case
def text_with_decimal_commas(folder):
    own = codes()
    lines = ['\t'.join(f'{v / 4095:.6f}'.replace('.', ',') for v in sweep + 2048) for sweep in own[:, 0, :, 0]]
    (folder / 'a.tsv').write_text('\n'.join(lines))
    samples = {'bits': 12, 'coding': 'offset_binary', 'span': 1, 'span_codes': 4095}
    settings = {'radar': RADAR, 'samples': samples, 'options': {'decimal_comma': True}}
    return [folder / 'a.tsv'], settings, own[:, 0]


@case
def raw_big_endian_blocks(folder):
    own = codes(receivers=2, iq=True)
    stored = (own.astype(int) + 32768).transpose(0, 1, 3, 2).astype('>u2')  # blocks of I and of Q
    (folder / 'a.bin').write_bytes(b'12345678' + stored.tobytes())
    layout = {'axes': ['chirp', 'receiver', 'iq', 'sample'], 'shape': [-1, 2, 2, SAMPLES], 'receiver': 1}
    options = {'type': 'uint16', 'byte_order': 'big', 'header_bytes': 8}
    return [folder / 'a.bin'], {'radar': RADAR, 'layout': layout, 'options': options}, own[:, 1]


@case
def raw_columns_q_first_cut(folder):
    own = codes(iq=True)
    (folder / 'a.bin').write_bytes(np.concatenate([own[:, 0, :, ::-1].ravel(), [1, 2]]).astype('<i2').tobytes())
    layout = {'axes': ['chirp', 'sample', 'iq'], 'shape': [-1, SAMPLES, 2], 'swap_iq': True, 'drop_incomplete': True}
    layout |= {'skip_samples': 4, 'sample_count': 40}
    settings = {'radar': RADAR, 'layout': layout, 'samples': {'bits': 12}, 'options': {'columns': 2}}
    return [folder / 'a.bin'], settings, own[:, 0, 4:44]


@case
def sigmf_complex(folder):
    own = codes(iq=True)
    (folder / 'a.sigmf-data').write_bytes(own[:, 0].astype('>i2').tobytes())
    meta = {'global': {'core:datatype': 'ci16_be', 'core:sample_rate': 64e3}, 'captures': [{'core:sample_start': 0}]}
    (folder / 'a.sigmf-meta').write_text(json.dumps(meta))
    radar = {k: v for k, v in RADAR.items() if k != 'sample_rate'}
    layout = {'axes': ['chirp', 'sample'], 'shape': [-1, SAMPLES]}
    return [folder / 'a.sigmf-meta'], {'radar': radar, 'layout': layout, 'samples': {'bits': 12}}, own[:, 0]


@case
def dca1000_four_lanes(folder):
    own = codes(receivers=4, iq=True, bits=16)
    (folder / 'a.bin').write_bytes(own.transpose(0, 2, 3, 1).astype('<i2').tobytes())
    options = {'lanes': 4, 'samples': SAMPLES}
    settings = {'format': 'dca1000', 'radar': RADAR, 'layout': {'receiver': 2}, 'options': options}
    return [folder / 'a.bin'], settings, own[:, 2]


@case
def dca1000_two_lanes_of_frames(folder):
    own = codes(receivers=4, iq=True, bits=16)
    pairs = own.reshape(SWEEPS, 4, SAMPLES // 2, 2, 2).transpose(0, 1, 2, 4, 3)  # I I Q Q
    (folder / 'a.bin').write_bytes(pairs.astype('<i2').tobytes())
    options = {'lanes': 2, 'samples': SAMPLES, 'chirps': 3}
    settings = {'format': 'dca1000', 'radar': RADAR, 'layout': {'receiver': 3}, 'options': options}
    return [folder / 'a.bin'], settings, own[:, 3]


@case
def infineon(folder):
    own = codes(receivers=3)
    frames = own[..., 0].reshape(2, 3, 3, SAMPLES).transpose(0, 2, 1, 3).astype(np.uint16)
    np.save(folder / 'radar.npy', frames + np.uint16(2048))
    shape = {
        'start_frequency_Hz': 58e9, 'end_frequency_Hz': 63.5e9, 'sample_rate_Hz': 2000000,
        'num_samples_per_chirp': SAMPLES,
        'chirp_repetition_time_s': 5e-4, 'frame_repetition_time_s': 0.1, 'rx_antennas': [1, 2, 3],
    }  # fmt: skip
    (folder / 'config.json').write_text(json.dumps({'device_config': {'fmcw_single_shape': shape}}))
    return [folder / 'radar.npy', folder / 'config.json'], {'layout': {'receiver': 2}}, own[:, 2]


@case
def apres(folder):
    own = codes(bits=16, count=6)  # two bursts of three chirps
    header = (
        '\r\n*** Burst Header ***\r\nTime stamp=2022-05-22 19:39:00\r\nRMB_Issue=C:VAB-I\r\n'
        'NSubBursts=3\r\nAverage=0\r\n'
        'TxAnt=1,0,0,0,0,0,0,0\r\nRxAnt=1,0,0,0,0,0,0,0\r\nnAttenuators=1\r\nAttenuator1=10.0,0.0\r\n'
        f'SamplingFreqMode=0\r\nPeriod={SAMPLES / 40e3}\r\n'
        f'N_ADC_SAMPLES={SAMPLES}\r\n*** End Header ***\r\n'
    )
    with open(folder / 'a.dat', 'wb') as file:
        for burst in (own[:3], own[3:]):
            file.write(header.encode() + (burst[:, 0, :, 0].astype(int) + 32768).astype('<u2').tobytes())
    return [folder / 'a.dat'], {}, own[:, 0]


@case
def wav_with_sync(folder):
    own = codes(bits=16)
    period, lead = 100, 37
    track = np.zeros((lead + period * SWEEPS, 2), np.int16)
    track[:, 1] = -20000
    for n in range(SWEEPS):
        begin = lead + n * period
        track[begin : begin + SAMPLES, 0] = own[n, 0, :, 0]
        track[begin : begin + period // 2, 1] = 20000
    soundfile.write(folder / 'a.wav', track, 44100, subtype='PCM_16')
    radar = {k: v for k, v in RADAR.items() if k != 'sample_rate'} | {'ramp_duration': SAMPLES / 44100}
    return [folder / 'a.wav'], {'radar': radar, 'options': {'sweep_duration': SAMPLES / 44100}}, own[:, 0]


def settings_file(folder, settings):
    path = folder / 'settings.yaml'
    path.write_text(yaml.safe_dump(settings))
    return path
