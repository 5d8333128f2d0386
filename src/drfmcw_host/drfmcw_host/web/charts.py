"""Options that all charts share: colours that differ for colour-blind people too, axes, fonts."""

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True)
class Colours:
    """Colours of a theme; the lines are those of Okabe and Ito (2008), darker or lighter for contrast."""

    text: str
    grid: str
    lines: tuple[str, ...]
    guard: str


_LIGHT = Colours('#3d4653', '#d9dee5', ('#0067a5', '#b84a00', '#00765a', '#8f4c7c'), 'rgba(120,128,140,0.22)')
_DARK = Colours('#c3ccd8', '#333d4a', ('#6cc3f5', '#f5954a', '#3fd0a4', '#e39ac7'), 'rgba(150,160,175,0.22)')


def colours(theme: str) -> Colours:
    """Return the colours of 'light' or 'dark'."""
    return _DARK if theme == 'dark' else _LIGHT


def axis_chart(palette: Colours, language: str, time_axis: bool = False) -> dict[str, Any]:
    """Return the options of a line chart without series."""
    label = {'color': palette.text, 'fontSize': 13, 'hideOverlap': True}
    plain = f'value => value.toLocaleString("{language}", {{maximumFractionDigits: 9, useGrouping: false}})'
    numbers = label | {':formatter': plain}
    rule = {'lineStyle': {'color': palette.grid}}
    horizontal: dict[str, Any] = {
        'type': 'time' if time_axis else 'value',
        'axisLabel': label if time_axis else numbers,
        'splitLine': {'show': False},
    }
    return {
        'animation': False,
        'grid': {'left': 8, 'right': 18, 'top': 16, 'bottom': 8, 'containLabel': True},
        'xAxis': horizontal | {'axisLine': rule},
        'yAxis': {'type': 'value', 'scale': True, 'axisLabel': numbers, 'splitLine': rule, 'splitNumber': 4},
        'title': {
            'show': False,
            'left': 'center',
            'top': 'middle',
            'textStyle': {'color': palette.text, 'fontSize': 15, 'fontWeight': 'normal'},
        },
        'textStyle': {'fontFamily': 'system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif'},
        'series': [],
    }
