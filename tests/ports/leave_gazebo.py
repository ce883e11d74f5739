"""Speakers flood a topic and leave while their words wait half read; apart, since libzmq may abort its process."""

import time

from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import ProcessLeft, Received
from ullage.ports.gazebo.transport import TransportPeer

TOPIC, LATE_S = "/flood", 0.02


class Late(TransportPeer):
    """Busy for a moment between seeing that something waits and reading who left and what was said."""

    def _serve(self) -> None:
        time.sleep(LATE_S)
        super()._serve()


with Late() as listener:
    listener.subscribe(TOPIC)
    for _ in range(4):
        with TransportPeer() as speaker:
            speaker.advertise(TOPIC, "gz.msgs.Float_V")
            heard, end = 0, time.monotonic() + 5
            while heard < 50 and time.monotonic() < end:
                speaker.publish(TOPIC, gz().Float_V(data=[0.5] * 1000))
                event = listener.wait(0.002)
                heard += isinstance(event, Received)
        while not (isinstance(event := listener.wait(5.0), ProcessLeft) or event is None):
            pass
    time.sleep(4 * LATE_S)
    print("left", sorted(listener._joined))
