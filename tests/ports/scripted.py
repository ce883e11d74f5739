"""What a simulator would tell, told by a script."""


class Script:
    """A feed that tells what it was given, then nothing."""

    def __init__(self, events, newest_ns=0):
        self.events, self.given, self.newest_ns = list(events), [], newest_ns
        self.closed = self.ended = False

    def next(self, timeout_s):
        if self.ended:
            raise KeyboardInterrupt
        self.ended = not self.events
        return self.events.pop(0) if self.events else None

    def give(self, chunk, offset_ns):
        self.given.append((chunk, offset_ns))

    def close(self):
        self.closed = True
