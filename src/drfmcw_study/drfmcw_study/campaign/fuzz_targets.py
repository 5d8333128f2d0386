"""What is fuzzed: each target takes bytes, and raises only what is a fault of ours."""

import contextlib
import dataclasses
import functools
import os
import random
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from drfmcw_msgs.msg import (
    BeatFrequency,
    CompressedIfSamples,
    IfSamples,
    StationCalibration,
    StationStatus,
    SweepConfig,
    SweepSchedule,
)
from rclpy.logging import LoggingSeverity
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from drfmcw_fusion.fusion import FusionNode
from drfmcw_fusion.offline import is_weather, read_weather, replay_recording
from drfmcw_fusion.pipeline import RangeFusion
from drfmcw_node.compression import CODECS, CompressionError, compress, decompress
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Sweep
from drfmcw_node.sources import feed, reassembly, sealing
from drfmcw_node.station import StationNode
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.commands.config_files import find_config
from drfmcw_ros.graph.messages import ImplausibleError, from_message, stamp_ns, to_message
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_sim.recording import write_recording
from drfmcw_sim.scenario import read_scenario, scenario_from_mapping

_KEY = b'a key of sixteen bytes'
_SAMPLES = 256
_STAMP = 1_700_000_000_000_000_000


def _unchanged(data: bytes, rng: random.Random) -> bytes:
    return data


@dataclasses.dataclass(frozen=True)
class Target:
    """Something that takes bytes from outside."""

    name: str
    title: str
    seeds: Callable[[], list[bytes]]
    run: Callable[[bytes], None]
    tokens: tuple[bytes, ...] = ()
    mended: Callable[[bytes, random.Random], bytes] = _unchanged
    """Makes checksums right again, most of the time, so that mutations get past them."""


# --- the feed ---


def _frames() -> list[bytes]:
    samples = np.random.default_rng(1).integers(-3000, 3000, _SAMPLES).astype(np.int16)
    whole = feed.Frame(1, _STAMP, 8192.0, False, samples, 'slave', 1, 6e-7, 20.0)
    older = dataclasses.replace(whole, samples=samples[:0], peer='', version=1)
    return [feed.encode(whole), feed.encode(dataclasses.replace(older, version=feed.VERSION)) * 2, feed.encode(older)]


def _mended_frames(data: bytes, rng: random.Random) -> bytes:
    """Put right the checksums of every frame."""
    if rng.random() < 0.1:
        return data
    changed = bytearray(data)
    at = changed.find(feed.MAGIC)
    while 0 <= at <= len(changed) - feed.HEADER_SIZE:
        begin = at + (feed.header_size(changed[at + 4]) or feed.HEADER_SIZE)
        header = bytes(changed[at : begin - 4])
        changed[begin - 4 : begin] = struct.pack('<I', zlib.crc32(header))
        end = begin + 2 * struct.unpack_from('<I', header, 48)[0]
        if end + 4 <= len(changed):
            samples = bytes(changed[begin:end])
            changed[end : end + 4] = struct.pack('<I', zlib.crc32(samples))
        at = changed.find(feed.MAGIC, at + 1)
    return bytes(changed)


@functools.cache
def _processor() -> StationProcessor:
    processor = StationProcessor()
    for station in ('master', 'slave'):
        processor.add_calibration(Calibration(station))
    processor.add_sweep_config(SweepSettings('master', 'slave', sample_count=_SAMPLES, sample_rate=256e3))
    return processor


def _take_frames(data: bytes) -> None:
    parser = feed.FrameParser(1 << 20)
    half = len(data) // 2
    with contextlib.suppress(feed.MalformedFrame):
        for frame in parser.feed(data[:half]) + parser.feed(data[half:]):
            _processor().process([frame.sweep('master', frame.peer or 'slave', frame.stamp, '')])


def _datagrams() -> list[bytes]:
    whole = feed.decode_whole(_frames()[0])
    assert whole is not None
    pieces = list(feed.encode_fragments(whole, 7, 200))
    return [b''.join(struct.pack('<H', len(piece)) + piece for piece in pieces)]


def _take_datagrams(data: bytes) -> None:
    assembler = reassembly.FragmentAssembler(4096)
    at = 0
    while at + 2 <= len(data):
        size = struct.unpack_from('<H', data, at)[0]
        assembler.feed(data[at + 2 : at + 2 + size], data[at], at * 1e-4)
        if assembler.held > assembler.bound:
            raise AssertionError(f'{assembler.held} bytes held, at most {assembler.bound} are allowed')
        at += 2 + size


def _sealed() -> list[bytes]:
    session = bytes(range(16))
    return [
        sealing.seal(b'payload', _KEY, sealing.TO_STATION, 0, session),
        sealing.seal(b'payload', _KEY, sealing.TO_STATION, _STAMP),
        sealing.encode_hello(session),
        feed.encode_request(feed.Request(1, 6e-7, 'slave')),
        feed.encode_request(feed.TurnsRequest(25.0, 1, 'slave')),
    ]


