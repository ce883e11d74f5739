"""Fly into a wall: contact is reported with place and time, and the wall is not flown through."""

import warnings

import ullage as ul

WALL_M = 2.0


def main() -> None:
    wall = ul.scenes.plate(width_m=4, height_m=4, distance_m=WALL_M, material="steel")
    through = ul.Waypoints([(0, 0, 0), (4, 0, 0)], speed_m_s=0.5, stop=True)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ul.UllageWarning)
        flown, log = ul.fly_log(through, scene=wall)
    print(told[0].message)
    wall.plot(path=flown).figure.savefig("fly_and_contact.png")

    if not log.contacts:
        raise SystemExit("the wall was not felt")
    if not abs(log.contacts[0].point[0] - WALL_M) < 0.02:
        raise SystemExit("contact is not where the wall stands")
    if not flown.position[:, 0].max() < WALL_M:
        raise SystemExit("the vehicle went through the wall")

    free = ul.fly(ul.Waypoints([(0, 0, 0), (1.2, 0, 0)], speed_m_s=0.5, stop=True), scene=wall)
    if not abs(free.position[-1, 0] - 1.2) < 0.03:
        raise SystemExit("a waypoint short of the wall is not reached")


if __name__ == "__main__":
    main()
