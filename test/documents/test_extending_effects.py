"""The section of docs/extending.md that adds an effect, executed step by step."""

import importlib.util
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from checkout import ROOT

from drfmcw_diagnosis import diagnose
from drfmcw_sim import effects, simulate

PAGE = ROOT / 'docs/extending.md'
COMMANDS = {'simulate': simulate.main, 'diagnose': diagnose.main}


def blocks(section):
    """(language, code) of each block of a section."""
    text = PAGE.read_text(encoding='utf-8')
    (text,) = re.findall(rf'^## {section}\n(.*?)(?=^## |\Z)', text, re.DOTALL | re.MULTILINE)
    return re.findall(r'^```(\w+)\n(.*?)^```', text, re.DOTALL | re.MULTILINE)


@pytest.fixture
def registry():
    """The registry of effects, restored afterwards."""
    before = dict(effects.Effect.registry)
    yield effects.Effect.registry
    effects.Effect.registry.clear()
    effects.Effect.registry.update(before)


def test_add_an_effect(tmp_path, monkeypatch, registry):
    """The steps in their order: the effect is simulated, concealed, and found within 4 standard deviations of its size.

    The recording is fixed, so nothing is by chance.
    """
    (_, module), (_, scenario), (_, commands) = blocks('Add an effect')
    monkeypatch.chdir(tmp_path)
    Path('antenna_temperature.py').write_text(module, encoding='utf-8')
    name = f'{effects.__name__}.antenna_temperature'
    spec = importlib.util.spec_from_file_location(name, 'antenna_temperature.py')
    monkeypatch.setitem(sys.modules, name, importlib.util.module_from_spec(spec))
    spec.loader.exec_module(sys.modules[name])
    Path('warm.yaml').write_text(scenario, encoding='utf-8')
    for line in commands.splitlines():
        _, command, *arguments = shlex.split(line)
        assert COMMANDS[command](arguments) == 0
    finding = json.loads(Path('warm.json').read_text(encoding='utf-8'))
    (effect,) = finding['effects']
    assert (effect['effect'], effect['station']) == ('antenna_temperature', 'slave')
    slope = effect['parameters']['slope']
    assert abs(slope['value'] + 0.1) < 4.0 * slope['std']