def _take_sealed(data: bytes) -> None:
    for use in (
        lambda: sealing.SealedStream(_KEY, bytes(range(16)), sealing.TO_STATION, 1000).feed(data),
        lambda: sealing.SealedDatagrams(_KEY, 0).open(data, _STAMP),
        lambda: sealing.decode_hello(data),
        lambda: feed.decode_requests(data),
    ):
        with contextlib.suppress(sealing.SealError):
            use()


# --- compressed sweeps ---


def _compressed() -> list[bytes]:
    samples = np.round(3000 * np.sin(np.arange(_SAMPLES))).astype(np.int16)
    return [
        struct.pack('<BBH', number, iq, _SAMPLES) + compress(samples, codec, bool(iq))
        for number, codec in enumerate(CODECS)
        for iq in (0, 1)
    ]


def _decompress(data: bytes) -> None:
    if len(data) >= 4:
        codec, iq, count = struct.unpack_from('<BBH', data)
        with contextlib.suppress(CompressionError, ConfigurationError):
            decompress(data[4:], CODECS[codec % len(CODECS)], count, bool(iq % 2))


# --- recordings and settings ---


def _tiny_scenario() -> dict[str, Any]:
    return {
        'stations': {'master': {}, 'slave': {}},
        'pairs': [{'first': 'master', 'second': 'slave', 'standing': {'distances': [100.0], 'sweeps': 3}}],
    }


def _recordings() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'r'
        write_recording(scenario_from_mapping(_tiny_scenario(), 'fuzz'), path)
        return [next(path.glob('*.mcap')).read_bytes()]


@functools.cache
def _metadata() -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'r'
        write_recording(scenario_from_mapping(_tiny_scenario(), 'fuzz'), path)
        text = (path / 'metadata.yaml').read_text(encoding='utf-8')
        return text.replace(next(path.glob('*.mcap')).name, 'r.mcap')


def _keep(fusion: RangeFusion, topic: str, message: Any) -> None:
    """Take one recorded message as the replay does; an implausible one is refused."""
    with contextlib.suppress(ImplausibleError):
        if is_weather(topic):
            fusion.add_weather(read_weather(topic, message)[0], stamp_ns(message.header.stamp), 0.0)
        elif topic.endswith('/sweep_config'):
            fusion.add_sweep_config(from_message(message, SweepSettings))
        elif topic.endswith('/calibration'):
            fusion.add_calibration(from_message(message, Calibration))
        elif topic.endswith('/if_samples'):
            _processor().process([from_message(message, Sweep)])


def _replay(data: bytes) -> None:
    folder = Path(tempfile.mkdtemp())
    try:
        (folder / 'metadata.yaml').write_text(_metadata(), encoding='utf-8')
        (folder / 'r.mcap').write_bytes(data)
        with contextlib.suppress(ConfigurationError), BagReader(folder) as bag:
            fusion = RangeFusion()
            for topic, _, message in bag.messages():
                _keep(fusion, topic, message)
            if data[-1:] < b'\x10':  # some of them all the way, which takes long
                replay_recording(str(folder))
    finally:
        shutil.rmtree(folder)


def _scenarios() -> list[bytes]:
    return [
        yaml.safe_dump(_tiny_scenario()).encode(),
        *(find_config(n).read_bytes()[:4000] for n in ('crane', 'gantry')),
    ]


def _read_settings(data: bytes) -> None:
    with tempfile.NamedTemporaryFile(suffix='.yaml') as file:
        file.write(data)
        file.flush()
        with contextlib.suppress(ConfigurationError):
            read_scenario(Path(file.name))


_YAML = tuple(
    text.encode()
    for text in (
        ' nan', ' .nan', ' .inf', ' -1', ' 1e400', ' 0', ' []', ' {}', ' null', ' true', "'", '"', '&a ', '*a',
        '!!binary x', '\n', '\n  ', ': ', '- ', 'effects: [{effect: spur}]', 'weather: ', 'seed: ',
        'timing: {sweep_interval: 0}',
        '2024-13-45', '1:2:3', '<<: ', '{', '}', '[', '\t', '\x00', '99999999999999999999', '0x', 'é',
    )
)  # fmt: skip


# --- messages ---

_TAKEN_BY_FUSION = (
    SweepConfig, StationCalibration, StationStatus, BeatFrequency, Temperature, FluidPressure, RelativeHumidity,
    SweepSchedule,
)  # fmt: skip
_TAKEN_BY_STATION = (SweepConfig, StationCalibration, IfSamples, CompressedIfSamples)
_NAMES = ('master', 'slave', '', 'a\nb', 'x' * 3000, 'hann', 'flac', 'zlib', '/../x', '\u202e')
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e308, float('nan'), float('inf'), -float('inf'), 5.725e9, 1.5e8, 1e-3, 1e5)


