"""A node's parameters through its services, as `ros2 param` sees them."""

from __future__ import annotations

from typing import Any

import yaml
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python


class Remote:
    """A node's parameters, through its services."""

    def __init__(self, graph: Any, node: str) -> None:
        self.graph, self.node = graph, node

    def call(self, service: Any, name: str, **request: Any) -> Any:
        client = self.graph.probe.create_client(service, f'/{self.node}/{name}')
        self.graph.until(client.service_is_ready)
        future = client.call_async(service.Request(**request))
        self.graph.until(future.done)
        return future.result()

    def give(self, name: str, value: Any) -> str:
        """Set a parameter; return why not, '' if it was taken."""
        message = Parameter(name, value=value).to_parameter_msg()
        (result,) = self.call(SetParameters, 'set_parameters', parameters=[message]).results
        assert result.successful == (not result.reason)
        return str(result.reason)

    def get(self, name: str) -> Any:
        (value,) = self.call(GetParameters, 'get_parameters', names=[name]).values
        found = parameter_value_to_python(value)
        return found if found is None or isinstance(found, float) else list(found)

    def names(self) -> set[str]:
        return set(self.call(ListParameters, 'list_parameters').result.names)

    def dump(self) -> str:
        """Return what `ros2 param dump` prints: nested by dots, all values as YAML."""
        names = sorted(self.names())
        found: dict[str, Any] = {}
        values = self.call(GetParameters, 'get_parameters', names=names).values
        for name, value in zip(names, values, strict=True):
            *path, last = name.split('.')
            here = found
            for each in path:
                here = here.setdefault(each, {})
            here[last] = _plain(value)
        return str(yaml.dump({f'/{self.node}': {'ros__parameters': found}}))

    def give_text(self, name: str, text: str) -> str:
        """Set what `ros2 param set` makes of a text; return why not, '' if it was taken."""
        return self.give(name, yaml.safe_load(text))


def _plain(value: ParameterValue) -> Any:
    found = parameter_value_to_python(value)
    return found if isinstance(found, bool | int | float | str | None) else list(found)
