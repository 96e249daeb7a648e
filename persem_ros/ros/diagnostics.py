"""/diagnostics once a second: rates, latency, queue, drops, size of the map, last error."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from persem_ros.ros.inputs import TF_STATIC


class Diagnostics:
    """
    Publishes the node's state.

    Parameters
    ----------
    node : rclpy.node.Node
    worker : persem_ros.ros.worker.Worker
    inputs : persem_ros.ros.inputs.Inputs
    inbox : persem_ros.ros.inbox.Inbox

    """

    def __init__(self, node, worker, inputs, inbox):
        """Advertise the topic."""
        self._node, self._worker, self._inputs, self._inbox = node, worker, inputs, inbox
        self._out = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._counts, self._dropped = {}, 0

    def publish(self, silent=False):
        """Publish the state; *silent* says that the watchdog has warned."""
        array = DiagnosticArray(status=[self.status(silent)])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._out.publish(array)

    def status(self, silent=False):
        """Return the DiagnosticStatus of now; call it once a second."""
        statistics, memory = self._worker.statistics, self._worker.memory
        p50, p95 = statistics.latencies()
        dropped = statistics.dropped.total()
        values = {}
        for one in self._inputs.all:
            if one.role != TF_STATIC and one.subscriptions:
                values[f'{one.name} (Hz)'] = one.count - self._counts.get(one, 0)
                values[f'{one.name} messages'] = one.count
                self._counts[one] = one.count
        values.update({
            'frames (Hz)': f'{statistics.frame_rate():.1f}', 'frames': statistics.frames,
            'latency p50 (ms)': f'{1e3 * p50:.1f}', 'latency p95 (ms)': f'{1e3 * p95:.1f}',
            'queue messages': len(self._inbox), 'queue bytes': self._inbox.bytes,
            'dropped': dropped,
            **{f'dropped: {reason}': n for reason, n in sorted(dict(statistics.dropped).items())},
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
            level=level, name=f'{self._node.get_name()}: mapping', message=message,
            hardware_id='', values=[KeyValue(key=k, value=str(v)) for k, v in values.items()])

    def _verdict(self, dropped, silent):
        """Return level and message."""
        if not self._worker.ready.is_set():
            return DiagnosticStatus.WARN, 'compiling the kernels'
        if not self._worker.is_alive():
            return DiagnosticStatus.ERROR, 'the worker has ended'
        if silent:
            return DiagnosticStatus.WARN, 'no complete frame'
        if dropped > self._dropped:
            return DiagnosticStatus.WARN, f'{dropped - self._dropped} messages dropped'
        return DiagnosticStatus.OK, 'paused' if self._worker.paused else 'mapping'
