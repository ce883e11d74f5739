"""A source and a sink at one place share a link; it closes when the last of them leaves."""

from __future__ import annotations

from dataclasses import dataclass

from ullage.ports.network import SharedLinks


@dataclass(eq=False)
class Link:
    closed: bool = False
    usable: bool = True

    def close(self) -> None:
        self.closed = True


def opened(links: SharedLinks[Link], key: str, role: str) -> tuple[Link, bool]:
    return links.get(key, role, Link, usable=lambda link: link.usable)


def test_two_roles_share_a_link_until_both_have_left() -> None:
    links: SharedLinks[Link] = SharedLinks()
    one, joined = opened(links, "here", "source")
    assert not joined
    assert opened(links, "here", "sink") == (one, True)
    assert opened(links, "there", "sink")[0] is not one
    links.leave(one, "source")
    assert not one.closed
    assert opened(links, "here", "source") == (one, True)
    links.leave(one, "source")
    links.leave(one, "sink")
    assert one.closed
    assert opened(links, "here", "source")[1] is False


def test_a_second_use_of_a_role_and_a_link_that_has_ended_get_a_new_link() -> None:
    links: SharedLinks[Link] = SharedLinks()
    one, _ = opened(links, "here", "source")
    second, joined = opened(links, "here", "source")
    assert (second is one, joined) == (False, False)
    second.usable = False
    assert opened(links, "here", "sink")[0] not in (one, second)
    links.leave(one, "source")  # no longer listed: closed for itself
    assert one.closed
