"""Decompression of what rosbag2 compresses: chunks, messages, and files, also files whose end is missing."""

from pathlib import Path
from typing import Any

import rosbags.rosbag2.reader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

zstd: Any = vars(rosbags.rosbag2.reader)['zstd']  # from wherever this Python has it

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR message begins so: their first byte is zero
_PIECE = 1 << 20


def decompressed_chunk(data: bytes, compression: str, size: int) -> bytes:
    """Return the records of a chunk.

    Raises:
        ValueError: unknown compression, broken data, or another length than stated.
    """
    if compression not in DECOMPRESSORS:
        raise ValueError(f'unknown compression {compression!r} of a chunk')
    try:
        held = bytes(DECOMPRESSORS[compression](data, size))
    except Exception as error:  # each decompressor raises its own
        raise ValueError(f'a chunk cannot be decompressed ({error})') from None
    if len(held) != size:
        raise ValueError('a chunk has another length than it states')
    return held


def decompressed_message(data: bytes) -> bytes:
    """Return a message as it was before rosbag2 compressed it, or as it is; raises ValueError where it is broken."""
    if data[:4] != _ZSTD_MAGIC:
        return data
    try:
        return bytes(zstd.decompress(data))
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
    return bool(decompressor.eof)
