"""Draw a random world and a flight in it."""

import ullage as ul

scene, path = ul.worlds.random("machines", 3), ul.worlds.flight("machines", 3)
scene.plot(path=path).figure.savefig("machines.png")
