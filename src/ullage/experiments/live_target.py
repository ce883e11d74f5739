"""What a live run listens to: one live port, or instruments and what gives their poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ullage.errors import InputError
from ullage.ports.cosimulation import rig_of
from ullage.ports.live import INSTRUMENTS, LISTED_POSES, Address


@dataclass(frozen=True, slots=True)
class LiveTarget:
    """Live ports that are received together."""

    addresses: tuple[Address, ...]
    poses: Address | None = None

    @classmethod
    def of(cls, sources: Sequence[str], poses: str = "") -> LiveTarget | None:
        """Return what several sources, or one beside a port of poses, name; None: one source of any kind.

        Args:
            sources: what `ullage run` is given.
            poses: a live port that gives poses; empty: none.

        Raises:
            InputError: a source is no instrument, or nothing gives poses at `poses`.
        """
        if len(sources) == 1 and not poses:
            return None
        found = [Address.of(source) for source in sources]
        for source, address in zip(sources, found, strict=True):
            if address is None or address.scheme not in INSTRUMENTS:
                what = f"{source!r} together with {'a port of poses' if poses else 'other sources'}"
                raise InputError(
                    what, where="run", allowed=f"instruments: {', '.join(f'{one}:' for one in INSTRUMENTS)}"
                )
        posed = Address.of(poses) if poses else None
        if posed is not None and (not posed.known or posed.part("poses") is None):
            raise InputError(f"no poses come from {poses!r}", where="--poses", allowed=LISTED_POSES)
        return cls(tuple(address for address in found if address is not None), posed)

    @property
    def kind(self) -> str:
        """Its schemes, for the name of a run."""
        return "-".join(dict.fromkeys(address.scheme for address in self.addresses))

    def __str__(self) -> str:
        """Return the places, for people."""
        places = ", ".join(map(str, self.addresses))
        return places if self.poses is None else f"{places} with poses of {self.poses}"

    def open(self, rig: str = "") -> Any:
        """Open the source.

        Args:
            rig: preset or file that has the mounts of instruments by name; empty: each has its own.

        Raises:
            InputError: a port, an option or the rig cannot be used.
        """
        addresses = list(self.addresses)
        if all(address.scheme in INSTRUMENTS for address in addresses):
            from ullage.ports.instruments.group import InstrumentGroup, mounted

            if rig:
                addresses = mounted(addresses, rig_of(rig, None, "", where="sensing.rig"))
            if len(addresses) > 1 or self.poses is not None:
                return InstrumentGroup(addresses, self.poses)
        return addresses[0].open("source")
