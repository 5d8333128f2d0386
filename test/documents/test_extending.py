"""Every step of docs/extending.md leads where it says: files are written into a copy, commands are run there."""

import dataclasses
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy
from checkout import ROOT
from drfmcw_msgs.msg import BeatFrequency, SweepConfig
from rclpy.executors import SingleThreadedExecutor

from drfmcw_ros.graph import qos

PACKAGE = Path('src', 'drfmcw_node')
LIMIT = 90.0  # for anything that is waited for, on a busy machine [s]
SUBCOMMANDS = {name: module for name, (module, _) in runpy.run_path(str(ROOT / 'drfmcw'))['SUBCOMMANDS'].items()}

_BLOCK = re.compile(r'^```(\w+)\n(.*?)^```$', re.DOTALL | re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class Block:
    """A fenced block of the document."""

    language: str
    text: str

    @property
    def path(self) -> str:
        """The file that it is, '' where it is none."""
        found = re.match(r'# ((?:src|test)/\S+)\n', self.text)
        return found[1] if found else ''


def blocks(section: str) -> list[Block]:
    """Return the fenced blocks of a section, in order."""
    text = (ROOT / 'docs' / 'extending.md').read_text(encoding='utf-8')
    (body,) = re.findall(rf'^## {section}\n(.*?)(?=^## |\Z)', text, re.DOTALL | re.MULTILINE)
    return [Block(language, content) for language, content in _BLOCK.findall(body)]


class Checkout:
    """A copy of what the steps change; all else comes from the repository."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        shutil.copytree(ROOT / PACKAGE, directory / PACKAGE, ignore=shutil.ignore_patterns('__pycache__'))
        (directory / 'test').mkdir()
        (directory / 'test' / 'data').symlink_to(ROOT / 'test' / 'data')
        self.environment = os.environ | {
            'PYTHONPATH': os.pathsep.join([str(directory / PACKAGE), os.environ.get('PYTHONPATH', '')]),
            'PYTHONDONTWRITEBYTECODE': '1',
        }

    def write(self, block: Block) -> None:
        path = self.directory / block.path
        assert path.parent.is_dir() and not path.exists()
        path.write_text(block.text)

    def command(self, line: str) -> list[str]:
        """Return the command of a line of shell, ./drfmcw without its setting up."""
        program, *arguments = line.split()
        if program == './drfmcw':
            return [sys.executable, '-m', SUBCOMMANDS[arguments[0]], *arguments[1:]]
        return [sys.executable, *arguments] if program == 'python' else ['sh', '-c', line]

    def run(self, arguments: list[str]) -> str:
        """Run to the end; return what was printed."""
        ended = subprocess.run(
            arguments, cwd=self.directory, env=self.environment, capture_output=True, text=True, timeout=LIMIT
        )
        assert ended.returncode == 0, ended.stdout + ended.stderr
        return ended.stdout

    def follow(self, block: Block) -> str:
        """Write a block's file, or run its code or its commands; return what was printed."""
        if block.path:
            self.write(block)
            return ''
        if block.language == 'python':
            return self.run([sys.executable, '-c', block.text])
        assert block.language == 'sh'
        return ''.join(self.run(self.command(line)) for line in block.text.splitlines())

    def readme(self) -> str:
        return (self.directory / PACKAGE / 'README.md').read_text(encoding='utf-8')


def test_add_an_estimator(tmp_path):
    checkout = Checkout(tmp_path)
    steps = blocks('Add an estimator')
    printed = [checkout.follow(step) for step in steps]
    assert [s.language for s in steps] == ['python', 'python', 'sh', 'python', 'sh', 'sh'], 'all of them were run'
    assert 'range' in printed[2]
    assert '1 passed' in printed[4]
    assert '`hann`, `ml`, `pair`, `paper`, `parabola`' in checkout.readme()
    assert '| `parabola` | FFT under a Hann window, parabola' in checkout.readme()


@pytest.mark.graph
def test_add_a_source(tmp_path):
    """A station of the example, in a process of its own, is heard to estimate the line; a signal ends it."""
    checkout = Checkout(tmp_path)
    file, alone, station, *documented = blocks('Add a source')
    for step in (file, alone, *documented):
        checkout.follow(step)
    assert '| `tone_frequency` | 400000 | Hz |' in checkout.readme()
    assert station.language == 'sh'
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    beats: list[BeatFrequency] = []
    settings: list[SweepConfig] = []
    qos.subscription(node, BeatFrequency, '/master/beat_frequency', beats.append, qos.RELIABLE)
    qos.subscription(node, SweepConfig, '/master/sweep_config', settings.append, qos.latched_subscription(1))
    end = node.get_clock().now().nanoseconds + LIMIT * 1e9
    process = subprocess.Popen(
        checkout.command(station.text.strip()),
        cwd=tmp_path,
        env=checkout.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        while not (len(beats) >= 3 and settings) and process.poll() is None:
            assert node.get_clock().now().nanoseconds < end, f'{len(beats)} beat frequencies, {len(settings)} settings'
            executor.spin_once(timeout_sec=0.2)
    finally:
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=LIMIT)
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert process.returncode == 0, said
    assert 'Traceback' not in said
    assert (settings[0].station, settings[0].peer) == ('master', 'master')
    assert all(abs(beat.frequency - 4.1e5) < 20.0 and beat.flags == 0 for beat in beats)
