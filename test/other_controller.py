"""A controller of another make, in a process of its own: open62541's OPC UA client (o6), or pyModbusTCP's.

Neither shares code with the gateway's libraries, and neither knows anything of drfmcw. `ask` starts the process with an
order in JSON; `order` of `_o6` and `_modbus` say what it may hold.
"""

import importlib.util
import json
import struct
import subprocess
import sys
import time

LIMIT = 90.0  # of the process [s]; o6 loads for seconds on a busy machine
NAMESPACE = 'urn:drfmcw:gateway'
_NAMESPACES = 'i=2255'  # Server_NamespaceArray (OPC 10000-6, A.3)
_POLICY = 'http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256'
_SIGN_AND_ENCRYPT = 3  # MessageSecurityMode (OPC 10000-4, 7.20)


def ask(module, **order):
    """What a process with the client of `module` found; skips the test where the module is not installed."""
    return answer(started(module, **order))


def started(module, **order):
    """Start the process; `answer` waits for it."""
    import pytest

    if importlib.util.find_spec(module) is None:
        pytest.skip(f'no {module}: .venv/bin/python -m pip install --no-deps -r setup/controllers.txt')
    command = [sys.executable, __file__, module, json.dumps(order)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def answer(process):
    """What the process printed at its end."""
    out, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, out + err
    return json.loads(out.splitlines()[-1])


def certified(directory, trusted):
    """What an order for a secured connection holds: the client's own files, and the server's certificate."""
    from cryptography import x509

    certificate = directory / 'certificate.der'
    own = x509.load_der_x509_certificate(certificate.read_bytes())
    names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    uri = names.get_values_for_type(x509.UniformResourceIdentifier)[0]
    return {'certificate': str(certificate), 'key': str(directory / 'key.pem'), 'trusted': str(trusted), 'uri': uri}


def _o6(order):
    """Read, write and watch variables by OPC UA; {'refused': status code} where the server does not let the client in.

    Order: `url`; `certificate`, `key`, `trusted`, `uri` of a secured connection; names to `read`; (name, type, value)
    to `write`; a name to `watch` until its status code is `until`, for `seconds` at most.
    """
    import o6

    secured = {}
    if 'certificate' in order:
        secured = {
            'certificate': order['certificate'], 'privateKey': order['key'], 'trustList': [order['trusted']],
            'applicationUri': order['uri'], 'securityMode': _SIGN_AND_ENCRYPT, 'securityPolicy': _POLICY,
        }  # fmt: skip
    client = o6.Client(order['url'], **secured)
    try:
        client.connect()
    except o6.StatusCodeError as error:
        return {'refused': int(error.args[0])}
    seen = []
    try:
        index = list(client.read(_NAMESPACES)).index(NAMESPACE)

        def node(name):
            return f'ns={index};s={name}'

        def shown(data):
            return [None if data.value is None else float(data.value), int(data.status)]

        read = {name: shown(client.read(node(name), valueOnly=False)) for name in order.get('read', ())}
        written = {
            name: int(client.write(node(name), getattr(o6, kind)(value)))
            for name, kind, value in order.get('write', ())
        }
        if 'watch' in order:
            end = time.monotonic() + order['seconds']
            keep = lambda data: seen.append(shown(data))  # noqa: E731
            client.monitor(node(order['watch']), keep, 10.0, valueOnly=False, queueSize=100)
            while time.monotonic() < end and not (seen and seen[-1][1] == order['until']):
                time.sleep(0.01)
    finally:
        client.disconnect()
    return {'read': read, 'written': written, 'seen': seen}


def _modbus(order):
    """Read blocks of registers, write the heartbeat, read on until a word is there; answers are lists of words.

    Order: `port`; `read`, lists of first input register and count; `write`, a number for holding register 0; `until`,
    the value that the first register of the last block has in its low five bits, within `seconds`.
    """
    from pyModbusTCP.client import ModbusClient

    client = ModbusClient('127.0.0.1', order['port'], unit_id=1, timeout=LIMIT, auto_open=True)
    written = client.write_single_register(0, order['write']) if 'write' in order else None
    holding = client.read_holding_registers(0, 1)
    end = time.monotonic() + order.get('seconds', 0.0)
    while True:
        blocks = [client.read_input_registers(*block) for block in order['read']]
        if 'until' not in order or blocks[-1][0] & 31 == order['until'] or time.monotonic() >= end:
            break
        time.sleep(0.01)
    refused = client.read_input_registers(50, 1), client.last_except
    client.close()
    return {'blocks': blocks, 'written': written, 'holding': holding, 'refused': refused}


def float32(words):
    """The number in two registers, high word first."""
    return struct.unpack('>f', struct.pack('>2H', *words))[0]


if __name__ == '__main__':
    print(json.dumps({'o6': _o6, 'pyModbusTCP': _modbus}[sys.argv[1]](json.loads(sys.argv[2]))))
