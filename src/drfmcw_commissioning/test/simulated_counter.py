"""A frequency counter that speaks SCPI over a TCP socket, for the tests."""

import socketserver
import threading

import numpy as np


class SimulatedCounter(socketserver.ThreadingTCPServer):
    """Answers *IDN? and MEAS:FREQ? of its inputs; on 127.0.0.1, at a free port."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, frequencies, std=0.0, seed=1, answer=None):
        """`frequencies` by input [Hz], read with `std` [1]; `answer` replaces every reading."""
        super().__init__(('127.0.0.1', 0), _Handler)
        self.frequencies, self.std, self.answer = frequencies, std, answer
        self.random = np.random.default_rng(seed)
        self.asked = []
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def address(self):
        return f'127.0.0.1:{self.server_address[1]}'

    def __exit__(self, *exception):
        self.shutdown()
        super().__exit__(*exception)

    def reply(self, query):
        self.asked.append(query)
        if query == '*IDN?':
            return 'Simulated,Counter,7,1.0'
        number = int(query.partition('(@')[2].rstrip(')'))
        if self.answer is not None:
            return self.answer
        return f'{self.frequencies[number] * (1.0 + self.std * self.random.standard_normal()):+.15E}'


class _Handler(socketserver.StreamRequestHandler):
    def handle(self):
        for line in self.rfile:
            reply = self.server.reply(line.decode().strip())
            if reply:
                self.wfile.write((reply + '\n').encode())
