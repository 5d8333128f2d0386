"""The progress bar of all commands."""

from rich import progress
from rich.console import Console


class Progress(progress.Progress):
    """Progress bar that leaves a terminal as it was, and that writes nothing to a file or a pipe."""

    def __init__(self, *columns: str | progress.ProgressColumn, console: Console) -> None:
        """Show the columns on the console, if it is a terminal."""
        super().__init__(*columns, console=console, transient=True, disable=not console.is_terminal)

    def stop(self) -> None:
        """Remove the bar; before rich 14, one that is not shown would leave an empty line."""
        if not self.disable:
            super().stop()
