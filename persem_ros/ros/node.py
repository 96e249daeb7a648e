"""The node: parameters in, messages to the worker, results out. Start here."""

import logging
from pathlib import Path

from persem_ros.core.memory.dump import dump
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.live import LiveIntake
from persem_ros.outputs.map import store
from persem_ros.ros.counters import Statistics
from persem_ros.ros.diagnostics import Diagnostics
from persem_ros.ros.images import ImageOutputs
from persem_ros.ros.inbox import Inbox
from persem_ros.ros.inputs import check_topics, Inputs
from persem_ros.ros.map import LATCHED, MapOutputs
from persem_ros.ros.parameters import Parameters
from persem_ros.ros.services import Services
from persem_ros.ros.watchdog import Watchdog
from persem_ros.ros.worker import Worker
from persem_ros.settings.legend import Legend, load_legend
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

LOOK = 0.1      # s between two looks at the graph, until every input is found


class Mapper(Node):
    """
    Maps what its topics bring.

    Its one executor thread only queues messages, answers services and looks at the graph; the
    Worker owns the map.

    """

    def __init__(self, **options):
        """Declare parameters, subscribe, advertise, start the worker."""
        super().__init__('mapper', automatically_declare_parameters_from_overrides=True, **options)
        self._handler = _forward(self.get_logger())
        self.parameters = Parameters(self)
        config = self.parameters.config
        check_topics(config)
        self.legend = load_legend(config.labels.legend) if config.labels.legend else Legend()
        self.statistics = Statistics()
        self.worker = Worker(config, self.statistics, _stored(config), self.context.ok)
        self.inbox = Inbox(config.sync, self.worker.lost)
        intake = LiveIntake(config, Decoder(), self.statistics.dropped, self.worker.jumped)
        self.maps = MapOutputs(self, config.frames.map, lambda: self.legend)
        cameras = [name for name in config.cameras if name] or ['']
        images = {name: ImageOutputs(self, name, lambda: self.legend) for name in cameras}
        self.inputs = Inputs(self, config, intake, self.inbox)
        self.worker.connect(self.inbox, intake, images, self.maps, self.inputs.all)
        self.triggers = Services(self, self.worker, lambda: self.legend)
        self._watchdog = Watchdog(self.inputs, self.statistics)
        self._diagnostics = Diagnostics(self, self.worker, self.inputs, self.inbox)
        self._images = images
        if not config.labels.legend:
            self.create_subscription(String, config.labels.topic, self._take_legend, LATCHED)
        self.parameters.follow(lambda changed: self.worker.call(self.worker.configure, changed))
        steady = Clock(clock_type=ClockType.STEADY_TIME)    # a paused /clock stops no timer
        self._looking = self.create_timer(LOOK, self._look, clock=steady)
        self.create_timer(1.0, self._tick, clock=steady)
        self.worker.start()

    def close(self):
        """Stop the worker, save the map if map.save says so."""
        self.worker.stop()
        self.triggers.close()
        config = self.worker.config
        if config.map.save and config.map.path:
            try:
                store.save(Path(config.map.path).expanduser(), dump(self.worker.memory), config,
                           self.legend)
                self.get_logger().info(f'saved {self.worker.memory.n_voxels} voxels to '
                                       f'{config.map.path}')
            except PersemError as error:
                self.get_logger().error(str(error))
        logging.getLogger('persem_ros').removeHandler(self._handler)

    def _look(self):
        """Follow the graph until every input has a publisher; _tick goes on once a second."""
        self.inputs.resolve()
        if self.inputs.settled:
            self._looking.cancel()

    def _tick(self):
        self.inputs.resolve()
        if not self.inputs.settled and self._looking.is_canceled():
            self._looking.reset()
        self.inputs.want_color(any('overlay' in out.wanted() for out in self._images.values()))
        self._watchdog.look()
        self._diagnostics.publish(self._watchdog.warned)

    def _take_legend(self, msg):
        """Use the legend of a topic; refuse what is none."""
        try:
            legend = Legend.from_yaml(msg.data, self.parameters.config.labels.topic)
        except PersemError as error:
            self.get_logger().warning(str(error))
            return
        if legend != self.legend:
            self.legend = legend
            self.maps.publish_legend()


def main(args=None):
    """Run the node until it is interrupted; return the exit status."""
    rclpy.init(args=args)
    node, status = None, 0
    try:
        node = Mapper()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except PersemError as error:
        rclpy.logging.get_logger('mapper').fatal(str(error))
        status = 1
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _stored(config):
    """Return the memory of map.path where map.load asks for it, else None."""
    if not (config.map.load and config.map.path):
        return None
    path = Path(config.map.path).expanduser()
    if config.map.save and not path.exists():       # the first of many sessions
        return None
    memory = store.load(path).memory(config)
    memory.new_session()
    return memory


class _Forward(logging.Handler):
    """Passes our own log records on to the node's logger."""

    def __init__(self, logger):
        super().__init__()
        # rclpy wants one severity per place in the code, hence one function per severity.
        self._by_level = {logging.DEBUG: logger.debug, logging.INFO: logger.info,
                          logging.WARNING: logger.warning, logging.ERROR: logger.error}

    def emit(self, record):
        """Log one record."""
        text = self.format(record)
        level = min(record.levelno, logging.ERROR)
        if level >= logging.ERROR:
            self._by_level[logging.ERROR](text)
        elif level >= logging.WARNING:
            self._by_level[logging.WARNING](text)
        elif level >= logging.INFO:
            self._by_level[logging.INFO](text)
        else:
            self._by_level[logging.DEBUG](text)


def _forward(logger):
    """Let everything of persem_ros be logged by *logger*; return the handler."""
    handler = _Forward(logger)
    logging.getLogger('persem_ros').addHandler(handler)
    logging.getLogger('persem_ros').setLevel(logging.DEBUG)
    return handler
