"""One line of progress: rewritten on a terminal, a line now and then in a log."""

import shutil
import sys
import time


class Progress:
    """Shows how far a set-up of several weighted steps is."""

    def __init__(self, weights, stream=None):
        """Take {step: seconds it usually takes}, in order."""
        self._weights = weights
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._start = time.monotonic()
        self._shown = None
        self._open = False

    def show(self, step, share, detail=""):
        """Show that `share` (0..1) of a step is done."""
        names = list(self._weights)
        before = sum(self._weights[name] for name in names[: names.index(step)])
        percent = int(100 * (before + share * self._weights[step]) / sum(self._weights.values()))
        # Ten lines are enough in a log.
        key = (step, percent, detail) if self._terminal else (step, percent // 10)
        if key == self._shown:
            return
        self._shown = key
        text = f"[{percent:3d} %] {step} {detail}".rstrip()
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            self._stream.write("\r" + text[:width].ljust(width))
            self._open = True
        else:
            self._stream.write(text + "\n")
        self._stream.flush()

    def finish(self):
        """Say that all is done."""
        self.clear()
        self._stream.write(f"[100 %] ready after {time.monotonic() - self._start:.0f} s\n")
        self._stream.flush()

    def clear(self):
        """Make room for another message."""
        if self._open:
            self._stream.write("\r" + " " * (shutil.get_terminal_size().columns - 1) + "\r")
            self._stream.flush()
            self._open = False
