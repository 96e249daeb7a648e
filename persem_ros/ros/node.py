"""The node: parameters in, messages to the worker, results out. Start here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import logging
import threading
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard import limits
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.live import LiveIntake
from persem_ros.inputs.names import Names
from persem_ros.inputs.recording.kinds import roles_of
from persem_ros.inputs.sync.match import LABELS
from persem_ros.ros.clicked import ClickedPoint
from persem_ros.ros.counters import Statistics
from persem_ros.ros.diagnostics import Diagnostics
from persem_ros.ros.ending import Ending
from persem_ros.ros.first_look import FirstLook
from persem_ros.ros.grid import GridOutputs
from persem_ros.ros.images import ImageOutputs
from persem_ros.ros.inbox import Inbox
from persem_ros.ros.input_list import check_topics
from persem_ros.ros.inputs import Inputs
from persem_ros.ros.losses import Losses
from persem_ros.ros.map import MapOutputs
from persem_ros.ros.map_file import MapFile
from persem_ros.ros.mover import check_moves
from persem_ros.ros.parameters import Parameters
from persem_ros.ros.services import Services
from persem_ros.ros.watchdog import Watchdog
from persem_ros.ros.wording import as_ros
from persem_ros.ros.worker import Worker
from persem_ros.settings.config import topics_of
from persem_ros.settings.legend_files import load_legend
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

if TYPE_CHECKING:
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

LOOK = 0.1      # s between two looks at the graph, until every input is found
LATE = 'depth images come {:.1f} s after their stamp, or their clock is behind (chrony, PTP): ' \
       'then every frame gets a wrong pose'


# rclpy has types only where ROS is.
class Mapper(Node):     # type: ignore[misc]
    """
    Maps what its topics bring.

    Its one executor thread only queues messages, answers services and looks at the graph; the
    Worker owns the map.

    """

    def __init__(self, **options: Any) -> None:
        """Declare parameters, subscribe, advertise; `start` begins to work."""
        super().__init__('mapper', automatically_declare_parameters_from_overrides=True, **options)
        self._handler = _forward(self.get_logger())
        self.parameters = Parameters(self)
        config = self.parameters.config
        limits.use(config.inputs.max_pixels)
        check_topics(config)
        legend = load_legend(config.labels.legend) if config.labels.legend else None
        self._colors: tuple[Legend, tuple[int, ...], Legend] | None = None
        self.statistics = Statistics()
        self.map_file = MapFile(lambda: self.statistics.forgotten, lambda: self.legend)
        memory = self.map_file.begin(config)
        check_moves(config, memory)
        self.worker = Worker(config, self.statistics, memory)
        self.worker.renew = lambda: self.map_file.renew(self.worker.config)
        self.worker.replaced = self.map_file.follow
        self.inbox = Inbox(config.sync, self.worker.lost)
        decode = Decoder()
        self.intake = LiveIntake(config, decode, self.statistics.dropped, self.worker.jumped,
                                 lambda: self.get_clock().now().nanoseconds)
        self.intake.names = Names(config, legend or self.map_file.legend)
        self.maps = MapOutputs(self, config.frames.map, self.colors)
        cameras = [name for name in config.cameras if name] or ['']
        images = {name: ImageOutputs(self, name, self.colors, maps_clouds(config, name))
                  for name in cameras}
        self.inputs = Inputs(self, config, self.intake, self.inbox)
        self.worker.connect(self.inbox, self.intake, images, self.maps, self.inputs.all,
                            FirstLook(self.inputs.stations, Decoder(), lambda: self.legend))
        self.triggers = Services(self, self.worker, self.map_file)
        self._clicked = ClickedPoint(self)
        self._grid = GridOutputs(self)
        self._watchdog = Watchdog(self.inputs, self.statistics)
        self._losses = Losses(self.inputs.all)
        self._diagnostics = Diagnostics(self, self.worker, self.inputs, self.inbox)
        self._images = images
        self._late = False
        self.parameters.follow(self._configure)
        steady = Clock(clock_type=ClockType.STEADY_TIME)    # a paused /clock stops no timer
        self._looking = self.create_timer(LOOK, self._look, clock=steady)
        self.create_timer(1.0, self._tick, clock=steady)

    def start(self) -> None:
        """Begin to work."""
        self.get_logger().info(f'listening to {self.inputs.describe()}; results under '
                               f'{self.get_fully_qualified_name()}/')
        self.worker.start()

    def close(self) -> bool:
        """Stop the worker, save the map if map.save says so; return whether that went well."""
        self.worker.stop()
        self.triggers.close()
        self._grid.close()
        well = self.map_file.end(self.worker.config, self.worker.memory,
                                 self.statistics.frames > 0)
        logging.getLogger('persem_ros').removeHandler(self._handler)
        return well

    @property
    def legend(self) -> Legend:
        """Return the classes of the map."""
        return self.intake.names.legend

    def colors(self) -> Legend:
        """Return the legend with the ids that the settings ignore in grey, as a replay's."""
        key = self.legend, self.parameters.config.memory.ignore_labels
        if self._colors is None or self._colors[0] is not key[0] or self._colors[1] != key[1]:
            self._colors = *key, self.legend.ignoring(key[1])
        return self._colors[2]

    def _configure(self, config: Config) -> None:
        """Have the worker go on with changed settings."""
        limits.use(config.inputs.max_pixels)
        self.worker.call(self.worker.configure, config)

    def _look(self) -> None:
        """Follow the graph until every input has a publisher; _tick goes on once a second."""
        self.inputs.resolve()
        if self.inputs.settled:
            self._looking.cancel()

    def _tick(self) -> None:
        self.inputs.resolve()
        if not self.inputs.settled and self._looking.is_canceled():
            self._looking.reset()
        self.inputs.want_color(any('overlay' in out.wanted() for out in self._images.values()))
        if self.worker.ready.is_set():      # before that nothing can be complete
            self._watchdog.look()
        self._losses.look()
        late, before = self.intake.lateness, self._late
        self._late = late > 0
        if late and not before:
            self.get_logger().warning(LATE.format(late / 1e9))
        self._diagnostics.publish(self._watchdog.state)


