"""The fixtures of this folder."""

from .network import namespace, network

__all__ = ["namespace", "network"]
