"""Share one open link between a source and a sink of one program at one place."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Generic, Protocol, TypeVar


class Closable(Protocol):
    """Link that can be closed."""

    def close(self) -> None:
        """Close the link."""


L = TypeVar("L", bound=Closable)


class SharedLinks(Generic[L]):
    """Open links by key, each with the roles that use it. Each role uses a link once at most."""

    def __init__(self) -> None:
        self._open: dict[Hashable, tuple[L, set[str]]] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, role: str, make: Callable[[], L], *, usable: Callable[[L], bool]) -> tuple[L, bool]:
        """Return a usable link that this role does not use yet, or a new one, and whether it was open already.

        Args:
            key: of the place and all settings that the roles must have in common.
            role: that uses the link from now on.
            make: opens a new link.
            usable: whether an open link can still be used.
        """
        with self._lock:
            if found := self._open.get(key):
                link, roles = found
                if role not in roles and usable(link):
                    roles.add(role)
                    return link, True
            link = make()
            self._open[key] = link, {role}
            return link, False

    def leave(self, link: L, role: str) -> None:
        """Close a link, unless another role still uses it."""
        with self._lock:
            for key, (shared, roles) in list(self._open.items()):
                if shared is link:
                    roles.discard(role)
                    if roles:
                        return
                    del self._open[key]
        link.close()
