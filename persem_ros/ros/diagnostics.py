"""/diagnostics once a second: rates, latency, queue, drops, size of the map, last error."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from persem_ros.preflight.findings import REFUSE
from persem_ros.ros.topic import TF_STATIC

if TYPE_CHECKING:
    from persem_ros.ros.inbox import Inbox
    from persem_ros.ros.inputs import Inputs
    from persem_ros.ros.topic import Input
    from persem_ros.ros.worker import Worker
    from rclpy.node import Node


class Diagnostics:
    """
    Publishes the node's state.

    Parameters
    ----------
    node : rclpy.node.Node
    worker : Worker
    inputs : Inputs
    inbox : Inbox

    """

    def __init__(self, node: Node, worker: Worker, inputs: Inputs, inbox: Inbox) -> None:
        """Advertise the topic."""
        self._node, self._worker, self._inputs, self._inbox = node, worker, inputs, inbox
        self._out = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._counts: dict[Input, int] = {}
        self._dropped = 0
        # As diagnostic_updater has it: node, then task; several robots share the topic.
        self._name = node.get_fully_qualified_name().lstrip('/')
        self._hardware = f'{socket.gethostname()}{node.get_namespace()}'.rstrip('/')

    def publish(self, silent: str = '') -> None:
        """Publish the state; *silent* is what the watchdog has warned of, '' for nothing."""
        array = DiagnosticArray(status=[self.status(silent), self.preflight()])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._out.publish(array)

    def status(self, silent: str = '') -> DiagnosticStatus:
        """Return that of now; call it once a second."""
        statistics, memory = self._worker.statistics, self._worker.memory
        p50, p95 = statistics.latencies()
        losses = statistics.losses()
        dropped = losses.total()
        values: dict[str, object] = {}
        for one in self._inputs.all:
            if one.role != TF_STATIC and one.subscriptions:
                values[f'{one.name} (Hz)'] = one.count - self._counts.get(one, 0)
                values[f'{one.name} messages'] = one.count
                if one.lost:
                    values[f'{one.name} lost on the way'] = one.lost
                self._counts[one] = one.count
        values.update({
            'frames (Hz)': f'{statistics.frame_rate():.1f}', 'frames': statistics.frames,
            'latency p50 (ms)': f'{1e3 * p50:.1f}', 'latency p95 (ms)': f'{1e3 * p95:.1f}',
            'queue messages': len(self._inbox), 'queue bytes': self._inbox.bytes,
            'dropped': dropped,
            **{f'dropped: {reason}': n for reason, n in sorted(losses.items())},
            'depth without labels': statistics.unused,
            'voxels': memory.n_voxels, 'observations': memory.n_observations,
            'forgotten voxels': statistics.forgotten,
            'map bytes': sum(memory.nbytes().values()), 'sessions': memory.session + 1,
            'refinements': statistics.refinements,
            'refinement (s)': f'{statistics.refined_in:.3f}',
            'refined voxels': statistics.visited, 'time jumps': self._worker.intake.jumps,
            'last error': statistics.error})
        level, message = self._verdict(dropped, silent)
        self._dropped = dropped
        return DiagnosticStatus(
            level=level, name=f'{self._name}: mapping', message=message,
            hardware_id=self._hardware,
            values=[KeyValue(key=k, value=str(v)) for k, v in values.items()])

    def preflight(self) -> DiagnosticStatus:
        """Return that of what the look at the first messages has found."""
        look = self._worker.first_look
        found = list(look.findings)
        levels = [DiagnosticStatus.ERROR if finding.severity == REFUSE else DiagnosticStatus.WARN
                  for finding in found]
        message = f'{len(found)} findings' if found else \
            'nothing found' if look.done else 'waiting for the first messages'
        return DiagnosticStatus(
            level=max(levels, default=DiagnosticStatus.OK), name=f'{self._name}: preflight',
            message=message, hardware_id=self._hardware,
            values=[KeyValue(key=f'{number} {finding.severity}', value=finding.text(live=True))
                    for number, finding in enumerate(found, 1)])

    def _verdict(self, dropped: int, silent: str) -> tuple[bytes, str]:
        """Return level and message."""
        if not self._worker.ready.is_set():
            return DiagnosticStatus.WARN, 'compiling the kernels'
        if not self._worker.is_alive():
            return DiagnosticStatus.ERROR, 'the worker has ended'
        if silent:
            return DiagnosticStatus.WARN, silent
        if dropped > self._dropped:
            return DiagnosticStatus.WARN, f'{dropped - self._dropped} messages dropped'
        return DiagnosticStatus.OK, 'paused' if self._worker.paused else 'mapping'
