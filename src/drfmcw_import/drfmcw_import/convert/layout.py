"""From the axes of a file to sweeps, piece by piece."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..formats.base import Array, Numbers, Source, spooled
from .settings import AXES, LayoutSettings

_AT_ONCE = 1 << 22  # numbers read at once

_DEFAULT = {1: ['sample'], 2: ['chirp', 'sample']}


@dataclasses.dataclass(frozen=True)
class Layout:
    """A file's array with the meaning of its axes."""

    array: Array
    axes: tuple[str, ...]
    name: str

    @property
    def sizes(self) -> dict[str, int]:
        """{axis: size}, 1 for what the file has not; complex numbers have an axis iq."""
        sizes = dict.fromkeys(AXES, 1)
        for axis, size in zip(self.axes, self.array.shape, strict=True):
            sizes[axis] *= size
        if is_complex(self.array.dtype):
            sizes['iq'] = 2
        return sizes

    def blocks(self) -> Iterator[Numbers]:
        """Yield (sweeps, transmitter, ramp, receiver, sample, iq) blocks in order of time."""
        shape = self.array.shape
        along = next((self.axes.index(a) for a in ('frame', 'chirp') if self.sizes[a] > 1), 0)
        if self.axes[along] not in ('frame', 'chirp'):
            yield self._arranged(np.asarray(self.array[tuple(slice(None) for _ in shape)]))
            return
        step = max(1, _AT_ONCE // max(1, math.prod(shape) // shape[along]))
        for start in range(0, shape[along], step):
            key = tuple(slice(start, start + step) if i == along else slice(None) for i in range(len(shape)))
            yield self._arranged(np.asarray(self.array[key]))

    def _arranged(self, block: Numbers) -> Numbers:
        axes = list(self.axes)
        if is_complex(block.dtype):
            block, axes = _as_pairs(block), [*axes, 'iq']
        order = sorted(range(len(axes)), key=lambda i: AXES.index(axes[i]))
        merged = [math.prod(block.shape[i] for i in range(len(axes)) if axes[i] == name) for name in AXES]
        return block.transpose(order).reshape(merged[0] * merged[1], *merged[2:])


def is_complex(dtype: Any) -> bool:
    """Return True for complex numbers and structures of two numbers."""
    dtype = np.dtype(dtype)
    return dtype.kind == 'c' or (dtype.names is not None and len(dtype.names) == 2)


def _as_pairs(block: Numbers) -> Numbers:
    """Return complex numbers as a last axis (real, imaginary)."""
    if block.dtype.names is not None:
        return np.stack([block[name] for name in block.dtype.names], axis=-1)
    return np.stack([block.real, block.imag], axis=-1)


def lay_out(source: Source, settings: LayoutSettings) -> Layout:
    """Return a file's array with its axes.

    Raises:
        ConfigurationError: axes, shape and file do not fit.
    """
    array, name = source.array, source.name
    _require_numbers(source)
    axes = settings.axes or _DEFAULT.get(max(1, sum(s > 1 for s in array.shape)), [])
    if settings.shape:
        array = _reshaped(array, settings, name)
    if len(array.shape) != len(axes):
        array = _squeezed(array, len(axes))
    if len(array.shape) != len(axes):
        listed = 'x'.join(map(str, source.array.shape))
        raise ConfigurationError(
            f'{name}: is an array of {listed}, which needs {len(source.array.shape)} axes, not {list(axes)}: set '
            'layout: axes, and shape where the file does not state the sizes'
        )
    layout = Layout(array, tuple(axes), name)
    _check(layout, settings)
    return layout


def _require_numbers(source: Source) -> None:
    """Refuse what holds no numbers.

    Raises:
        ConfigurationError: an empty array, or one of text or of structures that are no complex numbers.
    """
    listed, dtype = 'x'.join(map(str, source.array.shape)), np.dtype(source.array.dtype)
    if math.prod(source.array.shape) == 0:
        raise ConfigurationError(f'{source.name}: holds no samples: its array is of {listed}')
    fields = [dtype[name] for name in dtype.names] if is_complex(dtype) and dtype.names else [dtype]
    if any(field.kind not in 'biufc' for field in fields):
        raise ConfigurationError(f"{source.name}: holds values of type '{dtype}', not numbers")


def _check(layout: Layout, settings: LayoutSettings) -> None:
    sizes, name = layout.sizes, layout.name
    if 'iq' in layout.axes and is_complex(layout.array.dtype):
        raise ConfigurationError(f'{name}: holds complex numbers: layout: axes must not have iq')
    if sizes['iq'] not in (1, 2):
        raise ConfigurationError(f'{name}: layout: the axis iq has size {sizes["iq"]}, not 2')
    if sizes['ramp'] not in (1, 2):
        raise ConfigurationError(f'{name}: layout: the axis ramp has size {sizes["ramp"]}, not 2 (up, down)')
    for axis, chosen in (('receiver', settings.receiver), ('transmitter', settings.transmitter)):
        if chosen >= sizes[axis]:
            raise ConfigurationError(
                f'{name}: layout: {axis} = {chosen}, but the file has {sizes[axis]} (0 is the first)'
            )


def _squeezed(array: Array, dimensions: int) -> Array:
    """Return the array without axes of size 1 where that gives as many as wanted."""
    if sum(s > 1 for s in array.shape) == dimensions:
        whole = np.asarray(array[tuple(slice(None) for _ in array.shape)])
        return np.squeeze(whole)
    return array


def _reshaped(array: Array, settings: LayoutSettings, name: str) -> Array:
    """Return the array in another shape: a view of what is mapped, a copy on disk of what is not."""
    shape = list(settings.shape)
    total = math.prod(array.shape)
    inner = math.prod(s for s in shape if s != -1)
    free = shape.index(-1) if -1 in shape else None
    if free is None and total != inner:
        raise ConfigurationError(f'{name}: holds {total} numbers, but layout: shape = {shape} needs {inner}')
    used = total if free is None else total // inner * inner
    if used != total and not (settings.drop_incomplete and free == 0):
        raise ConfigurationError(
            f'{name}: {total} numbers are no multiple of {inner} (layout: shape = {shape}): {total - used} are left '
            'over; correct the shape, or set drop_incomplete: true'
        )
    if used == 0:
        raise ConfigurationError(
            f'{name}: holds {total} numbers, fewer than the {inner} of one layout: shape = {shape}'
        )
    if free is not None:
        shape[free] = used // inner
    return _flat(array)[:used].reshape(shape)


def _flat(array: Array) -> Numbers:
    if isinstance(array, np.ndarray):
        return array.reshape(-1)
    rest = math.prod(array.shape[1:])
    step = max(1, _AT_ONCE // max(1, rest))
    others = tuple(slice(None) for _ in array.shape[1:])
    pieces = (np.asarray(array[(slice(i, i + step), *others)]).reshape(-1, 1) for i in range(0, array.shape[0], step))
    return spooled(pieces, 1, array.dtype)


def sample_slice(settings: LayoutSettings, available: int, name: str) -> slice:
    """Return which samples of each sweep are kept.

    Raises:
        ConfigurationError: fewer are there.
    """
    start = settings.skip_samples
    stop = start + settings.sample_count if settings.sample_count else available
    if stop > available or start >= stop:
        raise ConfigurationError(
            f'{name}: sweeps have {available} samples, but layout: skip_samples = {start} and sample_count = '
            f'{settings.sample_count} ask for more'
        )
    return slice(start, stop)


def sweep_times(frames: int, chirps: int, period: float, frame_time: float) -> Numbers:
    """Return the start of each sweep since the first, (frames * chirps,) [s]; NaN as frame_time: no pauses."""
    between = chirps * period if math.isnan(frame_time) else frame_time
    times: Numbers = (np.arange(frames)[:, None] * between + np.arange(chirps) * period).ravel()
    return times


def split_triangle(block: Numbers, ramps: int) -> Numbers:
    """Return sweeps whose samples run over both ramps with an axis of ramps, (sweeps, 2, sample, iq)."""
    if ramps == 1 or block.shape[1] == ramps:
        return block
    if block.shape[2] % ramps:
        raise ConfigurationError(f'layout: a triangle of {block.shape[2]} samples cannot be halved: set sample_count')
    sweeps, _, samples, iq = block.shape
    return block.reshape(sweeps, ramps, samples // ramps, iq)
