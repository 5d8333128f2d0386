"""What the documents claim of the code as a whole: one claim per test."""

import ast
import importlib.util
import itertools
import json
import re
import tomllib
from pathlib import Path

import pytest
from checkout import ROOT

from drfmcw_sim.effects import Effect

ARCHITECTURE = (ROOT / 'docs/architecture.md').read_text(encoding='utf-8')
DOCUMENTS = sorted(itertools.chain(ROOT.glob('*.md'), ROOT.glob('docs/*.md'), ROOT.glob('src/*/README.md')))
PACKAGES = {path.parent.name for path in ROOT.glob('src/*/package.xml')}
BANNED = (
    (r'\btold\b', 'estimated, determined, separated'),
    (r'\btells?\b', 'estimates, shows, determines'),
    (r'\btelling\b', 'informative'),
    (r'\bparted\b', 'separated'),
    (r'\bparts (them|the truth|it)\b', 'separates'),
    (r'\blends?\b', 'contributes'),
    (r'\bstated deviations?\b', 'standard deviation'),
)
"""Words that documents, docstrings, messages and names avoid, and what to write instead."""

SOURCES = sorted(
    path
    for pattern in ('src/*/**/*.py', 'test/**/*.py', 'setup/*.py', 'benchmarks/*.py', 'conftest.py', 'drfmcw')
    for path in ROOT.glob(pattern)
    if path != Path(__file__)
)


def name(path):
    return str(path.relative_to(ROOT))


def section(title):
    return ARCHITECTURE.partition(f'\n## {title}\n')[2].partition('\n## ')[0]


def layers():
    """Return the documented layers from top to bottom, each a set of packages."""
    block = section('Layers').split('```')[1]
    return [set(re.findall(r'drfmcw_\w+', line)) for line in block.strip().splitlines()]


def imports(package):
    """Return the packages of this repository that a package imports."""
    found = set()
    for source in (ROOT / 'src' / package / package).rglob('*.py'):
        for node in ast.walk(ast.parse(source.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).partition('.')[0])
    return found & PACKAGES - {package}


def test_architecture_lists_every_package():
    listed = re.findall(r'^\| `(drfmcw_\w+)` \|', section('Packages and rooms'), re.MULTILINE)
    assert sorted(listed) == sorted(PACKAGES)


def test_architecture_states_the_number_of_packages():
    numbers = 'zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen'.split()
    (stated,) = re.findall(r'^(\w+) packages\. Imports point downward only', ARCHITECTURE, re.MULTILINE)
    assert numbers.index(stated.lower()) == len(PACKAGES)


def test_every_package_but_the_messages_has_one_layer():
    assert sorted(itertools.chain(*layers())) == sorted(PACKAGES - {'drfmcw_msgs'})


@pytest.mark.parametrize('document', ['README.md', 'docs/README.md', 'QUALITY_DECLARATION.md'])
def test_document_names_every_package(document):
    text = (ROOT / document).read_text(encoding='utf-8')
    assert not {package for package in PACKAGES if package not in text}


def test_architecture_lists_every_room():
    rooms = {
        '.'.join(path.parent.relative_to(ROOT / 'src').parts[1:])
        for path in ROOT.glob('src/drfmcw_*/drfmcw_*/*/**/__init__.py')
    }
    listed = set(re.findall(r'^\| `(drfmcw_\w+\.[\w.]+)` \|', section('Packages and rooms'), re.MULTILINE))
    assert not rooms - listed


def test_modules_named_in_the_architecture_exist():
    for module in set(re.findall(r'`(drfmcw_\w+(?:\.[a-z]\w*)+)`', ARCHITECTURE)):
        assert importlib.util.find_spec(module), module


def test_packages_import_downward_only_as_documented():
    above = set()
    for layer in layers():
        above |= layer
        for package in layer:
            assert not imports(package) & above, package


def test_contracts_of_the_layers_are_those_of_the_document():
    settings = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))
    contracts = settings['tool'].get('importlinter', {}).get('contracts', [])
    stacks = [c['layers'] for c in contracts if c['type'] == 'layers' and 'containers' not in c]
    for stack in stacks:
        assert [set(re.findall(r'drfmcw_\w+', layer)) for layer in stack] == layers()


def test_bringup_imports_neither_diagnosis_nor_studies():
    assert not imports('drfmcw_bringup') & {'drfmcw_diagnosis', 'drfmcw_study', 'drfmcw_proof'}


def test_physics_imports_nothing_of_the_others():
    assert not imports('drfmcw_physics')


