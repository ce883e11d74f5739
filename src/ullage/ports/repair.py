"""Finish recordings that a kill left unfinished: their index, and rosbag2's metadata.yaml next to them."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ullage.files import write_whole
from ullage.ports.bag import Topics, mcap_writer, write_metadata
from ullage.ports.replay import MAGIC, McapSource

TAIL = 8


def repair_bag(target: str | Path) -> str:
    """Give a killed bag its index and its metadata back.

    A folder without `metadata.yaml` whose MCAP file nobody writes any more gets both; everything else is left as it is.
    What can be read of the file is kept, message by message, under its own name once it is written whole.

    Args:
        target: a run's folder, a rosbag2 folder, or the MCAP file in one.

    Returns:
        What was done, in one line; empty where there was nothing to do.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    bag = _unfinished(Path(target))
    if bag is None:
        return ""
    with _owned(bag) as owned:
        if not owned:
            return ""
        finished, topics = _is_finished(bag), Topics()
        if finished:
            for _ in _copied(bag, None, topics):
                pass
        else:
            write_whole(bag, lambda out: list(_copied(bag, mcap_writer(out), topics)))
        if not topics.counts:
            return ""
        write_metadata(bag, topics)
    what = "metadata.yaml" if finished else "its index and metadata.yaml"
    return f"{bag.parent}: the recording was never finished; it has {what} now, with {topics.counts.total()} messages"


def _unfinished(target: Path) -> Path | None:
    """The MCAP file of a bag without a description."""
    folder = target if target.is_dir() else target.parent
    found = sorted(folder.glob("*.mcap")) if target.is_dir() else [target]
    alone = len(found) == 1 and len(list(folder.glob("*.mcap"))) == 1
    named = target.is_dir() or target.name == "frames.mcap"
    if not (alone and named and target.exists()) or (folder / "metadata.yaml").exists():
        return None
    with found[0].open("rb") as file:
        return found[0] if file.read(len(MAGIC)) == MAGIC else None


@contextmanager
def _owned(bag: Path) -> Iterator[bool]:
    """Return whether no process writes the file: a writer holds a lock until it ends, also by a kill."""
    try:
        file = open(bag, "rb")  # noqa: SIM115 (closed below)
    except OSError:
        yield False
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield os.access(bag.parent, os.W_OK)
    except BlockingIOError:
        yield False
    finally:
        file.close()


def _is_finished(bag: Path) -> bool:
    with bag.open("rb") as file:
        file.seek(max(bag.stat().st_size - TAIL, 0))
        return bag.stat().st_size > 2 * TAIL and file.read(TAIL) == MAGIC


def _copied(bag: Path, writer: Any, topics: Topics) -> Iterator[None]:
    """Count every message that can be read, and write it anew where there is a writer."""
    from mcap.records import Channel, Header, Message, Schema

    schemas: dict[int, tuple[str, int]] = {0: ("", 0)}  # name, and number in the copy
    channels: dict[int, tuple[str, int]] = {}
    started = False
    for record in McapSource(bag).records():
        if writer is not None and not started:
            profile = record.profile if isinstance(record, Header) else ""
            writer.start(profile=profile, library="ullage")
            started = True
        if isinstance(record, Schema) and record.id not in schemas:
            number = writer.register_schema(record.name, record.encoding, record.data) if writer is not None else 0
            schemas[record.id] = record.name, number
        elif isinstance(record, Channel) and record.id not in channels and record.schema_id in schemas:
            kind, schema = schemas[record.schema_id]
            number = (
                writer.register_channel(record.topic, record.message_encoding, schema, record.metadata) if writer else 0
            )
            channels[record.id] = record.topic, number
            topics.kinds[record.topic] = kind
            topics.offered[record.topic] = record.metadata.get("offered_qos_profiles", "")
        elif isinstance(record, Message) and record.channel_id in channels:
            topic, number = channels[record.channel_id]
            if writer is not None:
                writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
            topics.count(topic, record.log_time)
            yield
    if writer is not None and started:
        writer.finish()
