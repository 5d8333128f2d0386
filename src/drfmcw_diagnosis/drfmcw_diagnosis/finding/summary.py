"""A diagnosis for the terminal: the verdict, then plain sentences under short headings."""

from rich.box import ROUNDED
from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from . import wording
from .result import Diagnosis
from .wording import sentences

__all__ = ['COLORS', 'sentences', 'terminal']

COLORS = {'consistent': 'green', 'explained': 'cyan', 'ambiguous': 'yellow', 'partial': 'magenta', 'unexplained': 'red'}
"""Of the verdicts."""


def terminal(diagnosis: Diagnosis, report: str | None = None) -> Group:
    """Return what `diagnose` prints, for a rich Console.

    Args:
        diagnosis: what was found.
        report: path of the HTML report that was written.
    """
    color = COLORS[diagnosis.verdict]
    banner = Text.assemble((diagnosis.verdict.upper(), f'bold {color}'), '  ', (wording.headline(diagnosis), 'bold'))
    body = Table.grid(padding=(0, 2))
    body.add_column(no_wrap=True, style='bold')
    body.add_column(overflow='fold')
    for part in wording.paragraphs(diagnosis):
        text = '\n'.join(part.sentences)
        body.add_row(Text(part.heading), Text(text))
    for heading, path in (('Refined model', diagnosis.refined_config), ('Report', report)):
        if path:
            body.add_row(Text(heading), Text(path))
    return Group(
        Panel(banner, title=Text(diagnosis.recording), title_align='left', box=ROUNDED, border_style=color), body
    )
