"""Holders of locks on this machine according to the kernel: names of abstract sockets, and their listeners."""

import socket
import struct
from hashlib import sha256

LONGEST_SOCKET_NAME = 100  # bytes of an abstract socket's name; the kernel takes 107


def lock_of(key: str) -> bytes:
    """Return the address of the abstract socket that locks a name."""
    name = f"leactl/{key}".encode(errors="surrogateescape")
    if len(name) > LONGEST_SOCKET_NAME:
        name = f"leactl/{sha256(name).hexdigest()}".encode()
    return b"\0" + name


def holder(lock: bytes) -> tuple[int, int] | None:
    """Return the numbers of the process and the user that hold a lock; None if nobody does, or its queue is full."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.setblocking(False)
        try:
            client.connect(lock)
        except OSError:
            return None
        process, user, _group = struct.unpack("3i", client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return process, user