def maps_clouds(config: Config, camera: str) -> bool:
    """Return whether a camera is a LiDAR with labelled clouds."""
    return roles_of(config, topics_of(config, camera))[LABELS] == 'points'


def main(args: list[str] | None = None, ending: Ending | None = None) -> int:
    """
    Run the node until it is asked to end; return the exit status.

    Parameters
    ----------
    args : list, optional
        The command line.
    ending : Ending, optional
        Hears the signals.

    """
    ending = ending or Ending()
    node: Mapper | None = None
    status = 0
    try:
        ending.begun = True
        # Our own handlers: ROS lives until the map is saved.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = Mapper()
        ending.patient = True
        with _spinning(node, ending):
            node.start()
            ending.wait()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except PersemError as error:
        rclpy.logging.get_logger('mapper').fatal(as_ros(str(error)))
        status = 1
    finally:
        ending.patient = True
        if node is not None:
            status = status if node.close() else 1
            node.destroy_node()
        rclpy.try_shutdown()
        ending.over()
    return status


@contextmanager
def _spinning(node: Node, ending: Ending) -> Iterator[None]:
    """
    Have an executor serve *node* on a thread; what ends that ends the node.

    The main thread stays free: only there Python hears signals, and only while it is not inside
    of the middleware.

    """
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    failure: list[BaseException] = []

    def spin() -> None:
        try:
            while not ending.wanted:
                executor.spin_once()
        except ExternalShutdownException:
            pass
        except BaseException as error:      # noqa: B902  told by the main thread
            failure.append(error)
        finally:
            ending.want()
    thread = threading.Thread(target=spin, name='executor')
    thread.start()
    try:
        yield
    finally:
        ending.want()
        executor.wake()
        thread.join()
        executor.shutdown()
    if failure:
        raise failure[0]


class _Forward(logging.Handler):
    """Passes our own log records on to the node's logger."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        # rclpy wants one severity per place in the code, hence one function per severity.
        self._by_level = {logging.DEBUG: logger.debug, logging.INFO: logger.info,
                          logging.WARNING: logger.warning, logging.ERROR: logger.error}

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record."""
        text = as_ros(self.format(record))
        level = min(record.levelno, logging.ERROR)
        if level >= logging.ERROR:
            self._by_level[logging.ERROR](text)
        elif level >= logging.WARNING:
            self._by_level[logging.WARNING](text)
        elif level >= logging.INFO:
            self._by_level[logging.INFO](text)
        else:
            self._by_level[logging.DEBUG](text)


def _forward(logger: Any) -> logging.Handler:
    """Let everything of persem_ros be logged by *logger*; return the handler."""
    handler = _Forward(logger)
    logging.getLogger('persem_ros').addHandler(handler)
    logging.getLogger('persem_ros').setLevel(logging.DEBUG)
    return handler
