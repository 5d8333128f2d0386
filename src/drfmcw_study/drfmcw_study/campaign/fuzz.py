"""Coverage-guided fuzzing of everything that comes from outside: mutated inputs that reach new lines are kept.

In: targets with seeds, a time. Out: inputs that raise what their target does not declare, or take too long.
"""

import contextlib
import dataclasses
import hashlib
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from .fuzz_targets import Target

LONGEST_RUN = 20.0
"""Of one input; a longer one counts as a failure [s]."""
_LARGEST_INPUT = 1 << 16  # bytes
_INTEGERS = (0, 1, 2, 15, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
_TURN = 0.5  # of one target before the next one's [s]


class TooSlow(Exception):
    """An input that takes too long."""


@dataclasses.dataclass
class Found:
    """What a target's fuzzing has come to."""

    target: Target
    corpus: list[bytes]
    lines: set[tuple[str, int]] = dataclasses.field(default_factory=set)
    runs: int = 0
    failures: dict[str, bytes] = dataclasses.field(default_factory=dict)  # by what was raised, and where


def fuzz(targets: Sequence[Target], minutes: float, seed: int, corpus: Path | None = None) -> list[Found]:
    """Try mutations of every target's seeds in turn.

    Args:
        targets: to try.
        minutes: for all together.
        seed: of the mutations; how far they get depends on the machine's speed as well.
        corpus: folder with further inputs, one folder per target; what reaches new lines is added to it.
    """
    rng = random.Random(seed)
    state = [Found(target, [*target.seeds(), *_read(corpus, target)]) for target in targets]
    for found in state:
        for data in found.corpus:
            attempt(found, data)
    end = time.monotonic() + 60.0 * minutes
    while time.monotonic() < end:
        for found in state:
            turn = time.monotonic() + _TURN
            while time.monotonic() < turn:
                data = found.target.mended(mutated(found.corpus, found.target.tokens, rng), rng)
                if attempt(found, data):
                    found.corpus.append(data)
                    _write(corpus, found.target, data)
    return state


def attempt(found: Found, data: bytes) -> bool:
    """Give one input to its target; keep what it raises, and return whether it has reached new lines."""
    reached: set[tuple[str, int]] = set()
    found.runs += 1
    try:
        with _limited(LONGEST_RUN), _traced(reached):
            found.target.run(data)
    except Exception as error:
        frame = (traceback.extract_tb(error.__traceback__) or [None])[-1]
        own = [
            f for f in traceback.extract_tb(error.__traceback__) if 'drfmcw' in f.filename and 'fuzz' not in f.filename
        ]
        at = own[-1] if own else frame
        place = f'{Path(at.filename).name}:{at.lineno}' if at else '?'
        found.failures.setdefault(f'{type(error).__name__} in {place}: {str(error)[:100]!r}', data)
    new = not reached <= found.lines
    found.lines |= reached
    return new


def mutated(corpus: Sequence[bytes], tokens: Sequence[bytes], rng: random.Random) -> bytes:
    """Return one of the inputs with some changes: bits, numbers, blocks, tokens, parts of another input."""
    data = bytearray(rng.choice(corpus))
    for _ in range(1 << rng.randrange(5)):
        at = rng.randrange(len(data) + 1)
        kind = rng.randrange(8 if tokens else 7)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            size = rng.choice((1, 2, 4, 8))
            data[at : at + size] = (rng.choice(_INTEGERS) % (1 << 8 * size)).to_bytes(size, 'little')
        elif kind == 2:
            del data[at : at + rng.choice((1, 4, 32, 500))]
        elif kind == 3:
            data[at:at] = rng.randbytes(rng.choice((1, 4, 32)))
        elif kind == 4:
            data[at:at] = data[at : at + rng.choice((4, 32, 500))]
        elif kind == 5:
            other = rng.choice(corpus)
            begin = rng.randrange(len(other) + 1)
            data[at : at + len(other) - begin] = other[begin:]
        elif kind == 6 and at < len(data):
            data[at] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        elif tokens:
            data[at:at] = rng.choice(tokens)
    return bytes(data[:_LARGEST_INPUT])


@contextlib.contextmanager
def _traced(reached: set[tuple[str, int]]) -> Iterator[None]:
    """Collect the lines of this project that run."""

    def line(frame: FrameType, event: str, _: Any) -> Callable | None:
        reached.add((frame.f_code.co_filename, frame.f_lineno))
        return line

    def call(frame: FrameType, event: str, _: Any) -> Callable | None:
        return line if '/drfmcw_' in frame.f_code.co_filename else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        yield
    finally:
        sys.settrace(before)


@contextlib.contextmanager
def _limited(duration: float) -> Iterator[None]:
    def late(*_: Any) -> None:
        raise TooSlow(f'longer than {duration:g} s')

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, duration)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _read(corpus: Path | None, target: Target) -> list[bytes]:
    return [path.read_bytes() for path in sorted((corpus / target.name).glob('*'))] if corpus else []


def _write(corpus: Path | None, target: Target, data: bytes) -> None:
    if corpus is not None:
        (corpus / target.name).mkdir(parents=True, exist_ok=True)
        (corpus / target.name / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)


def summary(state: Sequence[Found]) -> str:
    """Return what was tried and found, as a Markdown table."""
    lines = ['| input | tried | lines reached | kept | failures |', '| - | - | - | - | - |']
    lines += [f'| {f.target.title} | {f.runs} | {len(f.lines)} | {len(f.corpus)} | {len(f.failures)} |' for f in state]
    lines += [f'- {f.target.title}: {what}' for f in state for what in f.failures]
    return '\n'.join(lines)
