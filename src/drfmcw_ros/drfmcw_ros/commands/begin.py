"""Starts a module of drfmcw, so that a Ctrl-C while it is still being imported ends it without a traceback.

`python -m drfmcw_ros.commands.begin MODULE ARGUMENTS`. Whoever starts it blocks SIGINT first: one that comes while the
interpreter starts then waits until here. The module itself says what a Ctrl-C does from then on, see `cli.guarded`.
"""

import runpy
import signal
import sys


def main() -> None:
    """Run the module that the first argument names as the main one."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)


if __name__ == '__main__':
    main()
