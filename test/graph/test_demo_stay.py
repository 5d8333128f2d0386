"""`demo --stay` serves the page with a live diagnosis until Ctrl-C; `run --parameters` loads what the page saves."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest
import rclpy
from checkout import ROOT
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from test_graph import STANDING, scenario_file
from websockets.sync.client import connect

from drfmcw_host.configure.parameter_file import save
from drfmcw_host.configure.values import Described

pytestmark = [pytest.mark.graph, pytest.mark.slow]

LIMIT = 90.0  # for anything that is waited for, on a busy machine [s]
SHORT = {'standing': {'distances': [100.0], 'sweeps': 60}}


def said(process, pattern):
    """Read a process's output up to a line; return its match and what came before."""
    before = ''
    for line in process.stdout:
        if found := re.search(pattern, line):
            return found, before
        before += line
    pytest.fail(f'ended without {pattern}: {before}')


def start(directory, module, *arguments):
    command = [sys.executable, '-u', '-m', module, *map(str, arguments)]
    environment = os.environ | {'COLUMNS': '200'}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=directory
    )


def test_demo_stays_with_page_and_watch_until_it_is_interrupted(tmp_path):
    path = scenario_file(tmp_path, SHORT, timing={'sweep_interval': 0.05})
    out = tmp_path / 'demo'
    with start(ROOT, 'drfmcw_bringup.demo', '--scenario', path, '--out', out, '--stay', '--port', 0) as process:
        try:
            found, before = said(process, r'open (http://127\.0\.0\.1:\d+/) in a browser')
            assert 'to join this graph: export ROS_DOMAIN_ID=' in before and 'Traceback' not in before
            address = found[1]
            with urllib.request.urlopen(address, timeout=LIMIT) as answer:
                assert answer.status == 200 and b'drfmcw' in answer.read()
            live = f'ws{address.removeprefix("http")}live?view=diagnosis'
            end, watched = time.monotonic() + LIMIT, []
            with connect(live, origin=address.rstrip('/')) as stream:
                while not watched:
                    assert time.monotonic() < end
                    watched = json.loads(stream.recv(LIMIT)).get('rows', {}).get('watch', [])
            assert watched[0][1] == 'master → slave'
            process.send_signal(signal.SIGINT)
            rest, _ = process.communicate(timeout=LIMIT)
            assert process.returncode in (0, 130) and 'Traceback' not in rest
            with pytest.raises(urllib.error.URLError):
                urllib.request.urlopen(address, timeout=5.0)
        finally:
            process.kill()


def test_run_loads_the_parameter_file_that_the_page_saves(tmp_path):
    given = {('/fusion', 'maximum_range'): 4321.5, ('/slave/station', 'spectrum_decimation'): 7}
    described = [Described(*key, type(v), v, '', '', -math.inf, math.inf, False) for key, v in given.items()]
    file = save(tmp_path, 'site', described)
    path = scenario_file(tmp_path, STANDING, timing={'sweep_interval': 0.05})
    with start(ROOT, 'drfmcw_bringup.run', path, '--parameters', file) as process:
        try:
            domain = int(said(process, r'export ROS_DOMAIN_ID=(\d+)')[0][1])
            loaded = {(node, name): parameter(domain, node, name) for node, name in given}
            assert loaded == given
            assert parameter(domain, '/master/station', 'spectrum_decimation') == 1  # is not in the file
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=LIMIT)


def parameter(domain, node, name):
    """A parameter of a running node, asked for by its service."""
    rclpy.init(args=[], domain_id=domain, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        asking = rclpy.create_node('asking')
        client = asking.create_client(GetParameters, f'{node}/get_parameters')
        assert client.wait_for_service(LIMIT), node
        answer = client.call_async(GetParameters.Request(names=[name]))
        executor = SingleThreadedExecutor()
        executor.add_node(asking)
        executor.spin_until_future_complete(answer, LIMIT)
        (value,) = answer.result().values
        asking.destroy_node()
        return parameter_value_to_python(value)
    finally:
        rclpy.utilities.try_shutdown()
