"""Flags in words; which bit means what stands in the enumerations of fusion, integrity and estimation alone."""

import enum

from drfmcw_fusion.integrity.checks import Test
from drfmcw_fusion.pipeline import USELESS
from drfmcw_fusion.pipeline import Flag as RangeFlag
from drfmcw_node.estimators.estimation import Flag as LineFlag
from drfmcw_physics.sweep import Mode

from .phrases import phrase


def _words(kind: str, flags: enum.IntFlag, language: str) -> list[str]:
    members = [flag for flag in type(flags) if flag and flag in flags]
    unknown = int(flags) & ~sum(int(flag) for flag in type(flags))
    found = [phrase(f'{kind}.{flag.name}', language) for flag in members]
    return [*found, phrase('flag.unknown', language).format(bits=unknown)] if unknown else found


def range_flags(flags: int, language: str) -> list[str]:
    """Return what the flags of a RangeEstimate say, one text per bit."""
    return _words('range', RangeFlag(flags), language)


def line_flags(flags: int, language: str) -> list[str]:
    """Return what the flags of a BeatFrequency say, one text per bit."""
    return _words('line', LineFlag(flags), language)


def failed_tests(tests: int, language: str) -> list[str]:
    """Return which integrity tests a range failed, one text per bit."""
    return _words('test', Test(tests), language)


def quality(flags: int) -> str:
    """Return 'good', 'doubtful' or 'unusable'."""
    return 'unusable' if flags & USELESS else 'doubtful' if flags else 'good'


def mode(value: int, language: str) -> str:
    """Return the name of a measurement mode."""
    try:
        return phrase(f'mode.{Mode(value).name}', language)
    except ValueError:
        return phrase('flag.unknown', language).format(bits=value)
