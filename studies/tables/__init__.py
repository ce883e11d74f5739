"""Tables and pictures of the documentation, each measured by its own script; not part of `make bench`."""
