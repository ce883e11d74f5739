"""A controller on an IMC bus sets the height of the multirotor: by asking for a height, or for a force."""

import socket
import threading
import time
from contextlib import suppress

import matplotlib.pyplot as plt

import ullage as ul
from ullage.ports.imc.codec import Packet, Parser, encode, make

PACE, STEP_S, FROM_M, TO_M = 3.0, 2.0, 1.0, 2.0


def height(state, wanted_m):
    return make("DesiredZ", value=wanted_m, z_units=2)


def force(state, wanted_m):
    """PD: a mass of 1.477 kg on a spring of 1.2 rad/s, damped by 0.9; z points down."""
    return make("DesiredControl", z=-1.477 * (1.44 * (wanted_m - state["alt"]) + 2.16 * state["vz"]), flags=4)


def controller(server, law):
    """What a DUNE with Transports.TCP.Server does, in one task."""
    client, _ = server.accept()
    parser, began = Parser(), None
    client.sendall(encode(Packet(make("Heartbeat"), time.time(), src=0x0803)))
    with suppress(OSError):
        while data := client.recv(65536):
            for packet in parser.feed(data):
                if packet.name == "EstimatedState":
                    began = began or packet.t_s
                    wanted_m = TO_M if packet.t_s - began > STEP_S else FROM_M
                    client.sendall(encode(Packet(law(packet, wanted_m), time.time(), src=0x0803)))


def flight(law):
    server = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=controller, args=(server, law), daemon=True).start()
    place = f"imc:tcp://127.0.0.1:{server.getsockname()[1]}"
    with ul.open(f"{place}?fly=hector&start=0,0,{FROM_M}&pace={PACE}&duration_s=12") as source:
        list(source.stream())
        return source.trajectory()


for law in (height, force):
    path = flight(law)
    z_m, t_s = path.position[:, 2] - FROM_M, (path.t_ns - path.t_ns[0]) * 1e-9 - STEP_S
    rise_s, over_m = t_s[z_m > 0.9][0] - t_s[z_m > 0.1][0], z_m.max() - 1
    print(f"{law.__name__}: rises in {rise_s:.2f} s, overshoots {max(over_m, 0):.3f} m, ends {z_m[-1] - 1:+.3f} m off")
    plt.plot(t_s, z_m, label=f"DUNE asks for a {law.__name__}")
    if not (rise_s < 3.5 and over_m < 0.15 and abs(z_m[-1] - 1) < 0.05):
        raise SystemExit(f"{law.__name__}: the step is not followed")
plt.xlabel("time after the step [s]")
plt.ylabel("height above the start [m]")
plt.legend()
plt.savefig("imc_height.png")
