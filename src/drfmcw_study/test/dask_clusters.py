"""A Dask cluster on this machine, for tests."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from checkout import ROOT

MODULES = [str(Path(__file__).parent), str(ROOT / 'test')]
"""Where a worker finds the tests' modules and what they import."""


@contextlib.contextmanager
def dask_cluster(folder):
    """Yield (address, worker processes) of a scheduler with two workers, each a process of its own."""
    where = folder / 'scheduler.json'
    environment = os.environ | {'PYTHONPATH': os.pathsep.join([*MODULES, os.environ.get('PYTHONPATH', '')])}

    def start(name, *arguments):
        command = [sys.executable, '-m', 'dask', *arguments, '--no-dashboard']
        with open(folder / f'{name}.log', 'w') as log:
            return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)

    local = ('--host', '127.0.0.1')
    processes = [start('scheduler', 'scheduler', *local, '--port', '0', '--scheduler-file', str(where))]
    try:
        for _ in range(600):
            if where.exists() and where.stat().st_size:
                break
            time.sleep(0.05)
        address = json.loads(where.read_text())['address']
        workers = [start(f'worker{i}', 'worker', address, *local, '--nthreads', '1', '--no-nanny') for i in range(2)]
        processes += workers
        yield address, workers
    finally:
        for process in processes:
            process.kill()
            process.wait()
