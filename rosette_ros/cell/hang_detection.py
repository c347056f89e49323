# SPDX-License-Identifier: Apache-2.0
"""Finds nodes of a cell that hang: their processes run, but their statuses stay away."""

import threading
import time

from rosette_ros.cell.client import GraphClient
from rosette_ros.cell.supervisor import Cell
from rosette_ros.nodes import qos
from rosette_ros.nodes.base_node import make_executor
from rosette_ros.nodes.liveliness import NodeMonitors, started

_STEP = 0.1


class HangDetector(GraphClient):
    """Receives the statuses of the nodes of a running cell, in a thread of its own; a context manager.

    Raises CellError where the graph cannot be joined."""

    def __init__(self, cell: Cell) -> None:
        super().__init__('supervisor', cell.domain_id, cell.namespace, make_executor)
        self._processes = cell.processes
        self._every = NodeMonitors(self._node)
        self._monitors = [self._every.of(name) for name in cell.processes]
        self._heard_none = time.monotonic()
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._spin, name='hang detector', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._is_closed.set()
        self._thread.join()
        super().close()

    def hanging(self) -> list[str]:
        """Return the nodes whose present process has published statuses, but none for HEARTBEAT_HANGS.

        A node that computes publishes them. None where no statuses at all were received within this time: then the
        fault is here, or all nodes stood still together. To be called often."""
        now = time.monotonic()
        if all(monitor.silence > qos.HEARTBEAT_LOST for monitor in self._monitors):
            self._heard_none = now
        if now - self._heard_none < qos.HEARTBEAT_HANGS:
            return []
        return [monitor.peer for monitor in self._monitors if monitor.silence > qos.HEARTBEAT_HANGS
                and monitor.process.startswith(started(monitor.peer, self._processes[monitor.peer].popen.pid))]

    def _spin(self) -> None:
        while not self._is_closed.is_set():
            self._executor.spin_once(timeout_sec=_STEP)
            self._every.watch()