def _built(kind: Any, data: bytes) -> Any:
    """Return a plausible message of a type, with fields changed as the bytes say: field, how, value."""
    base: dict[type, Any] = {
        SweepConfig: SweepSettings('master', 'slave', stamp=_STAMP - 1),
        StationCalibration: Calibration('master', stamp=_STAMP - 1),
    }
    message = to_message(base[kind], kind) if kind in base else kind()
    for name, value in (('station', 'master'), ('peer', 'slave'), ('full_scale', 32767.0), ('frequency', 5e5)):
        if hasattr(message, name) and kind not in base:
            setattr(message, name, value)
    if hasattr(message, 'frequency_std'):
        message.frequency_std = 10.0
    message.header.stamp.sec = _STAMP // 10**9
    fields = [name for name in kind.get_fields_and_field_types() if name != 'header']
    for at in range(0, len(data) - 9, 10):
        index, how = data[at], data[at + 1]
        raw = data[at + 2 : at + 10]
        if index == 255:
            message.header.stamp.sec, message.header.stamp.nanosec = struct.unpack('<iI', raw)
            continue
        name = fields[index % len(fields)]
        _set(message, name, kind.get_fields_and_field_types()[name], how, raw)
    return message


def _set(message: Any, name: str, kind: str, how: int, raw: bytes) -> None:
    if kind in ('double', 'float'):
        value: Any = _FLOATS[how % len(_FLOATS)] if how < 200 else struct.unpack('<d', raw)[0]
        if kind == 'float' and abs(value) > 3e38:
            value = float('inf')
    elif kind == 'string':
        value = _NAMES[how % len(_NAMES)]
    elif kind == 'boolean':
        value = bool(how % 2)
    elif kind.startswith('sequence<int16'):
        value = np.resize(np.frombuffer(raw, np.int16), (0, 1, 7, 2048)[how % 4]).tolist()
    elif kind.startswith('sequence'):
        value = list(raw) * (how % 9)
    else:
        bits = int(''.join(c for c in kind if c.isdigit()) or 8)
        value = struct.unpack('<Q', raw)[0] % (1 << bits)
        value -= 0 if kind.startswith('u') or value < 1 << (bits - 1) else 1 << bits
    setattr(message, name, value)


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Let a context that is initialised meanwhile discover nobody; leave the environment of this process as it was."""
    name = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    before = os.environ.get(name)
    os.environ[name] = 'OFF'
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


@functools.cache
def _node(kind: str) -> Any:
    if not rclpy.ok():
        with _alone():
            rclpy.init()
    made = FusionNode() if kind == 'fusion' else StationNode(namespace='/master')
    made.get_logger().set_level(LoggingSeverity.FATAL)
    return made


def _messages(data: bytes, kinds: Sequence[type]) -> Iterator[tuple[type, Any]]:
    """Yield (type, message) of each part of an input; its first byte chooses the type."""
    for part in filter(None, data.split(b'|||')):
        kind = kinds[part[0] % len(kinds)]
        yield kind, _built(kind, part[1:])


def _to_fusion(data: bytes) -> None:
    node = _node('fusion')
    for kind, message in _messages(data, _TAKEN_BY_FUSION):
        if kind is SweepConfig:
            node._sweep_config(message)
        elif kind is StationCalibration:
            node._calibration(message)
        elif kind is StationStatus:
            node._status(message)
        elif kind is SweepSchedule:
            node._sweep_schedule(message)
        elif kind is BeatFrequency:
            node._beats(message.station, Publishers('/any/beat_frequency'), [message])
        else:
            topics = {Temperature: 'temperature', FluidPressure: 'pressure', RelativeHumidity: 'humidity'}
            node._weather(f'/site/{topics[kind]}', message)


def _to_station(data: bytes) -> None:
    node = _node('station')
    for kind, message in _messages(data, _TAKEN_BY_STATION):
        if kind is SweepConfig:
            node._take_sweep_config(message)
        elif kind is StationCalibration:
            node._take_calibration(message)
        elif kind is IfSamples:
            node._take_samples([message])
        else:
            node._take_compressed([message])


def _typed(count: int) -> Callable[[], list[bytes]]:
    """Return seeds: one plausible message of each type, and all after each other."""
    return lambda: [*(bytes([i]) for i in range(count)), b'|||'.join(bytes([i]) for i in range(count)),
                    bytes([count - 1]) + bytes(range(60))]  # fmt: skip


def targets() -> list[Target]:
    """Return everything that is fuzzed."""
    return [
        Target('frames', 'frames of the feed', _frames, _take_frames, (feed.MAGIC,), _mended_frames),
        Target('datagrams', 'pieces of frames', _datagrams, _take_datagrams, (feed.FRAGMENT_MAGIC,)),
        Target('sealed', 'sealed messages and requests', _sealed, _take_sealed),
        Target('compressed', 'compressed sweeps', _compressed, _decompress),
        Target('recording', 'recordings (mcap)', _recordings, _replay),
        Target('scenario', 'scenario files (YAML)', _scenarios, _read_settings, _YAML),
        Target('fusion', 'messages to fusion', _typed(len(_TAKEN_BY_FUSION)), _to_fusion, (b'|||', b'\xff')),
        Target('station', 'messages to a station', _typed(len(_TAKEN_BY_STATION)), _to_station, (b'|||', b'\xff')),
    ]
