"""Drives a lifecycle node by its services, as ros2cli does. Arguments: node, topic of Range to listen to."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Range
from stranger import node_of

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4


def main() -> None:
    name, topic = sys.argv[1:3]
    node = node_of("drive")
    heard: list[float] = []
    node.create_subscription(Range, topic, lambda message: heard.append(time.monotonic()), qos_profile_sensor_data)

    def call(kind: Any, service: str, request: Any) -> Any:
        client = node.create_client(kind, f"{name}/{service}")
        assert client.wait_for_service(timeout_sec=60.0), service
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
        node.destroy_client(client)
        return future.result()

    def change(transition: int) -> bool:
        request = ChangeState.Request()
        request.transition.id = transition
        return bool(call(ChangeState, "change_state", request).success)

    def state() -> str:
        return str(call(GetState, "get_state", GetState.Request()).current_state.label)

    def listen(until: int, most_s: float) -> int:
        heard.clear()
        end = time.monotonic() + most_s
        while len(heard) < until and time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.1)
        return len(heard)

    fine = change(CONFIGURE)
    first = [state(), fine]
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="ntnu-room")
    request = SetParameters.Request(parameters=[Parameter(name="simulate", value=value)])
    parameter = all(r.successful for r in call(SetParameters, "set_parameters", request).results)
    states, count = [], {}
    for transition in (CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE):
        change(transition)
        states.append(state())
        if states == ["inactive", "active"]:
            count["active"] = listen(10, 30.0)
        if transition == DEACTIVATE:
            listen(1, 1.0)
            count["inactive"] = listen(100, 2.0)
    print(json.dumps({"first": first, "parameter": parameter, "states": states, "heard": count}))


main()
