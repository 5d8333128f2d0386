"""Lossless compression of sweeps for the radio link.

`flac` predicts each sample from its predecessors and Rice-codes the remainder, which suits an IF line in noise; it uses
libsndfile (python-soundfile). `zlib` needs nothing but Python: bit planes of the zigzag code, deflated.
Quadrature sweeps are two channels.
"""

import argparse
import functools
import io
import time
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError, nearest

from .processing.records import Sweep

_FLAC_MAGIC = b'fLaC'
_NOMINAL_RATE = 48000  # FLAC wants one; the true one stands in the sweep's settings


class CompressionError(ValueError):
    """Compressed data that cannot be decoded; the message is one line."""


def _flac_compress(channels: np.ndarray) -> bytes:
    import soundfile

    file = io.BytesIO()
    soundfile.write(file, channels, _NOMINAL_RATE, format='FLAC', subtype='PCM_16')
    return file.getvalue()


def _flac_decompress(data: bytes, shape: tuple[int, int]) -> np.ndarray:
    import soundfile

    if not data.startswith(_FLAC_MAGIC):  # libsndfile would try all that it knows, MP3 too
        raise CompressionError('no FLAC stream')
    try:
        with soundfile.SoundFile(io.BytesIO(data)) as file:
            if (file.format, file.frames, file.channels) != ('FLAC', *shape):
                raise CompressionError(f'{file.frames} x {file.channels} samples of {file.format}, not {shape}')
            return file.read(dtype='int16', always_2d=True)
    except (soundfile.LibsndfileError, RuntimeError, ValueError, TypeError) as error:
        raise CompressionError(f'no FLAC stream ({error})') from None


def _zlib_compress(channels: np.ndarray) -> bytes:
    wide = channels.astype(np.int32)
    zigzag = ((wide << 1) ^ (wide >> 31)).astype('<u2')  # small magnitudes, either sign, have only low bits
    bits = np.unpackbits(zigzag.reshape(-1, 1).view(np.uint8), axis=1)
    return zlib.compress(np.packbits(bits.T).tobytes(), 1)


def _zlib_decompress(data: bytes, shape: tuple[int, int]) -> np.ndarray:
    count = shape[0] * shape[1]
    try:
        stream = zlib.decompressobj()
        planes = np.frombuffer(stream.decompress(data, 2 * count + 1), np.uint8)  # however much is packed into it
    except zlib.error as error:
        raise CompressionError(f'no zlib stream ({error})') from None
    if len(planes) != 2 * count or not stream.eof:
        raise CompressionError(f'not the {count} samples that it states')
    bits = np.unpackbits(planes, count=16 * count).reshape(16, count)
    zigzag = np.packbits(np.ascontiguousarray(bits.T), axis=1).view('<u2').astype(np.int32)
    return ((zigzag >> 1) ^ -(zigzag & 1)).astype(np.int16).reshape(shape)


_CODECS: dict[str, tuple[Callable, Callable]] = {
    'flac': (_flac_compress, _flac_decompress),
    'zlib': (_zlib_compress, _zlib_decompress),
}
CODECS = tuple(_CODECS)
"""Names of the codecs, as CompressedIfSamples.format states them."""


def compress(samples: np.ndarray, codec: str, iq: bool = False) -> bytes:
    """Return the compressed int16 samples.

    Args:
        samples: int16 (n,), I, Q, I, Q, ... where `iq`.
        codec: one of `CODECS`.
        iq: quadrature samples.

    Raises:
        ConfigurationError: unknown codec, or the library it needs is not installed.
    """
    encode = _codec(codec)[0]
    channels = np.ascontiguousarray(samples, dtype=np.int16).reshape(-1, 2 if iq else 1)
    return encode(channels) if channels.size else b''


def decompress(data: bytes, codec: str, count: int, iq: bool = False) -> np.ndarray:
    """Return the int16 samples (count,) that `compress` was given.

    Raises:
        ConfigurationError: unknown codec, or the library it needs is not installed.
        CompressionError: damaged data.
    """
    decode = _codec(codec)[1]
    width = 2 if iq else 1
    if count == 0 and not len(data):
        return np.zeros(0, np.int16)
    samples = np.ascontiguousarray(decode(bytes(data), (count // width, width))).reshape(-1)
    if len(samples) != count:
        raise CompressionError(f'{len(samples)} samples instead of {count}')
    return samples


def decompress_message(message: Any) -> Sweep:
    """Return the sweep in a CompressedIfSamples message (of rclpy or of a recording); raises as `decompress`."""
    return Sweep(
        station=message.station,
        peer=message.peer,
        sweep_id=message.sweep_id,
        full_scale=message.full_scale,
        iq=message.iq,
        samples=decompress(bytes(message.data), message.format, message.sample_count, message.iq),
        stamp=message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec,
        frame_id=message.header.frame_id,
    )


@functools.cache
def _codec(name: str) -> tuple[Callable, Callable]:
    if name not in _CODECS:
        raise ConfigurationError(f"codec '{name}' is not valid{nearest(name, CODECS)}")
    if name == 'flac':
        try:
            import soundfile  # noqa: F401
        except (ImportError, OSError) as error:
            raise ConfigurationError(f'codec flac needs python3-soundfile and libsndfile ({error})') from None
    return _CODECS[name]


def main(argv: Sequence[str] | None = None) -> int:
    """Print ratio and time of every codec on a recording: ``python -m drfmcw_node.compression RECORDING``."""
    from drfmcw_ros.bag.files import BagReader
    from drfmcw_ros.commands.cli import Parser, guarded

    parser = Parser(prog='compression', description='Compression ratio of the sweeps of a recording.')
    parser.add_argument('recording', help='rosbag2 recording with if_samples')
    arguments = parser.parse_args(argv)
    return guarded(parser.prog, lambda: _report(arguments, BagReader))


def _report(arguments: argparse.Namespace, reader: Callable) -> None:
    with reader(arguments.recording) as bag:
        topics = [t for t in bag.topics if t.endswith('/if_samples')]
        sweeps = [(np.asarray(m.samples, np.int16), m.iq) for _, _, m in bag.messages(topics)]
    if not sweeps:
        raise ConfigurationError(f'{arguments.recording}: no if_samples in it')
    total = sum(2 * len(samples) for samples, _ in sweeps)
    print(f'{len(sweeps)} sweeps, {total / 1e6:.2f} MB')
    print('codec   ratio  compress  decompress')
    for codec in CODECS:
        start = time.perf_counter()
        packed = [compress(samples, codec, iq) for samples, iq in sweeps]
        middle = time.perf_counter()
        for data, (samples, iq) in zip(packed, sweeps, strict=True):
            if not np.array_equal(decompress(data, codec, len(samples), iq), samples):
                raise CompressionError(f'codec {codec} changed samples')
        end = time.perf_counter()
        each = 1e6 / len(sweeps)
        ratio = total / sum(map(len, packed))
        print(f'{codec:6} {ratio:6.2f} {(middle - start) * each:6.0f} us {(end - middle) * each:8.0f} us')


if __name__ == '__main__':
    raise SystemExit(main())
