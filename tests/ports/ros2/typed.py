"""A real rclpy node that speaks `imc_msgs`: publishes two messages 20 times, once both topics have a subscriber.

Argument: the namespace.
"""

from __future__ import annotations

import json
import sys
import time

from imc_msgs.msg import DesiredZ, LogBookControl, LogBookEntry
from stranger import node_of, repeat


def main() -> None:
    node = node_of("typed")
    height = DesiredZ(value=4.25, z_units=DesiredZ.Z_UNITS_HEIGHT)
    entries = [LogBookEntry(context="dive", text=text, htime=12.5) for text in ("first", "second")]
    book = LogBookControl(command=LogBookControl.COMMAND_REPLY, htime=2.0, msg=entries)
    wishes = [
        (node.create_publisher(type(message), f"{sys.argv[1]}/to_imc/{name}", 10), message)
        for name, message in (("height", height), ("book", book))
    ]
    while not all(publisher.get_subscription_count() for publisher, _ in wishes):
        time.sleep(0.05)
    repeat(wishes, 20)
    print(json.dumps(len(wishes)))


main()
