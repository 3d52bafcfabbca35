"""Who holds a place on this machine, by the kernel's own word: names of abstract sockets, and who listens there."""

import socket
import struct
from hashlib import sha256

LONGEST_NAME = 100  # bytes of an abstract socket's name; the kernel takes 107


def lock_of(place: str) -> bytes:
    """The address by which a place is held."""
    name = f"leactl/{place}".encode(errors="surrogateescape")
    if len(name) > LONGEST_NAME:
        name = f"leactl/{sha256(name).hexdigest()}".encode()
    return b"\0" + name


def holder(lock: bytes) -> tuple[int, int] | None:
    """Process and user that hold a lock; None where nobody does, or nobody can be asked."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(lock)
        except OSError:
            return None
        process, user, _group = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return process, user
