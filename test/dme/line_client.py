# SPDX-License-Identifier: Apache-2.0
"""A client that sends lines and reads lines, so that the server is tried by something that shares no code with it."""

import re
import socket


class LineClient:
    """A connection; lines: all that came, without CR LF."""

    def __init__(self, port):
        self._socket = socket.create_connection(('127.0.0.1', port), timeout=300)
        self._file = self._socket.makefile('rb')
        self._tag, self.lines = 0, []

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._file.close()
        self._socket.close()

    def send(self, data):
        """Send bytes, or a command with the next tag; return the tag."""
        if isinstance(data, bytes):
            self._socket.sendall(data)
            return ''
        self._tag += 1
        tag = f'E{self._tag:04d}' if data.split('(')[0].endswith('E') else f'{self._tag:05d}'
        self._socket.sendall(f'{tag} {data}\r\n'.encode())
        return tag

    def line(self):
        """Return the next line, '' at the end of the connection."""
        data = self._file.readline()
        assert not data or data.endswith(b'\r\n')
        self.lines.append(data.decode('latin-1').removesuffix('\r\n'))
        return self.lines[-1]

    def until(self, text):
        """Return the lines up to the one that begins with a text, or to the end of the connection."""
        out = []
        while not out or (out[-1] and not out[-1].startswith(text)):
            out.append(self.line())
        return out

    def ask(self, command):
        """Send a command and return what came until it was done, without its tag."""
        tag = self.send(command)
        return [line.removeprefix(f'{tag} ') for line in self.until(f'{tag} %')]

    def data(self, command):
        """Send a command that is done without an error and return its data in one text."""
        first, *data, last = self.ask(command)
        assert (first, last) == ('&', '%')
        assert all(line.startswith('#') for line in data), data
        return ' '.join(line[1:].strip() for line in data)

    def numbers(self, command):
        """Return the data of a command as numbers by name."""
        return {name: float(value) for name, value in re.findall(r'(\w+)\(([-+.\de]+)\)', self.data(command))}

    def error(self, command):
        """Send a command and return the number of its error."""
        first, error, last = self.ask(command)
        assert (first, last) == ('&', '%')
        return int(re.match(r'! Error\([01239], "?(\d{4})"?, "\w*", ".*"\)$', error)[1])
