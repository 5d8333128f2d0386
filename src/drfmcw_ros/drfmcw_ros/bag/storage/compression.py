"""Decompression of what rosbag2 compresses: chunks, messages, and files, also files whose end is missing."""

import sys
from pathlib import Path

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR message begins so: their first byte is zero
_PIECE = 1 << 20


def decompressed_chunk(data: bytes, compression: str, size: int) -> bytes:
    """Return the records of a chunk.

    Raises:
        ValueError: unknown compression, broken data, or another length than stated.
    """
    if compression == '':
        held = data
    elif compression == 'zstd':
        try:
            held = zstd.decompress(data)
        except zstd.ZstdError as error:
            raise ValueError(f'a chunk cannot be decompressed ({error})') from None
    elif compression == 'lz4':
        held = _lz4(data)
    else:
        raise ValueError(f'unknown compression {compression!r} of a chunk')
    if len(held) != size:
        raise ValueError('a chunk has another length than it states')
    return held


def _lz4(data: bytes) -> bytes:
    try:
        import lz4.frame
    except ImportError:
        raise ValueError("a chunk is compressed with lz4, and Python's lz4 is not installed") from None
    try:
        return bytes(lz4.frame.decompress(data))
    except RuntimeError as error:
        raise ValueError(f'a chunk cannot be decompressed ({error})') from None


def decompressed_message(data: bytes) -> bytes:
    """Return a message as it was before rosbag2 compressed it, or as it is; raises ValueError where it is broken."""
    if data[:4] != _ZSTD_MAGIC:
        return data
    try:
        return zstd.decompress(data)
    except zstd.ZstdError as error:
        raise ValueError(f'a message cannot be decompressed ({error})') from None


def decompress_file(source: Path, target: Path) -> bool:
    """Decompress a .zstd file as far as it is whole; return whether it was to its end.

    Raises:
        OSError: it cannot be read, or the copy not be written.
    """
    decompressor = zstd.ZstdDecompressor()
    with open(source, 'rb') as file, open(target, 'wb') as copy:
        while piece := file.read(_PIECE):
            try:
                while piece:
                    if decompressor.eof:  # a file may consist of several frames
                        decompressor = zstd.ZstdDecompressor()
                    copy.write(decompressor.decompress(piece))
                    piece = decompressor.unused_data if decompressor.eof else b''
            except zstd.ZstdError:
                return False
    return decompressor.eof