@pytest.mark.parametrize('document', DOCUMENTS, ids=name)
def test_stated_number_of_effects_is_that_of_the_registry(document):
    text = document.read_text(encoding='utf-8')
    for number in re.findall(r'\b(?:own|the|all|of) (\d+) effects\b(?! outside)', text):
        assert int(number) == len(Effect.registry)


def test_readme_states_the_number_of_effects():
    assert f'{len(Effect.registry)} effects' in (ROOT / 'README.md').read_text(encoding='utf-8')


def test_readme_has_at_most_130_lines():
    assert len((ROOT / 'README.md').read_text(encoding='utf-8').splitlines()) <= 130


@pytest.mark.parametrize('document', DOCUMENTS, ids=name)
def test_document_avoids_banned_words(document):
    for number, line in enumerate(document.read_text(encoding='utf-8').splitlines(), 1):
        for pattern, instead in BANNED:
            found = re.search(pattern, line, re.IGNORECASE)
            assert not found, f'{name(document)}:{number}: "{found[0]}"; write: {instead}'


def test_sources_avoid_banned_words():
    """An underscore separates words of a name as a space does those of a sentence."""
    assert len(SOURCES) > 300
    found = []
    for path in SOURCES:
        for number, line in enumerate(path.read_text(encoding='utf-8').replace('_', ' ').splitlines(), 1):
            here = [instead for pattern, instead in BANNED if re.search(pattern, line, re.IGNORECASE)]
            found += [f'{name(path)}:{number}: write {instead}' for instead in here]
    assert not found, '\n'.join(found)


def test_one_module_starts_worker_processes():
    for path in ROOT.glob('src/*/drfmcw_*/**/*.py'):
        if path.name != 'processes.py':
            found = re.search(r'ProcessPoolExecutor|\b(import|from) multiprocessing', path.read_text('utf-8'))
            assert not found, name(path)


def bare_constants(path):
    """Return names of a module's constants that are numbers, or collections of numbers, without unit and origin."""
    found = []
    for node in ast.parse(path.read_text(encoding='utf-8')).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, 'target', None)]
        value = getattr(node, 'value', None)
        for target in targets:
            if isinstance(target, ast.Name) and target.id.isupper() and isinstance(value, ast.Constant | ast.Tuple):
                numbers = [n.value for n in ast.walk(value) if isinstance(n, ast.Constant)]
                found += [target.id] if any(type(n) in (int, float) for n in numbers) else []
    return found


def test_constants_of_the_diagnosis_state_unit_and_origin():
    """They are fields of frozen dataclasses, each of which has a docstring of its own."""
    package = ROOT / 'src/drfmcw_diagnosis/drfmcw_diagnosis'
    for path in package.rglob('*.py'):
        assert not bare_constants(path), name(path)
    for path in package.rglob('limits.py'):
        for node in ast.parse(path.read_text(encoding='utf-8')).body:
            if not isinstance(node, ast.ClassDef):
                continue
            for field, text in itertools.pairwise(node.body):
                if isinstance(field, ast.AnnAssign):
                    said = ast.literal_eval(text.value) if isinstance(text, ast.Expr) else ''
                    where = f'{name(path)}: {node.name}.{field.target.id}'
                    assert re.search(r'\b(chosen|derived|measured)\b', said), where
            assert not isinstance(node.body[-1], ast.AnnAssign), f'{name(path)}: {node.name}'


def test_benchmarks_are_generated_from_their_figures(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / 'benchmarks'))
    from document import document

    results = json.loads((ROOT / 'docs/benchmarks.json').read_text(encoding='utf-8'))
    text = (ROOT / 'docs/benchmarks.md').read_text(encoding='utf-8')
    assert document(results) == text, 'run ./drfmcw bench report'


@pytest.mark.parametrize('document', DOCUMENTS, ids=name)
def test_pull_is_given_with_all_parameters_first(document):
    """The rms over all parameters comes before the one with ground reflections set aside."""
    text = document.read_text(encoding='utf-8')
    if re.search(r'\b1\.15 (over|without)', text):
        assert '34.13' in text.partition('1.15 ')[0]


def test_glossary_is_sorted_and_has_one_sentence_a_term():
    text = (ROOT / 'docs/glossary.md').read_text(encoding='utf-8')
    for table in text.split('\n## ')[1:]:
        rows = re.findall(r'^\| ([^|]+) \| ([^|]+) \|$', table, re.MULTILINE)[1:]
        terms = [term.lower() for term, _ in rows]
        assert terms == sorted(terms)
        assert all(meaning.endswith('.') and '. ' not in meaning for _, meaning in rows)


@pytest.mark.parametrize('document', ['README.md', 'docs/README.md'])
def test_glossary_is_linked(document):
    assert 'glossary.md' in (ROOT / document).read_text(encoding='utf-8')
