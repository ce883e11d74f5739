"""Files that tests of worlds read."""


def put(path, text):
    """Write text or bytes into a file, whose folder is made; its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path
