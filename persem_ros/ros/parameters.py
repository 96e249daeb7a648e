"""Settings as ROS parameters: declared with unit and range, checked, changed while mapping."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.ros.map_path import unusable
from persem_ros.ros.wording import as_ros
from persem_ros.settings.config import nearest, settings, topics_of, updated
from persem_ros.settings.config_file import comment, from_values, NODE_DEFAULTS, span
from persem_ros.settings.parameter_file import ROS_OWN
from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.parameter import Parameter

if TYPE_CHECKING:
    from persem_ros.settings.config import Config, Topics
    from rclpy.node import Node

FLAT = {'cameras': ('',)}       # settings whose empty list ROS could not type


class Parameters:
    """
    The settings of a node.

    The node is to be made with automatically_declare_parameters_from_overrides=True: that is how
    names that are not ours come to light.

    Parameters
    ----------
    node : rclpy.node.Node

    Attributes
    ----------
    config : Config
        What is in force.

    Raises
    ------
    PersemError
        For a value that does not fit: one sentence.

    """

    def __init__(self, node: Node) -> None:
        """Declare every setting with the value of file or command line, else its default."""
        self._node = node
        given = {name: plain(parameter.value)
                 for name, parameter in node.get_parameters_by_prefix('').items()
                 if not ROS_OWN.match(name)}
        base = from_values(NODE_DEFAULTS)
        shape = from_values({n: v for n, v in given.items() if n == 'cameras'}, base)
        known = {name for name, _, _ in settings(shape)}
        for name in sorted(set(given) - known):
            node.get_logger().warning(f'parameter {name!r} is not known{nearest(name, known)}; '
                                      'it has no effect')
        self.config = from_values({n: v for n, v in given.items() if n in known}, base)
        for name in given:
            node.undeclare_parameter(name)
        for name, value, meta in settings(self.config):
            node.declare_parameter(name, listed(name, value), _descriptor(name, value, meta),
                                   ignore_override=True)
        node.add_pre_set_parameters_callback(self._as_numbers)
        node.add_on_set_parameters_callback(self._check)

    def follow(self, changed: Callable[[Config], None]) -> None:
        """Have changed(config) called after every change."""
        def apply(parameters: list[Parameter]) -> None:
            values = self._ours(parameters)
            if values:
                self.config = updated(self.config, values)
                changed(self.config)
        self._node.add_post_set_parameters_callback(apply)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse values that do not fit, alone or together."""
        try:
            config = updated(self.config, self._ours(parameters))
        except PersemError as error:
            return SetParametersResult(successful=False, reason=as_ros(str(error)))
        problem = unusable(config) if config.map != self.config.map else ''
        return SetParametersResult(successful=not problem, reason=as_ros(problem))

    def _as_numbers(self, parameters: list[Parameter]) -> list[Parameter]:
        """Take whole numbers where doubles are meant: ROS types '2' and '[0, 0, 0]' as those."""
        kinds = {name: value for name, value, _ in settings(self.config)}
        return [_as_double(p, kinds.get(p.name)) for p in parameters]

    def _ours(self, parameters: list[Parameter]) -> dict[str, Any]:
        known = {name for name, _, _ in settings(self.config)}
        return {p.name: plain(p.value) for p in parameters if p.name in known}


def camera_topics(config: Config) -> dict[str, Topics]:
    """Return the topics by camera; the camera is '' where there is only one."""
    return {name: topics_of(config, name) for name in [n for n in config.cameras if n] or ['']}


def plain(value: Any) -> Any:
    """Return a parameter's value without array.array."""
    return list(value) if isinstance(value, (array, tuple)) else value


def listed(name: str, value: Any) -> Any:
    """Return a setting's value as ROS types it: a list that is never empty."""
    if isinstance(value, tuple):
        return list(value or FLAT.get(name, (-1,)))
    return value


def _as_double(parameter: Parameter, value: Any) -> Parameter:
    """Return a parameter with doubles in place of integers where *value* has doubles."""
    if parameter.type_ == Parameter.Type.INTEGER and isinstance(value, float):
        return Parameter(parameter.name, Parameter.Type.DOUBLE, float(parameter.value))
    if parameter.type_ == Parameter.Type.INTEGER_ARRAY and isinstance(value, tuple) \
            and value and isinstance(value[0], float):
        return Parameter(parameter.name, Parameter.Type.DOUBLE_ARRAY,
                         [float(item) for item in parameter.value])
    return parameter


def _descriptor(name: str, value: Any, meta: Mapping[str, Any]) -> ParameterDescriptor:
    """Return the description, range and read-only flag of a setting."""
    descriptor = ParameterDescriptor(description=comment(name, meta), read_only=not meta['live'])
    if meta['choices']:
        descriptor.additional_constraints = f'one of {span(meta)}'
    elif meta['low'] is not None and isinstance(value, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(meta['low']), to_value=float(meta['high']))]
    elif meta['low'] is not None and isinstance(value, int):
        descriptor.integer_range = [
            IntegerRange(from_value=meta['low'], to_value=meta['high'], step=1)]
    return descriptor
