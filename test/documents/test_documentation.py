"""The documentation against the code: tables, topics, commands, links."""

import ast
import dataclasses
import importlib.util
import inspect
import itertools
import re
import runpy
import shlex
import sys

import pytest
from checkout import ROOT

from drfmcw_physics.settings import declared_parameters
from drfmcw_ros.graph.topics import PAIR_TOPICS, SITE_TOPICS, STATION_TOPICS
from drfmcw_ros.nodes.parameter_tables import filled
from drfmcw_sim import scenario, trajectory

PACKAGES = sorted(path.parent for path in ROOT.glob('src/*/package.xml'))
DOCUMENTS = sorted(itertools.chain(ROOT.glob('*.md'), ROOT.glob('docs/**/*.md'), ROOT.glob('src/*/*.md')))
TOPICS = {*STATION_TOPICS, *PAIR_TOPICS, *SITE_TOPICS, '/diagnostics'}
SUBCOMMANDS = runpy.run_path(str(ROOT / 'drfmcw'))['SUBCOMMANDS']
OTHER_TOOLS = ('pytest',)  # whose options are their own
EXECUTED = 'docs/extending.md'  # test_extending.py runs its commands, on files that it has the reader write


def name(path):
    return str(path.relative_to(ROOT))


def code_in(text):
    """Lines of fenced blocks, and inline code."""
    fenced = re.findall(r'^```\w*\n(.*?)^```', text, re.DOTALL | re.MULTILINE)
    rest = re.sub(r'^```.*?^```', '', text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in fenced for line in block.replace('\\\n', ' ').splitlines()]
    return lines + [' '.join(code.split()) for code in re.findall(r'`([^`]+)`', rest)]


def drfmcw_calls():
    """(document, words) of every call of the launcher; placeholders in brackets count as given."""
    found = []
    for document in DOCUMENTS:
        for line in code_in(document.read_text(encoding='utf-8')):
            for call in re.findall(r'\./drfmcw\s+([^|;&]*)', line):
                words = shlex.split(re.sub(r'[\[\]]', ' ', call), comments=True)
                found.append((name(document), words))
    return found


def topics_in(package):
    """Topics of the contract that stand in a package's code, alone or at the end of a name."""
    found = set()
    for module in set(package.rglob('*.py')) - set(package.glob('test/**/*.py')):
        for node in ast.walk(ast.parse(module.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found |= {topic for topic in TOPICS if re.fullmatch(rf'(/|/.+/)?{topic.lstrip("/")}', node.value)}
            if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'Diagnostics':
                found.add('/diagnostics')
    return found


@pytest.mark.parametrize('document', DOCUMENTS, ids=name)
def test_tables_are_those_of_the_declarations(document):
    text = document.read_text(encoding='utf-8')
    assert filled(text) == text, f'run python -m drfmcw_ros.nodes.parameter_tables {name(document)}'


def test_every_key_of_a_scenario_is_documented():
    text = (ROOT / 'src/drfmcw_sim/README.md').read_text(encoding='utf-8')
    for cls in [*vars(scenario).values(), *vars(trajectory).values()]:
        if inspect.isclass(cls) and dataclasses.is_dataclass(cls) and cls.__module__.startswith('drfmcw_sim.'):
            for key in declared_parameters(cls):
                assert f'`{key}`' in text, (cls.__name__, key)


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_readme_names_every_topic_of_the_package(package):
    text = (package / 'README.md').read_text(encoding='utf-8')
    code = ' '.join(code_in(text))
    for topic in sorted(topics_in(package)):
        assert re.search(rf'(^|[\s/]){topic.lstrip("/")}($|[\s,:])', code), topic


def test_commands_in_the_documentation_exist(monkeypatch, capsys):
    """Every subcommand is one, and its --help knows each option."""
    calls = drfmcw_calls()
    assert len(calls) > 20
    helps = {}
    for document, words in calls:
        if words[0] in ('--help', '...', 'SUBCOMMAND'):
            continue
        assert words[0] in SUBCOMMANDS, (document, words)
        target = SUBCOMMANDS[words[0]][0]
        if target in OTHER_TOOLS:
            files = [word for word in words if word.endswith('.py') and document != EXECUTED]
            assert all((ROOT / word).exists() for word in files), (document, words)
            continue
        if target not in helps:
            monkeypatch.setattr(sys, 'argv', [target, '--help'])
            monkeypatch.syspath_prepend(str(ROOT / target))  # a directory brings its own modules
            with pytest.raises(SystemExit) as end:
                if target.endswith('/'):
                    runpy.run_path(str(ROOT / target), run_name='__main__')
                else:
                    sys.exit(importlib.import_module(target).main(['--help']))
            assert not end.value.code
            helps[target] = set(re.findall(r'--[\w-]+', capsys.readouterr().out))
        own = words[: words.index('--ros-args')] if '--ros-args' in words else words
        for option in (word.partition('=')[0] for word in own if word.startswith('--')):
            assert option in helps[target], (document, words)


def test_modules_in_the_documentation_exist():
    for document in DOCUMENTS:
        for line in code_in(document.read_text(encoding='utf-8')):
            for module in re.findall(r'python -m (drfmcw[\w.]+)', line):
                assert importlib.util.find_spec(module), (name(document), module)


@pytest.mark.parametrize('document', DOCUMENTS, ids=name)
def test_links_point_to_files(document):
    text = re.sub(r'^```.*?^```', '', document.read_text(encoding='utf-8'), flags=re.DOTALL | re.MULTILINE)
    for target, _, anchor in re.findall(r'\]\(([^)#\s]*)(#([^)\s]*))?\)', text):
        if target.startswith(('http:', 'https:', 'mailto:')):
            continue
        path = (document.parent / target).resolve() if target else document
        assert path.exists(), target
        if anchor:
            headings = re.findall(r'^#+ (.*)$', path.read_text(encoding='utf-8'), re.MULTILINE)
            assert anchor in [re.sub(r'[^\w -]', '', h).lower().replace(' ', '-') for h in headings], (target, anchor)


def test_documents_named_in_the_code_exist():
    for source in itertools.chain(
        ROOT.glob('src/**/*.py'), ROOT.glob('test/**/*.py'), ROOT.glob('setup/*.py'), DOCUMENTS
    ):
        for document in re.findall(r'(?<![\w./])docs/\w+\.md', source.read_text(encoding='utf-8')):
            assert (ROOT / document).exists(), (name(source), document)


def test_every_subcommand_says_what_it_does_in_one_line():
    for command, (_, summary) in SUBCOMMANDS.items():
        assert 10 < len(summary) < 90 and not summary.endswith('.'), command
